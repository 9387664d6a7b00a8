#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The golden runner's own test, with a stand-in for drc. usage: runner_test.sh GOLDEN_RUNNER
set -euo pipefail
runner=$(realpath "$1")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"

# `drc check FILE` prints the lines of FILE that begin with `//! ` and exits with 1 if there are any.
# `drc --say TEXT FILE` prints TEXT, FILE and where it runs; `drc --exit N FILE` exits with N.
cat > drc <<'END'
#!/usr/bin/env bash
case $1 in
  check) sed -n 's|^//! ||p' "$2" >&2; ! grep -q '^//! ' "$2" ;;
  --say) printf '%s\n%s\n%s/x\n' "$2" "$3" "$PWD" ;;
  --exit) echo "stopped on purpose" >&2; exit "$2" ;;
esac
END
chmod +x drc
mkdir tests

failures=0
# expect STATUS TEXT RUNNER-ARGUMENTS...: the runner ends with STATUS and prints TEXT.
expect() {
  local want=$1 text=$2 status=0 output
  shift 2
  output=$("$runner" "$@" 2>&1) || status=$?
  if [[ $status != "$want" || $output != *"$text"* ]]; then
    printf 'FAILED: golden_runner %s\n  exit %s, expected %s; expected text: %s\n%s\n' "$*" "$status" "$want" "$text" "$output"
    failures=$((failures + 1))
  fi
}
# case_file NAME: a test file from standard input; `run STATUS TEXT NAME` runs it.
case_file() { cat > "tests/$1"; }
run() { expect "$1" "$2" --drc drc --file "tests/$3"; }

# Output against an expectation, with the folder's path dropped; a file is written by --update only.
case_file say.dr <<< '//TEST: --say "two  words"'
run 1 "does not exist" say.dr
[[ ! -e tests/say.expected ]] || { echo "FAILED: an expectation was written without --update"; failures=1; }
expect 0 "say.expected: new" --drc drc --update tests
[[ $(cat tests/say.expected) == $'two  words\nsay.dr\nx' ]] || { echo "FAILED: say.expected"; failures=1; }
run 0 "" say.dr
printf 'two  words\nother.dr\nx\n' > tests/say.expected
run 1 $'@@ -1,3 +1,3 @@\n two  words\n-other.dr\n+say.dr\n x' say.dr
expect 0 "say.expected: changed" --drc drc --update --file tests/say.dr
run 0 "" say.dr

# Tags, {file}, several tests, .ir files.
case_file tag.ir <<< $'//TEST[a]: --say {file} rest\n  //TEST[b]: --say b'
printf 'tag.ir\nrest\nx\n' > tests/tag.a.expected
run 1 "tag.b.expected" tag.ir
printf 'b\ntag.ir\nx' > tests/tag.b.expected
run 1 'No newline at end of file' tag.ir
printf 'b\ntag.ir\nx\n' > tests/tag.b.expected
run 0 "" tag.ir

# Exit codes.
case_file exit.dr <<< $'//TEST: --exit 3\n//EXIT: 3'
: > tests/exit.expected
run 0 "" exit.dr
case_file exit.dr <<< $'//TEST: --exit 3'
run 1 "stopped on purpose" exit.dr
expect 1 "drc exits with 3, expected 0" --drc drc --update --file tests/exit.dr
expect 1 "exits with 127" --drc no-such-command --file tests/exit.dr
rm tests/exit.*

# The other stream.
case_file stream.dr <<< $'//TEST: check\n//COMPARE: stderr\n//EXIT: 1\n//CHECK: stands in stderr\n//! stands in stderr'
run 0 "" stream.dr
case_file stream.dr <<< $'//TEST: check\n//EXIT: 1\n//CHECK: stands in stderr\n//! stands in stderr'
run 1 "not found" stream.dr
case_file stream.dr <<< $'//TEST: check\n//COMPARE: stdin'
run 1 "takes 'stderr'" stream.dr
rm tests/stream.*

