#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# What may be wrong with a run of drun: each fault gives one line that names it and exit code 1 (bad usage: 2), and
# leaves no file behind, on the reference and, where there is one, on lavapipe. usage: faults_test.sh DRUN
set -euo pipefail
drun=$(realpath "$1")
source "$(dirname "${BASH_SOURCE[0]}")/in_folder.sh"
cat > fit.dr << 'END_OF_PROGRAM'
edition 1;
param x : float[W, H] = 0.0;
input goal : float[W, H];
let d = x - goal;
let error = mean(d * d);
step fit { x <- x - 0.5 * grad(error, x); output error, d; }
END_OF_PROGRAM
cat > mesh.dr << 'END_OF_PROGRAM'
edition 1;
input position : vec3[V];
input face : ivec3[F];
step look { output corner = position.at(face.x); }
step beside { output edge = topology(face, 3).edge; }
END_OF_PROGRAM
grep -v topology mesh.dr > corner.dr
cat > small.dr << 'END'
edition 1;
input x : float[W, H];
let halved = x.at(2 * coord(W, H / 2).xy) + float(coord(W, H / 2).y);
step look { output halved; }
END
cat > place.dr << 'END'
edition 1;
input position : vec3[V];
input face : ivec3[F];
step look { output seen = position.at(face.at(1).y); }
step other { output mean = mean(position); }
END
cat > outline.dr << 'END_OF_PROGRAM'
edition 1;
import std.coverage;
import std.mesh;
input position : vec3[V];
input face     : ivec3[F];
let across = mesh.neighbours(topology(face));
step look { output drawn = coverage.silhouette(vec4(position, 1.0), face, across, 16, 16); }
END_OF_PROGRAM
printf 'v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 7\n' > bad.obj
printf 'no array' > junk.npy
printf 'no bundle' > junk.drb
: > empty.drb
printf '\310\014\000\000\054\000\000\000DRB1' | tee bundle.dr > cut.drb
cat > divide.dr << 'END_OF_PROGRAM'
edition 1;
input top    : float[W, H];
input bottom : float[W, H];
param scale  : float = 1.0;
let blurred = 0.5 * shift(top, 1, 0) + 0.5 * top;
let share = blurred / (bottom - scale);
let near = shift(share, 1, 0) + share;
step go { scale <- scale + 1.0; output near, total = sum(near); }
END_OF_PROGRAM
cat > masked.dr << 'END_OF_PROGRAM'
edition 1;
input top    : float[W, H];
input bottom : float[W, H];
let share = top / bottom;
step go { output safe = select(isnan(share), 0.0, share); }
END_OF_PROGRAM
cat > listed.dr << 'END_OF_PROGRAM'
edition 1;
param tone  : float[64] = 0.0;
input where : float[W, H];
fn pick(i: float) -> float {
  var sum = 0.0;
  for k in 0..8 { sum = sum + exp(tone.at(int(i) + k) * float(k)); }
  sum
}
let blend = if where > 0.0 { pick(where) } else { 0.0 };
let error = sum(blend * blend * log((where - 0.1) * (where - 0.3)));
step fit { tone <- tone - grad(error, tone); }
END_OF_PROGRAM
printf '1,NaN\n' > nan.csv
mkdir folder folder.drb folder.npy

complain() {
  printf 'FAILED: drun %s: %s\n' "$1" "$2"
  sed 's/^/  out: /' out
  sed 's/^/  err: /' err
  failed=1
}
# expect STATUS TEXT ARGUMENTS...: drun ends so, and says TEXT in the first line on stderr, which is the only one unless
# the status is 2 (where usage follows); nothing on stdout, no file.
expect() {
  local want=$1 text=$2 status=0 lines
  shift 2
  rm -rf result
  timeout 60 "$drun" "$@" --out result > out 2> err || status=$?
  lines=$(wc -l < err)
  [[ $status == "$want" ]] || complain "$*" "exit code $status, expected $want"
  head -n 1 err | grep -qF -- "$text" || complain "$*" "stderr does not start with: $text"
  [[ $want == 2 || $lines == 1 ]] || complain "$*" "$lines lines on stderr"
  [[ ! -s out ]] || complain "$*" "something on stdout"
  [[ ! -d result || -z $(ls -A result) ]] || complain "$*" "files are left: $(ls -A result)"
}

