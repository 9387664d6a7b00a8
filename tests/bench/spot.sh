#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# spot.sh BUILD_FOLDER [MESH.obj] [--device NAME] [--quick]: a sphere of 2,562 vertices becomes Spot, or another mesh, from the silhouettes of eight
# views of 128², by the program of the pear, in 250 steps (--quick: 40), with more smoothness, as its mesh is finer. Overlap with the eight and with four other views, on 512² points
# each, and distances as parts of the mesh's radius. Also as bench-out/spot/figures.json. Without a mesh it wants Spot in
# $DR_SHARED_DATA, or shared/data beside the sources.
set -euo pipefail
source "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/suite.bash"
suite spot "$@"
mesh=${rest[0]:-${DR_SHARED_DATA:-$root/../shared/data}/obj/spot/cow.obj}
if [[ ! -e $mesh ]]; then echo "spot: skipped, there is no $mesh"; exit 0; fi
steps=${quick:+40} steps=${steps:-250}
run() { "$bin/drun" "$@" --device "$device" > "$out/run.txt" || { cat "$out/run.txt"; exit 1; }; }
pear=$root/docs/examples/pear
obj=(--bind "position=$mesh:position" --bind "face=$mesh:indices")

run "$root/docs/examples/studio.dr" "${obj[@]}" --step silhouettes --out "$out/train"
run "$root/docs/examples/studio.dr" "${obj[@]}" -D N=4 -D turn=22.5 -D elevation=0.0 --step silhouettes --out "$out/held_out"
run "$pear/target.dr" -D coarse=16 --step meshes --out "$out/sphere"

run "$pear/fit.dr" --bind "position=$out/sphere/meshes.position.npy" --bind "face=$out/sphere/meshes.face.npy" \
  --bind "view=$out/train/silhouettes.view.npy" --bind "mask=$out/train/silhouettes.mask.npy" -D "steps=$steps" -D smoothness=100.0 --step "fit_shape=$steps" --step finish \
  --out "$out/fit" --mesh "$out/fit.glb=finish.drawn:face"

judge() {  # judge VIEWS: against the mesh itself
  run "$here/cases/judge_shape.dr" --bind "position=$out/fit/finish.drawn.npy" --bind "face=$out/sphere/meshes.face.npy" \
    --bind "true_position=$out/train/silhouettes.position.npy" --bind "true_face=$out/train/silhouettes.face.npy" --bind "view=$out/$1/silhouettes.view.npy" \
    --step silhouettes --step distances --out "$out/judge_$1"
}
judge train
judge held_out

/usr/bin/python3 - "$out" << 'END'
import json, sys
from pathlib import Path
out = Path(sys.argv[1])
def log(folder):
    return {k: v for line in (out / folder / "log.jsonl").read_text().splitlines() for k, v in json.loads(line).items()}
train, held_out = log("judge_train"), log("judge_held_out")
figures = {
    "overlap, mean of the 8 views": train["overlap"],
    "overlap, least of the 8 views": train["least_overlap"],
    "overlap, mean of 4 other views": held_out["overlap"],
    "overlap, least of 4 other views": held_out["least_overlap"],
    "mean distance of the fit's vertices from the mesh, % of its radius": 100 * train["distance"],
    "farthest vertex, %": 100 * train["farthest"],
    "mean distance of the mesh's vertices from the fit, %": 100 * train["missed"],
}
for name, value in figures.items():
    print(f"{name:<68}{value:8.4f}")
(out / "figures.json").write_text(json.dumps(figures, indent=1))
END
