#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Every ```dr block of the documentation passes `drc check`. usage: docs_test.sh DRC FILE.md...
set -euo pipefail
drc=$1
shift
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
count=0 failed=0
for file in "$@"; do
  rm -f "$folder"/*.dr
  awk -v folder="$folder" '
    /^```dr$/ { inside = 1; name = sprintf("%s/line_%05d.dr", folder, NR + 1); next }
    /^```$/ { if (inside) close(name); inside = 0; next }
    inside { print > name }' "$file"
  for snippet in "$folder"/*.dr; do
    [[ -e $snippet ]] || continue
    count=$((count + 1))
    if ! "$drc" check "$snippet" 2> "$folder/messages"; then
      echo "$file, $(basename "$snippet" .dr):"
      sed "s|$folder/||" "$folder/messages"
      failed=1
    fi
  done
done
echo "$count snippets checked"
[[ $count -gt 0 && $failed == 0 ]]
