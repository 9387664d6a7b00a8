#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# table4.sh BUILD_FOLDER [ROUNDS [SIZE...]] [--device NAME] [--quick]: a frame of a fit by silhouettes (table4.dr), forward and backward: microseconds while
# several are under way, for spheres of 682, 14,208 and 51,414 triangles, beside the same frame written by hand
# (handwritten/), in turns in one process; exact sums and float atomics. The ratio is compiled over hand-written, the median
# of ROUNDS rounds; `waited for` is the time of a frame that is submitted and waited for; `apart` is how far the gradients are, relative L2. --quick: 256² and 512², without the largest sphere.
set -euo pipefail
source "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/suite.bash"
suite table4 "$@"
default=9 sizes=(256 512 1024 2048) spheres=("31 12" "96 75" "209 124")
if [[ -n $quick ]]; then default=3 sizes=(256 512) spheres=("31 12" "96 75"); fi
rounds=${rest[0]:-$default}
if ((${#rest[@]} > 1)); then sizes=("${rest[@]:1}"); fi
: > "$out.jsonl"
"$build/bin/bench_handwritten" --heading
for sphere in "${spheres[@]}"; do
  read -r around rings <<< "$sphere"
  awk -v around="$around" -v rings="$rings" -f "$here/uv_sphere.awk" > "$out/sphere.obj"
  awk '/^v/ { print "v", 1.03 * $2 + 0.01, 0.97 * $3, $4; next } { print }' "$out/sphere.obj" > "$out/goal.obj"
  for size in "${sizes[@]}"; do
    for scatter in exact atomic; do
      "$build/bin/bench_handwritten" "$out.jsonl" "$here/cases/table4.dr" "$device" "$rounds" "$scatter" "size=$size" -- \
        "position=$out/sphere.obj:position" "face=$out/sphere.obj:indices" "goal=$out/goal.obj:position" rate==1e-6 ||
        printf '%9s %6s %s: not measured\n' "$((2 * around * (rings - 1)))" "$size" "$scatter"
    done
  done
done
