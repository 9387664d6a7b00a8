#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# ggx.sh BUILD_FOLDER [--device NAME] [--quick]: D and V of GGX and a whole metal on a device against mpmath, at 10,000 points (--quick:
# 1000) with cosines from 1e-3 and alpha from 2e-3. Their bounds are 4 u / alpha + 8 u, 1e-6 and 1e-4, relative.
set -euo pipefail
source "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/suite.bash"
suite ggx "$@"
no_more
count=10000
if [[ -n $quick ]]; then count=1000; fi
python3 "$here/ggx.py" points "$out" $count
from=()
for leaf in normal to_light to_camera alpha; do from+=(--bind "$leaf=$out/$leaf.npy"); done
"$bin/drun" "$here/ggx.dr" --device "$device" "${from[@]}" --step terms --out "$out/out" > "$out/run.txt"
python3 "$here/ggx.py" judge "$out" | tee "$out/figures.json"
