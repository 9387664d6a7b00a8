#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# table4.sh BUILD_FOLDER [RUNS [SIZE...]]: a frame of a fit by silhouettes (table4.dr), forward and backward: microseconds while
# several are under way, for spheres of 682, 14,208 and 51,414 triangles. DR_DEVICE chooses the device; without it, lavapipe.
set -euo pipefail
build=$(cd "$1" && pwd)
runs=${2:-20}
sizes=("${@:3}")
if ((${#sizes[@]} == 0)); then sizes=(256 512 1024 2048); fi
here=$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")" && pwd)
out=$PWD/bench-out/table4
mkdir -p "$out"
if [[ -z ${DR_DEVICE-} && -n ${DR_LAVAPIPE_ICD-} ]]; then export VK_ICD_FILENAMES=$DR_LAVAPIPE_ICD VK_DRIVER_FILES=$DR_LAVAPIPE_ICD; fi
: > "$out.jsonl"
printf '%9s %6s %12s\n' triangles pixels 'us a frame'
for sphere in "31 12" "96 75" "209 124"; do
  read -r around rings <<< "$sphere"
  awk -v around="$around" -v rings="$rings" -f "$here/uv_sphere.awk" > "$out/sphere.obj"
  awk '/^v/ { print "v", 1.03 * $2 + 0.01, 0.97 * $3, $4; next } { print }' "$out/sphere.obj" > "$out/goal.obj"
  for size in "${sizes[@]}"; do
    us=$("$build/bin/drun" "$here/table4.dr" -D "size=$size" --device "${DR_DEVICE-}" --bind "position=$out/sphere.obj:position" \
      --bind "face=$out/sphere.obj:indices" --bind "goal=$out/goal.obj:position" --bind rate==1e-6 --step "frame=$runs" \
      --log-every "$runs" --timing --out "$out" | sed -n 's/^frame: \(.*\) us a run .*/\1/p')
    triangles=$((2 * around * (rings - 1)))
    printf '%9s %6s %12s\n' "$triangles" "$size" "$us"
    echo "{\"bench\": \"table4\", \"triangles\": $triangles, \"pixels\": $size, \"us\": $us}" >> "$out.jsonl"
  done
done
