#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# skip_scenes.sh BUILD_FOLDER [--device NAME] [--quick]: twelve scenes (skip/*.dr; --quick: three of them), each with and without each skip of
# docs/explain/skipping.md (`--no-skip=ID`): what is done and avoided, times of both sides in turns, medians, and whether the two sides give
# the same bits, outputs and params after four runs. `ms` is of a run while several are under way; for `shaders` of compiling,
# for `pipelines` of making them. `soft` counts fragments, by draws: what it avoids is what the other side does more. What avoids
# nothing in a scene stands in figures.jsonl alone. `rebuild` needs data that the host binds anew: see docs/explain/skipping.md.
set -euo pipefail
PYTHONDONTWRITEBYTECODE=1 PYTHONPATH=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")") exec /usr/bin/python3 - "$@" << 'END'
import json, os, re, shutil, statistics
from suite import Suite, here

suite = Suite("skip")
os.environ["DRC_CACHE_DIR"] = str(suite.out / "cache")
shutil.rmtree(suite.out / "cache", ignore_errors=True)
scenes = sorted(p.stem for p in (here / "cases/skip").glob("*.dr") if p.stem != "scene")[:: 4 if suite.quick else 1]
of_compiling = ("dead", "zero", "fold", "share", "slots", "shaders")
skips = (*of_compiling, "active", "stepped", "branches", "soft", "cache", "commands", "pipelines")
runs, rounds = (5, 1) if suite.quick else (20, 3)
if suite.device:
    runs *= 20


def run(scene, off, *arguments):
    off = ["--no-skip", off] if off else []
    return suite.drun(f"skip/{scene}.dr", *off, "--counters=json", *arguments)


def counters(said):
    return json.loads(next(line for line in said.splitlines() if line.startswith("{")))


def count(found, skip):
    """What is done and avoided, and in what; None where it has nothing to do with the program."""
    at = found["skips"] if skip in (*of_compiling, "pipelines") else found["steps"]["frame"]["skips"]
    return at.get(skip)


def bits(scene, off):
    folder = suite.out / "bits"
    shutil.rmtree(folder, ignore_errors=True)
    run(scene, off, "--step", "frame=4", "--out", folder)
    return {p.name: p.read_bytes() for p in sorted(folder.glob("*.npy"))} | {"log": (folder / "log.jsonl").read_bytes()}


def times(scene, off):
    said = run(scene, off, "--step", f"frame={runs + 2}", "--log-every", max(runs // 5, 1), "--timing")
    of_run = re.search(r"^frame: ([\d.]+) us a run while", said, re.M)
    return {"run": float(of_run[1]) / 1000 if of_run else 0.0,
            "shaders": float(re.search(r"compiled or read in (\d+) ms", said)[1]),
            "pipelines": float(re.search(r"pipelines of \d+ commands took (\d+) ms", said)[1])}, counters(said)


print(f"{'scene':12} {'skip':10} {'unit':10} {'done':>9} {'avoided':>9}  {'ms':>8} {'without':>8}  saved  bits")
different = 0
for scene in scenes:
    expected = bits(scene, "")  # and every cache is warm then
    same = {skip: bits(scene, skip) == expected for skip in skips}
    taken, found = {skip: [] for skip in ("", *skips)}, {}
    for _ in range(rounds):
        for side in taken:
            time, found[side] = times(scene, side)
            taken[side].append(time)
    median = lambda side, what: statistics.median(t[what] for t in taken[side])
    for skip in skips:
        what = skip if skip in ("shaders", "pipelines") else "run"
        with_ms, without_ms = median("", what), median(skip, what)
        if skip == "soft":
            drawn = [counters(run(scene, off, "--step", "frame", "--raster", "hardware"))["steps"]["frame"]["fragments"]
                     for off in ("", "soft")]
            on, other = {"unit": "fragments", "done": drawn[0], "avoided": drawn[1] - drawn[0]}, {"done": drawn[1], "avoided": 0}
        else:
            on, other = count(found[""], skip), count(found[skip], skip)
        on = on or {"unit": "", "done": 0, "avoided": 0}
        other = other or {"done": 0, "avoided": 0}
        suite.record(scene=scene, skip=skip, unit=on["unit"], done=on["done"], avoided=on["avoided"], done_without=other["done"],
                     avoided_without=other["avoided"], ms=with_ms, ms_without=without_ms, same_bits=same[skip], rounds=rounds, runs=runs)
        different += not same[skip]
        if on["avoided"] == 0 and same[skip]:
            continue
        saved = f"{100 * (1 - with_ms / without_ms):4.0f}%" if without_ms > 0 else "    -"
        print(f"{scene:12} {skip:10} {on['unit']:10} {on['done']:9} {on['avoided']:9}  {with_ms:8.3f} {without_ms:8.3f}  {saved}  "
              f"{'same' if same[skip] else 'DIFFERENT'}", flush=True)
print(f"{len(scenes)} scenes, {len(skips)} skips: {different} pairs of sides with other bits")
END
