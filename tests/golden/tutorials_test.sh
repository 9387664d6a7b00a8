#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The programs of docs/tutorial/README.md find what they look for. usage: tutorials_test.sh DRC TUTORIALS.md
set -euo pipefail
drc=$(realpath "$1")
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
awk -v folder="$folder" '
  /^```dr$/ { inside = 1; name = sprintf("%s/%d.dr", folder, ++n); next }
  /^```$/ { if (inside) close(name); inside = 0; next }
  inside { print > name }' "$2"
failed=0
# finds NUMBER STEPS NAME LEAST MOST: after that many steps the output lies between the two.
finds() {
  "$drc" eval "$folder/$1.dr" --step "fit=$2" > "$folder/out.txt" || { failed=1; return; }
  sed -n "s/^$3 = //p" "$folder/out.txt" | tail -n 1 |
    awk -v what="tutorial $1, $3" -v least="$4" -v most="$5" '
      { found = $1 }
      END {
        if (found == "") { print what " is not printed"; exit 1 }
        if (!(found + 0 >= least + 0 && found + 0 <= most + 0)) { print what " = " found ", expected " least " to " most; exit 1 }
      }' || failed=1
}
finds 1 60 width 0.94 0.98
finds 2 60 error 0 1e-5
finds 3 150 degrees_off 0 0.05
finds 3 150 off 0 0.001
finds 4 80 error 0 2e-5
[[ -e $folder/4.dr && ! -e $folder/5.dr ]] || { echo "expected 4 programs"; failed=1; }
exit $failed
