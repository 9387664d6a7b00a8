#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The programs that benchmarks run check without an error, and frames that are measured have as many commands as
# bench_commands.txt says: one more shows there before anybody measures.
# usage: bench_cases_test.sh DRC SOURCE_ROOT [--update]
set -euo pipefail
drc=$(readlink -f "$1")
root=$(readlink -f "$2")
listed="$root/tests/golden/bench_commands.txt"
cd "$root/tests/bench/cases"
failed=0
count=0
for program in *.dr skip/*.dr; do
  "$drc" check "$program" -I ../../../docs/examples/pear || { echo "FAILED: $program"; failed=1; }
  count=$((count + 1))
done

# commands PROGRAM PROFILE STEP: how many of each kind the step has
commands() {
  "$drc" build "$1" --profile "$2" --scatter exact --emit=commands |
    awk -v step="$3" '/^step / { on = $2 == step } on && /^  [0-9]+ / { ++count[$2] } END { for (k in count) print count[k], k }' |
    sort -k 2 | paste -sd , | sed "s|,|, |g; s|^|$(basename "$1") for $2, step $3: |"
}
found=$(for profile in lavapipe nvidia-h200; do
  commands table4.dr "$profile" frame
  commands table5.dr "$profile" frame
  commands ../../../docs/examples/pear/fit.dr "$profile" fit_shape
  commands ../../../docs/examples/pear/fit.dr "$profile" fit_texture
done)
if [[ ${3:-} == --update ]]; then
  printf '%s\n' "$found" > "$listed"
elif ! diff -u "$listed" - <<< "$found"; then
  echo "measured frames have other commands than $listed says; if that is meant: $0 DRC ROOT --update"
  failed=1
fi
[[ $count -gt 10 && $failed == 0 ]]
