#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# judge.sh BUILD_FOLDER [COUNT] [--quick]: the judge of accuracy and sweep itself: the float64 evaluator's values and derivatives at
# COUNT points (a million; --quick: 20,000) against mpmath with 50 digits. The figures go to bench-out/judge.json, and with
# bench-out/accuracy.json into docs/results/accuracy.md; those of --quick to bench-out/judge/ alone.
set -euo pipefail
source "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/suite.bash"
suite judge "$@"
default=${quick:+20000} file=${quick:+$out/figures.json}
points=$(mktemp)
trap 'rm -f "$points"' EXIT
"$bin/bench_judge" "$points" "${rest[0]:-${default:-1000000}}"
/usr/bin/python3 "$here/judge.py" "$points" "${file:-bench-out/judge.json}"
if [[ -z $quick && -f bench-out/accuracy.json ]]; then
  "$bin/bench_accuracy" document bench-out/accuracy.json > bench-out/accuracy.md
  cp bench-out/accuracy.md "$root/docs/results/accuracy.md"
fi
