#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# ggx.sh BUILD_FOLDER [--device NAME] [--quick]: D and V of GGX and a whole metal on a device against mpmath, at 10,000 points (--quick:
# 1000) with cosines from 1e-3 and alpha from 2e-3. Their bounds are 4 u / alpha + 8 u, 1e-6 and 1e-4, relative.
set -euo pipefail
source "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/suite.bash"
suite ggx "$@"
no_more
draw_points 10000 1000 normal to_light to_camera alpha
judge_points "$device" figures
