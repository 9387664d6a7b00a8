#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Every product of `drc build` and results of `drc eval` have the same bytes, whatever the folder they are made in, the
# time and the number of threads. usage: determinism_test.sh DRC PROGRAM...
set -euo pipefail
drc=$(readlink -f "$1")
shift
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
failed=0
count=0
index=0
for program in $(readlink -f "$@"); do
  name=$(basename "$program" .dr)
  # Shaders follow from the GLSL, and take most of the time: every third program shows that they do. Every third one is
  # evaluated, as the programs' own tests compare what it gives with a file.
  products=ast,ir,grad-ir,schedule,glsl
  third=$((index++ % 3))
  ((third != 0)) || products+=,bundle
  for copy in one another/much/deeper; do
    mkdir -p "$folder/$name/$copy/products"
    cp "$program" "$folder/$name/$copy/"
    modules=$(dirname "$program")/modules
    [[ ! -d $modules ]] || cp -r "$modules" "$folder/$name/$copy/"
    cd "$folder/$name/$copy"
    "$drc" build "$name.dr" --emit=$products --profile=lavapipe -o products
    threads=1
    [[ $copy == one ]] || threads=3
    # A second run goes on from the first. What tests the library only repeats, and takes half of the time.
    steps=2
    [[ $name != *_library && $name != *_stress ]] || steps=1
    # Steps that nobody binds data to are left to their own tests.
    if ((third == 1)) && "$drc" eval "$name.dr" --steps $steps --threads $threads --out values > values.txt 2> /dev/null; then
      mv values.txt values/
    fi
  done
  cd "$folder/$name"
  for made in one/products one/values; do
    [[ -d $made ]] || continue
    count=$((count + $(find "$made" -type f | wc -l)))
    diff -r "$made" "another/much/deeper/${made#one/}" || failed=1
  done
done
echo "$count files compared"
[[ $count -gt 0 && $failed == 0 ]]