# CHECK lines: in order, and no expectation file.
case_file check.dr <<< $'//TEST: --say "one two three two"\n//CHECK: one\n//CHECK-NOT: three\n//CHECK: two\n//CHECK: two'
run 0 "" check.dr
case_file check.dr <<< $'//TEST: --say "one two three"\n//CHECK: two\n//CHECK: one'
run 1 "check.dr:3: not found after" check.dr
case_file check.dr <<< $'//TEST: --say "one two three"\n//CHECK: one\n//CHECK-NOT: two\n//CHECK: three'
run 1 "check.dr:3: found, though" check.dr
case_file check.dr <<< $'//TEST: --say "one two three"\n//CHECK: one\n//CHECK-NOT: two'
run 1 "check.dr:3: found, though" check.dr

# ERROR lines: each has its message, each message its line.
case_file error.dr << 'END'
let x = 1;
//ERROR: E0312 cannot add
//ERROR: E0001
let y = 2;
//ERROR: E0102 end of file
//! error.dr:1:3: error[E0001]: first
//!   1 | let x
//! error.dr:1:5: error[E0312]: cannot add vec3 and vec4
//! error.dr:4:1: error[E0102]: unexpected end of file
END
run 0 "" error.dr
sed -i 's/^\/\/ERROR: E0001$//' tests/error.dr
run 1 "no //ERROR below the line for: error.dr:1:3" error.dr
case_file error.dr <<< $'let x = 1;\n//ERROR: E0312 cannot\n//! error.dr:2:1: error[E0312]: must add'
run 1 "error.dr:2: drc does not report E0312 'cannot' for line 1" error.dr
case_file error.dr <<< $'let x = 1;\n//ERROR: E0312 cannot'
run 1 "drc check: drc exits with 0, expected 1" error.dr
case_file error.dr <<< $'let x = 1;\n//ERROR: E0312 a\n//! other.dr:1:1: error[E0312]: a'
run 1 "no //ERROR below the line for: other.dr:1:1" error.dr
# A parser that runs out of text reports the end of the file, where the directive stands.
{ printf '//! end.dr:4:1: error[E0102]: unexpected end\nfn f(\n//ERROR: E0102 unexpected end\n'; } | case_file end.dr
run 0 "" end.dr
rm tests/end.dr tests/error.dr tests/check.dr

# Skips end with ctest's code, and fail once the test passes.
case_file skip.dr <<< $'//TEST: --exit 1\n//SKIP: known'
run 77 "skipped: known" skip.dr
expect 0 "1 skipped" --drc drc tests
case_file skip.dr <<< $'//TEST: --exit 0\n//SKIP: known'
: > tests/skip.expected
run 1 "remove its //SKIP" skip.dr
rm tests/skip.*

# Directives that make no sense.
while IFS='|' read -r text message; do
  printf '%b\n' "$text" | case_file bad.dr
  run 1 "$message" bad.dr
done << 'END'
let x = 1;|no //TEST and no //ERROR
//TEST --say|expected ':'
//TEST: a\n//TEST: b|needs a tag
//TEST[a]: a\n//TEST[a]: b|used twice
//TEST[a b]: a|the tag
//TEST: "a|quote is not closed
//TEST: a\n//EXIT: one|takes a number
//TEST: a\n//CHECK-NEXT: b|unknown directive //CHECK-NEXT
//TEST: a\n//HELP: b|unknown directive //HELP
//CHECK: b|//CHECK without a //TEST
//ERROR: E0312|no code above
let x = 1;\n//ERROR: cannot add|takes a code
let x = 1; //ERROR: E0312|on a line of its own
END
rm tests/bad.dr

# Scanning: modules without directives are left out; expectations need exactly one reader.
case_file module.dr <<< 'fn f() {}'
expect 0 $'tests/say.dr\ntests/tag.ir' --list tests
expect 0 "2 passed, 0 failed, 0 skipped" --drc drc tests
expect 0 "" --unused tests no-such-folder
: > tests/say.old.expected
expect 1 "say.old.expected: no test reads it" --unused tests
rm tests/say.old.expected
case_file say.ir <<< '//TEST: --say "two  words"'
expect 1 "say.expected: read by several tests" --unused tests

# Usage.
expect 0 "usage:" --help
expect 2 "usage:"
expect 2 "usage:" --file tests/say.dr
expect 2 "usage:" --drc drc --file tests/none.dr
expect 2 "usage:" --drc drc --wrong tests

[[ $failures == 0 ]] && echo "all cases pass"
