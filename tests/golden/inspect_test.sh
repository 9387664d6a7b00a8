#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# `drc inspect` on bundles that drc has just built, on damaged ones, and the cache of bundles and shaders. usage: inspect_test.sh DRC
# UPDATE=1 rewrites backend/reduce_map.inspect.txt.
set -euo pipefail
drc=$(realpath "$1")
cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")"
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
export DRC_CACHE_DIR=$work/cache
failures=0
complain() { printf 'FAILED: %s\n' "$*"; failures=$((failures + 1)); }

cd backend
"$drc" build --emit=bundle --lower=compute --scatter=exact -o "$work/a.drb" reduce_map.dr
# The size of SPIR-V depends on the version of glslang.
"$drc" inspect "$work/a.drb" | sed -E 's/[0-9]+ bytes/N bytes/' > "$work/a.txt"
if [[ -n ${UPDATE-} ]]; then cp "$work/a.txt" reduce_map.inspect.txt; fi
diff -u reduce_map.inspect.txt "$work/a.txt" || complain "drc inspect prints something else"

"$drc" inspect --json "$work/a.drb" > "$work/a.json"
python3 - "$work/a.json" << 'END' || complain "the JSON form"
import json, sys
bundle = json.load(open(sys.argv[1]))
assert [leaf["name"] for leaf in bundle["leaves"]] == ["weight", "index"], bundle["leaves"]
commands = bundle["steps"][0]["commands"]
assert any("reduce_map.dr:" in line for c in commands for line in c["lines"]), commands
assert all(s["bytes"] > 0 and s["entry"] == "main" for s in bundle["shaders"])
END
"$drc" inspect --graph "$work/a.drb" > "$work/graph.ir"
"$drc" build --emit=ir "$work/graph.ir" | cmp -s - "$work/graph.ir" || complain "the bundle's graph is not read back"

# damaged FILE TEXT: inspect refuses the file and says so.
damaged() {
  local status=0
  "$drc" inspect "$1" > "$work/out" 2> "$work/err" || status=$?
  if [[ $status != 1 || -s $work/out ]] || ! grep -q "$2" "$work/err"; then
    complain "inspect $1: exit $status, expected 1 and: $2"
    cat "$work/err"
  fi
}
head -c 2000 "$work/a.drb" > "$work/cut.drb"
damaged "$work/cut.drb" "the bundle is cut off: it has 2000 of "
echo "edition 1;" > "$work/text.drb"
damaged "$work/text.drb" "not a bundle"
: > "$work/empty.drb"
damaged "$work/empty.drb" "not a bundle"
damaged "$work/missing.drb" "cannot read"

# A second build finds its shaders; a damaged cache changes nothing; without a cache there is none.
[[ -n $(ls "$DRC_CACHE_DIR") ]] || complain "no shader was kept"
build() { "$drc" build --emit=bundle --lower=compute --scatter=exact -o "$1" "${@:2}" reduce_map.dr && cmp "$1" "$work/a.drb"; }
build "$work/b.drb" || complain "a bundle from the cache differs"
# A bundle alone is found as well, by the same program and options, and no shader is made for it.
kept=$(LC_ALL=C grep -la 'bundle 20:' "$DRC_CACHE_DIR"/* || true)
find "$DRC_CACHE_DIR" -type f ! -path "$kept" -delete
build "$work/b.drb" || complain "a bundle from the cache differs"
[[ $(find "$DRC_CACHE_DIR" -type f | wc -l) == 1 ]] || complain "a bundle that was kept is not found"
mkdir -p "$work/other/std"
cp reduce_map.dr "$work/other/"
(cd "$work/other" && "$drc" build --emit=bundle --lower=compute --scatter=exact -o x.drb reduce_map.dr)
[[ -z $(LC_ALL=C grep -la 'bundle 20:' "$DRC_CACHE_DIR"/* | grep -vx "$kept") ]] || complain "kept beside modules that may change"
rmdir "$work/other/std"
sed -i 's/edition 1;/& const unused = 1;/' "$work/other/reduce_map.dr"
(cd "$work/other" && "$drc" build --emit=bundle --lower=compute --scatter=exact -o y.drb reduce_map.dr)
[[ $(LC_ALL=C grep -la 'bundle 20:' "$DRC_CACHE_DIR"/* | wc -l) == 2 ]] || complain "another program is taken for the first"
"$drc" build --emit=bundle --lower=fragment -o "$work/z.drb" reduce_map.dr
cmp -s "$work/z.drb" "$work/a.drb" && complain "another lowering is taken for the first"
# Of the float profile native all is another.
"$drc" build --emit=bundle --lower=compute --scatter=exact --float=native -o "$work/native.drb" reduce_map.dr
"$drc" inspect "$work/native.drb" | head -n 1 | grep -q ', native, ' || complain "inspect does not say native"
build "$work/b.drb" || complain "a bundle after one of native floats differs"
for file in "$DRC_CACHE_DIR"/*; do head -c 100 "$file" > "$work/part" && cat "$work/part" > "$file"; done
build "$work/c.drb" || complain "a bundle after the cache was damaged differs"
for file in "$DRC_CACHE_DIR"/*; do printf 'x' | dd of="$file" bs=1 seek=$(($(stat -c %s "$file") - 8)) conv=notrunc status=none; done
build "$work/d.drb" || complain "a bundle after words of the cache were changed differs"
rm -r "$DRC_CACHE_DIR"
build "$work/e.drb" --no-cache || complain "a bundle without a cache differs"
[[ ! -e $DRC_CACHE_DIR ]] || complain "--no-cache wrote a cache"
DRC_CACHE_DIR=/dev/null/nowhere build "$work/f.drb" || complain "a cache that cannot be written stops the build"

[[ $failures == 0 ]] && echo "inspect: all as expected"
