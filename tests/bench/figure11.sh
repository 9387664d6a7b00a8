#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# figure11.sh BUILD_FOLDER [--device NAME] [--quick] [--steps N]: the paper's Figures 11, 12 and 14: a sphere of 2,562 vertices becomes a dense skull-like shape
# (skull.py) from its shading, each step by a view and a lamp of its own (figure11.dr), for K layers and radii r. Mean distance from the true
# surface after 500 and 2,500 steps (a GPU) or 500 steps and 3 x 3 settings (a CPU; --quick: 100 steps of 64² for 2 x 2): a heat map, the curves
# on the way, and the spread over ten (three; two) choices of views and lamps. `--steps N` is N steps instead, and all cells. A GPU has twelve
# fits at once.
set -euo pipefail
PYTHONDONTWRITEBYTECODE=1 PYTHONPATH=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")") exec /usr/bin/python3 - "$@" << 'END'
import functools, json, statistics, sys
from concurrent.futures import ThreadPoolExecutor
import numpy as np
from suite import Suite, plt
from skull import skull, vertices

words = sys.argv[1:]
only = int(words.pop(words.index("--steps") + 1)) if "--steps" in words else None
suite = Suite("figure11", [word for word in words if word != "--steps"])
gpu = "cpu" not in json.loads((suite.out / "run.json").read_text())["device"].lower() and bool(suite.device)
lengths = (only,) if only else (100,) if suite.quick else (500, 2500) if gpu else (500,)
side_by_side = ThreadPoolExecutor(12 if gpu else 1)
gpu = gpu or bool(only)
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


@functools.cache
def fit(length, radius, trial, **consts):
    """The distance after each tenth (fifth) of the steps, once asked for."""
    return side_by_side.submit(course_of, length, radius, trial, consts).result


def course_of(length, radius, trial, consts):
    out = suite.out / f"fit_{length}_{radius}_{trial}_{'_'.join(map(str, consts.values()))}"
    words = [w for k, v in dict(consts, S=size).items() for w in ("-D", f"{k}={v}")]
    words += ["--bind", f"radius==[[{radius}, {radius}]]", "--bind", f"steps=={length}.0", "--bind", f"trial=={trial}"]
    ways = [w for _ in range(stops) for w in ("--step", f"fit={length // stops}", "--step", "measure")]
    suite.drun("figure11.dr", *words, *bound, *ways, "--log-every", length, "--out", out)
    log = [json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()]
    return [float(row["distance"]) for row in log if "distance" in row]


for length in lengths:
    figure, (heat, curves) = plt.subplots(1, 2, figsize=(12, 4.6))
    grid = np.full((len(layers), len(radii)), np.nan)
    edges = {(K, R): fit(length, R, 0, K=K) for K in layers for R in radii}
    coverages = {R: fit(length, R, 0, way=3, K=1) for R in radii}
    outlines = fit(length, 2, 0, way=0, K=1)
    others = [fit(length, 2, t, K=3) for t in range(trials)]
    for i, K in enumerate(layers):
        for j, R in enumerate(radii):
            course = edges[K, R]()
            grid[i, j] = 100 * course[-1]
            suite.record(steps=length, K=K, r=R, distance=course[-1], course=course)
            print(f"{length:5} steps  K = {K}  r = {R:<4} distance {grid[i, j]:.3f}%", flush=True)
            curves.plot(np.arange(1, stops + 1) * (length // stops), 100 * np.array(course), label=f"K = {K}, r = {R}")
    for R in radii:
        course = coverages[R]()
        suite.record(steps=length, r=R, way="coverage", distance=course[-1], course=course)
        print(f"{length:5} steps  coverage, r = {R:<4} distance {100 * course[-1]:.3f}%", flush=True)
    course = outlines()
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
    ends = [100 * course()[-1] for course in others]
    suite.record(steps=length, K=3, r=2, trials=trials, mean=statistics.mean(ends), deviation=statistics.stdev(ends), least=min(ends), most=max(ends))
    print(f"{length:5} steps  K = 3  r = 2: {trials} trials, mean {statistics.mean(ends):.3f}%, standard deviation {statistics.stdev(ends):.3f}, "
          f"{min(ends):.3f} to {max(ends):.3f}", flush=True)
END
