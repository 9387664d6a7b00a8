#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# pose.sh BUILD_FOLDER [--device NAME] [--quick]: four cameras around Spot, each a degree turned and 1% of its distance moved from where it is thought
# to be, are found again from silhouettes of 256² (--quick: 128², 30 steps of 100), 16 x 16 samples a pixel: what is left of turn and shift, by exact coverage,
# by that and colours inside of outlines, and by distances to outlines. It wants Spot in
# $DR_SHARED_DATA, or shared/data beside the sources.
set -euo pipefail
source "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/suite.bash"
suite pose "$@"
no_more
size=256 steps=100
if [[ -n $quick ]]; then size=128 steps=30; fi
spot=${DR_SHARED_DATA:-$root/../shared/data}/obj/spot
if [[ ! -e $spot/cow.obj ]]; then echo "pose: skipped, there is no $spot/cow.obj"; exit 0; fi
"$bin/drun" "$here/cases/pose_target.dr" --device "$device" -D W=$size -D H=$size --bind "position=$spot/cow.obj:position" \
  --bind "face=$spot/cow.obj:indices" --bind "uv=$spot/cow.obj:uv" --bind "uv_face=$spot/cow.obj:uv_indices" \
  --bind "albedo=$spot/cow_texture.png" --step draw=16 --out "$out/target" > "$out/target.txt"
from=()
for leaf in position face uv uv_face view mask; do from+=(--bind "$leaf=$out/target/draw.$leaf.npy"); done
from+=(--bind "photo=$out/target/draw.image.npy")
ways=("0 false" "0 true" "1 false")
if [[ -n $quick ]]; then ways=("0 false"); fi
for which in "${ways[@]}"; do
  read -r way colors <<< "$which"
  "$bin/drun" "$here/cases/pose.dr" --device "$device" "${from[@]}" --bind "albedo=$spot/cow_texture.png" -D way=$way -D colors=$colors --step fit=$steps \
    --out "$out/fit_${way}_$colors" > "$out/fit_${way}_$colors.txt"
  tail -n 1 "$out/fit_${way}_$colors/log.jsonl"
done | tee "$out/figures.jsonl"
