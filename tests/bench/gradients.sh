#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# gradients.sh BUILD_FOLDER [--only MESH] [--with-mitsuba] [--device NAME] [--quick]: silhouettes and their gradients against a judge that forgives nothing (exact_area.h:
# the area of the union of the projected faces in each pixel, in float64), and time. UV spheres of 682 and 14,208 triangles at
# 256² and 512² (--quick: 682 at 128²), turned so that no pole lies on an axis, at 60% of a picture of 45 degrees; then masks of
# the meshes of ../shared/data, four sides each, where that folder is there. Two losses: the mean square against the exact picture of the mesh
# made larger and moved, and linear with white noise as its weights. Errors are relative L2 of the gradient to vertices in pixels; vertices at one
# place count as one, since it is rounding which of them an outline belongs to. --with-mitsuba: in the same run Mitsuba 3's projective sampling of the spheres,
# by the python in $DR_MITSUBA_PYTHON (python3; `pip install mitsuba`), with LLVM from 17 on in $DRJIT_LIBLLVM_PATH (Debian's libllvm19); left out without.
set -euo pipefail
PYTHONDONTWRITEBYTECODE=1 PYTHONPATH=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")") exec /usr/bin/python3 - "$@" << 'PYTHON'
import sys
import numpy as np
from exact import against_exact, against_mitsuba, camera, files, mesh, mitsuba_python, sides, sphere
from suite import Suite, fronts

words = sys.argv[1:]
only = words.pop(words.index("--only") + 1) if "--only" in words else None
python = mitsuba_python() if "--with-mitsuba" in words else None
suite = Suite("gradients", [w for w in words if w not in ("--only", "--with-mitsuba")])
if "--with-mitsuba" in words and python is None:
    print("gradients: Mitsuba is left out: no python in DR_MITSUBA_PYTHON that has it, with LLVM from 17 on in DRJIT_LIBLLVM_PATH", flush=True)
ways = {"coverage": {"way": 0}, "coverage, 12 faces": {"way": 0, "K": 12}, "outlines, r = 2": {"way": 1}, "outlines, r = 4": {"way": 1, "R": 4.0},
        "all edges, K = 3": {"way": 2, "K": 3}, "antialias": {"way": 3}}

distance = 1 / np.sin(np.arctan(0.6 * np.tan(np.radians(22.5))))
cells, theirs = [], []
if only in (None, "sphere"):
    for columns, rings in ((31, 11),) if suite.quick else ((31, 11), (96, 74)):
        position, faces = sphere(columns, rings)
        for size in (128,) if suite.quick else (256, 512):
            moved = position * 1.06 + [0.12, 0.05, 0]
            cells += against_exact(suite, "gradients.dr", "sphere", position, faces, camera(distance), moved, size, ways)
            if python:
                theirs += against_mitsuba(suite, python, "sphere", position, faces, distance, moved, size, (1,) if suite.quick else (1, 4, 16))
    rows = suite.race(cells, 1 if suite.quick else 5)
    for faces, size in dict.fromkeys((r["faces"], r["pixels"]) for r in rows):
        alike = [r for r in rows if (r["faces"], r["pixels"]) == (faces, size)]
        others = [r for r in theirs if (r["faces"], r["pixels"]) == (faces, size)]
        if others:
            fronts(suite, f"square with Mitsuba, {faces} faces, {size}", alike + others, "us", "square", lambda r: f"{r['way']} ({r['us'] / 1000:.1f} ms)")
            ahead = [(t["way"], r["way"]) for t in others for r in alike if t["us"] < r["us"] and t["square"] < r["square"]]
            suite.record(faces=faces, pixels=size, mitsuba_ahead=ahead)
            print(f"Mitsuba is ahead in error and time of {ahead or 'none of ours'}", flush=True)
        for error in ("square", "noise"):
            fronts(suite, f"{error}, {faces} faces, {size}", alike, "us", error, lambda r: f"{r['way']} ({r['us'] / 1000:.1f} ms)")

chosen = [] if suite.quick and only is None else files if only is None else [only] if only in files else []
for name, (position, faces, size) in ((n, m) for n in chosen if (m := mesh(suite, n))):
    for side, turned in enumerate(sides(position)):
        against_exact(suite, "gradients.dr", f"{name} {side}", turned, faces, camera(3.0), turned * 1.03 + [0.03, 0.02, 0], size,
                      {w: ways[w] for w in ("coverage", "coverage, 12 faces", "outlines, r = 2")})
PYTHON
