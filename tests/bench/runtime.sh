#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# runtime.sh BUILD_FOLDER [ROUNDS] [--device NAME] [--quick]: what the host adds to a step, in 25 rounds (--quick: 5). The figures go
# to bench-out/runtime.json as well.
set -euo pipefail
source "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/suite.bash"
suite runtime "$@"
default=${quick:+5}
exec "$bin/bench_runtime" bench-out/runtime.json "$device" "${rest[0]:-${default:-25}}"
