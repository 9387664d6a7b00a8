#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# accuracy.sh BUILD_FOLDER [--quick] [--device NAME]: the accuracy of every op on lavapipe and SwiftShader, or on the
# device that is named instead. The figures go to bench-out/accuracy.json, beside those of other devices that are there,
# and from there to docs/accuracy.md.
set -euo pipefail
bin=$(realpath "$1")/bin
shift
samples=262144 device=''
while (($# > 0)); do
  case $1 in
    --quick) samples=16384 ;;
    --device) device=${2-}; [[ -n $device ]] || { echo "accuracy.sh: --device takes a name" >&2; exit 2; }; shift ;;
    *) echo "accuracy.sh: unknown option $1 (--quick, --device NAME)" >&2; exit 2 ;;
  esac
  shift
done
mkdir -p bench-out
file=bench-out/accuracy.json
failed=0
measure() { "$bin/bench_accuracy" measure "$file" "$1" "$2" "$samples" || failed=1; }
if [[ -n $device ]]; then
  measure "$device" "$device"
else
  for pair in "lavapipe ${DR_LAVAPIPE_ICD-}" "swiftshader ${DR_SWIFTSHADER_ICD-}"; do
    read -r name icd <<< "$pair"
    if [[ -z $icd ]]; then echo "no ICD of $name is named: left out"; continue; fi
    VK_ICD_FILENAMES=$icd VK_DRIVER_FILES=$icd measure "$name" ''
  done
fi
"$bin/bench_accuracy" document "$file" > bench-out/accuracy.md
cp bench-out/accuracy.md "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/../../docs/accuracy.md"
exit $failed
