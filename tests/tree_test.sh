#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# What the tree holds is what people wrote: no file over 1 MB, and no folder that a run left. A switch over op kinds names
# them all, so that the compiler tells where a new kind is missing. usage: tree_test.sh SOURCE_ROOT
set -euo pipefail

# Prints what must not be in a list of `SIZE PATH` lines; fails if there is such a line.
check() {
  awk '
    { size = $1; path = $0; sub(/^[0-9]+ /, "", path) }
    size > 1000000 { print path ": " size " bytes; files of the tree have at most 1000000"; failed = 1 }
    path ~ /\.out\// { print path ": a run left this (*.out/ is ignored by git)"; failed = 1 }
    path ~ /(^|\/)(build(-[^\/]*)?|bench-out)\// { print path ": made by a build or a benchmark"; failed = 1 }
    END { exit failed }'
}

probe() {  # probe LINE pass|refuse: the check itself is checked
  local verdict=pass
  check <<< "$1" > /dev/null || verdict=refuse
  [[ $verdict == "$2" ]] || { echo "self-test: '$1': $verdict, expected $2"; exit 1; }
}
probe '1000000 docs/a b.png' pass
probe '1000001 docs/a b.png' refuse
probe '10 docs/examples/pear/exact.out/log.jsonl' refuse
probe '10 build-asan/a.o' refuse
probe '10 tests/bench/a.py' pass

# Prints each `default:` of a switch over op kinds in the files named; fails if there is one.
check_switches() {
  awk '
    FNR == 1 || /^}/ || /switch \(/ { over_ops = 0 }
    /case (dr::)?(ir::)?OpKind::/ { over_ops = 1 }
    over_ops && /(^|[^A-Za-z_])default:/ {
      print FILENAME ":" FNR ": a switch over op kinds has no default: (name the kinds left, or DR_ELEMENTWISE for all element-wise ones)"
      failed = 1
    }
    END { exit failed }' "$@"
}

probe_switch() {  # probe_switch TEXT pass|refuse
  local verdict=pass
  check_switches <(printf '%b' "$1") > /dev/null || verdict=refuse
  [[ $verdict == "$2" ]] || { echo "self-test: '$1': $verdict, expected $2"; exit 1; }
}
probe_switch 'switch (kind) {\n  case OpKind::Add: return;\n  default: break;\n}\n' refuse
probe_switch 'switch (kind) {\n  case ir::OpKind::Add:\n  default: break;\n}\n' refuse
probe_switch 'switch (kind) {\n  case OpKind::Add: return;\n}\nswitch (other) {\n  default: break;\n}\n' pass
probe_switch 'switch (kind) {\n  case Kind::Add: return;\n  default: break;\n}\n' pass

cd "$1"
mapfile -d '' sources < <(find compiler runtime \( -name '*.cpp' -o -name '*.h' \) -print0)
((${#sources[@]} > 0)) || { echo "no sources in compiler/ and runtime/"; exit 1; }
check_switches "${sources[@]}"

# A tree from an archive has no list of what is tracked.
if ! git rev-parse --is-inside-work-tree > /dev/null 2>&1; then
  echo "not a git checkout: nothing to look at"
  exit 77
fi
git ls-files -z | while IFS= read -r -d '' file; do
  if [[ -f $file ]]; then stat -c '%s %n' "$file"; fi
done | check
