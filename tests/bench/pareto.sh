#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# pareto.sh BUILD_FOLDER [--device NAME] [--quick]: run time against error, which is split.
# First of a frame's gradients (pareto.dr), for a sphere of 1,280 faces at 256² (--quick: 96²), an axis at a time: how edges are softened,
# layers K, radius, sigma (its share of the radius; 0: the library's), edge mask, culling of what looks away, texture fetch, bits of colours (where a loss
# of the blurred picture reads them at other places), scatter, lowering, float profile, size of the picture. Errors are relative L2 of gradients: `numerical_*` of the device against the float64 evaluator that is given its
# decisions, to vertices and to texels; `bias` of the evaluator's against the gradient of exact area coverage, vertex by vertex,
# and `bias_whole` of their sums for shifts and growth of the whole. The latter is in closed form: the silhouette of a convex
# mesh is the hull of its projected vertices, and moving an edge changes coverage by the integral along it, which is cut at the
# pixels' borders. Times are `us a run while several are under way`; see suite.py. Before that, the bias of meshes of 80 to 5,120 faces.
# Then where fits of a shape and of a texture are after 1, 3 and 10 seconds (--quick: 1), by three seeds (one): see outcome.py.
# Then what lights a frame: mirrored light, shadow maps, filters of textures; see light_pareto.py. --light: that part alone.
# Fronts of each kind of error; plot.png, plot_resolution.png, plot_shape.png, plot_texture.png, plot_light.png.
set -euo pipefail
PYTHONDONTWRITEBYTECODE=1 PYTHONPATH=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")") exec /usr/bin/python3 - "$@" << 'END'
import functools, sys
import numpy as np
import light_pareto
import outcome
from coverage import distance_from, true_gradient
from suite import Failed, Suite, fronts, here, lines, plt, text

alone = "--light" in sys.argv
suite = Suite("pareto", [word for word in sys.argv[1:] if word != "--light"])
if alone:
    light_pareto.lights(suite)
    sys.exit()
size = 96 if suite.quick else 256
kinds = ("numerical_vertices", "numerical_texels", "bias", "bias_whole")


def sphere(levels):
    return [*suite.icosphere(levels), "--bind", "rate==0"]


def evaluated(bound, consts, **outputs):
    """The evaluator's output of each step, a pair a vertex."""
    saves = [w for step, name in outputs.items() for w in ("--step", step, "--save", f"{name}={suite.out / name}.npy")]
    suite.call("drc", "eval", here / "cases" / "pareto.dr", *bound, *consts, *saves)
    return [np.load(suite.out / f"{name}.npy").astype(np.float64).reshape(-1, 2) for name in outputs.values()]


# What finer meshes do to the bias.
for levels in (1, 4) if suite.quick else (1, 2, 3, 4):
    for way, name in ((0, "outlines"), (1, "faces"), (2, "antialias")):
        pixels, found = evaluated(sphere(levels), ["-D", f"S={size}", "-D", f"way={way}", "-D", f"K={3 if way == 1 else 1}"],
                                  project="pixel", frame="to_slide")
        row = {"way": name, "pixels": size, "faces": 20 * 4**levels, **distance_from(found, true_gradient(pixels), pixels, size)}
        suite.record(**row)
        print(text(row), flush=True)

bound = sphere(3)


@functools.cache
def truth(pixels):
    """Where vertices are in a picture so large, and the true gradient to them."""
    [points] = evaluated(bound, ["-D", f"S={pixels}"], project="pixel")
    return points, true_gradient(points)


base = {"pixels": size, "way": "outlines", "K": 1, "radius": 2.0, "share": 7, "mask": True, "cull": True, "fetch": "linear", "loss": "linear", "store": 32,
        "scatter": "exact", "lower": "auto", "float": "strict"}
faces, antialias = {"way": "faces", "K": 3}, {"way": "antialias"}
changes = [{}, {"radius": 4.0}, {"share": 3}, antialias, faces, {**faces, "mask": False}, {"scatter": "atomic"}, {"fetch": "nearest"}, {"lower": "fragment"},
           {**faces, "cull": False}, {"loss": "blurred"}, {"loss": "blurred", "store": 16}, {"float": "native"}]
