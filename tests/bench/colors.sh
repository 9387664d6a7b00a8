#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# colors.sh BUILD_FOLDER [--device NAME] [--quick]: pictures of one constant colour a face and their gradients against exact areas (exact_area.h), as
# gradients.sh has silhouettes: all faces of one colour, colours that change slowly over the mesh, and a random colour a face. Spot, bob, teapot, armchair and
# nefertiti of ../shared/data, from one side (--quick: a sphere of 682 triangles at 128²).
set -euo pipefail
PYTHONDONTWRITEBYTECODE=1 PYTHONPATH=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")") exec /usr/bin/python3 - "$@" << 'PYTHON'
import numpy as np
from exact import against_exact, camera, files, mesh, rounded, sides, sphere
from suite import Suite

suite = Suite("colors")
ways = {"faces": {"way": 0}, "blend": {"way": 4}, "outlines, r = 2": {"way": 1}, "antialias": {"way": 3}}
scenes = {"sphere": (*sphere(31, 11), 128)} if suite.quick else {n: m for n in files if (m := mesh(suite, n))}
for name, (position, faces, size) in scenes.items():
    turned = sides(0.8 * position if suite.quick else position)[0]
    x, y, z = position[faces].mean(1).T
    colors = {"one colour": np.full(len(faces), 0.8), "slow colours": 0.6 + 0.4 * np.sin(3 * x + 1) * np.cos(4 * y) * np.cos(5 * z),
              "random colours": np.random.default_rng(3).uniform(size=len(faces))}
    for kind, color in colors.items():
        against_exact(suite, "colors.dr", f"{name}, {kind}", turned, faces, camera(3.0), turned * 1.03 + [0.03, 0.02, 0], size, ways, rounded(color))
PYTHON
