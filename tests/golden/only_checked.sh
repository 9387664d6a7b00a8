#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Programs lower without an error; nothing is differentiated or evaluated. usage: only_checked.sh DRC PROGRAM...
set -euo pipefail
drc=$1
shift
for program in "$@"; do
  "$drc" check "$program"
done
