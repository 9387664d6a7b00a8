#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# scale.sh BUILD_FOLDER [--device NAME] [--quick]: what a frame (scale.dr: a silhouette, forward and backward) costs by the number of
# triangles, pixels, views and ops a pixel. Each grows alone from 5,000 triangles, one view of 128² and no further ops. Says the exponent
# over all and between the two largest (the line in log-log), and from where on the cost grows by more than the square root:
# before that, what is fixed weighs more. Times are `us a run while several are under way`; see suite.py.
set -euo pipefail
PYTHONDONTWRITEBYTECODE=1 PYTHONPATH=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")") exec /usr/bin/python3 - "$@" << 'END'
import numpy as np
from suite import Suite, lines, plt

suite = Suite("scale")
big = not suite.quick
axes_of = {
    "triangles": (1_000, 5_000, 25_000, 100_000) + ((400_000, 1_000_000) if big else ()),
    "pixels": (64, 128, 256, 512) + ((1024, 2048) if big else ()),
    "views": (1, 4, 16) + ((64,) if big else ()),
    "ops": (0, 64, 256) + ((1024,) if big else ()),
}
base = {"triangles": 5_000, "pixels": 128, "views": 1, "ops": 0}
spheres, cells, done = {}, [], set()
for axis, values in axes_of.items():
    for value in values:
        at = {**base, axis: value}
        if tuple(at.values()) in done:
            continue
        done.add(tuple(at.values()))
        if at["triangles"] not in spheres:
            around = round((at["triangles"] * 0.65) ** 0.5)
            spheres[at["triangles"]] = suite.uv_sphere(around, round(at["triangles"] / (2 * around)) + 1)[:4]
        runs = 2000 if suite.device else 10
        cells.append((at, "scale.dr", "frame", runs, [*spheres[at["triangles"]], "--bind", "rate==1e-9", "--bind", "gain==1e-3", "-D",
                                                      f"S={at['pixels']}", "-D", f"N={at['views']}", "-D", f"ops={at['ops']}"]))

rows = suite.race(cells, 1 if suite.quick else 3)
figure, panels = plt.subplots(1, 4, figsize=(16, 4))
for panel, axis in zip(panels, axes_of):
    mine = sorted((r for r in rows if all(r[k] == v for k, v in base.items() if k != axis)), key=lambda r: r[axis])
    power = 2 if axis == "pixels" else 1  # `pixels` is a side
    mine = [r for r in mine if r[axis] > 0]
    x, y = np.log([float(r[axis]) ** power for r in mine]), np.log([r["us"] for r in mine])
    local = np.diff(y) / np.diff(x)
    steep = next((k for k in range(len(local)) if all(local[k:] > 0.5)), None)
    bend = None if steep is None else mine[steep][axis]
    exponent = float(np.polyfit(x, y, 1)[0])
    suite.record(axis=axis, exponent=exponent, exponent_at_the_end=float(local[-1]), bends_at=bend, **{"from": mine[0][axis], "to": mine[-1][axis]})
    print(f"{axis}: exponent {exponent:.2f}, {local[-1]:.2f} at the end; above 0.5 from {bend} on")
    lines(panel, mine, axis, lambda r: "")
    panel.set(yscale="log", xlabel="side of the picture" if axis == "pixels" else axis, title=f"exponent {exponent:.2f}, {local[-1]:.2f} at the end")
panels[0].set_ylabel("ms a frame")
suite.save(figure, "plot")
END