sides = (192,) if suite.quick else (128, 512, 1024)
changes += [{**way, "pixels": side} for side in sides for way in ({}, faces, antialias)]
if not suite.quick:
    changes += [{"radius": 0.5}, {"radius": 1.0}, {"radius": 7.0}, {"radius": 0.5, "share": 0}, {"radius": 1.0, "share": 0}, {"share": 2}, {"share": 5}, {"share": 10},
                {"K": 3}, {"mask": False}, {"lower": "compute"}, {"scatter": "rows"}, {**antialias, "scatter": "atomic"}, *({**faces, "K": k} for k in (1, 2, 5))]
    changes += [{"way": "faces", "K": k, "radius": r} for k in (1, 3) for r in (1.0, 4.0, 7.0)]
    changes += [{**faces, "share": s} for s in (3, 10)]
    changes += [*({**way, "loss": "blurred", "store": bits} for way in (faces, antialias) for bits in (32, 16)), {"cull": False}, {**antialias, "cull": False}, *({**faces, "K": k, "cull": False} for k in (1, 2, 5)), {**faces, "float": "native"}]

colors = suite.bind("random", texels=np.random.default_rng(1).uniform(size=(64, 64, 3)))
cells = []
for change in changes:
    at = {**base, **change}
    consts = {"S": at["pixels"], "way": ["outlines", "faces", "antialias"].index(at["way"]), "K": at["K"], "R": at["radius"], "share": f"{at['share']}.0",
              "everywhere": int(not at["mask"]), "linear": int(at["fetch"] == "linear"), "cull": int(at["cull"]),
              "blurred": int(at["loss"] == "blurred")}
    arguments = [*bound, *(w for k, v in consts.items() for w in ("-D", f"{k}={v}"))]
    if at["loss"] == "blurred":
        arguments += colors
    # The evaluator has all colours in full.
    options = ["--scatter", at["scatter"], "--lower", at["lower"], "-D", f"store={at['store']}"]
    if at["float"] != base["float"]:
        options += ["--float", at["float"]]
    try:
        frame = suite.against_evaluator("pareto.dr", "frame", ["to_slide", "to_texels"], arguments, options)
    except Failed as failed:
        suite.record(**at, problem=failed.args[1])
        print(text(change), "does not run:", failed.args[1])
        continue
    points, true = truth(at["pixels"])
    errors = {"numerical_vertices": frame["to_slide"][2], "numerical_texels": frame["to_texels"][2],
              **distance_from(frame["to_slide"][1].reshape(-1, 2), true, points, at["pixels"])}
    cells.append(({**at, **errors}, "pareto.dr", "frame", 2000 if suite.device else 10, [*arguments, *options]))

rows = suite.race(cells, 1 if suite.quick else 5)
name = lambda r: " ".join([r["way"]] + [v if isinstance(v, str) else f"{k}={v:g}" for k, v in r.items() if k in base and v != base[k] and k != "way"])
ways = (("outlines", "C0"), ("faces", "C1"), ("antialias", "C2"))
figure, panels = plt.subplots(1, 4, figsize=(20, 4.6))
alike = [r for r in rows if r["pixels"] == size]
for ax, kind in zip(panels, kinds):
    front = fronts(suite, kind, alike, "us", kind, lambda r: f"{name(r)} ({r['us'] / 1000:.1f} ms)")
    for way, color in ways:
        mine = [r for r in alike if r["way"] == way]
        ax.scatter([r["us"] / 1000 for r in mine], [r[kind] for r in mine], color=color, label=way, s=18)
    for r in alike:
        ax.annotate(name(r).partition(" ")[2], (r["us"] / 1000, r[kind]), fontsize=6, xytext=(3, 2), textcoords="offset points")
    ax.step([r["us"] / 1000 for r in front], [r[kind] for r in front], where="post", color="0.5", linewidth=1, label="front")
    ax.set(xlabel="ms a frame", yscale="log", title=kind.replace("_", ", "))
panels[0].set_ylabel("relative L2 of gradients")
panels[0].legend()
suite.save(figure, "plot")

# Larger pictures, of the ways with nothing else changed.
sizes = [r for r in rows if any(all(r[k] == v for k, v in {**base, **way, "pixels": r["pixels"]}.items()) for way in ({}, faces, antialias))]
figure, panels = plt.subplots(1, 5, figsize=(22, 4.2))
for ax, kind in zip(panels, ("us", *kinds)):
    lines(ax, sizes, "pixels", lambda r: r["way"], kind, 1e-3 if kind == "us" else 1)
    ax.set(xlabel="side of the picture", yscale="log", title="ms a frame" if kind == "us" else kind.replace("_", ", "))
panels[0].legend()
suite.save(figure, "plot_resolution")

outcome.shapes(suite)
outcome.textures(suite)
light_pareto.lights(suite)
END
