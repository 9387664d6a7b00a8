#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# HardSoftRas with and without leaving out soft work that does not show, and with either shape of enlarged faces: the same bits on each device, by compute loops and by
# draws; and loops over more fragments than are written out. usage: soft_skip_test.sh DRUN
set -euo pipefail
drun=$(readlink -f "$1")
here=$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")" && pwd)
program=$here/../golden/programs/soft_skip.dr
if [[ -z ${DR_LAVAPIPE_ICD-}${DR_SWIFTSHADER_ICD-} ]]; then
  echo "neither DR_LAVAPIPE_ICD nor DR_SWIFTSHADER_ICD is set: devices are left out"
  [[ -z ${CI-} ]] || exit 1
  exit 77
fi
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
face=$(sed -n '1s/.*--bind face=//p' "$program")
failed=0
# check ICD RASTER STEP...
check() {
  local icd=$1 raster=$2 out step
  shift 2
  out=$folder/$(basename "$icd").$raster
  VK_ICD_FILENAMES=$icd VK_DRIVER_FILES=$icd "$drun" "$program" --bind "face==$face" --raster "$raster" "${@/#/--step=}" \
    --out "$out" > /dev/null 2> "$out.said"
  # The splinter makes the mesh an open one, which is told once.
  if (($(grep -c "warning: the mesh 'face' is not closed" "$out.said") != 1)); then
    echo "$(basename "$icd") $raster: expected one warning, found: $(cat "$out.said")"
    failed=1
  fi
  for step; do
    if ! grep -q "\"step\": \"$step\".*\"moved_by\": 1[45], \"differ\": 0}" "$out/log.jsonl"; then
      echo "$(basename "$icd") $raster: $(grep "\"step\": \"$step\"" "$out/log.jsonl")"
      failed=1
    fi
  done
}
if [[ -n ${DR_LAVAPIPE_ICD-} ]]; then
  check "$DR_LAVAPIPE_ICD" compute outlines thin layers faces both_sides
  check "$DR_LAVAPIPE_ICD" hardware thin faces face_shapes
fi
# Loops over fragments give what the same fragments give written out; gradients to a millionth.
loops=$here/../golden/programs/soft_loops.dr
if [[ -n ${DR_LAVAPIPE_ICD-} ]]; then
  VK_ICD_FILENAMES=$DR_LAVAPIPE_ICD VK_DRIVER_FILES=$DR_LAVAPIPE_ICD "$drun" "$loops" \
    --bind "face==$(sed -n '1s/.*--bind face=//p' "$loops")" --step everywhere > "$folder/loops" 2>&1 || failed=1
  if (($(grep -c '^everywhere\..* = 0$' "$folder/loops") != 8)); then
    echo "loops over fragments: $(cat "$folder/loops")"
    failed=1
  fi
fi
# One step is enough where compiling a shader takes seconds.
if [[ -n ${DR_SWIFTSHADER_ICD-} ]]; then check "$DR_SWIFTSHADER_ICD" compute thin; fi
exit $failed
