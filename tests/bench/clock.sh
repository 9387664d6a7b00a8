#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# clock.sh BUILD_FOLDER [--device NAME] [--quick]: shape and texture of a clock from 16 photos of rendered_clock, judged by 13 others: shape and texture
# together, and one after the other with as many steps. It wants multiview/rendered_clock in $DR_SHARED_DATA, or shared/data beside the sources, and
# Python with NumPy and Pillow; --quick takes a tenth of the steps.
set -euo pipefail
source "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/suite.bash"
suite clock "$@"
no_more
photos=${DR_SHARED_DATA:-$root/../shared/data}/multiview/rendered_clock/rendered_clock.zip
if [[ ! -f $photos ]]; then echo "clock: skipped, there is no $photos"; exit 0; fi
sphere=$root/docs/examples/sphere.obj
/usr/bin/python3 "$here/clock.py" "$photos" "$sphere" 128 "$out"
bound=(--bind "face=$sphere:indices")
for leaf in start view photo mask new_view new_photo new_mask; do bound+=(--bind "$leaf=$out/$leaf.npy"); done
coarse=220 fine=120
if [[ -n $quick ]]; then coarse=30 fine=15; fi
for way in fit paint; do
  began=$(date +%s%N)
  "$bin/drun" "$root/docs/examples/shape_from_photos.dr" --device "$device" "${bound[@]}" --step "coarse=$coarse" --step "$way=$fine" \
    --step judge --step look --out "$out/$way" > "$out/$way.txt"
  awk -v way="$way" -v seconds="$((($(date +%s%N) - began) / 1000000))e-3" '
    sub(/^judge\./, "") { record = record sprintf(", \"%s\": %s", $1, $3) }
    END { printf "{\"then\": \"%s\", \"seconds\": %.1f%s}\n", way, seconds, record }' "$out/$way.txt"
done | tee "$out/figures.json"
