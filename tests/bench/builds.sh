#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# builds.sh BUILD_FOLDER OTHER_BUILD_FOLDER [--device NAME] [--quick]: a build beside another, in turns in one go: frames of avocado.dr and of a
# sphere of a million triangles, and the first run from empty caches of compiler and driver. Both builds compile the programs of this tree.
# `wall` and `cpu` are milliseconds of the first build: a run of drun of many frames less one of a single frame; of the first run the whole of
# drun. `times` is first over other, the median of the rounds. Without a second folder it is left out.
set -euo pipefail
PYTHONDONTWRITEBYTECODE=1 PYTHONPATH=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")") exec /usr/bin/python3 - "$@" << 'END'
import os, statistics, subprocess, sys, tempfile, time
from pathlib import Path

from suite import Failed, Suite, here

words = sys.argv[1:]
if len(words) < 2 or words[1].startswith("-"):
    print("builds: skipped, there is no second build folder")
    sys.exit(0)
suite = Suite("builds", words[:1] + words[2:])
programs = [suite.build / "bin/drun", Path(words[1]).resolve() / "bin/drun"]
rounds = 3 if suite.quick else 5
mesh = Path(os.environ.get("DR_SHARED_DATA", here / "../../../shared/data")) / "gltf/Avocado/Avocado.gltf"

def run(drun, arguments, frames, folder=None):
    """Wall and processor time of a whole run, in ms; from empty caches in `folder`."""
    caches = {"XDG_CACHE_HOME": folder, "DRC_CACHE_DIR": folder, "MESA_SHADER_CACHE_DIR": folder} if folder else {}
    before, begin = os.times(), time.monotonic()
    done = subprocess.run([str(drun), *map(str, arguments), "--step", f"frame={frames}", "--log-every", str(frames), "--device", suite.device],
                          capture_output=True, text=True, env=os.environ | caches)
    wall, after = time.monotonic() - begin, os.times()
    if done.returncode != 0:
        raise Failed(f"{drun} {' '.join(map(str, arguments))}", done.stderr.strip())
    return 1000 * wall, 1000 * (after.children_user + after.children_system - before.children_user - before.children_system)

def first(drun, arguments, _):
    with tempfile.TemporaryDirectory() as folder:
        return run(drun, arguments, 1, folder)

def frame(drun, arguments, count):
    one, many = run(drun, arguments, 1), run(drun, arguments, 1 + count)
    return [max(b - a, 1e-3) / count for a, b in zip(one, many)]

def row(name, measure, arguments, count=1):
    if measure is frame:
        for drun in programs:
            run(drun, arguments, 1)  # fills the caches
    turns = [[measure(drun, arguments, count) for drun in programs] for _ in range(rounds)]
    wall, cpu = (statistics.median(ours[k] for ours, _ in turns) for k in (0, 1))
    times = [statistics.median(ours[k] / other[k] for ours, other in turns) for k in (0, 1)]
    suite.record(row=name, wall_ms=wall, cpu_ms=cpu, wall_times=times[0], cpu_times=times[1], rounds=rounds)
    print(f"{name:<44} {wall:9.2f} {times[0]:6.2f} {cpu:9.2f} {times[1]:6.2f}", flush=True)

print(f"{'':<44} {'wall ms':>9} {'times':>6} {'cpu ms':>9} {'times':>6}")
if mesh.exists():
    for size, views in ((256, 1), (512, 1)) if suite.quick else ((128, 8), (256, 1), (512, 1), (1024, 1), (2048, 1)):
        for layers, name in ((0, "outlines"), (1, "all edges, K = 1"), (3, "all edges, K = 3")):
            scene = [here / "cases/avocado.dr", "-D", f"S={size}", "-D", f"N={views}", "-D", f"K={layers}", "--bind", f"position={mesh}:position",
                     "--bind", f"face={mesh}:indices"]
            title = f"{size}²{f', {views} views' if views > 1 else ''}, {name}"
            row(title, frame, scene, max(120 * 256 // size // views, 4))
            if size == 256:
                row(f"{title}: first run", first, scene)
million = suite.uv_sphere(806, round(1_000_000 / 1612) + 1)[:4]
row("a million triangles, 128²", frame, [here / "cases/scale.dr", *million, "--bind", "rate==1e-9", "--bind", "gain==1e-3"], 4)
END
