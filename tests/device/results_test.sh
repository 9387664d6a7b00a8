#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# What drun and drc eval leave behind: the same files under the same names, checked before anything runs; and what drun says of NaN and of
# commands that are not run again. On the reference and, where there is one, on lavapipe. usage: results_test.sh DRC DRUN
set -euo pipefail
drc=$(realpath "$1") drun=$(realpath "$2")
here=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
failed=0
fail() { printf 'FAILED: %s\n' "$*"; failed=1; }
same() { [[ $2 == "$3" ]] || fail "$1: expected '$2', found '$3'"; }

cat > two.dr << 'END'
edition 1;
param x : vec2[W] = vec2(1.0, 3.0);
param unused : float[Q];
state runs : int = 0;
let p = coord(4, 2).xy;
step first { x <- 0.5 * x; runs <- runs + 1; output total = sum(x) / 3.0, count = runs, frame = mat2(1.0, 0.0, 0.0, 2.0); }
step second { output total = sum(x), picture = vec3(p.x, p.y, 1) / 4.0, grey = float(p.x) / 3.0, number = p.x; }
END
both=(two.dr --symbol W=4 --step first=2 --step second)
"$drc" eval "${both[@]}" --out by_drc > drc.txt
"$drun" "${both[@]}" --device reference --out by_drun > drun.txt
expected='first.count.npy first.frame.npy first.total.npy results.txt runs.npy second.grey.npy second.grey.png second.number.npy second.picture.npy second.picture.png second.total.npy x.npy'
files() { (cd "$1" && find . -maxdepth 1 '(' -name '*.npy' -o -name '*.png' -o -name results.txt ')' | sed 's#^./##' | LC_ALL=C sort | tr '\n' ' ' | sed 's/ $//'); }
same 'files of drc eval' "$expected" "$(files by_drc)"
same 'files of drun' "$expected" "$(files by_drun)"
# Leaves that no step needs, where what they begin with is known.
cat > idle.dr << 'END'
edition 1;
import std.random;
param drawn : float[W] = random.uniform(coord(W), 1u);
param set : float[W] = 2.0;
state zero : float[4];
param sizeless : float[Q] = 1.0;
param unbound : float[3];
input x : float[W];
step look { output total = sum(x); }
END
"$drc" eval idle.dr --bind x=[1,2,3] --out idle_drc > drc_idle.txt
"$drun" idle.dr --bind x=[1,2,3] --device reference --out idle_drun > drun_idle.txt
same 'leaves that no step needs, drc eval' 'drawn.npy look.total.npy results.txt set.npy zero.npy' "$(files idle_drc)"
same 'leaves that no step needs, drun' "$(files idle_drc)" "$(files idle_drun)"
for file in $(files by_drc); do cmp "by_drc/$file" "by_drun/$file" || fail "$file differs"; done
grep -q "'<f8'" by_drc/first.total.npy || fail 'a number of the evaluator is no float64'
same 'prints of drun' $'first.total = (0.6666666666666666, 2)\nfirst.count = 1\nfirst.frame = (1, 0, 0, 2)\nsecond.total = (1, 3)' "$(cat drun.txt)"
same 'prints of drc eval' "$(sed -n '1,4p' drun.txt)" "$(tail -n 4 drc.txt)"

# What an older run left goes when a new one has ended; what is not of a run stays.
for tool in "$drc eval" "$drun --device reference"; do
  rm -rf again
  $tool two.dr --symbol W=4 --step first --step second --out again > /dev/null
  touch again/mine.npy
  $tool two.dr --symbol W=4 --step first --out again > /dev/null
  same "$tool: an older run's files" 'first.count.npy first.frame.npy first.total.npy mine.npy results.txt runs.npy x.npy' \
    "$(files again)"
done

