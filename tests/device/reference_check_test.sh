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
# A number that float32 has no room for passes, and is told of.
cat > small.dr << 'END'
edition 1;
input a : float[N];
step look { output sure = 2.0 * a, decided = if a * 1e-30 * 1e-30 > 0.0 { a } else { 0.0 }; }
END
expect 0 'agrees with the reference in 2 values' small.dr --bind 'a=[1, 2, 3]' --check-against-reference
expect 0 "float32 alone decides otherwise than the reference: pass" small.dr --bind 'a=[1, 2, 3]' --check-against-reference
expect 2 'expected a number of runs' sum.dr --bind a=ones.csv --check-against-reference=0
exit $failed
