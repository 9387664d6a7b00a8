#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# all.sh BUILD_FOLDER [--device NAME] [--quick]: every suite, one after the other, a line for each with seconds of wall clock and of the
# processor and its exit code; what suites print goes to bench-out/all/NAME.log. Then the report. A suite that fails does not keep
# the others from running; the exit code is 1 then. --quick: under ten minutes on two cores.
set -euo pipefail
source "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/suite.bash"
suite all "$@"
no_more
rm "$out/run.json"  # it has no figures of its own
failed=()
TIMEFORMAT='%R %U %S'
line() { printf '%-14s %8s %10s %5s\n' "$@"; }
line suite 'wall, s' 'cpu, s' code
for script in "$here"/*.sh; do
  name=$(basename "$script" .sh) code=0
  case $name in
    all | report | results | skip_scenes) continue ;;  # skip runs the latter
  esac
  times=$({ time bash "$script" "$@" > "$out/$name.log" 2>&1; } 2>&1) || code=$?
  read -r wall user system <<< "$times"
  line "$name" "$wall" "$(awk "BEGIN { print $user + $system }")" "$code"
  if ((code != 0)); then failed+=("$name"); tail -n 3 "$out/$name.log" | sed 's/^/    /'; fi
done
bash "$here/report.sh" "$build"
if ((${#failed[@]} > 0)); then echo "failed: ${failed[*]}" >&2; exit 1; fi
