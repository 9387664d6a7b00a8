# SPDX-License-Identifier: Apache-2.0
"""Where fits are after some seconds, for pareto.sh: the distance of a shape from the true one (figure11.dr) and of texels from the
true ones (inverse_uv.dr).

A fit gets as many steps as take T seconds, by a trial run, and its schedules end with it. Seconds are of its own steps, wall clock,
without start, compiling and what measures the error on the way. Settings run in turns, each by several seeds: other views and lamps
for a shape, other texels at first for a texture. Errors are medians over seeds, from the least to the most.
"""
import json, re, statistics

import numpy as np
from skull import skull, vertices
from suite import Failed, fronts, here, plt

stops = 8  # where the error is measured on the way


def run(suite, program, arguments, steps, error):
    """A fit of so many steps: the seconds it took, and [(seconds, error)] on the way."""
    each = max(steps // stops, 2)  # the last one of each is looked at, and has no time
    ways = ["--step", "measure", *["--step", f"fit={each}", "--step", "measure"] * max(steps // each, 1)]
    said = suite.drun(program, *arguments, "--bind", f"steps=={steps}.0", *ways, "--log-every", steps, "--timing", "--out", suite.out / "fit")
    runs, seconds = re.findall(r"^fit: .*; (\d+) runs in ([\d.]+) s$", said, re.M)[-1]
    found = [row[error] for row in map(json.loads, (suite.out / "fit" / "log.jsonl").read_text().splitlines()) if error in row]
    course = [(k * each * float(seconds) / int(runs), e) for k, e in enumerate(found)]
    return course[-1][0], course


def outcome(suite, kind, program, settings, seeds, error):
    """settings: {name: arguments}; seeds: arguments of each. Records and draws, into plot_<kind>."""
    budgets = (1,) if suite.quick else (1, 3, 10)
    paces = {}
    for name, arguments in settings.items():
        try:
            run(suite, program, [*arguments, *seeds[0]], 4, error)  # fills the caches of compiler and driver
            steps = 16
            seconds, _ = run(suite, program, [*arguments, *seeds[0]], steps, error)
            while seconds < 0.2:
                steps *= 3
                seconds, _ = run(suite, program, [*arguments, *seeds[0]], steps, error)
            paces[name] = seconds / steps
        except Failed as failed:
            suite.record(outcome=kind, setting=name, problem=failed.args[1])
            print(kind, name, "does not run:", failed.args[1], flush=True)
    rows, courses = [], {}
    for budget in budgets:
        found = {name: [] for name in paces}
        for seed in seeds:
            for name, pace in paces.items():
                found[name].append(run(suite, program, [*settings[name], *seed], max(round(budget / pace), 4), error))
        for name, fits in found.items():
            ends = [course[-1][1] for _, course in fits]
            courses[name, budget] = sorted(fits, key=lambda fit: fit[1][-1][1])[len(fits) // 2][1]
            rows.append({"outcome": kind, "setting": name, "budget_s": budget, "seconds": statistics.median(t for t, _ in fits),
                         "steps": max(round(budget / paces[name]), 4), "seeds": len(fits), "error": statistics.median(ends),
                         "error_least": min(ends), "error_most": max(ends)})
            suite.record(**rows[-1], course=courses[name, budget])
            print("{outcome} after {budget_s} s: {setting:38} {error:.5f} ({error_least:.5f} to {error_most:.5f}), {steps} steps in {seconds:.2f} s"
                  .format(**rows[-1]), flush=True)
    front = fronts(suite, f"outcome, {kind}", rows, "seconds", "error", lambda r: f"{r['setting']} for {r['budget_s']} s")
    figure, axes = plt.subplots(figsize=(9, 5))
    for k, name in enumerate(paces):
        for budget in budgets:
            times, errors = zip(*courses[name, budget][1:])
            axes.plot(times, errors, color=f"C{k}", linewidth=0.7, alpha=0.6)
        mine = [r for r in rows if r["setting"] == name]
        middle, low, high = (np.array([r[key] for r in mine]) for key in ("error", "error_least", "error_most"))
        axes.errorbar([r["seconds"] for r in mine], middle, yerr=[middle - low, high - middle], color=f"C{k}", marker="o", markersize=5,
                      capsize=3, linestyle="none", label=name)
    axes.step([r["seconds"] for r in front], [r["error"] for r in front], where="post", color="0.5", linewidth=1, label="front")
    for budget in budgets:
        axes.axvline(budget, color="0.8", linewidth=0.8)
    axes.set(xlabel="seconds of the fit", ylabel=error.replace("_", " "), xscale="log", yscale="log", title=f"{kind}: each curve a fit for so long")
    axes.legend(fontsize=7)
    suite.save(figure, f"plot_{kind}")


def shapes(suite):
    """A sphere becomes the skull of skull.py, 2,562 vertices at 128² (--quick: 642 at 64²): mean distance of vertices from the true
    surface, as a part of its radius."""
    levels, size = (3, 64) if suite.quick else (4, 128)
    bound = suite.icosphere(levels)
    sphere = vertices(bound[1].partition("=")[2].rpartition(":")[0])
    target = sphere / np.linalg.norm(sphere, axis=1, keepdims=True)
    bound = [*suite.bind("start", position=0.8 * sphere), *bound[2:], "--bind", bound[3].replace("face=", "true_face=", 1),
             *suite.bind("target", true_position=skull(target)[:, None] * target), "-D", f"S={size}"]

    def setting(way, K, first, last, scatter="auto"):
        return [*bound, "-D", f"way={way}", "-D", f"K={K}", "--bind", f"radius==[[{first}, {last}]]", "--scatter", scatter]

    settings = {"outlines, r = 2": setting(0, 1, 2.0, 2.0), "outlines, r from 4 to 1": setting(0, 1, 4.0, 1.0),
                "all edges, K = 3": setting(1, 3, 2.0, 2.0), "antialias": setting(2, 1, 2.0, 2.0), "outlines, r = 2, atomic": setting(0, 1, 2.0, 2.0, "atomic")}
    if not suite.quick:
        settings["all edges, K = 1"] = setting(1, 1, 2.0, 2.0)
        settings |= {f"outlines, r = 2, {s}": setting(0, 1, 2.0, 2.0, s) for s in ("exact", "rows")}
    outcome(suite, "shape", "figure11.dr", settings, [["--bind", f"trial=={k}"] for k in range(1 if suite.quick else 3)], "distance")


def textures(suite):
    """The pear's texture of 256² from six pictures of 256² (--quick: both 128²) on its own shape: rms of the texels that they show."""
    side = 128 if suite.quick else 256
    target, pear = suite.out / "target", here / "../../docs/examples/pear"
    suite.drun(pear / "target.dr", "-D", f"W={side}", "-D", f"H={side}", "-D", f"T={side}", "--step", "render", "--step", "meshes", "--out", target)
    bound = ["-I", pear, "-D", f"T={side}"]
    for leaf, file in (("position", "meshes.pear_position"), ("face", "meshes.pear_face"), ("uv", "meshes.pear_uv"), ("uv_face", "meshes.pear_uv_face"),
                       ("view", "render.view"), ("mask", "render.mask"), ("image", "render.image")):
        bound += ["--bind", f"{leaf}={target / file}.npy"]
    random = np.random.default_rng(1)
    seeds = [suite.bind(f"texels_{k}", albedo=random.uniform(size=(side, side, 3))) for k in range(1 if suite.quick else 3)]
    ways = {"exact": ["--scatter", "exact"], "inverse UV": ["-D", "inverse=1"], "inverse UV, the same pixels": ["-D", "inverse=2"]}
    if not suite.quick:
        ways |= {"atomic": ["--scatter", "atomic"], "rows": ["--scatter", "rows"]}
    settings = {f"{name}, rate {rate}": [*bound, *words, "--bind", f"rate=={rate}"]
                for name, words in ways.items() for rate in ((0.2,) if suite.quick else (0.2, 0.05))}
    outcome(suite, "texture", "inverse_uv.dr", settings, seeds, "texel_error")
