#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# accuracy.sh BUILD_FOLDER [--device NAME] [--quick]: the accuracy of every op on lavapipe and SwiftShader, or on the
# device that is named instead. The figures go to bench-out/accuracy.json, beside those of other devices that are there,
# and from there to docs/results/accuracy.md; those of --quick, which has fewer operands and every
# fifth function of the library, to bench-out/accuracy/ alone.
set -euo pipefail
source "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/suite.bash"
suite accuracy "$@"
no_more
samples=${quick:+16384} file=${quick:+$out/figures.json}
samples=${samples:-262144} file=${file:-bench-out/accuracy.json}
failed=0
measured="$(date -u +%F), commit $(git -C "$root" rev-parse --short HEAD 2> /dev/null || echo unknown)"
measure() { "$bin/bench_accuracy" measure "$file" "$1" "$2" "$samples" "$measured" || failed=1; }
if [[ -n $device ]]; then
  measure "$device" "$device"
else
  for pair in "lavapipe ${DR_LAVAPIPE_ICD-}" "swiftshader ${DR_SWIFTSHADER_ICD-}"; do
    read -r name icd <<< "$pair"
    if [[ -z $icd ]]; then echo "no ICD of $name is named: left out"; continue; fi
    VK_ICD_FILENAMES=$icd VK_DRIVER_FILES=$icd measure "$name" ''
  done
fi
if [[ -z $quick ]]; then
  "$bin/bench_accuracy" document "$file" > bench-out/accuracy.md
  cp bench-out/accuracy.md "$root/docs/results/accuracy.md"
fi
exit $failed
