#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The programs of docs/tutorial/ find what they look for. usage: tutorials_test.sh DRC TUTORIAL_FOLDER
set -euo pipefail
drc=$(realpath "$1") pages=$2
source "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/printed.bash"
# finds PAGE STEPS NAME LEAST MOST: after that many steps the output lies between the two.
finds() {
  awk '/^```dr$/ { inside = 1; next } /^```$/ { inside = 0 } inside' "$pages/$1.md" > "$folder/$1.dr"
  "$drc" eval "$folder/$1.dr" --step "fit=$2" > "$folder/$1.txt" || { failed=1; return; }
  lies_between "$4" "$5" "fit.$3" "$folder/$1.txt"
}
finds shape 60 width 0.95 0.97
finds shape 60 error 0 3e-5
finds texture 60 error 0 1e-5
finds pose 150 degrees_off 0 0.01
finds pose 150 off 0 0.0002
finds shading 80 error 0 2e-5
# The fit of materials.md takes the evaluator a minute: its program is checked, not run.
awk '/^```dr$/ { inside = 1; next } /^```$/ { inside = 0 } inside' "$pages/materials.md" > "$folder/materials.dr"
"$drc" check "$folder/materials.dr" || failed=1
[[ $(grep -l '^```dr$' "$pages"/*.md | wc -l) == 5 ]] || { echo "expected 5 pages with a program"; failed=1; }
exit $failed
