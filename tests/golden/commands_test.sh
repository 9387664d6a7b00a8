#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# What all commands of drc have in common: streams, exit codes, `-`, --help, --version, and files that are written whole
# or not at all. usage: commands_test.sh DRC
set -euo pipefail
drc=$(realpath "$1")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
printf 'edition 1;\nstep s { output a = 1.0; }\n' > good.dr
printf 'edition 1;\nlet x=;\n' > bad.dr
printf 'edition 1;\nlet  x=1.0;\n' > ugly.dr
printf 'edition 1;\nlet x = 1.0;\n' > tidy.dr

failed=0
# expect STATUS STREAM TEXT ARGUMENTS...: drc ends so, says TEXT on STREAM (out, err), and nothing on the other one.
# STREAM `both` says nothing of the other, `none` that both are empty. Input comes from the file `input`.
: > input
expect() {
  local want=$1 stream=$2 text=$3 status=0 other=err
  shift 3
  "$drc" "$@" < input > out 2> err || status=$?
  [[ $stream == err ]] && other=out
  local good=1
  [[ $status == "$want" ]] || good=0
  case $stream in
    none) [[ ! -s out && ! -s err ]] || good=0 ;;
    *) grep -qF -- "$text" "$stream" && [[ ! -s $other ]] || good=0 ;;
  esac
  if [[ $good == 0 ]]; then
    printf 'FAILED: drc %s: exit %s, expected %s and "%s" on %s\n' "$*" "$status" "$want" "$text" "$stream"
    sed 's/^/  out: /' out
    sed 's/^/  err: /' err
    failed=1
  fi
}

expect 0 out drc --version
expect 0 out 'Exit codes' --help
expect 2 err 'subcommand'
expect 2 err "no command 'nonsense'" nonsense
expect 2 err "did you mean 'build'" biuld
for command in check build eval fmt explain doc inspect; do
  expect 0 out "$command" $command --help
  expect 2 err 'no-such-option' $command --no-such-option good.dr
done
for command in check build eval fmt; do
  expect 2 err 'required' $command
  expect 1 err 'bad.dr:2:7: error[E0102]' $command bad.dr
  expect 1 err "cannot read 'missing.dr'" $command missing.dr
  expect 2 err 'xml' $command good.dr --diagnostics=xml
done
expect 1 err 'bad.dr:2:7: error[E0102]' doc bad.dr
expect 1 err "cannot read 'missing.dr'" doc missing.dr
printf 'v 0 0 0\n' > point.obj
expect 1 err "expected a program, found data: 'point.obj' can be bound to an input, as in --bind NAME=point.obj" check point.obj
expect 2 err 'expected a file' doc
expect 2 err 'required' inspect
expect 1 err "cannot read 'missing.drb': no such file" inspect missing.drb
expect 1 err 'not a bundle' inspect good.dr
expect 2 err 'text or json' build good.dr --report=yaml
expect 2 err 'did you mean' explain E031
expect 0 out E0711 explain

# What is given twice would count once; and what --known asks for.
printf 'edition 1;\nconst K = 1;\ninput glow : float;\ninput tint : vec3;\nparam p : float[K] = 1.0;\nstep s { output a = glow * p, b = tint; }\n' > known.dr
expect 2 err "--known: 'glow' is given twice, as '0' and '0.5'" build known.dr --known glow=0 --known tint=0 --known glow=0.5
expect 2 err "-D: 'K' is given twice, as '2' and '2'" check known.dr -D K=2 -D K=2
expect 2 err "--bind: 'glow' is given twice, as '0' and 'glow.npy'" eval known.dr --bind glow=0 --bind glow=glow.npy
expect 2 err "--symbol: 'W' is given twice, as '1' and '2'" eval known.dr --symbol W=1 --symbol W=2
expect 1 err "found 'glo', which the program does not have, did you mean 'glow'?" build known.dr --known glo=0
expect 1 err "found 'p', a param, whose value changes" build known.dr --known p=0
expect 1 err "expected one number or 3 as the --known value of 'tint', found 2" build known.dr --known tint=0,1
expect 1 err "expected one number as the --known value of 'glow', found 2" build known.dr --known glow=0,1
# A bundle where a program should be.
"$drc" build known.dr -o known.drb --no-cache
expect 1 err "'known.drb' is a bundle, which is compiled already" check known.drb
expect 1 err "'known.drb' is a bundle, which is compiled already" eval known.drb

