#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# schedules.sh BUILD_FOLDER [tables|order]: how the pear's steps are packed for each profile, whole and with parts of packing
# switched off; then 50 schedules of fit_sphere.dr, predicted against measured on lavapipe. The figures go to
# bench-out/schedules-*.json as well.
set -euo pipefail
bin=$(realpath "$1")/bin
out=$(realpath -m bench-out)
mkdir -p "$out"
examples=$(realpath "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/../../docs/examples")
if [[ -n ${DR_LAVAPIPE_ICD-} ]]; then export VK_ICD_FILENAMES=$DR_LAVAPIPE_ICD VK_DRIVER_FILES=$DR_LAVAPIPE_ICD; fi

if [[ ${2-tables} == tables ]]; then
  # Six views of 256 x 256, an icosphere of 642 vertices.
  "$bin/bench_schedules" "$out/schedules-tables.json" tables "$examples/pear/fit.dr" \
    V=642 F=1280 A=2562 N=6 W=256 H=256 P=2562 Q=5120 face_edges=1920
fi
if [[ ${2-order} == order ]]; then
  work=$(mktemp -d)
  trap 'rm -rf "$work"' EXIT
  cd "$examples"
  "$bin/drun" render_target.dr --bind position=pear.obj:position --bind face=pear.obj:indices --bind view=views.json \
    --out "$work" > "$work/log"
  "$bin/bench_schedules" "$out/schedules-order.json" order fit_sphere.dr V=642 F=1280 W=128 H=128 N=2 \
    position=sphere.obj:position face=sphere.obj:indices view=views.json "target=$work/target.npy" "photo=$work/photo.npy"
fi
