#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# drun --check-against-reference agrees with lavapipe, and ends with 1 where lavapipe ends a loop that a wrong profile
# lets it run. usage: reference_check_test.sh DRUN
set -eu
drun=$(readlink -f "$1")
profiles=$(readlink -f "$(dirname "${BASH_SOURCE[0]}")/../../compiler/target/profiles")
source "$(dirname "${BASH_SOURCE[0]}")/on_lavapipe.sh" "the check against the reference on lavapipe"
cat > sum.dr << 'END'
edition 1;
input a : float[N];
let before = a.at(0) * 2.0;
let total = reduce(sum, i in 0..N) { a.at(i) };
step count { output before, total; }
END
sed 's/"loop_trips": 65535/"loop_trips": 0/' "$profiles/lavapipe.json" > no_limit.json
yes 1 | head -n 70000 > ones.csv || true
expect 0 'agrees with the reference in 2 values' sum.dr --bind a=ones.csv --check-against-reference
expect 1 "for 'total' at element (0, 0, 0), the reference 70000" sum.dr --bind a=ones.csv --profile no_limit.json \
  --check-against-reference
expect 1 'sum.dr:4' sum.dr --bind a=ones.csv --profile no_limit.json --check-against-reference=2
expect 2 'expected a number of runs' sum.dr --bind a=ones.csv --check-against-reference=0
exit $failed