# --save and --mesh: STEP.NAME, a leaf or a name that one step alone has; told before anything runs.
cat > shape.dr << 'END'
edition 1;
param position : vec3[3] = 1.0;
input face : ivec3[1];
step go { position <- 2.0 * position; output moved = position, total = 1.0; }
step say { output total = 2.0, face; }
END
shape=(shape.dr --bind 'face=[[0, 1, 2]]' --step go)
refuses() { # TEXT COMMAND...
  local text=$1 status=0
  shift
  "$@" > out 2> err || status=$?
  [[ $status == 1 && ! -s out ]] && grep -qF -- "$text" err || fail "expected '$text' of: $* ($status): $(cat out err)"
}
"$drun" "${shape[@]}" --device reference --save go.moved=m.npy --save position=p.csv --save total=t.npy --mesh a.glb=go.moved:face > /dev/null
same 'a leaf at the end' $'2,2,2\n2,2,2\n2,2,2' "$(cat p.csv)"
[[ -s m.npy && -s t.npy && -s a.glb ]] || fail '--save and --mesh wrote nothing'
for tool in "$drc eval" "$drun --device reference"; do
  go="$tool shape.dr --bind face=[[0,1,2]] --step go --step say"
  refuses "several steps have an output 'total': write go.total or say.total" $go --save total=t.npy
  refuses "did you mean 'position'" $go --save positon=t.npy
  refuses "there is no leaf 'say.total', and no such output of the steps that run" $tool "${shape[@]}" --save say.total=t.npy
  refuses "there is no folder 'none'" $go --save position=none/t.npy
  refuses "unknown extension '.pgn' (did you mean '.png'?)" $go --save position=t.pgn
  refuses 'a PNG holds floats' $go --save face=t.png
done
go=("$drun" "${shape[@]}" --device reference)
refuses "did you mean 'position'" "${go[@]}" --mesh a.glb=positon:face
refuses "'total' is not made of vec3" "${go[@]}" --mesh a.glb=total:face
refuses "a material has no 'rough'" "${go[@]}" --mesh a.glb=position:face:rough=total
refuses "there is a texture but no uv" "${go[@]}" --mesh a.glb=position:face:base_color_texture=total
refuses "an OBJ file cannot name 'a b.mtl'" "${go[@]}" --mesh "a b.obj=position:face:position:face:total"
refuses "there is no folder 'none'" "${go[@]}" --mesh none/a.glb=position:face
refuses "unknown extension '.fbx'" "${go[@]}" --mesh a.fbx=position:face

# A leaf and an output of one name are told apart by nobody.
cat > shared.dr << 'END'
edition 1;
struct S { velocity: float; }
optimizer momentum(rate) { state velocity = 0.0; update(x, g) { velocity <- 0.9 * velocity + g; x - rate * velocity } }
param p : float = 3.0;
step go { minimize p * p over p with momentum(rate = 0.1); output p = S(7.0); }
END
cat > counted.dr << 'END'
edition 1;
param p : float = 3.0;
step go { p <- p * 0.5; output step_index = 77; }
step look { output at = step_index of go; }
END
printf 'edition 1;\nparam p : float[N] = 3.0;\n' > stepless.dr
for tool in "$drc eval" "$drun --device reference"; do
  shares="is a leaf and an output of step 'go', and both would be one file of --out"
  refuses "'go.p.velocity' $shares" $tool shared.dr --out shared
  refuses "'go.step_index' $shares" $tool counted.dr --step go --step look --out shared
  refuses "'go.p.velocity' is a leaf and an output of step 'go': give" $tool shared.dr --save go.p.velocity=v.npy
done
refuses 'the program has no step' "$drun" stepless.dr --device reference
for size in 0 -3; do refuses "'N' is given as $size, at least 1 is expected" "$drc" eval stepless.dr --symbol N=$size; done

