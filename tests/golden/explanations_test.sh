#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Every code has a summary, an explanation whose wrong example gets this code and no other and whose right one gets none,
# and an error case in tests/golden/errors (one that no file can show is shown by a script among the explanations).
# usage: explanations_test.sh DRC SOURCE_ROOT
set -euo pipefail
drc=$(realpath "$1")
root=$(realpath "$2")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
mkdir "$work/bin"
ln -s "$drc" "$work/bin/drc"
export PATH=$work/bin:$PATH
failed=0
fail() { printf '%s\n' "$*"; failed=1; }

codes=$(sed -nE 's/^DR_DIAGNOSTIC\((E[0-9]{4}),.*/\1/p' "$root/dsl/diagnostic/diagnostic_codes.def")
sections=$(sed -n 's/^## //p' "$root/dsl/diagnostic/explanations.md")
[[ $codes == "$sections" ]] || fail "explanations.md and diagnostic_codes.def name other codes, or in another order:" \
  "$(diff <(printf '%s\n' "$codes") <(printf '%s\n' "$sections") | grep '^[<>]')"

# Blocks of code become CODE.1.dr (wrong), CODE.2.dr (right), or .sh
awk -v folder="$work" '
  /^## / { code = $2; count = 0; next }
  /^```(dr|sh)$/ { name = sprintf("%s/%s.%d.%s", folder, code, ++count, substr($0, 4)); next }
  /^```$/ { close(name); name = ""; next }
  name { print > name }' "$root/dsl/diagnostic/explanations.md"

# try CODE NUMBER STATUS: runs an example; `messages` is what it says.
try() {
  local example=$work/$1.$2 status=0
  mkdir "$example"
  if [[ -f $example.sh ]]; then
    messages=$(cd "$example" && bash "$example.sh" 2>&1) || status=$?
  elif [[ -f $example.dr ]]; then
    messages=$(cd "$example" && drc check "$example.dr" 2>&1) || status=$?
  else
    fail "$1: example $2 is missing"
    return
  fi
  [[ $status == "$3" ]] || fail "$1: example $2 exits with $status, expected $3: $messages"
}

for code in $codes; do
  try "$code" 1 1
  found=$(grep -oE '(error|warning)\[E[0-9]+\]' <<< "$messages" | grep -oE 'E[0-9]+' | sort -u | tr '\n' ' ' || true)
  [[ $found == "$code " ]] || fail "$code: the wrong example gets: $messages"
  try "$code" 2 0
  [[ -z $messages ]] || fail "$code: the right example gets: $messages"
  "$drc" explain "$code" > "$work/text" || fail "drc explain $code fails"
  grep -q "^$code: " "$work/text" && grep -q '^Wrong:' "$work/text" && grep -q '^Right:' "$work/text" ||
    fail "drc explain $code is incomplete"
  if ! grep -rqE "^//ERROR: $code\b|error\[$code\]" "$root/tests/golden/errors" && [[ ! -f $work/$code.1.sh ]]; then
    fail "$code: no case in tests/golden/errors"
  fi
done
echo "$(wc -w <<< "$codes") codes checked"
[[ $failed == 0 ]]
