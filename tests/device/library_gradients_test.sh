#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Gradients of whole frames (library_gradients.dr) on each device against the evaluator's, which is given the device's
# faces: relative L2 at most 1e-4, and one direction. usage: library_gradients_test.sh DRC DRUN
set -euo pipefail
drc=$(readlink -f "$1") drun=$(readlink -f "$2")
here=$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")" && pwd)
devices=()
for icd in "${DR_LAVAPIPE_ICD-}" "${DR_SWIFTSHADER_ICD-}"; do
  if [[ -n $icd ]]; then devices+=("$icd"); fi
done
if ((${#devices[@]} == 0)); then
  echo "neither DR_LAVAPIPE_ICD nor DR_SWIFTSHADER_ICD is set: gradients on devices are left out"
  [[ -z ${CI-} ]] || exit 1
  exit 77
fi
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
awk -v levels=2 -f "$here/../bench/icosphere.awk" > sphere.obj
cat > compare.dr << 'END'
edition 1;
input found    : float[W, H, N];
input expected : float[W, H, N];
let size = sqrt(sum(expected * expected));
step compare {
  output size, l2 = sqrt(sum((found - expected) * (found - expected))) / size,
         turned = 1.0 - sum(found * expected) / (size * sqrt(sum(found * found)));
}
END
inputs=(--bind position=sphere.obj:position --bind face=sphere.obj:indices)
names=(position albedo slide rotation translation lamp)
failed=0
for icd in "${devices[@]}"; do
  for step in outlines faces hard; do
    rm -rf device out
    VK_ICD_FILENAMES=$icd VK_DRIVER_FILES=$icd "$drun" "$here/library_gradients.dr" "${inputs[@]}" --step $step \
      --dump-raster device --out out > /dev/null
    saves=()
    for k in "${!names[@]}"; do saves+=(--save "$step.g.$k=expected.$k.npy"); done
    "$drc" eval "$here/library_gradients.dr" "${inputs[@]}" --step $step --freeze device "${saves[@]}" > /dev/null
    for k in "${!names[@]}"; do
      "$drc" eval compare.dr --bind "found=out/$step.g.$k.npy" --bind "expected=expected.$k.npy" > result.txt
      awk -v what="$(basename "$icd") $step ${names[$k]}" '
        { value[substr($1, 9)] = $3 }
        END {
          if (what ~ /hard lamp/) exit value["size"] != 0;  # nothing is lit there
          if (!(value["size"] > 0)) { print what ": the gradient is 0"; exit 1 }
          if (!(value["l2"] <= 1e-4 && value["turned"] <= 1e-8)) { print what ": l2 " value["l2"] ", turned " value["turned"]; exit 1 }
        }' result.txt || failed=1
      if [[ -n ${SHOW-} ]]; then echo "$(basename "$icd") $step ${names[$k]}: $(tr '\n' ' ' < result.txt)"; fi
    done
  done
done
exit $failed
