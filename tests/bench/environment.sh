#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# environment.sh BUILD_FOLDER [--device NAME] [--quick]: irradiance by sums (of the map, and of it halved three times) and by harmonics, and light mirrored
# at roughness 0.5 by sums and by 64 points of Sobol's, of two skies against sums over all texels in float64. One holds a sun of 86,528. It wants the maps
# in $DR_SHARED_DATA, or shared/data beside the sources; --quick takes one.
set -euo pipefail
source "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/suite.bash"
suite environment "$@"
no_more
maps=${DR_SHARED_DATA:-$root/../shared/data}/hdr
if [[ ! -d $maps ]]; then echo "environment: skipped, there is no $maps"; exit 0; fi
names=(venice_sunset_1k quarry_01_1k)
if [[ -n $quick ]]; then names=(venice_sunset_1k); fi
for name in "${names[@]}"; do
  "$bin/drun" "$here/cases/environment.dr" --device "$device" --bind "sky=$maps/$name.hdr" --step filter --out "$out/$name" > "$out/$name.txt"
  /usr/bin/python3 "$here/environment.py" "$out/$name" "$name" 0.5
done | tee "$out/figures.json"
