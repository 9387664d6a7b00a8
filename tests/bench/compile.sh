#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# compile.sh BUILD_FOLDER [RUNS] [--device NAME] [--quick]: what compiling costs, by pass, the median of 9 runs (--quick: 3), then of whole
# programs, with the driver's time beside it. The figures go to bench-out/compile.json and bench-out/compile/programs.json as well.
set -euo pipefail
source "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/suite.bash"
suite compile "$@"
default=${quick:+3}
"$bin/bench_compile" bench-out/compile.json "${rest[0]:-${default:-9}}"
exec /usr/bin/python3 "$here/compile_programs.py" "$bin" "$out" "$device" ${quick:+--quick}
