#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# A sphere becomes a pear. usage: run.sh BUILD_DIR [OUT_DIR]
# DR_DEVICE chooses the device; without it, the software device that always gives the same pictures.
set -euo pipefail
bin=$(cd "$1" && pwd)/bin
here=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")
out=${2:-$here/../../../out}
mkdir -p "$out"
out=$(cd "$out" && pwd)
cd "$here"

if [[ -z ${DR_DEVICE-} && -n ${DR_LAVAPIPE_ICD-} ]]; then export VK_ICD_FILENAMES=$DR_LAVAPIPE_ICD VK_DRIVER_FILES=$DR_LAVAPIPE_ICD; fi
begin=$SECONDS
run() { "$bin/drun" "$@" --device "${DR_DEVICE-}"; }
target=$out/target
mesh=(--bind "face=$target/meshes.face.npy" --bind "uv=$target/meshes.uv.npy" --bind "uv_face=$target/meshes.uv_face.npy")
pictures() { echo --bind "view=$1/render.view.npy" --bind "mask=$1/render.mask.npy" --bind "image=$1/render.image.npy"; }

echo "1/4 the pear's pictures: six to fit, twelve to judge by"
run target.dr --step render --step meshes --out "$target"
for round in 1 2; do run target.dr -D "round=$round" --step render --out "$out/held_out_$round"; done

echo "2/4 fit: shape from silhouettes, then colours"
# shellcheck disable=SC2046
run fit.dr --bind "position=$target/meshes.position.npy" "${mesh[@]}" $(pictures "$target") \
  --bind "true_position=$target/meshes.pear_position.npy" --bind "true_face=$target/meshes.pear_face.npy" \
  --step fit_shape=150 --step fit_texture=50 --step measure_shape --step finish \
  --out "$out/fit" --mesh "$out/pear.glb=finish.drawn:face:uv:uv_face:albedo"

echo "3/4 judge it by the other pictures"
for round in 1 2; do
  # shellcheck disable=SC2046
  run fit.dr --bind "position=$out/fit/position.npy" --bind "albedo=$out/fit/albedo.npy" "${mesh[@]}" \
    $(pictures "$out/held_out_$round") --step measure_pictures --out "$out/held_out_$round"
done

echo "4/4 pictures for people"
show=(show.dr "${mesh[@]}" --bind "view=$target/render.view.npy" --symbol T=1 --symbol U=1)
run "${show[@]}" --bind "position=$target/meshes.position.npy" --out "$out/start"
run "${show[@]}" --bind "position=$out/fit/finish.drawn.npy" --out "$out/shape"
/usr/bin/python3 report.py "$out"
echo "$((SECONDS - begin)) seconds; open $out/report.html, or $out/pear.glb in a 3D viewer"
