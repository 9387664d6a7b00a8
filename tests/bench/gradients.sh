#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# gradients.sh BUILD_FOLDER [--device NAME] [--quick]: silhouettes and their gradients against a judge that forgives nothing (exact_area.h:
# the area of the union of the projected faces in each pixel, in float64), and time. UV spheres of 682 and 14,208 triangles at
# 256² and 512² (--quick: 682 at 128²), turned so that no pole lies on an axis, at 60% of a picture of 45 degrees; then masks of
# the meshes of ../shared/data, four sides each, where that folder is there. Two losses: the mean square against the exact picture of the mesh
# made larger and moved, and linear with white noise as its weights. Errors are relative L2 of the gradient to vertices in pixels; vertices at one
# place count as one, since it is rounding which of them an outline belongs to.
set -euo pipefail
PYTHONDONTWRITEBYTECODE=1 PYTHONPATH=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")") exec /usr/bin/python3 - "$@" << 'PYTHON'
import numpy as np
from pathlib import Path
from suite import Suite, fronts, here, text

suite = Suite("gradients")
ways = {"coverage": {"way": 0}, "coverage, 12 outlines": {"way": 0, "K": 12}, "outlines, r = 2": {"way": 1}, "outlines, r = 4": {"way": 1, "R": 4.0},
        "all edges, K = 3": {"way": 2, "K": 3}, "antialias": {"way": 3}}


