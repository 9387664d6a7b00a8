#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# hair.sh BUILD_FOLDER [--device NAME] [--quick]: M, N, A of std.hair and whole fibres on a device and in the evaluator against mpmath, at 10,000
# points (--quick: 300).
set -euo pipefail
source "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/suite.bash"
suite hair "$@"
no_more
count=10000
if [[ -n $quick ]]; then count=300; fi
python3 "$here/hair.py" points "$out" $count
from=() saves=()
for leaf in tangent to_light to_camera fiber melanin h variance scale phi; do from+=(--bind "$leaf=$out/$leaf.npy"); done
"$bin/drun" "$here/hair.dr" --device reference "${from[@]}" --step terms --out "$out/out" > "$out/run.txt"
echo "the evaluator:"
python3 "$here/hair.py" judge "$out" | tee "$out/figures_evaluator.json"
"$bin/drun" "$here/hair.dr" --device "$device" "${from[@]}" --step terms --out "$out/out" > "$out/run.txt"
echo "the device:"
python3 "$here/hair.py" judge "$out" | tee "$out/figures.json"
