#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The documents that commands write are as they write them now. usage: generated_docs.sh DRC SOURCE_ROOT [DRUN] [--update]
# A build without the runtime has no drun, and leaves docs/reference/drun.md alone.
set -euo pipefail
drc=$(realpath "$1") root=$2
shift 2
drun='' update=0
for argument in "$@"; do
  if [[ $argument == --update ]]; then update=1; else drun=$(realpath "$argument"); fi
done
cd "$root"
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

"$drc" doc --ops -o "$work/ops.md"
# A page for each module, and one that lists them with the first sentence of each.
mkdir "$work/library"
{
  printf '<!-- Made from stdlib/std/; see docs/howto/test.md. -->\n# The library\n\n'
  printf 'Each page begins with a worked example, which `tests/golden/library_examples_test.sh` runs.\n\n'
  printf '| module | holds |\n| --- | --- |\n'
} > "$work/library.md"
for module in stdlib/std/*.dr; do
  name=$(basename "$module" .dr)
  {
    printf '<!-- Made by `drc doc` from %s; see docs/howto/test.md. -->\n' "$module"
    "$drc" doc "$module"
  } > "$work/library/$name.md"
  sentence=$(awk '!/^\/\/\/ ./ { exit } { printf "%s ", substr($0, 5) }' "$module" | sed -E 's/([^l])\. .*/\1/; s/\. *$//; s/ $//')
  printf '| [%s](library/%s.md) | %s |\n' "$name" "$name" "$sentence" >> "$work/library.md"
done

# help_page NAME COMMAND SUBCOMMAND...: what --help says of a command and of each of its subcommands.
help_page() {
  local name=$1 command=$2 subcommand
  shift 2
  printf '<!-- Made by `%s --help`; see docs/howto/test.md. -->\n# %s\n\n```text\n' "$name" "$name"
  "$command" --help
  printf '```\n'
  for subcommand in "$@"; do
    printf '\n## %s %s\n\n```text\n' "$name" "$subcommand"
    "$command" "$subcommand" --help
    printf '```\n'
  done
}
# subcommands COMMAND: those that its help lists.
subcommands() { "$1" --help | awk '/^Subcommands:/ { inside = 1; next } /^[^ ]/ { inside = 0 } inside && NF { print $1 }'; }

# shellcheck disable=SC2046
help_page drc "$drc" $(subcommands "$drc") | sed 's/[ \t]*$//' > "$work/drc.md"
# shellcheck disable=SC2046
if [[ -n $drun ]]; then help_page drun "$drun" $(subcommands "$drun") | sed 's/[ \t]*$//' > "$work/drun.md"; fi

{
  cat << 'END'
<!-- Made by `drc explain`; see docs/howto/test.md. -->
# Errors

A message of `drc` names its place, a code, what was found and what was expected, and where it can what to write instead:

```text
fit.dr:4:13: error[E0201]: expected a name that is declared, found 'positon'
4 | let moved = positon + offset;
  |             ^^^^^^^
help: did you mean 'position'?
```

`drc explain CODE` says what a code means, with an example that gets it and one that does not. The texts stand in
[dsl/diagnostic/explanations.md](../../dsl/diagnostic/explanations.md). A code keeps its meaning for ever.

Exit codes of [drc](drc.md): 0 ok, 1 an error in the input, 2 bad usage, 3 an internal error.

| code | means |
| --- | --- |
END
  "$drc" explain | awk '{ code = $1; sub(/^[^ ]+ +/, ""); printf "| [%s](../../dsl/diagnostic/explanations.md#%s) | %s |\n", code, tolower(code), $0 }'
} > "$work/errors.md"

# The words that editors colour as functions.
grammar=dsl/editors/dressi.tmLanguage.json
functions=$("$drc" doc --functions | paste -sd'|')
sed -E "s/\(\?:abs\|[A-Za-z0-9_|]*\)/(?:$functions)/" "$grammar" > "$work/grammar.json"

failed=0
if ! cmp -s "$work/grammar.json" "$grammar"; then
  if ((update)); then
    cp "$work/grammar.json" "$grammar"
    echo "$grammar: changed"
  else
    diff -u "$grammar" "$work/grammar.json" || true
    echo "$grammar does not know the functions there are; ./dr test --update writes it anew"
    failed=1
  fi
fi
if ((update)); then mkdir -p docs/reference/library; fi
for page in "$work"/*.md "$work"/library/*.md; do
  name=${page#"$work"/}
  cmp -s "$page" "docs/reference/$name" && continue
  if ((update)); then
    cp "$page" "docs/reference/$name"
    echo "docs/reference/$name: changed"
  else
    diff -u "docs/reference/$name" "$page" || true
    echo "docs/reference/$name is not what the commands print; ./dr test --update writes it anew"
    failed=1
  fi
done
for page in docs/reference/library/*.md; do
  [[ -e $work/library/$(basename "$page") ]] && continue
  echo "$page is of no module"
  failed=1
done
exit $failed