goal='goal=[[1, 2], [3, 4]]'
faults() { # DEVICE
  local on=(--device "$1")
  expect 1 "cannot read 'folder': it is a folder" folder "${on[@]}"
  expect 1 "cannot read 'folder.drb': it is a folder" folder.drb "${on[@]}"
  expect 1 "cannot read 'missing.dr': no such file" missing.dr "${on[@]}"
  expect 1 "cannot read 'missing.drb': no such file" missing.drb "${on[@]}"
  expect 1 "'junk.drb': not a bundle" junk.drb "${on[@]}"
  expect 1 "'cut.drb': the bundle is cut off: it has 12 of 3284 bytes" cut.drb "${on[@]}"
  expect 1 "'bundle.dr' is a bundle" bundle.dr "${on[@]}"
  expect 1 'not a bundle' empty.drb "${on[@]}"
  expect 1 "'goal'" fit.dr "${on[@]}"
  expect 1 "'W' is 2 by" fit.dr "${on[@]}" --bind "$goal" --bind 'x=[[1, 2, 3]]'
  expect 1 "'W' is 4 by" fit.dr "${on[@]}" --bind "$goal" --symbol W=4
  expect 1 "symbol 'W'" fit.dr "${on[@]}" --bind "$goal" --symbol W=2x
  expect 1 "there is no symbol 'Q'; there are: H, W" fit.dr "${on[@]}" --bind "$goal" --symbol Q=3
  expect 1 "there is no leaf 'gaol' (did you mean 'goal'?)" fit.dr "${on[@]}" --bind "gaol=1"
  expect 1 "there is no step 'fti' (did you mean 'fit'?)" fit.dr "${on[@]}" --bind "$goal" --step fti
  expect 1 "there is no step 'paint'; there are: fit" fit.dr "${on[@]}" --bind "$goal" --step paint
  expect 1 "cannot read 'missing.npy': no such file" fit.dr "${on[@]}" --bind goal=missing.npy
  expect 1 "cannot read 'folder.npy': it is a folder" fit.dr "${on[@]}" --bind goal=folder.npy
  expect 1 "cannot read 'junk.npy'" fit.dr "${on[@]}" --bind goal=junk.npy
  expect 1 "0.5" mesh.dr "${on[@]}" --step look --bind 'position=[[0, 0, 0]]' --bind 'face=[[0.5, 1, 2]]'
  expect 1 'vertex index 7 is out of range' mesh.dr "${on[@]}" --step look --bind position=bad.obj:position --bind face=bad.obj:indices
  expect 1 "leaf 'face': element 1 names 3, but 'position' has 3 elements; if reading 0 there is meant, give --unchecked" \
    mesh.dr "${on[@]}" --step look --bind 'position=[[0, 0, 0], [1, 0, 0], [0, 1, 0]]' --bind 'face=[[0, 1, 2], [3, -1, 9]]'
  expect 1 "leaf 'face': element 0 names 3, but 'position' has 3 elements" \
    outline.dr "${on[@]}" --bind 'position=[[0, 0, 0], [1, 0, 0], [0, 1, 0]]' --bind 'face=[[0, 1, 3]]'
  expect 1 "leaf 'face': element 1 names 4, but 'position' has 2 elements" \
    place.dr "${on[@]}" --step look --bind 'position=[[0, 0, 0], [1, 0, 0]]' --bind 'face=[[9, 9, 9], [0, 4, 0]]'
  "$drun" place.dr "${on[@]}" --step other --bind 'position=[[0, 0, 0], [1, 0, 0]]' --bind 'face=[[9, 9, 9], [0, 4, 0]]' > out 2> err ||
    complain 'an index that the step does not read' "exit code $?"
  local made=" by leaf 'x'; made at small.dr:3"
  [[ $1 == reference ]] && made=
  expect 1 "where 'H' is 1$made" \
    small.dr "${on[@]}" --step look --bind 'x=[[1, 2]]'
  expect 1 "expected a file, or a number or list, after '='" mesh.dr "${on[@]}" --step look --bind face=
  expect 1 "expected a program, found data: 'bad.obj' can be bound to an input" bad.obj "${on[@]}"
  expect 1 'names -2,' \
    mesh.dr "${on[@]}" --step look --bind 'position=[[0, 0, 0], [1, 0, 0], [0, 1, 0]]' --bind 'face=[[-2, 1, 2]]'
  "$drun" corner.dr "${on[@]}" --unchecked --bind 'position=[[0, 0, 0]]' --bind 'face=[[-2, 1, 2]]' > out 2> err ||
    complain 'with --unchecked' "exit code $?"
  expect 1 'face 0 names the vertex 7 of 3 vertices' mesh.dr "${on[@]}" --step beside --bind 'face=[[0, 1, 7]]'
  expect 1 'face 0 names the vertex -7 of 3 vertices' mesh.dr "${on[@]}" --step beside --bind 'face=[[0, 1, -7]]'
  expect 2 "'goal' is given twice" fit.dr "${on[@]}" --bind "$goal" --bind 'goal=[[1]]'
  expect 2 "'K' is given twice, as '1' and '2'" fit.dr "${on[@]}" -D K=1 -D K=2
  expect 2 "'W' is given twice" fit.dr "${on[@]}" --bind "$goal" --symbol W=2 --symbol W=2
  expect 2 "expected name=value, found 'W'" fit.dr "${on[@]}" --bind "$goal" --symbol W
  expect 2 'expected a number of bytes' fit.dr "${on[@]}" --memory=99999999999999999999
  expect 2 "expected a number of bytes as 1000000, 512M or 2G, found '0'" fit.dr "${on[@]}" --memory=0
  expect 2 "found '9000000000G'" fit.dr "${on[@]}" --memory=9000000000G
  expect 2 "found '5X'" fit.dr "${on[@]}" --memory=5X
  expect 2 'expected a number of seconds' fit.dr "${on[@]}" --timeout=-3
  expect 2 'or never' fit.dr "${on[@]}" --checkpoint-every=often
  expect 2 'expected a number of runs' fit.dr "${on[@]}" --bind "$goal" --step fit=99999999999

  local named=0
  "$drun" fit.dr "${on[@]}" --bind "$goal" --out '' > out 2> err || named=$?
  [[ $named == 2 ]] && grep -q 'expected a folder, found nothing' err || complain "with --out ''" "exit code $named"

  # Results that found no room are no success.
  local status=0
  "$drun" fit.dr "${on[@]}" --bind "$goal" > /dev/full 2> err || status=$?
  [[ $status == 1 ]] && grep -q 'cannot write to stdout' err || complain 'to a full disk' "exit code $status"

  # NaN in data is a mistake, unless the user says otherwise: then the run goes on, and what it spoils says so. `null`
  # stands for it in the log.
  expect 1 "leaf 'goal': 'nan.csv' has NaN at element (1, 0, 0); if the program expects such, give --unchecked" \
    fit.dr "${on[@]}" --bind goal=nan.csv
  rm -rf result
  "$drun" fit.dr "${on[@]}" --unchecked --bind goal=nan.csv --out result > out 2> err || complain 'with NaN' "exit code $?"
  grep -q 'fit.error = nan' out && grep -q '"error": null' result/log.jsonl && [[ -s result/x.npy ]] ||
    complain 'with NaN' 'the results do not say so'
}

