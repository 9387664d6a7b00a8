#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# figure11.sh BUILD_FOLDER [--device NAME] [--quick]: the paper's Figures 11, 12 and 14: a sphere of 2,562 vertices becomes a dense skull-like shape
# (skull.py) from its shading, each step by a view and a lamp of its own (figure11.dr), for K layers and radii r. Mean distance from the true
# surface after 500 and 2,500 steps (a GPU) or 500 steps and 3 x 3 settings (a CPU; --quick: 100 steps of 64² for 2 x 2): a heat map, the curves
# on the way, and the spread over ten (three; two) choices of views and lamps.
set -euo pipefail
PYTHONDONTWRITEBYTECODE=1 PYTHONPATH=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")") exec /usr/bin/python3 - "$@" << 'END'
import json, statistics
import numpy as np
from suite import Suite, plt
from skull import skull, vertices

suite = Suite("figure11")
gpu = "cpu" not in json.loads((suite.out / "run.json").read_text())["device"].lower() and bool(suite.device)
lengths = (100,) if suite.quick else (500, 2500) if gpu else (500,)
layers = (1, 3) if suite.quick else (1, 2, 3, 5, 8) if gpu else (1, 3, 5)
radii = (1, 4) if suite.quick else (0.5, 1, 2, 4, 8) if gpu else (1, 2, 4)
trials = 2 if suite.quick else 10 if gpu else 3
size, levels = (64, 3) if suite.quick else (128, 4)
stops = 5 if suite.quick else 10

bound = suite.icosphere(levels)
start = vertices(bound[1].partition("=")[2].rpartition(":")[0])
bound[1:2] = suite.bind("start", position=0.8 * start)[1:]
dense = suite.icosphere(levels if suite.quick else levels + 1)
target = vertices(dense[1].partition("=")[2].rpartition(":")[0])
target = target / np.linalg.norm(target, axis=1, keepdims=True)
bound += suite.bind("target", true_position=skull(target)[:, None] * target) + ["--bind", dense[3].replace("face=", "true_face=", 1)]


def fit(length, radius, trial=0, **consts):
    """The distance after each tenth (fifth) of the steps."""
    words = [w for k, v in dict(consts, S=size).items() for w in ("-D", f"{k}={v}")]
    words += ["--bind", f"radius==[[{radius}, {radius}]]", "--bind", f"steps=={length}.0", "--bind", f"trial=={trial}"]
    ways = [w for _ in range(stops) for w in ("--step", f"fit={length // stops}", "--step", "measure")]
    suite.drun("figure11.dr", *words, *bound, *ways, "--log-every", length, "--out", suite.out / "fit")
    log = [json.loads(line) for line in (suite.out / "fit" / "log.jsonl").read_text().splitlines()]
    return [float(row["distance"]) for row in log if "distance" in row]


for length in lengths:
    figure, (heat, curves) = plt.subplots(1, 2, figsize=(12, 4.6))
    grid = np.full((len(layers), len(radii)), np.nan)
    for i, K in enumerate(layers):
        for j, R in enumerate(radii):
            course = fit(length, R, K=K)
            grid[i, j] = 100 * course[-1]
            suite.record(steps=length, K=K, r=R, distance=course[-1], course=course)
            print(f"{length:5} steps  K = {K}  r = {R:<4} distance {grid[i, j]:.3f}%", flush=True)
            curves.plot(np.arange(1, stops + 1) * (length // stops), 100 * np.array(course), label=f"K = {K}, r = {R}")
    for R in radii:
        course = fit(length, R, way=3, K=1)
        suite.record(steps=length, r=R, way="coverage", distance=course[-1], course=course)
        print(f"{length:5} steps  coverage, r = {R:<4} distance {100 * course[-1]:.3f}%", flush=True)
    course = fit(length, 2, way=0, K=1)
    suite.record(steps=length, K=1, r=2, way="outlines", distance=course[-1], course=course)
    print(f"{length:5} steps  outlines, r = 2    distance {100 * course[-1]:.3f}%", flush=True)
    curves.plot(np.arange(1, stops + 1) * (length // stops), 100 * np.array(course), "k--", label="outlines, r = 2")
    shown = heat.imshow(grid, cmap="viridis_r", aspect="auto")
    figure.colorbar(shown, ax=heat, label="mean distance, % of the radius")
    heat.grid(False)
    heat.set_xticks(range(len(radii)), radii)
    heat.set_yticks(range(len(layers)), layers)
    for (i, j), value in np.ndenumerate(grid):
        heat.text(j, i, f"{value:.2f}", ha="center", va="center", color="white")
    heat.set(xlabel="r, pixels", ylabel="K", title=f"after {length} steps")
    curves.set(xlabel="steps", ylabel="mean distance, %", yscale="log")
    curves.legend(fontsize=6, ncols=2)
    suite.save(figure, f"plot_{length}")
    ends = [100 * fit(length, 2, t, K=3)[-1] for t in range(trials)]
    suite.record(steps=length, K=3, r=2, trials=trials, mean=statistics.mean(ends), deviation=statistics.stdev(ends), least=min(ends), most=max(ends))
    print(f"{length:5} steps  K = 3  r = 2: {trials} trials, mean {statistics.mean(ends):.3f}%, standard deviation {statistics.stdev(ends):.3f}, "
          f"{min(ends):.3f} to {max(ends):.3f}", flush=True)
END
