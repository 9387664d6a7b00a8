#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# contractions.sh BUILD_FOLDER [--device NAME] [--quick]: products of matrices, dense layers, a network and convolutions, by blocks of elements (on
# GPUs with reads that workgroups do together) and element by element: us a run of each, and the ratio. On processors --quick leaves the large ones out.
set -euo pipefail
PYTHONDONTWRITEBYTECODE=1 PYTHONPATH=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")") exec /usr/bin/python3 - "$@" << 'END'
from suite import Suite

suite = Suite("contractions")
runs = {"matmul_512": 20, "matmul_1024": 10, "dense": 20, "dense_fit": 10, "network": 50, "convolution_9x9": 50, "features_16": 50}
if suite.quick:
    runs = {step: 3 for step in runs if step != "matmul_1024"}
ways = {"blocks": [], "one by one": ["--ablate", "blocks"]}
rows = suite.race([({"step": step, "way": way}, "contractions.dr", step, count, arguments) for step, count in runs.items()
                   for way, arguments in ways.items()])
us = {(row["step"], row["way"]): row["us"] for row in rows}
for step in runs:
    ratio = us[step, "blocks"] / us[step, "one by one"]
    suite.record(ratio=f"{step}: blocks / one by one", value=ratio)
    print(f"{step}: blocks / one by one {ratio:.2f}")
END
