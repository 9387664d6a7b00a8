#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# runtime.sh BUILD_FOLDER [DEVICE [ROUNDS]]: what the host adds to a step. The figures go to bench-out/runtime.json as
# well. The device is lavapipe, where DR_LAVAPIPE_ICD says it is, unless another one is named.
set -euo pipefail
mkdir -p bench-out
if [[ -z ${2-} && -n ${DR_LAVAPIPE_ICD-} ]]; then export VK_ICD_FILENAMES=$DR_LAVAPIPE_ICD VK_DRIVER_FILES=$DR_LAVAPIPE_ICD; fi
exec "$1/bin/bench_runtime" bench-out/runtime.json "${@:2}"