# Ctrl-C and SIGTERM leave what there is: the run at hand comes to its end.
cat > long.dr << 'END'
edition 1;
state count : int = 0;
step go { count <- count + 1; output count; }
step late { output one = 1.0; }
END
for signal in INT TERM; do
  rm -rf stopped count.csv out
  "$drc" eval long.dr --step go=1000000000 --step late --out stopped --save count=count.csv --save late.one=one.npy > out 2> err &
  for ((wait = 0; wait < 240; ++wait)); do [[ -s out ]] && break; sleep 0.05; done
  kill -$signal $!
  status=0; wait $! || status=$?
  [[ $status == $(($(kill -l $signal) + 128)) && -s stopped/count.npy && -s count.csv && ! -e one.npy ]] ||
    fail "drc eval, SIG$signal: $status $(cat err)"
  same "drc eval, SIG$signal: words" 2 "$(grep -c "^warning: stopped by a signal\|^warning: --save: 'one.npy' is not written" err)"
done

# A file that finds no room costs no other one, and no run; what is there is whole lines. Words come once.
cat > room.dr << 'END'
edition 1;
param x : float[N] = 0.0;
let error = sum((x - 1.0) * (x - 1.0));
step fit { x <- x - 0.1 * grad(error, x); output error, seen = x; }
END
room=("$drun" room.dr --device reference --symbol N=4 --log-every 1)
rm -rf full x.csv && mkdir full && ln -s /dev/full full/log.jsonl
status=0; "${room[@]}" --step fit=30 --out full --save x=x.csv > out 2> err || status=$?
same 'a full disk: the code' 1 "$status"
same 'a full disk: words' $'drun: warning: cannot write \'full/log.jsonl\': No space left on device\ndrun: error: cannot write \'full/log.jsonl\': No space left on device; --resume writes it without running again' "$(cat err)"
[[ -s x.csv && -s full/x.npy && -s full/fit.seen.npy ]] || fail "a full disk: $(ls . full)"
rm full/log.jsonl
"${room[@]}" --step fit=30 --out full --resume > /dev/null 2> err || fail "a log that found no room: $(cat err)"
same 'a log that found no room' 30 "$(wc -l < full/log.jsonl)"
# No file may have more than a kilobyte: the log has that of whole lines, checkpoints are said to be missing once.
rm -rf small x.csv
status=0
(ulimit -f 1; trap '' XFSZ; exec "${room[@]}" --step fit=100 --checkpoint-every 10 --out small --save x=x.csv > out 2> err) || status=$?
same 'a small disk: the code' 1 "$status"
same 'a small disk: warnings' 2 "$(grep -c '^drun: warning: ' err)"
grep -q "^drun: warning: no checkpoint, and the run goes on: cannot write 'small/checkpoint-[01]/log.jsonl': File too large" err || fail "a small disk: $(cat err)"
lines=$(wc -l < small/log.jsonl)
same 'a small disk: whole lines' "$lines" "$(grep -c '^{.*}$' small/log.jsonl)"
[[ $lines -gt 5 && -s x.csv && -s small/x.npy && ! -e small/checkpoint-1 ]] || fail "a small disk: $(ls . small)"
"${room[@]}" --step fit=100 --out small --resume > /dev/null 2> err || fail "after a small disk: $(cat err)"
same 'after a small disk' 100 "$(wc -l < small/log.jsonl)"
rm -rf full n.csv && mkdir -p full/results.txt
status=0; "$drc" eval room.dr --symbol N=4 --out full --save fit.seen=n.csv > out 2> err || status=$?
[[ $status == 1 && -s n.csv ]] || fail "drc eval, a full disk: $status $(cat err)"
same 'drc eval, a full disk: words' "error: cannot write 'full/results.txt': it is a folder" "$(cat err)"
# A folder that cannot be made, or takes no files, is told before anything runs.
touch file
for tool in "$drc eval" "$drun --device reference"; do
  refuses "cannot make the folder 'file': Not a directory" $tool room.dr --symbol N=4 --out file
  [[ -w /sys ]] || refuses "nothing can be written into the folder '/sys'" $tool room.dr --symbol N=4 --out /sys
done
# The folder of --out is made before files are written into it.
rm -rf fresh
"${room[@]}" --out fresh --save x=fresh/mine.csv --mesh fresh/a.glb=x:x > out 2> err && fail 'a mesh of floats is written'
grep -q "'x' is not made of vec3" err || fail "--out makes the folder: $(cat err)"
"${room[@]}" --out fresh --save x=fresh/mine.csv > /dev/null && [[ -s fresh/mine.csv ]] || fail '--save into the folder of --out'

