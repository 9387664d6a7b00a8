#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# schedules.sh BUILD_FOLDER [tables|order] [--device NAME] [--quick]: how the pear's steps are packed for each profile, whole and with parts of packing
# switched off; then 50 schedules of fit_sphere.dr (--quick: 5), predicted against measured. The figures go to
# bench-out/schedules/ as well.
set -euo pipefail
source "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/suite.bash"
suite schedules "$@"
examples=$root/docs/examples every=${quick:+10}

if [[ ${rest[0]-tables} == tables ]]; then
  # Six views of 256 x 256, an icosphere of 642 vertices.
  "$bin/bench_schedules" "$out/tables.jsonl" tables "$examples/pear/fit.dr" \
    V=642 F=1280 A=2562 N=6 W=256 H=256 P=2562 Q=5120 face_edges=1920
fi
if [[ ${rest[0]-order} == order ]]; then
  work=$(mktemp -d)
  trap 'rm -rf "$work"' EXIT
  cd "$examples"
  "$bin/drun" render_target.dr --device "$device" --bind position=pear.obj:position --bind face=pear.obj:indices --bind view=views.json \
    --out "$work" > "$work/log"
  "$bin/bench_schedules" "$out/order.jsonl" order "${every:-1}" "$device" fit_sphere.dr V=642 F=1280 W=128 H=128 N=2 \
    position=sphere.obj:position face=sphere.obj:indices view=views.json "target=$work/render.target.npy" "photo=$work/render.photo.npy"
fi
