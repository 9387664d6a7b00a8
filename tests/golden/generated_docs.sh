#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The documents that drc writes are as it writes them now. usage: generated_docs.sh DRC SOURCE_ROOT [--update]
set -euo pipefail
drc=$(realpath "$1")
cd "$2"
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

"$drc" doc --ops -o "$work/ops.md"
{
  echo '<!-- Made by `drc doc` from stdlib/std/; see docs/howto/test.md. -->'
  "$drc" doc stdlib/std/*.dr
} > "$work/library.md"

failed=0
for name in ops library; do
  cmp -s "$work/$name.md" "docs/reference/$name.md" && continue
  if [[ ${3-} == --update ]]; then
    cp "$work/$name.md" "docs/reference/$name.md"
    echo "docs/reference/$name.md: changed"
  else
    diff -u "docs/reference/$name.md" "$work/$name.md" || true
    echo "docs/reference/$name.md is not what drc doc prints; ./dr test --update writes it anew"
    failed=1
  fi
done
exit $failed
