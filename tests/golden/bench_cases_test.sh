#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The programs that benchmarks run check without an error: nobody else looks at them until somebody measures.
# usage: bench_cases_test.sh DRC SOURCE_ROOT
set -euo pipefail
drc=$(readlink -f "$1")
cd "$2/tests/bench/cases"
failed=0
count=0
for program in *.dr skip/*.dr; do
  "$drc" check "$program" -I ../../../docs/examples/pear || { echo "FAILED: $program"; failed=1; }
  count=$((count + 1))
done
[[ $count -gt 10 && $failed == 0 ]]