# A step that only writes a param does not want it bound; one that reads it first does.
cat > start.dr << 'END'
edition 1;
param x : float[W];
step start { x <- float(coord(W).x); }
step fit { x <- x + 1.0; output total = sum(x); }
END
nan() { # DEVICE
  same "$1: a step that only writes" 'fit.total = 6' "$("$drun" start.dr --device "$1" --symbol W=4 --step start --step fit)"
  refuses "'x'" "$drun" start.dr --device "$1" --symbol W=4 --step fit --step start
  # NaN in a param or a loss is told while steps run, once, and --strict-finite stops there.
  "$drun" nan.dr --device "$1" --step fit=60 > out 2> err || fail "$1: NaN is no warning: $(cat err)"
  same "$1: warnings" 1 "$(grep -c "^drun: warning: 'x' has NaN at element (2, 0, 0) after run [0-9]* of step 'fit': --check-finite names" err)"
  local status=0
  "$drun" nan.dr --device "$1" --step fit=60 --strict-finite --out strict > out 2> err || status=$?
  [[ $status == 1 ]] && grep -q 'after run [0-9]* of' err || fail "$1: --strict-finite: $status $(cat err)"
  # It keeps what there is, as every end before the last run does; a step that did not run has nothing.
  status=0
  rm -rf strict asked.npy
  "$drun" kept.dr --device "$1" --step fit=60 --step late --strict-finite --log-every 1 --out strict --save x=asked.npy late.one=late.npy > out 2> err || status=$?
  [[ $status == 1 && -s strict/checkpoint.json && -s strict/x.npy && -s strict/fit.total.npy && -s asked.npy && ! -e late.npy ]] ||
    fail "$1: --strict-finite keeps $(ls strict): $(cat err)"
  same "$1: lines before a NaN" "$(seq -f '{"step": "fit", "run": %g,' 5)" "$(grep -v null strict/log.jsonl | cut -d ' ' -f 1-4)"
  status=0
  "$drun" loss.dr --device "$1" --step fit=60 --strict-finite > out 2> err || status=$?
  # The root is no number from run 7 on. Lines come after run 1 and 11, and between them on a machine that is slow.
  [[ $status == 1 ]] && grep -Eq "output 'fit.error' is nan in run ([789]|1[01]):" err || fail "$1: a loss: $status $(cat err)"
}
# Whether drun told of the Inf by its pass, or by what holds it, where it happened to look right behind that run.
is_told() { # PROGRAM
  grep -Eq "^drun: warning: (pass '.*' \($1:[0-9, a-z.:]*\) left a NaN or Inf by run [0-9]* of step 'fit'|'x' has |output 'fit\.[a-z]*' is -?inf)" err
}
# One run of many leaves an Inf that the next one overwrites: the pass tells it on the device. Another cause is told at once.
at_once() { # DEVICE
  "$drun" once.dr --device "$1" --step fit=400 --log-every 1000 > out 2> err || fail "$1: once: $(cat err)"
  is_told once.dr || fail "$1: an Inf of one run: $(cat err)"
  local status=0
  "$drun" once.dr --device "$1" --step fit=400 --log-every 1000 --strict-finite > out 2> err || status=$?
  same "$1: an Inf stops" 1 "$status"
  "$drun" once.dr --device "$1" --step fit=90 --strict-finite > out 2> err || fail "$1: finite: $(cat err)"
  # So it is where an invocation takes several elements in turn, the last of 40,001 too.
  "$drun" turns.dr --device "$1" --symbol W=40001 --step fit=60 --log-every 1000 > out 2> err || fail "$1: turns: $(cat err)"
  is_told turns.dr || fail "$1: an Inf of one element: $(cat err)"
  same "$1: all elements in turn" 'fit.total = 40001' "$(cat out)"
}
cat > once.dr << 'END'
edition 1;
param x : vec3[100] = vec3(1.0);
let error = mean(dot(x, x));
step fit {
  x <- x - 0.1 * grad(error, x);
  output loss = error / (if step_index == 99 { 0.0 } else { 1.0 });
}
END
cat > turns.dr << 'END'
edition 1;
param x : float[W] = 1.0;
step fit {
  x <- 1.0 / (if step_index == 49 && coord(W).x == W - 1 { 0.0 } else { clamp(x, 1.0, 1.0) });
  output total = sum(x);
}
END
cat > nan.dr << 'END'
edition 1;
param x : float[4] = 1.0;
let i = coord(4).x;
step fit { x <- if i == 2 { sqrt(x - 0.4) } else { x }; }
END
cat > kept.dr << 'END'
edition 1;
param x : float[4] = 1.0;
let i = coord(4).x;
step fit { x <- if i == 2 { sqrt(x - 0.4) } else { x }; output total = sum(x); }
step late { output one = 1.0; }
END
cat > loss.dr << 'END'
edition 1;
state x : float = 5.0;
step fit { x <- x - 1.0; output error = sqrt(x); }
END
same 'drc eval: a step that only writes' 'fit.total = 6' "$("$drc" eval start.dr --symbol W=4 --step start --step fit)"
refuses "param 'x' : float[W] has no data" "$drc" eval start.dr --symbol W=4 --step fit --step start
nan reference
if [[ -n ${DR_LAVAPIPE_ICD-} ]]; then
  export VK_ICD_FILENAMES=$DR_LAVAPIPE_ICD VK_DRIVER_FILES=$DR_LAVAPIPE_ICD
  nan llvmpipe
  at_once llvmpipe
  "$drun" "${both[@]}" --device llvmpipe --out by_device > device.txt
  same 'files of a device' "$expected" "$(files by_device)"
  same 'prints of a device' "$(sed 's/0.6666666666666666/0.6666667/' drun.txt)" "$(cat device.txt)"
  grep -q "'<f4'" by_device/first.total.npy || fail 'a number of the device is no float32'
  # Where nothing depends on what changed, nothing runs again.
  "$drun" two.dr --device llvmpipe --symbol W=4 --step second=3 --timing > timing.txt
  grep -q '^second: nothing ran: all that it gives was there from the run before' timing.txt || fail "--timing: $(cat timing.txt)"
  # A clear is said to touch what it writes: here the bits of all pixels and the five words at a list's head, by two fills or by one
  # dispatch.
  cat > drawn.dr << 'END'
