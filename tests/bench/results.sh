#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# results.sh BUILD_FOLDER [--page]: takes the headline figures that benchmarks left in bench-out/ into docs/results/figures.jsonl, each with its
# commit, device and date, in place of the older one of the same device, and makes docs/results/README.md of all that stands there.
# --page only makes the page. Figures of --quick, and of a tree with changes, are not taken.
set -euo pipefail
exec /usr/bin/env python3 "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/results.py" "${@:2}"
