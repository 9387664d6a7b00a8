#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# under_sanitizers.sh BUILD_ASAN: tests that run drun, with one that has AddressSanitizer, UBSan and LeakSanitizer, on
# lavapipe. What the driver itself leaves is suppressed by its module's name, so it is loaded for good. The folder is one of
#   cmake --preset asan -DDR_BUILD_RUNTIME=ON && ninja -C build-asan drc drun
set -euo pipefail
here=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")
bin=$(realpath "$1")/bin
if [[ -z ${DR_LAVAPIPE_ICD-} ]]; then
  echo "DR_LAVAPIPE_ICD is not set: nothing to run on"
  exit 77
fi
unset DR_SWIFTSHADER_ICD CI
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
driver=$(sed -nE 's/.*"library_path": *"([^"]*)".*/\1/p' "$DR_LAVAPIPE_ICD")
echo "leak:$(basename "$driver")" > "$work/suppressions"
export LSAN_OPTIONS=suppressions=$work/suppressions:print_suppressions=0 NODEVICE_SELECT=1
printf '#!/bin/sh\nLD_PRELOAD="%s" exec "%s/drun" "$@"\n' "$driver" "$bin" > "$work/drun"
chmod +x "$work/drun"
failed=0
for name in results faults resume data initial_values reference_check reductions replay blocks long_rasters long_folds mesh_material; do
  case $name in
    results | initial_values | replay | blocks) commands=("$bin/drc" "$work/drun") ;;
    *) commands=("$work/drun") ;;
  esac
  status=0
  bash "$here/${name}_test.sh" "${commands[@]}" > "$work/said" 2>&1 || status=$?
  reports=$(grep -cE 'ERROR: (Address|Leak)Sanitizer|runtime error:' "$work/said" || true)
  echo "$name: exit $status, $reports reports"
  if ((status != 0 && status != 77 || reports > 0)); then
    tail -n 30 "$work/said"
    failed=1
  fi
done
exit $failed
