#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# edge_modes.sh BUILD_FOLDER [--device NAME] [--quick]: what edge_modes.dr says of icospheres of 320 to 5,120 faces (--quick: 1,280
# and a radius of 2 px): the error of coverage within the
# radius (root of the mean square, and the largest), beyond it, its jump at the inner border, and the share of pixels that
# fill all layers.
set -euo pipefail
source "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/suite.bash"
suite edge_modes "$@"
no_more
levels_of=(2 3 4) radii=(1.0 2.0 7.0)
if [[ -n $quick ]]; then levels_of=(3) radii=(2.0); fi
printf '%5s %6s %9s %4s %2s  %7s %8s %7s %6s %6s\n' faces radius edges mask K rms largest beyond jump filled
for levels in "${levels_of[@]}"; do
  awk -v levels=$levels -f "$here/icosphere.awk" > "$out/sphere.obj"
  for radius in "${radii[@]}"; do
    for mode in "0 0 1" "0 0 3" "0 0 5" "1 0 1" "1 0 2" "1 0 3" "1 1 1" "1 1 2" "1 1 3"; do
      read -r outlines everywhere layers <<< "$mode"
      "$bin/drun" "$here/cases/edge_modes.dr" --device "$device" -D R=$radius -D K="$layers" -D outlines="$outlines" -D everywhere="$everywhere" \
        --bind "position=$out/sphere.obj:position" --bind "face=$out/sphere.obj:indices" --out "$out" > /dev/null
      /usr/bin/python3 - "$out/log.jsonl" $((20 * 4 ** levels)) "$radius" "$outlines" "$everywhere" "$layers" << 'END'
import json, sys
r = json.loads(open(sys.argv[1]).readlines()[-1])
print(f"{sys.argv[2]:>5} {sys.argv[3]:>6} {['all', 'outlines'][int(sys.argv[4])]:>9} {['yes', 'no'][int(sys.argv[5])]:>4} {sys.argv[6]:>2}"
      f"  {r['rms']:7.4f} {r['largest']:8.4f} {r['beyond']:7.4f} {r['jump']:6.3f} {r['kept']:6.3f}")
END
    done
  done
done
