#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# table4.sh BUILD_FOLDER [ROUNDS [SIZE...]]: a frame of a fit by silhouettes (table4.dr), forward and backward: microseconds while
# several are under way, for spheres of 682, 14,208 and 51,414 triangles, beside the same frame written by hand
# (handwritten/), in turns in one process; exact sums and float atomics. The ratio is compiled over hand-written, the median
# of ROUNDS rounds; `apart` is how far the gradients are, relative L2. DR_DEVICE chooses the device; without it, lavapipe.
set -euo pipefail
build=$(cd "$1" && pwd)
rounds=${2:-9}
sizes=("${@:3}")
if ((${#sizes[@]} == 0)); then sizes=(256 512 1024 2048); fi
here=$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")" && pwd)
out=$PWD/bench-out/table4
mkdir -p "$out"
if [[ -z ${DR_DEVICE-} && -n ${DR_LAVAPIPE_ICD-} ]]; then export VK_ICD_FILENAMES=$DR_LAVAPIPE_ICD VK_DRIVER_FILES=$DR_LAVAPIPE_ICD; fi
: > "$out.jsonl"
"$build/bin/bench_handwritten" --heading
for sphere in "31 12" "96 75" "209 124"; do
  read -r around rings <<< "$sphere"
  awk -v around="$around" -v rings="$rings" -f "$here/uv_sphere.awk" > "$out/sphere.obj"
  awk '/^v/ { print "v", 1.03 * $2 + 0.01, 0.97 * $3, $4; next } { print }' "$out/sphere.obj" > "$out/goal.obj"
  for size in "${sizes[@]}"; do
    for scatter in exact atomic; do
      "$build/bin/bench_handwritten" "$out.jsonl" "$here/table4.dr" "${DR_DEVICE-}" "$rounds" "$scatter" "size=$size" -- \
        "position=$out/sphere.obj:position" "face=$out/sphere.obj:indices" "goal=$out/goal.obj:position" rate==1e-6 ||
        printf '%9s %6s %s: not measured\n' "$((2 * around * (rings - 1)))" "$size" "$scatter"
    done
  done
done
