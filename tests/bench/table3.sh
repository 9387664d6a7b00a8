#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# table3.sh BUILD_FOLDER [--quick] [--device NAME]: what stage packing and the reactive cache are worth to the steps of
# the pear, six views of 256 x 256, on lavapipe or the device that is named. The figures go to bench-out/table3.json.
set -euo pipefail
bin=$(realpath "$1")/bin
shift
rounds=15 device=''
while (($# > 0)); do
  case $1 in
    --quick) rounds=5 ;;
    --device) device=${2-}; [[ -n $device ]] || { echo "table3.sh: --device takes a name" >&2; exit 2; }; shift ;;
    *) echo "table3.sh: unknown option $1 (--quick, --device NAME)" >&2; exit 2 ;;
  esac
  shift
done
pear=$(realpath "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/../../docs/examples/pear")
mkdir -p bench-out/table3
target=bench-out/table3
if [[ -z $device && -n ${DR_LAVAPIPE_ICD-} ]]; then export VK_ICD_FILENAMES=$DR_LAVAPIPE_ICD VK_DRIVER_FILES=$DR_LAVAPIPE_ICD; fi
"$bin/drun" "$pear/target.dr" --device "$device" --step render --step meshes --out "$target" > "$target/log"
exec "$bin/bench_table3" bench-out/table3.json "$pear/fit.dr" "$device" "$rounds" fit_shape fit_texture -- \
  "position=$target/position.npy" "face=$target/face.npy" "uv=$target/uv.npy" "uv_face=$target/uv_face.npy" \
  "view=$target/view.npy" "mask=$target/mask.npy" "image=$target/image.npy"
