#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The demo: a sphere becomes a pear from two silhouettes. usage: run_demo.sh BUILD_DIR [OUT_DIR]
set -euo pipefail
bin=$(cd "$1" && pwd)/bin
here=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")
out=${2:-$here/../../out}
mkdir -p "$out"
out=$(cd "$out" && pwd)
cd "$here"

# The software device always gives the same pictures; DR_DEVICE chooses another one.
if [[ -z ${DR_DEVICE-} && -n ${DR_LAVAPIPE_ICD-} ]]; then export VK_ICD_FILENAMES=$DR_LAVAPIPE_ICD VK_DRIVER_FILES=$DR_LAVAPIPE_ICD; fi
device=(--device "${DR_DEVICE-}")
inputs=(--bind "face=sphere.obj:indices" --bind "view=views.json")

echo "1/3 render the target: a pear from two sides"
"$bin/drun" render_target.dr "${device[@]}" --bind position=pear.obj:position "${inputs[@]}" --out "$out/target"

fit=(fit_sphere.dr "${device[@]}" --bind position=sphere.obj:position "${inputs[@]}"
  --bind "target=$out/target/target.npy" --bind "photo=$out/target/photo.npy")
echo "2/3 before: the sphere"
"$bin/drun" "${fit[@]}" --step fit_shape=1 --step fit_gain=1 --out "$out/before"
echo "3/3 fit"
"$bin/drun" "${fit[@]}" --step fit_shape=200 --step fit_gain=30 --out "$out/after" --mesh "$out/fitted.glb=position:face" \
  --mesh "$out/fitted.obj=position:face"

for when in before after; do
  for name in alpha picture; do
    for view in 0 1; do cp "$out/$when/${name}_$view.png" "$out/${when}_${name}_$view.png"; done
  done
done
for view in 0 1; do cp "$out/target/target_$view.png" "$out/target_$view.png"; done
echo "pictures before and after, the target and the fitted mesh are in $out"