edition 1;
param size : float[100] = 3.0;
struct Triangle { a: vec2; b: vec2; c: vec2; }
let seen = raster(100, 64, 64, 1) {
  setup(f) -> Triangle {
    let at = vec2(float(f % 10), float(f / 10)) * 6.0;
    Triangle(at, at + vec2(size.at(f), 0.0), at + vec2(0.0, size.at(f)))
  }
  corner(s, c) -> vec2 { [s.a, s.b, s.c][c] }
  depth(s, p) -> float { 0.5 }
}[0];
step draw { output covered = sum(if seen.face >= 0 { 1.0 } else { 0.0 }); }
END
  sed 's/"subgroup_size": *8/"subgroup_size": 32/' "$here/../../compiler/target/profiles/lavapipe.json" > wide.json
  for profile in lavapipe wide.json; do
    "$drun" drawn.dr --device llvmpipe --profile $profile --raster compute --timing > timing.txt
    awk '/  clear / { print $3 }' timing.txt | sort -n | paste -s -d ' ' > "cleared_$profile"
  done
  same 'bytes of two clears' '20 512' "$(cat cleared_lavapipe)"
  same 'bytes of two clears in one' '532' "$(cat cleared_wide.json)"
fi
if [[ -n ${DR_SWIFTSHADER_ICD-} ]]; then
  VK_ICD_FILENAMES=$DR_SWIFTSHADER_ICD VK_DRIVER_FILES=$DR_SWIFTSHADER_ICD at_once SwiftShader
fi
exit $failed
