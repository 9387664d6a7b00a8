#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# pose.sh BUILD_FOLDER [--device NAME] [--quick]: four cameras around Spot, each a degree turned and 1% of its distance moved from where it is thought
# to be, are found again from pictures of 256² (--quick: 128², 30 steps of 100) and the known textured mesh: what is left of turn and shift. It wants Spot in
# $DR_SHARED_DATA, or shared/data beside the sources.
set -euo pipefail
source "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/suite.bash"
suite pose "$@"
no_more
size=256 steps=100
if [[ -n $quick ]]; then size=128 steps=30; fi
spot=${DR_SHARED_DATA:-$root/../shared/data}/obj/spot
if [[ ! -e $spot/cow.obj ]]; then echo "pose: skipped, there is no $spot/cow.obj"; exit 0; fi
"$bin/drun" "$root/docs/examples/studio.dr" --device "$device" -D W=$size -D H=$size -D N=4 --bind "position=$spot/cow.obj:position" \
  --bind "face=$spot/cow.obj:indices" --bind "uv=$spot/cow.obj:uv" --bind "uv_face=$spot/cow.obj:uv_indices" \
  --bind "albedo=$spot/cow_texture.png" --step pictures --out "$out/target" > "$out/target.txt"
from=()
for leaf in position face uv uv_face view mask image; do from+=(--bind "$leaf=$out/target/pictures.$leaf.npy"); done
"$bin/drun" "$here/cases/pose.dr" --device "$device" "${from[@]}" --bind "albedo=$spot/cow_texture.png" --step fit=$steps \
  --out "$out/fit" > "$out/fit.txt"
tail -n 1 "$out/fit/log.jsonl" | tee "$out/figures.json"