# The first number that is not finite, and the line that makes it: 0/0 in the second run.
finite() { # DEVICE
  local data=(--device "$1" --bind 'top=[[1, 2, 3], [4, 5, 6], [0, 0, 0]]' --bind 'bottom=[[3, 4, 3], [9, 9, 9], [5, 2, 5]]')
  "$drun" divide.dr "${data[@]}" --check-finite > out 2> err || complain 'with all finite' "exit code $?"
  local status=0
  for pack in fused naive; do
    status=0
    "$drun" divide.dr "${data[@]}" --step go=5 --pack $pack --check-finite --out result > out 2> err || status=$?
    [[ $status == 1 ]] || complain 'with 0/0' "exit code $status"
    grep -qE "drun: error: run 2 of step 'go': pass '[a-z_]*share[a-z_]*' stores NaN at element \(1, 2, 0\) of 'share'; lines divide.dr:" err ||
      complain 'with 0/0' 'does not say where'
    [[ $(sed -n 's/.*"done": \([0-9]*\).*/\1/p' result/checkpoint.json) == 2 ]] || complain 'with 0/0' 'the run is not counted'
    rm -rf result
  done
  # In naive packing the line is that of the op.
  grep -qE 'lines divide.dr:6$' err || complain 'with 0/0' 'does not name the line'
  # So is what is stored at the elements of a list alone: with branches apart, lavapipe adds it where it is computed.
  local listed=(listed.dr --device "$1" --scatter exact --no-skip branches)
  "$drun" "${listed[@]}" --bind 'where=[[1, 2, 3], [3, 0, 4]]' --check-finite > out 2> err || complain 'with a list' "exit code $?"
  status=0
  "$drun" "${listed[@]}" --bind 'where=[[1, 2, 3], [3, 0.2, 4]]' --check-finite > out 2> err || status=$?
  [[ $status == 1 ]] && grep -q "stores NaN at element (1, 1, 0) of" err || complain 'with a NaN in a list' 'does not say where'
  # What only its render pass needs is looked at too.
  local masked=(masked.dr --device "$1" --bind 'top=[[1, 0]]' --bind 'bottom=[[1, 0]]' --lower fragment --ablate substages,remat)
  "$drun" "${masked[@]}" > out 2> err || complain 'with a masked NaN' "exit code $?"
  status=0
  "$drun" "${masked[@]}" --check-finite > out 2> err || status=$?
  [[ $status == 1 ]] && grep -q "stores NaN at element (1, 0, 0) of 'share'" err || complain 'with a masked NaN' 'does not say where'
}
expect 1 'drc eval --check-finite' fit.dr --device reference --check-finite --bind "$goal"
faults reference
# No driver, where the loader is told to look.
VK_ICD_FILENAMES=/nowhere.json VK_DRIVER_FILES=/nowhere.json expect 1 'there is no Vulkan driver' fit.dr --bind "$goal"
if [[ -n ${DR_LAVAPIPE_ICD-} ]]; then
  export VK_ICD_FILENAMES=$DR_LAVAPIPE_ICD VK_DRIVER_FILES=$DR_LAVAPIPE_ICD
  expect 1 "no Vulkan device matches 'nonsense'; there are: llvmpipe" fit.dr --bind "$goal" --device nonsense
  expect 1 "no Vulkan device matches '7'" fit.dr --bind "$goal" --device 7
  faults llvmpipe
  finite llvmpipe
elif [[ -n ${CI-} ]]; then
  echo "DR_LAVAPIPE_ICD is not set"
  failed=1
fi
exit $failed
