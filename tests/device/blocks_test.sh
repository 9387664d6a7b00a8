#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Loops whose neighbours read the same run for blocks of elements, and on GPUs with reads that a workgroup does together:
# the same bits as element by element, close to the evaluator's, on every road. usage: blocks_test.sh DRC DRUN
set -euo pipefail
drc=$(readlink -f "$1") drun=$(readlink -f "$2")
profiles=$(readlink -f "$(dirname "${BASH_SOURCE[0]}")/../../compiler/target/profiles")
source "$(dirname "${BASH_SOURCE[0]}")/in_folder.sh"
if [[ -z ${DR_LAVAPIPE_ICD-}${DR_SWIFTSHADER_ICD-} ]]; then
  echo "neither DR_LAVAPIPE_ICD nor DR_SWIFTSHADER_ICD is set: blocks are left out"
  [[ -z ${CI-} ]] || exit 1
  exit 77
fi

cat > products.dr << 'E'
edition 1;
import std.nn;
import std.image;
import std.random;
// Extents that are known when data is bound, and are multiples of nothing.
param a : float[K, H] = random.uniform(coord(K, H), 1u) - 0.5;
param b : float[W, K] = random.uniform(coord(W, K), 2u) - 0.5;
param bias : float[W] = 0.1;
let c = nn.matmul(a, b);
let z = c + bias.at(coord(W, H).x);
let y = if z > 0.0 { z } else { 0.1 * z };
let e = sum(y * y);
step product { output c, y, ga = grad(e, a), gb = grad(e, b), gbias = grad(e, bias); }
// Gradients of gradients.
let slope = sum(grad(e, a) * grad(e, a));
step second { output sa = grad(slope, a), sb = grad(slope, b); }
step forward { output d = jvp(y, a, a * a); }
E
cat > kinds.dr << 'E'
edition 1;
import std.nn;
import std.image;
import std.random;
// Vectors as elements, layers as a batch, borders, loops in loops, minima, a loop that data ends.
param x : float[X, 23, 3] = random.uniform(coord(X, 23, 3), 1u);
param kernel : float[5, 3, 12] = random.uniform(coord(5, 3, 12), 2u) - 0.5;
let zero = nn.conv(x, kernel, image.zero);
let clamped = nn.conv(x, kernel, image.clamp);
let e = sum(zero * zero) + sum(clamped * clamped * clamped);
step borders { output zero, clamped, gx = grad(e, x), gk = grad(e, kernel); }

param v : vec3[19, Y] = vec3(random.uniform(coord(19, Y), 3u), random.uniform(coord(19, Y), 4u), 0.5);
param w : vec3[21, 19] = vec3(0.25, random.uniform(coord(21, 19), 5u), random.uniform(coord(21, 19), 6u));
let q = coord(21, Y);
let crossed = reduce(sum, k in 0..19) { cross(v.at(ivec2(k, q.y)), w.at(ivec2(q.x, k))) };
let f = sum(dot(crossed, crossed));
step vectors { output crossed, gv = grad(f, v), gw = grad(f, w); }

param p : float[13, Z, 5] = random.uniform(coord(13, Z, 5), 7u);
param r : float[11, 13, 5] = random.uniform(coord(11, 13, 5), 8u);
let z = coord(11, Z, 5);
let batched = reduce(sum, k in 0..13) { p.at(ivec3(k, z.y, z.z)) * r.at(ivec3(z.x, k, z.z)) };
let layers = reduce(sum, k in 0..13) { p.at(ivec2(k, z.y)) * r.at(ivec2(z.x, k)) };
step batches { output batched, layers, gp = grad(sum(batched * batched), p), gr = grad(sum(layers * layers), r); }

param from : vec2[N] = vec2(random.uniform(coord(N), 9u), random.uniform(coord(N), 10u));
param to : vec2[67] = vec2(random.uniform(coord(67), 11u), random.uniform(coord(67), 12u));
let here = from;
let nearest = reduce(min, j in 0..67) { dot(here - to.at(j), here - to.at(j)) };
let which = reduce(argmin, j in 0..67) { dot(here - to.at(j), here - to.at(j)) };
step nearest_of { output nearest, which, far = reduce(max, j in 0..67) { length(here - to.at(j)) }; }

// The loop's end changes along y: rows have trips of their own.
param t : float[40, 40] = random.uniform(coord(40, 40), 13u);
param across : float[U] = 1.0;
let u = coord(U, 40);
let triangle = across * reduce(sum, k in 0..u.y + 1) { t.at(ivec2(k, u.y)) * t.at(ivec2(u.x, k)) };
let branch = reduce(sum, k in 0..40) { if t.at(ivec2(k, u.y)) > 0.5 { t.at(ivec2(u.x, k)) } else { t.at(ivec2(k, u.x)) * 2.0 } };
let masked = reduce(sum, k in 0..40) { t.at(ivec2(k, u.y)) * t.at(ivec2(u.x + k - 20, k)) };
step shapes { output triangle, branch, masked, gt = grad(sum(triangle * triangle + branch * masked), t); }
E

