#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# hair.sh BUILD_FOLDER [--device NAME] [--quick]: M, N, A of std.hair and whole fibres on a device and in the evaluator against mpmath, at 10,000
# points (--quick: 300).
set -euo pipefail
source "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/suite.bash"
suite hair "$@"
no_more
draw_points 10000 300 tangent to_light to_camera fiber melanin h variance scale phi
echo "the evaluator:"
judge_points reference figures_evaluator
echo "the device:"
judge_points "$device" figures
