#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# pose.sh BUILD_FOLDER: four cameras around Spot, each a degree turned and 1% of its distance moved from where it is thought
# to be, are found again from pictures of 256² and the known textured mesh: what is left of turn and shift. It wants Spot in
# $DR_SHARED_DATA, or shared/data beside the sources.
set -euo pipefail
build=$(cd "$1" && pwd)
root=$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/../.." && pwd)
spot=${DR_SHARED_DATA:-$root/../shared/data}/obj/spot
if [[ ! -e $spot/cow.obj ]]; then echo "pose: skipped, there is no $spot/cow.obj"; exit 0; fi
out=$PWD/bench-out/pose
mkdir -p "$out"
if [[ -n ${DR_LAVAPIPE_ICD-} ]]; then export VK_ICD_FILENAMES=$DR_LAVAPIPE_ICD VK_DRIVER_FILES=$DR_LAVAPIPE_ICD; fi
"$build/bin/drun" "$root/docs/examples/studio.dr" -D W=256 -D H=256 -D N=4 --bind "position=$spot/cow.obj:position" \
  --bind "face=$spot/cow.obj:indices" --bind "uv=$spot/cow.obj:uv" --bind "uv_face=$spot/cow.obj:uv_indices" \
  --bind "albedo=$spot/cow_texture.png" --step pictures --out "$out/target" > "$out/target.txt"
from=()
for leaf in position face uv uv_face view mask image; do from+=(--bind "$leaf=$out/target/$leaf.npy"); done
"$build/bin/drun" "$root/tests/bench/pose.dr" "${from[@]}" --bind "albedo=$spot/cow_texture.png" --step fit=100 \
  --out "$out/fit" > "$out/fit.txt"
tail -n 1 "$out/fit/log.jsonl" | tee "$out/figures.json"
