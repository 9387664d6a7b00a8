#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# shading.sh BUILD_FOLDER [--device NAME] [--quick]: what materials, a sky and shadows cost a frame of 512² forward and backward, with gradients to mesh and
# textures: GGX beside Phong with the same textures, a filtered sky, and the shadow of a sun and of a spot lamp beside a frame without and the map alone.
set -euo pipefail
PYTHONDONTWRITEBYTECODE=1 PYTHONPATH=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")") exec /usr/bin/python3 - "$@" << 'END'
from suite import Suite

suite = Suite("shading")
mesh = suite.icosphere(4)
steps = ("phong", "ggx", "full", "sky_light", "map", "shaded", "spot_map", "spot_bare", "spot")
rows = suite.race([({"frame": step}, "shading.dr", step, 20 if suite.quick else 60, mesh) for step in steps], rounds=3 if suite.quick else 9)


def ratios(us):
    return {"GGX / Phong": us["ggx"] / us["phong"], "GGX that keeps energy / Phong": us["full"] / us["phong"],
            "sky / Phong": us["sky_light"] / us["phong"],
            "sun's shadow: what it adds / its map": (us["shaded"] - us["ggx"]) / us["map"],
            "spot's shadow: what it adds / its map": (us["spot"] - us["spot_bare"]) / us["spot_map"]}


# A machine that others use makes a difference of two medians say little; least times differ by a few hundredths from run to run.
least = ratios({row["frame"]: row["us_least"] for row in rows})
for what, value in ratios({row["frame"]: row["us"] for row in rows}).items():
    suite.record(ratio=what, value=value, of_least=least[what])
    print(f"{what}: {value:.2f}, of least times {least[what]:.2f}")
END
