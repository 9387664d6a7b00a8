#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# time_passes_test.sh DRC: `drc build --time-passes` names the phases of a build, and together they are at least 95% of
# the time that the whole command takes, seen from outside. Another program may hold the processor while drc starts or
# ends, so one of five tries is enough.
set -euo pipefail
drc=$(realpath "$1")
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
{
  printf 'edition 1;\nparam x0 : float = 1.0;\n'
  for ((k = 1; k <= 1500; ++k)); do printf 'let x%d = sin(x%d) * 0.%d;\n' "$k" $((k - 1)) $((k + 1000)); done
  printf 'step fit { x0 <- x0 - grad(x1500, x0); output y = x1500; }\n'
} > chain.dr

for phase in parse 'check and lower' simplify differentiate verify pack emit 'assemble: glslang' 'assemble: inline' \
  'assemble: validate' 'make bundle' 'write bundle'; do
  phases+=("$phase")
done
for attempt in 1 2 3 4 5; do
  begin=$(date +%s%N)
  "$drc" build chain.dr --emit bundle -o chain.drb --no-cache --time-passes 2> times
  outside=$((($(date +%s%N) - begin) / 1000))
  for phase in "${phases[@]}"; do
    grep -q "^$phase: [0-9.]* ms$" times || { echo "no line of '$phase'"; cat times; exit 1; }
  done
  # In microseconds: without the line of their sum, and that line.
  read -r sum total < <(awk -F': ' '{ t = $NF * 1000 } /^total/ { total = t; next } { sum += t } END { printf "%d %d\n", sum, total }' times)
  ((sum - total <= 100 && total - sum <= 100)) || { echo "the phases take $sum us, and their sum is $total us"; exit 1; }
  if ((sum * 100 >= outside * 95)); then exit 0; fi
  echo "try $attempt: $sum us of $outside us"
done
cat times
exit 1