# stdin and stdout
cp good.dr input
expect 0 none '' check -
expect 0 out 'step s' build -
expect 0 out 'a = 1' eval -
expect 0 out 'step s' fmt -
expect 0 out '# stdin' doc -
cp bad.dr input
expect 1 err '<stdin>:2:7: error' check -
expect 1 err '<stdin>:2:7: error' fmt -

# doc: what is written about a field stands above it, also where methods follow.
printf 'edition 1;\nstruct Lens {\n  /// Of its middle,\n  ///\n  /// in mm.\n  width: float;\n  fn half(self) { self.width }\n}\n' > lens.dr
expect 0 out '  /// Of its middle,' doc lens.dr
[[ $(grep -A3 'Of its' out) == $'  /// Of its middle,\n  ///\n  /// in mm.\n  width: float;' ]] || { echo "doc: $(cat out)"; failed=1; }

# fmt
expect 0 out 'let x = 1.0;' fmt ugly.dr
expect 1 out ugly.dr fmt --check tidy.dr ugly.dr
expect 0 none '' fmt --check tidy.dr good.dr
expect 2 err 'in-place' fmt --in-place -
expect 2 err 'excludes' fmt --in-place --check ugly.dr
expect 1 err 'E0102' fmt --in-place ugly.dr bad.dr
cmp ugly.dr tidy.dr || failed=1
[[ $(cat bad.dr) == $'edition 1;\nlet x=;' ]] || { echo 'fmt changed a file with errors'; failed=1; }
# An edition: the line that says so, where none does.
printf '// Light.\nlet  x=1.0;\n' > old.dr
expect 1 err "write 'edition 1;' as the first line" fmt old.dr
expect 0 out 'edition 1;' fmt --edition 1 old.dr
expect 0 none '' fmt --edition 1 --in-place old.dr
[[ $(cat old.dr) == $'// Light.\nedition 1;\n\nlet x = 1.0;' ]] || { echo "fmt --edition: $(cat old.dr)"; failed=1; }
expect 0 none '' check old.dr
expect 0 none '' fmt --edition 1 --check old.dr tidy.dr
expect 2 err 'edition' fmt --edition 2 old.dr
expect 0 out '--edition' fmt --help
# What is written about a declaration stays with it.
printf '// Light.\n/// What a is.\n/// And why.\nlet a = 1.0;\n' > old.dr
expect 0 none '' fmt --edition 1 --in-place old.dr
[[ $(cat old.dr) == $'// Light.\nedition 1;\n\n/// What a is.\n/// And why.\nlet a = 1.0;' ]] || { echo "fmt --edition: $(cat old.dr)"; failed=1; }
# A file keeps its mode and its other names.
printf 'edition 1;\nlet  x=1.0;\n' > private.dr
chmod 640 private.dr
expect 0 none '' fmt --in-place private.dr
[[ $(stat -c %a private.dr) == 640 ]] || { echo "fmt --in-place: mode $(stat -c %a private.dr)"; failed=1; }
cmp private.dr tidy.dr || failed=1
printf 'edition 1;\nlet  x=1.0;   // a text that gets shorter\n\n\n\n' > linked.dr
ln linked.dr other.dr
expect 0 none '' fmt --in-place linked.dr
[[ linked.dr -ef other.dr ]] || { echo 'fmt --in-place parts two names of a file'; failed=1; }
[[ $(cat other.dr) == $'edition 1;\nlet x = 1.0;  // a text that gets shorter' ]] || { echo "fmt --in-place: $(cat other.dr)"; failed=1; }
# On a full disk, the text stays.
if mkdir full && unshare -rm true 2> /dev/null; then
  unshare -rm bash -c 'mount -t tmpfs -o size=64k tmpfs full || exit 0
    { printf "edition 1;\n"; for i in {1..1500}; do printf "let x%d=1;\n" $i; done; } > full/a.dr
    ln full/a.dr full/b.dr
    cp full/a.dr before.dr
    head -c 100000 /dev/zero > full/rest 2> /dev/null
    ! "$1" fmt --in-place full/a.dr 2> err && grep -q "cannot write" err && cmp full/a.dr before.dr && [[ $(ls full) == $'"'"'a.dr\nb.dr\nrest'"'"' ]]' _ "$drc" || { echo "fmt --in-place on a full disk: $(cat err)"; failed=1; }
