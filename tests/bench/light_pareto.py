# SPDX-License-Identifier: Apache-2.0
"""Time against error of what lights a frame, for pareto.sh: mirrored light by split sums and by points of each pixel's lobe (pareto_sky.dr), a shadow's map
by size and filter (pareto_shadow.dr), filters of textures (pareto_filter.dr). Errors are relative L2 of the picture and of its gradient
against sums over all texels, the shadow of a ball in closed form, and the mean of 16 x 16 points a pixel.
"""
import numpy as np
from suite import fronts, plt


def look(suite, program, arguments, names):
    folder = suite.out / "look"
    suite.drun(program, *arguments, "--step", "look", "--out", folder)
    return [np.load(folder / f"look.{name}.npy").astype(np.float64) for name in names]


def told(name, arguments, picture, gradient):
    """A cell of a race. It is printed at once, since the race says nothing before all of its cells have run."""
    print(f"{name}: picture off by {picture:.3g}, gradient by {gradient:.3g}", flush=True)
    return name, arguments, picture, gradient


def off(found, truth):
    return float(np.linalg.norm(found - truth) / np.linalg.norm(truth))


def shadow_truth(lamp, pixels=128, points=8):
    """How much light reaches each pixel, and the smooth measure of where the shadow falls, which pareto_shadow.dr has too."""
    k = (np.arange(pixels * points) + 0.5) / (pixels * points)
    x, z = np.meshgrid(4 * k - 2, 4 * k - 2)
    ground = np.stack([x, 0 * x, z], -1)
    way = np.asarray(lamp) - ground
    way /= np.linalg.norm(way, axis=-1, keepdims=True)
    to_ball = np.array([0.0, 1.0, 0.0]) - ground
    along = (to_ball * way).sum(-1)
    dark = (to_ball**2).sum(-1) - along**2 < BALL**2
    place = (dark * np.exp(-((x - 0.5) ** 2 + (z - 0.5) ** 2))).sum() / (pixels * points) ** 2
    return 1.0 - dark.reshape(pixels, points, pixels, points).mean((1, 3)), place


BALL = 0.5


def shadow_slope(lamp, step=0.02):
    """Central differences of the place over lamps so far apart that the points' own steps do not show."""
    slopes = []
    for axis in np.eye(3):
        (_, more), (_, less) = (shadow_truth(np.asarray(lamp) + s * step * axis, points=24) for s in (1, -1))
        slopes.append((more - less) / (2 * step))
    return np.array(slopes)


def race(suite, kind, cells, program, panel):
    rows = suite.race([({"light": kind, "way": name, "picture": picture, "gradient": gradient}, program, "frame", 200 if suite.device else 6, arguments)
                       for name, arguments, picture, gradient in cells], 1 if suite.quick else 3)
    for error, mark in (("picture", "o"), ("gradient", "x")):
        front = fronts(suite, f"{kind}, {error}", rows, "us", error, lambda r: f"{r['way']} ({r['us'] / 1000:.1f} ms)")
        panel.scatter([r["us"] / 1000 for r in rows], [r[error] for r in rows], marker=mark, label=error)
        panel.step([r["us"] / 1000 for r in front], [r[error] for r in front], where="post", linewidth=1)
    for r in rows:
        panel.annotate(r["way"], (r["us"] / 1000, r["picture"]), fontsize=6, xytext=(3, 2), textcoords="offset points")
    panel.set(xlabel="ms a frame", yscale="log", xscale="log", title=kind)
    panel.legend()


def lights(suite):
    figure, panels = plt.subplots(1, 3, figsize=(17, 4.6))

    consts = lambda **c: [w for k, v in c.items() for w in ("-D", f"{k}={v}")]
    truth = look(suite, "pareto_sky.dr", consts(way=2), ["picture", "to_sky"])
    ways = [(f"split sum, {n} points", consts(way=0, N=n)) for n in ((16, 64) if suite.quick else (4, 16, 64, 256))]
    ways += [] if suite.quick else [(f"split sum, {k} maps", consts(way=0, N=64, levels=k)) for k in (3, 12)]
    ways += [(f"split sum, bent, {n} points", consts(way=0, N=n, bent="true")) for n in ((16,) if suite.quick else (16, 64))]
    ways += [(f"sampled, {n} points", consts(way=1, N=n)) for n in ((16, 64) if suite.quick else (4, 16, 64, 256))]
    cells = []
    for name, arguments in ways:
        found = look(suite, "pareto_sky.dr", arguments, ["picture", "to_sky"])
        cells.append(told(name, arguments, *(off(f, t) for f, t in zip(found, truth))))
    race(suite, "mirrored light", cells, "pareto_sky.dr", panels[0])

    lamp = (1.2, 4.0, 0.8)
    mesh, cells = suite.icosphere(4), []
    picture, slope = shadow_truth(lamp)[0], shadow_slope(lamp)
    for size in (64, 256) if suite.quick else (32, 64, 128, 256, 512):
        for soft, reach in ((False, 2),) if suite.quick else ((False, 2), (True, 2), (True, 4)):
            arguments = [*mesh, *consts(M=size, soft=str(soft).lower(), reach=f"{reach}.0")]
            lit, to_lamp = look(suite, "pareto_shadow.dr", arguments, ["lit", "to_lamp"])
            cells.append(told(f"{size}²" + (f", filter of {2 * reach} texels" if soft else ""), arguments, off(1 - lit.reshape(picture.shape), 1 - picture),
                              off(to_lamp.reshape(3), slope)))
    race(suite, "shadow map", cells, "pareto_shadow.dr", panels[1])

    truth = look(suite, "pareto_filter.dr", consts(way=4), ["picture", "to_texels"])
    ways = [("nearest", consts(way=0)), ("bilinear", consts(way=1)), ("trilinear", consts(way=2))]
    ways += [(f"anisotropic, {n} reads", consts(way=3, most=n)) for n in ((4,) if suite.quick else (2, 4, 8, 16))]
    cells = []
    for name, arguments in ways:
        found = look(suite, "pareto_filter.dr", arguments, ["picture", "to_texels"])
        cells.append(told(name, arguments, *(off(f, t) for f, t in zip(found, truth))))
    race(suite, "texture", cells, "pareto_filter.dr", panels[2])
    panels[0].set_ylabel("relative L2")
    suite.save(figure, "plot_light")
