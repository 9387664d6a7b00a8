#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Who may include whom: the pipeline's folders point one way. usage: layering_test.sh SOURCE_ROOT
# The linker says the same for code; headers alone could slip past it.
set -euo pipefail

# For a folder, what its files may include besides the folder itself. The deepest folder that matches decides.
rules='
dsl/source
dsl/diagnostic           dsl/source/
dsl/syntax               dsl/source/ dsl/diagnostic/
dsl/format               dsl/source/ dsl/diagnostic/ dsl/syntax/
dsl/document             dsl/source/ dsl/syntax/
compiler/ir              dsl/
compiler/ops             dsl/ compiler/ir/
compiler/target          dsl/ compiler/ir/ compiler/ops/
compiler/topology
compiler/lower           dsl/ compiler/ir/ compiler/ops/ compiler/topology/
compiler/passes          dsl/ compiler/ir/ compiler/ops/ compiler/target/ compiler/topology/
compiler/passes/gradient  GRAPH PASSES
compiler/passes/scatter   GRAPH PASSES
compiler/passes/simplify  GRAPH PASSES
compiler/reference       dsl/ compiler/ir/ compiler/ops/ compiler/topology/ compiler/io/array/ compiler/io/file/
compiler/backend/bundle    compiler/ir/dim.h
compiler/backend/analysis  BUNDLE GRAPH dsl/source/source.h
compiler/backend/schedule  BUNDLE GRAPH compiler/target/ B/analysis/
compiler/backend/cost      BUNDLE GRAPH compiler/target/ B/analysis/ B/schedule/
compiler/backend/pack      BUNDLE GRAPH compiler/target/ B/analysis/ B/schedule/ B/cost/
compiler/backend/lowering  BUNDLE GRAPH compiler/target/ B/analysis/ B/schedule/ B/cost/ B/pack/
compiler/backend/glsl      BUNDLE GRAPH B/analysis/ B/schedule/
compiler/backend/plan      BUNDLE compiler/ir/dim.h compiler/ir/initial_step.h
compiler/backend/emit      BUNDLE GRAPH B/analysis/ B/schedule/ B/glsl/ B/plan/
compiler/backend/spirv     BUNDLE compiler/ir/ B/glsl/source.h
compiler/backend           dsl/ GRAPH compiler/target/ compiler/passes/ compiler/backend/
compiler/driver          dsl/ compiler/ir/ compiler/lower/ compiler/passes/ compiler/target/ compiler/backend/
compiler/language_server dsl/ compiler/ir/ compiler/ops/ compiler/lower/
compiler/drc             dsl/ compiler/
compiler/io              compiler/io/
compiler/io/file
compiler/io/array        compiler/io/file/
compiler/io/picture      compiler/io/file/ compiler/io/array/
compiler/io/mesh         compiler/io/file/ compiler/io/array/ compiler/io/picture/
runtime                  compiler/backend/bundle/ compiler/io/ compiler/ir/dim.h compiler/ir/initial_step.h compiler/ir/internal_error.h compiler/target/ compiler/topology/
runtime/data             BUNDLE compiler/io/ compiler/ir/dim.h compiler/topology/
runtime/cache            BUNDLE
runtime/vk               BUNDLE compiler/io/ compiler/ir/dim.h compiler/target/ runtime/runtime.h runtime/data/ runtime/cache/
runtime/watch            compiler/io/
runtime/jit              runtime/ compiler/ dsl/
runtime/c                runtime/ compiler/backend/bundle/ compiler/backend/plan/ compiler/ir/initial_step.h compiler/ir/internal_error.h compiler/target/ dsl/source/utf8.h
'
# Short names: B is the back end, BUNDLE its contract with the runtime, GRAPH what all that read a graph may use, PASSES what passes share.
rules=${rules//PASSES/compiler/passes/passes.h compiler/passes/copy_steps.h}
rules=${rules//BUNDLE/B/bundle/}
rules=${rules//GRAPH/compiler/ir/ compiler/ops/}
rules=${rules// B\// compiler/backend/}

# Prints each include of the tree $1 that breaks the rules; fails if there is one.
check() {
  (cd "$1" && grep -rnE '^[ \t]*#[ \t]*include' --include='*.h' --include='*.cpp' --include='*.def' \
    $(for folder in dsl compiler runtime; do [[ -d $folder ]] && echo "$folder"; done) /dev/null || true) |
    awk -v rules="$rules" '
      BEGIN {
        lines = split(rules, line, "\n")
        for (i = 1; i <= lines; ++i) {
          words = split(line[i], word, " ")
          if (words > 0) allowed[word[1]] = line[i] " " word[1] "/"
        }
      }
      function bad(why) { print source ": " included ": " why; failed = 1 }
      {
        source = $0; sub(/:.*/, "", source)
        if (!match($0, /["<][^">]*[">]/)) next
        quote = substr($0, RSTART, 1)
        included = substr($0, RSTART + 1, RLENGTH - 2)
        if (quote == "<") {
          if (included ~ /^(dsl|compiler|runtime|tests)\//) bad("own headers are included with quotes")
          next
        }
        if (included ~ /^[^\/]*_generated\.h$/) next  # made by flatc in the build folder
        if (included ~ /^[^\/]*\.inc$/) next           # a text, made a literal in the build folder
        if (included !~ /^(dsl|compiler|runtime)\//) { bad("not a full path from the root"); next }
        folder = source
        while (sub(/\/[^\/]*$/, "", folder) && !(folder in allowed)) continue
        if (!(folder in allowed)) { bad("no rule for this folder in tests/layering_test.sh"); next }
        words = split(allowed[folder], word, " ")
        for (i = 2; i <= words; ++i) if (index(included, word[i]) == 1) next
        bad("not allowed in " folder)
      }
      END { exit failed }'
}

# The check itself is checked first: each of these must be refused, and the last few let pass.
tree=$(mktemp -d)
trap 'rm -rf "$tree"' EXIT
count=0
probe() {  # probe FILE INCLUDE pass|refuse
  count=$((count + 1))
  mkdir -p "$tree/$count/$(dirname "$1")"
  printf '#include %s\n' "$2" > "$tree/$count/$1"
  local verdict=pass
  check "$tree/$count" > /dev/null || verdict=refuse
  [[ $verdict == "$3" ]] || { echo "self-test: $1 including $2: $verdict, expected $3"; exit 1; }
}
probe dsl/a.h '"compiler/ir/graph.h"' refuse
probe compiler/ir/a.h '"compiler/ops/op.h"' refuse
probe compiler/drc/a.cpp '"runtime/device.h"' refuse
probe compiler/passes/a.cpp '"compiler/backend/compile.h"' refuse
probe runtime/a.cpp '"compiler/ir/graph.h"' refuse
probe compiler/io/a.cpp '"runtime/device.h"' refuse
probe compiler/io/a.cpp '"compiler/ir/dim.h"' refuse
probe compiler/io/array/a.cpp '"compiler/io/mesh/mesh.h"' refuse
probe compiler/io/mesh/a.cpp '"compiler/io/picture/image.h"' pass
probe runtime/vk/a.cpp '"device.h"' refuse
probe dsl/a.h '<dsl/b.h>' refuse
probe elsewhere/a.h '"nothing.h"' pass
probe dsl/a.h '<vector>' pass
probe runtime/vk/a.cpp '"compiler/backend/bundle/bundle.h"' pass
probe runtime/vk/a.cpp '"compiler/ir/dim.h"' pass
probe runtime/data/a.cpp '"runtime/vk/device.h"' refuse
probe runtime/cache/a.cpp '"runtime/program/state.h"' refuse
probe runtime/vk/a.cpp '"runtime/program/state.h"' refuse
probe runtime/program/a.cpp '"runtime/cache/run_list.h"' pass
probe runtime/jit/a.cpp '"compiler/passes/passes.h"' pass
probe compiler/backend/bundle/bundle.h '"bundle_generated.h"' pass
probe compiler/backend/analysis/a.h '"compiler/backend/schedule/schedule.h"' refuse
probe compiler/backend/schedule/a.h '"compiler/backend/pack/pack.h"' refuse
probe compiler/backend/pack/a.cpp '"compiler/backend/lowering/scatter.h"' refuse
probe compiler/backend/lowering/a.cpp '"compiler/backend/glsl/text.h"' refuse
probe compiler/backend/glsl/a.cpp '"compiler/target/profile.h"' refuse
probe compiler/backend/glsl/a.cpp '"compiler/backend/emit/generator.h"' refuse
probe compiler/backend/plan/a.cpp '"compiler/backend/schedule/schedule.h"' refuse
probe compiler/backend/spirv/a.cpp '"compiler/backend/compile.h"' refuse
probe compiler/backend/lowering/a.cpp '"compiler/backend/pack/stages.h"' pass
probe compiler/backend/compile.cpp '"compiler/backend/emit/generator.h"' pass

# Emission asks the schedule how code is to be written, never the device (compiler/backend/lowering/choose_code.h).
asks_device() {
  (cd "$1/compiler/backend" && grep -rnsE 'target::|(^|[^a-zA-Z_])profile_?[.]|compiler/target' emit glsl || true) |
    grep -vE '^[^:]*:[0-9]+: *//'
}
mkdir -p "$tree/asks/compiler/backend/emit"
echo 'if (profile_.subgroup_size > 1) return;' > "$tree/asks/compiler/backend/emit/a.cpp"
asks_device "$tree/asks" > /dev/null 2>&1 || { echo 'self-test: emission that asks the device passes'; exit 1; }
if asks_device "$1"; then echo 'emission asks the device'; exit 1; fi

check "$1"
