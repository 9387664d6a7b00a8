# SPDX-License-Identifier: Apache-2.0
# What tests share that look at what a program prints: sourced, it makes a `folder` for the time of the test.
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
failed=0
# lies_between LEAST MOST OUTPUT FILE: what the output is in the last of the file's lines that tell it lies between the two; else says so
# and sets `failed`.
lies_between() {
  sed -n "s/^$3 = //p" "$4" | tail -n 1 |
    awk -v what="$(basename "$4" .txt), $3" -v least="$1" -v most="$2" '
      { found = $1 }
      END {
        if (found == "") { print what " is not printed"; exit 1 }
        if (!(found + 0 >= least + 0 && found + 0 <= most + 0)) { print what " = " found ", expected " least " to " most; exit 1 }
      }' || failed=1
}