def turn(axis, angle):
    c, s, (i, j) = np.cos(angle), np.sin(angle), {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    m = np.eye(3)
    m[i, i] = m[j, j] = c
    m[i, j], m[j, i] = -s, s
    return m


def sphere(columns, rings):
    ring, k = np.meshgrid(np.arange(1, rings + 1), np.arange(columns), indexing="ij")
    polar, azimuth = np.pi * ring / (rings + 1), 2 * np.pi * k / columns
    around = np.stack([np.sin(polar) * np.sin(azimuth), np.cos(polar), np.sin(polar) * np.cos(azimuth)], -1).reshape(-1, 3)
    s, t = np.arange(columns), (np.arange(columns) + 1) % columns
    south = 1 + rings * columns
    faces = [np.stack([0 * s, 1 + s, 1 + t], -1), np.stack([0 * s + south, south - columns + t, south - columns + s], -1)]
    for r in range(rings - 1):
        upper, lower = 1 + r * columns, 1 + (r + 1) * columns
        faces += [np.stack([upper + s, lower + s, lower + t], -1), np.stack([upper + s, lower + t, upper + t], -1)]
    return np.concatenate([[[0, 1, 0]], around, [[0, -1, 0]]]) @ (turn("z", 0.3) @ turn("y", 0.4) @ turn("x", 0.9)).T, np.concatenate(faces)


def camera(distance, near=0.1, far=100.0):
    f, z = 1 / np.tan(np.radians(22.5)), far / (near - far)
    lens = np.array([[f, 0, 0, 0], [0, -f, 0, 0], [0, 0, z, near * z], [0, 0, -1, 0]])
    back = np.eye(4)
    back[2, 3] = -distance
    return (lens @ back).astype(np.float32).astype(np.float64)


def pixels(view, position, size):
    clip = np.c_[position, np.ones(len(position))] @ view.T
    return (clip[:, :2] / clip[:, 3:] * 0.5 + 0.5) * size


def judged(points, faces, size, adjoint=None):
    """The exact picture and, of sum(adjoint * picture), the gradient to the points."""
    for name, array in (("points", points), ("faces", faces.astype(np.int32)), ("adjoint", adjoint)):
        if array is not None:
            np.save(suite.out / f"{name}.npy", array)
    more = [] if adjoint is None else ["--adjoint", suite.out / "adjoint.npy"]
    suite.call("bench_exact_area", suite.out / "points.npy", suite.out / "faces.npy", size, size, suite.out / "exact", *more)
    picture = np.load(suite.out / "exact.picture.npy").reshape(size, size)
    return picture, None if adjoint is None else np.load(suite.out / "exact.gradient.npy").reshape(-1, 2)


def measure(name, position, faces, view, moved, size, wanted):
    """Records of pictures and gradients, and what to run for their times."""
    position = position.astype(np.float32).astype(np.float64)
    points = pixels(view, position, size)
    target = judged(pixels(view, moved, size), faces, size)[0].astype(np.float32).astype(np.float64)
    exact = judged(points, faces, size)[0]
    noise = np.random.default_rng(5).normal(size=(size, size)).astype(np.float32).astype(np.float64)
    of = np.unique(position, axis=0, return_inverse=True)[1].ravel()
    welded = lambda g: np.stack([np.bincount(of, g[:, k]) for k in (0, 1)], -1)
    apart = lambda x, y: float(np.linalg.norm(x - y) / np.linalg.norm(y))
    losses = {"square": (0, target, 2 * (exact - target)), "noise": (1, noise, noise)}
    true = {loss: welded(judged(points, faces, size, adjoint)[1]) for loss, (_, _, adjoint) in losses.items()}
    cells = []
    for way in wanted:
        row = {"mesh": name, "faces": len(faces), "pixels": size, "way": way}
        for loss, (white, weights, _) in losses.items():
            prefix = f"{name}_{size}_{loss}".replace(" ", "_")
            arguments = suite.bind(prefix, position=position, face=faces, target=weights)
            arguments += ["--bind", "view==[" + ",".join(repr(float(x)) for x in view.T.reshape(-1)) + "]"]
            arguments += [w for k, v in {"S": size, "white": white, **ways[way]}.items() for w in ("-D", f"{k}={v}")]
            suite.drun("gradients.dr", *arguments, "--step", "draw", "--out", suite.out / "drawn")
            alpha, found = (np.load(suite.out / "drawn" / f"draw.{n}.npy").astype(np.float64) for n in ("alpha", "to_slide"))
            found, off = welded(found.reshape(-1, 2)), np.abs(alpha.reshape(size, size) - exact)
            row[loss], row[f"{loss}_whole"] = apart(found, true[loss]), apart(found.sum(0), true[loss].sum(0))
            if loss == "square":
                row["picture_mean"], row["picture_worst"] = float(off.mean()), float(off.max())
                cells.append((row, "gradients.dr", "frame", 2000 if suite.device else 20, arguments))
        suite.record(**row)
        print(text(row), flush=True)
    return cells


distance = 1 / np.sin(np.arctan(0.6 * np.tan(np.radians(22.5))))
cells = []
for columns, rings in ((31, 11),) if suite.quick else ((31, 11), (96, 74)):
    position, faces = sphere(columns, rings)
    for size in (128,) if suite.quick else (256, 512):
        cells += measure("sphere", position, faces, camera(distance), position * 1.06 + [0.12, 0.05, 0], size, list(ways))
rows = suite.race(cells, 1 if suite.quick else 5)
for faces, size in dict.fromkeys((r["faces"], r["pixels"]) for r in rows):
    alike = [r for r in rows if (r["faces"], r["pixels"]) == (faces, size)]
    for error in ("square", "noise"):
        fronts(suite, f"{error}, {faces} faces, {size}", alike, "us", error, lambda r: f"{r['way']} ({r['us'] / 1000:.1f} ms)")

data = here.parents[2] / "shared" / "data"
meshes = {"spot": "obj/spot/cow.obj", "bob": "obj/bob/bob_tri.obj", "teapot": "obj/teapot/teapot.obj", "armchair": "gltf/armchair/armchair.gltf",
          "nefertiti": "obj/nefertiti/nefertiti-lowres.obj"}
for name, file in {} if suite.quick else meshes.items():
    if not (data / file).exists():
        print(f"{name}: {data / file} is not there", flush=True)
        continue
    position, faces = suite.mesh(data / file)
    position -= (position.max(0) + position.min(0)) / 2
    position /= np.linalg.norm(position, axis=1).max()
    for side in range(4):
        turned = position @ turn("y", side * np.pi / 2 + 0.1).T @ turn("x", 0.2).T
        measure(f"{name} {side}", turned, faces, camera(3.0), turned * 1.03 + [0.03, 0.02, 0], 1024 if name == "nefertiti" else 512,
                ["coverage", "coverage, 12 outlines", "outlines, r = 2"])
PYTHON
