#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Programs lower and differentiate; nothing is evaluated. usage: only_compiled.sh DRC PROGRAM...
set -euo pipefail
drc=$1
shift
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
for program in "$@"; do
  "$drc" build "$program" --emit=grad-ir -o "$folder/" || { echo "$program does not compile"; exit 1; }
done
[[ $(find "$folder" -type f | wc -l) == $# ]]
