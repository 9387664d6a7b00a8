#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# compile.sh BUILD_FOLDER [RUNS]: what compiling costs, by pass. The figures go to bench-out/compile.json as well.
set -euo pipefail
mkdir -p bench-out
exec "$1/bin/bench_compile" bench-out/compile.json "${@:2}"
