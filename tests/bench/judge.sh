#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# judge.sh BUILD_FOLDER [COUNT]: the judge of accuracy and sweep itself: the float64 evaluator's values and derivatives at
# COUNT points (a million) against mpmath with 50 digits. The figures go to bench-out/judge.json, and with
# bench-out/accuracy.json into docs/accuracy.md.
set -euo pipefail
bin=$(realpath "$1")/bin
here=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")
mkdir -p bench-out
points=$(mktemp)
trap 'rm -f "$points"' EXIT
"$bin/bench_sweep" points "$points" "${2-1000000}"
python3 "$here/judge.py" "$points" bench-out/judge.json
if [[ -f bench-out/accuracy.json ]]; then
  "$bin/bench_accuracy" document bench-out/accuracy.json > bench-out/accuracy.md
  cp bench-out/accuracy.md "$here/../../docs/accuracy.md"
fi