fi
# A pass that leaves an unsound schedule is a mistake of the compiler: code 3, the pass, the place, and a file that shows it again.
expect 3 err 'schedule fails verification after pass keep-sums' build good.dr --emit=bundle -o b.drb --no-cache --break-after=keep-sums
expect 3 err "step s: output 'a' is never stored" build good.dr --emit=bundle -o b.drb --no-cache --break-after=keep-sums
kept=$(sed -n 's/^  drc build \(.*\.ir\) .*/\1/p' err)
[[ -s $kept ]] || { echo "an internal error keeps no reproducer: $(cat err)"; failed=1; }
expect 3 err 'after pass keep-sums' build "$kept" --emit=bundle -o b.drb --break-after=keep-sums
expect 0 out 'output a' build "$kept" --emit=schedule
rm -f "$kept"
expect 2 err "unknown pass 'pac', did you mean 'pack'?" build good.dr --stop-after pac
expect 0 out 'step s {' build good.dr --stop-after pack
expect 0 out 'output a' build good.dr --stop-after simplify
expect 2 err 'diagnostics=json' build good.dr --diagnostics=json --time-passes
# So are bundles, and what each pass leaves can be seen.
expect 3 err 'bundle fails verification after pass plan-memory' build good.dr --emit=bundle -o b.drb --no-cache --break-after=plan-memory
rm -f "$(sed -n 's/^  drc build \(.*\.ir\) .*/\1/p' err)"
for pass in simplify differentiate pack choose-sums choose-code check-limits emit find-dependencies clear-together plan-memory assemble; do
  expect 0 err "// after $pass" build good.dr --emit=bundle -o b.drb --no-cache --dump-ir="$pass"
  expect 0 out 'step s' build good.dr --stop-after="$pass"
  expect 0 err "$pass: " build good.dr --emit=bundle -o b.drb --no-cache --time-passes
done
expect 0 out 'memory' build good.dr --stop-after=plan-memory

# Schedules are inputs, too: compiling goes on where they stand.
"$drc" build good.dr --stop-after=pack -o good.schedule || failed=1
expect 0 out 'schedule after keep-sums' build good.schedule --stop-after=keep-sums
"$drc" build good.schedule --emit=bundle -o from.drb && "$drc" build good.dr --emit=ir -o good.ir && "$drc" build good.ir --emit=bundle -o good.drb || failed=1
cmp from.drb good.drb || { echo 'a bundle by way of a schedule is another one'; failed=1; }
expect 0 out 'a = 1' eval good.schedule
sed 's/^  stage 0/  stag 0/' good.schedule > wrong.schedule
expect 1 err 'wrong.schedule:9: error: expected a stored value' build wrong.schedule --stop-after=pack
sed 's/^schedule after pack/schedule after pac/' good.schedule > wrong.schedule
expect 1 err "no pass over schedules, did you mean 'pack'?" build wrong.schedule --stop-after=pack
sed 's/^    writes.*/    writes/' good.schedule > wrong.schedule
expect 1 err "step s: output 'a' is never stored" build wrong.schedule --stop-after=pack

# Whole or not at all: what cannot be written leaves nothing behind.
expect 1 err "cannot write 'no/such/folder'" build good.dr -o no/such/folder
expect 1 err 'bad.dr' build bad.dr -o bad.ir
[[ ! -e bad.ir ]] || { echo 'a failed build left a file'; failed=1; }
"$drc" explain > /dev/full 2> err && { echo 'a full disk is not told'; failed=1; }
grep -q 'cannot write to stdout' err || failed=1
[[ -z $(find . -name '*.new') ]] || { echo 'a temporary file is left'; failed=1; }
exit $failed
