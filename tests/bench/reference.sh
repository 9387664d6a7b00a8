#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# reference.sh BUILD_FOLDER [THREADS] [--quick]: the time of one step of tests/bench/cases/reference.dr on the evaluator, the best of three (one), and of a run
# that compiles and binds but does no step, so that the difference is the step's. Also as bench-out/reference.json.
set -euo pipefail
source "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/suite.bash"
suite reference "$@"
threads=${rest[0]:-0} rounds=${quick:+1}
awk -v levels=3 -f "$here/icosphere.awk" > bench-out/icosphere.obj
run() {
  local begin end
  begin=$(date +%s%N)
  "$bin/drc" eval "$here/cases/reference.dr" --bind position=bench-out/icosphere.obj:position \
    --bind face=bench-out/icosphere.obj:indices --threads "$threads" --steps "$1" > bench-out/reference.txt
  end=$(date +%s%N)
  echo $(((end - begin) / 1000000))
}
idle=$(run 0)
best=''
for ((k = 0; k < ${rounds:-3}; ++k)); do
  now=$(($(run 1) - idle))
  if [[ -z $best || $now -lt $best ]]; then best=$now; fi
done
cat bench-out/reference.txt
echo "one step: $best ms, the best of ${rounds:-3} (compiling and binding: $idle ms)"
printf '{"step_ms": %d, "compile_ms": %d, "threads": %d}\n' "$best" "$idle" "$threads" > bench-out/reference.json
