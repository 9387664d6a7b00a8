#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# compile.sh BUILD_FOLDER [RUNS] [--quick]: what compiling costs, by pass, the median of 9 runs (--quick: 3). The figures go to
# bench-out/compile.json as well.
set -euo pipefail
source "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/suite.bash"
suite compile "$@"
default=${quick:+3}
exec "$bin/bench_compile" bench-out/compile.json "${rest[0]:-${default:-9}}"
