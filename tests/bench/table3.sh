#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# table3.sh BUILD_FOLDER [--device NAME] [--quick]: what stage packing and the reactive cache are worth to the steps of
# the pear, six views of 256 x 256, on lavapipe or the device that is named. The shape's steps are those of its fit: behind
# its end they take other times. The figures go to bench-out/table3.json.
set -euo pipefail
source "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/suite.bash"
suite table3 "$@"
no_more
rounds=${quick:+3} pear=$root/docs/examples/pear target=$out/target
mkdir -p "$target"
"$bin/drun" "$pear/target.dr" --device "$device" --step render --step meshes --out "$target" > "$target/log"
exec "$bin/bench_table3" bench-out/table3.json "$pear/fit.dr" "$device" "${rounds:-15}" fit_shape=150 fit_texture=200 -- \
  "position=$target/meshes.position.npy" "face=$target/meshes.face.npy" "uv=$target/meshes.uv.npy" "uv_face=$target/meshes.uv_face.npy" \
  "view=$target/render.view.npy" "mask=$target/render.mask.npy" "image=$target/render.image.npy"
