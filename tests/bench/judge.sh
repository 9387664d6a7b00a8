#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# judge.sh BUILD_FOLDER [--quick] [--points COUNT]: the judge of accuracy and sweep itself: the float64 evaluator's values and derivatives at
# COUNT points (a million, --quick: 20000) against mpmath with 50 digits; no device has a part in it. The figures go to bench-out/judge.json, and with
# bench-out/accuracy.json into docs/accuracy.md.
set -euo pipefail
bin=$(realpath "$1")/bin
here=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")
shift
count=1000000
while (($# > 0)); do
  case $1 in
    --quick) count=20000 ;;
    --points) count=${2-}; shift ;;
    --device) shift ;;  # as other suites take it
    *) echo "judge.sh: unknown option $1 (--quick, --points COUNT)" >&2; exit 2 ;;
  esac
  shift
done
mkdir -p bench-out
points=$(mktemp)
trap 'rm -f "$points"' EXIT
"$bin/bench_sweep" points "$points" "$count"
python3 "$here/judge.py" "$points" bench-out/judge.json
if [[ -f bench-out/accuracy.json ]]; then
  "$bin/bench_accuracy" document bench-out/accuracy.json > bench-out/accuracy.md
  cp bench-out/accuracy.md "$here/../../docs/accuracy.md"
fi