# same NAME: the files of folders NAME.a and NAME.b have the same bytes.
same() {
  diff -rq -x checkpoint.json "$1.a" "$1.b" > said || { echo "$1: bits differ"; head -n 3 said; failed=1; }
}
# A device of this kind that reads together, as GPUs do: where trips are known, so that no dispatch ends before its loops.
sharing() {
  sed -e 's/"name": *"[a-z]*"/"name": "'"$1"'_sharing"/' -e 's/"lanes_in_turn": true/"lanes_in_turn": false/' "$profiles/$1.json" > "$1_sharing.json"
}
sed -e 's/\bK\b/45/g' products.dr > of_45.dr
sed -e 's/\bW\b/67/g; s/\bH\b/150/g' products.dr > to_67.dr
# both NAME PROFILE PROGRAM ARGUMENTS...: blocks and element by element.
both() {
  local name=$1 profile=$2 program=$3
  shift 3
  "$drun" "$program" --profile "$profile" "$@" --device "$wanted" --out "$name.a" > /dev/null
  "$drun" "$program" --profile "$profile" "$@" --device "$wanted" --ablate blocks --out "$name.b" > /dev/null
  same "$name"
}
sizes=(--symbol K=45 --symbol H=150 --symbol W=67)
products=(--step product --step second --step forward)
symbols=(--symbol X=37 --symbol Y=70 --symbol Z=17 --symbol N=301 --symbol U=33)
kinds=("${symbols[@]}" --step borders --step vectors --step batches --step nearest_of --step shapes)
for device in lavapipe swiftshader; do
  icd=DR_${device^^}_ICD
  [[ -n ${!icd-} ]] || continue
  export VK_ICD_FILENAMES=${!icd} VK_DRIVER_FILES=${!icd} wanted=0
  sharing "$device"
  for profile in "$device" "./${device}_sharing.json"; do
    short=${device}_$(basename "$profile" .json)
    both "$short.products" "$profile" products.dr "${sizes[@]}" "${products[@]}"
    both "$short.of_45" "$profile" of_45.dr --symbol H=150 --symbol W=67 "${products[@]}"
    both "$short.to_67" "$profile" to_67.dr --symbol K=45 "${products[@]}"
    both "$short.kinds" "$profile" kinds.dr "${kinds[@]}"
  done
  both "$device.naive" "./${device}_sharing.json" products.dr "${sizes[@]}" "${products[@]}" --pack naive
  both "$device.fragment" "$device" kinds.dr "${kinds[@]}" --lower fragment
  both "$device.drawn" "$device" products.dr "${sizes[@]}" "${products[@]}" --lower fragment
  # All of these are one computation.
  for road in "${device}_${device}_sharing.products" "${device}_$device.of_45" "${device}_${device}_sharing.of_45" "${device}_${device}_sharing.to_67" "$device.naive" "$device.drawn"; do
    cp -r "${device}_$device.products.a" roads.a
    cp -r "$road.a" roads.b
    same roads
    rm -r roads.a roads.b
  done
done

# The evaluator says the same, to rounding.
for device in lavapipe swiftshader; do
  for run in "products ${sizes[*]} ${products[*]}" "kinds ${kinds[*]}"; do
    read -r program arguments <<< "$run"
    folder=${device}_$device.$program.a
    [[ -d $folder ]] || continue
    # shellcheck disable=SC2086
    "$drc" eval "$program.dr" $arguments --out "$program.expected" > /dev/null
    /usr/bin/python3 - "$folder" "$program.expected" << 'E' || failed=1
import sys, pathlib, numpy as np
found, expected = map(pathlib.Path, sys.argv[1:])
files = sorted(p.name for p in expected.glob("*.npy"))
bad = 0
for name in files:
    a, b = (np.load(folder / name).astype(np.float64) for folder in (found, expected))
    off = np.abs(a - b).max() / max(np.abs(b).max(), 1e-30)
    if not off < 2e-5:
        print(f"{found}: {name} is off by {off:.2g}")
        bad = 1
sys.exit(bad or (0 if len(files) > 5 else 1))
E
  done
done

# Blocks are there, and GPUs read together; where only few elements are computed there are none.
"$drc" build products.dr --profile lavapipe --emit=schedule -o cpu.schedule
"$drc" build products.dr --profile nvidia-h200 --emit=schedule -o gpu.schedule
for program in of_45 to_67 kinds; do
  sed -e 's/"lanes_in_turn": true/"lanes_in_turn": false/' "$profiles/lavapipe.json" > shares.json
  "$drc" build $program.dr --profile ./shares.json --emit=schedule -o $program.schedule
  grep -q "read together" $program.schedule || { echo "$program: nothing is read together"; failed=1; }
done
# Also where maps run as fragments: those passes are compute passes then.
"$drc" build products.dr --profile nvidia-rtx2080 --emit=schedule -o drawn.schedule
grep -q "read together gather .* by 16 16 1 for " drawn.schedule || { echo "nvidia-rtx2080: reads together"; failed=1; }
grep -q "^    block " cpu.schedule && ! grep -q "read together" cpu.schedule || { echo "lavapipe: blocks"; failed=1; }
grep -q "read together gather .* by 16 16 1 for " gpu.schedule || { echo "nvidia-h200: reads together"; failed=1; }
exit $failed
