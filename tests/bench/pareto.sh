#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# pareto.sh BUILD_FOLDER [--device NAME] [--quick]: run time of a frame against its errors (pareto.dr), for a sphere of 1,280 faces at
# 256² (--quick: 96²), an axis at a time: how edges are softened, layers K, radius, sigma (its share of the radius; 0: the library's), edge mask, scatter, texture fetch,
# lowering. Errors are relative L2 of gradients: `numerical_*` of the device against the float64 evaluator that is given its
# decisions, to vertices and to texels; `bias` of the evaluator's against the gradient of exact area coverage, vertex by vertex,
# and `bias_whole` of their sums for shifts and growth of the whole. The latter is in closed form: the silhouette of a convex
# mesh is the hull of its projected vertices, and moving an edge changes coverage by the integral along it, which is cut at the
# pixels' borders. Times are `us a run while several are under way`; see suite.py. The plot marks
# the fronts. Before that, the bias of meshes of 80 to 5,120 faces.
set -euo pipefail
PYTHONDONTWRITEBYTECODE=1 PYTHONPATH=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")") exec /usr/bin/python3 - "$@" << 'END'
import numpy as np
from coverage import distance_from, true_gradient
from suite import Failed, Suite, here, plt, text

suite = Suite("pareto")
size = 96 if suite.quick else 256


def sphere(levels):
    return [*suite.icosphere(levels), "--bind", "rate==0"]


def bias(found, true, points):
    return distance_from(found, true, points, size)


def evaluated(bound, consts, **outputs):
    """The evaluator's output of each step, a pair a vertex."""
    saves = [w for step, name in outputs.items() for w in ("--step", step, "--save", f"{name}={suite.out / name}.npy")]
    suite.call("drc", "eval", here / "pareto.dr", *bound, *consts, *saves)
    return [np.load(suite.out / f"{name}.npy").astype(np.float64).reshape(-1, 2) for name in outputs.values()]


# What finer meshes do to the bias.
for levels in (1, 4) if suite.quick else (1, 2, 3, 4):
    for way, name in ((0, "outlines"), (1, "faces"), (2, "antialias")):
        pixels, found = evaluated(sphere(levels), ["-D", f"S={size}", "-D", f"way={way}", "-D", f"K={3 if way == 1 else 1}"],
                                  project="pixel", frame="to_slide")
        row = {"way": name, "pixels": size, "faces": 20 * 4**levels, **bias(found, true_gradient(pixels), pixels)}
        suite.record(**row)
        print(text(row), flush=True)

bound = sphere(3)
[points] = evaluated(bound, ["-D", f"S={size}"], project="pixel")
true = true_gradient(points)
base = {"way": "outlines", "K": 1, "radius": 2.0, "share": 7, "mask": True, "fetch": "linear", "scatter": "exact", "lower": "auto"}
changes = [{}, {"radius": 1.0}, {"radius": 1.0, "share": 0}, {"radius": 4.0}, {"share": 3}, {"way": "antialias"}, {"way": "faces", "K": 1}, {"way": "faces", "K": 3},
           {"way": "faces", "K": 3, "mask": False}, {"scatter": "atomic"}, {"fetch": "nearest"}, {"lower": "fragment"}]
if not suite.quick:
    changes += [{"radius": 0.5}, {"radius": 0.5, "share": 0}, {"radius": 7.0}, {"share": 5}, {"share": 10}, {"share": 2}, {"K": 3}, {"mask": False}, {"lower": "compute"},
                {"scatter": "rows"}, {"way": "antialias", "scatter": "atomic"}, {"way": "faces", "K": 2}, {"way": "faces", "K": 5}]
    changes += [{"way": "faces", "K": k, "radius": r} for k in (1, 3) for r in (1.0, 4.0, 7.0)]
    changes += [{"way": "faces", "K": 3, "share": s} for s in (3, 10)]

cells = []
for change in changes:
    at = {**base, **change}
    consts = {"S": size, "way": ["outlines", "faces", "antialias"].index(at["way"]), "K": at["K"], "R": at["radius"], "share": f"{at['share']}.0",
              "everywhere": int(not at["mask"]), "linear": int(at["fetch"] == "linear")}
    arguments = [*bound, *(w for k, v in consts.items() for w in ("-D", f"{k}={v}"))]
    options = ["--scatter", at["scatter"], "--lower", at["lower"]]
    try:
        frame = suite.against_evaluator("pareto.dr", "frame", ["to_slide", "to_texels"], arguments, options)
    except Failed as failed:
        suite.record(**at, pixels=size, problem=failed.args[1])
        print(text(change), "does not run:", failed.args[1])
        continue
    errors = {"numerical_vertices": frame["to_slide"][2], "numerical_texels": frame["to_texels"][2],
              **bias(frame["to_slide"][1].reshape(-1, 2), true, points)}
    cells.append(({**at, "pixels": size, **errors}, "pareto.dr", "frame", 2000 if suite.device else 10, [*arguments, *options]))

rows = suite.race(cells, 2 if suite.quick else 5)
name = lambda r: " ".join([r["way"]] + [v if isinstance(v, str) else f"{k}={v:g}" for k, v in r.items() if k in base and v != base[k] and k != "way"])
figure, axes = plt.subplots(1, 3, figsize=(15, 4.6))
for ax, kind in zip(axes, ("numerical_vertices", "bias", "bias_whole")):
    front = []
    for r in sorted(rows, key=lambda r: r["us"]):
        if not front or r[kind] < front[-1][kind]:
            front.append(r)
    suite.record(front=kind, cells=[name(r) for r in front])
    print(f"the front of {kind}:", ", ".join(f"{name(r)} ({r['us'] / 1000:.1f} ms, {r[kind]:.1e})" for r in front))
    for way, color in (("outlines", "C0"), ("faces", "C1"), ("antialias", "C2")):
        mine = [r for r in rows if r["way"] == way]
        ax.scatter([r["us"] / 1000 for r in mine], [r[kind] for r in mine], color=color, label=way, s=18)
    for r in rows:
        ax.annotate(name(r).partition(" ")[2], (r["us"] / 1000, r[kind]), fontsize=6, xytext=(3, 2), textcoords="offset points")
    ax.step([r["us"] / 1000 for r in front], [r[kind] for r in front], where="post", color="0.5", linewidth=1, label="front")
    ax.set(xlabel="ms a frame", yscale="log", title=kind.replace("_", ", "))
axes[0].set_ylabel("relative L2 of gradients")
axes[0].legend()
suite.save(figure, "plot")
END
