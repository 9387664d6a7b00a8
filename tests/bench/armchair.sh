#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# armchair.sh BUILD_FOLDER [--device NAME] [--quick]: the six numbers of a pose of the armchair of ../shared/data, hundreds of open pieces, two views
# at 512² (--quick: 128²): the gradient of the mean square against an exact mask of another pose, by coverage and by outlines, against central
# differences of exact areas (exact_area.h) at steps of 1e-3 and 3e-3; turns are radians times the radius, 1. Then whether the loss is continuous: along a
# finite motion its difference quotients at 1e-3 against its gradients.
set -euo pipefail
PYTHONDONTWRITEBYTECODE=1 PYTHONPATH=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")") exec /usr/bin/python3 - "$@" << 'PYTHON'
import sys
import numpy as np
from exact import apart, camera, judged, mesh, projected, rounded, turn
from suite import Suite

suite = Suite("armchair")
found = mesh(suite, "armchair")
if found is None:
    sys.exit()
position, faces, size = found
if suite.quick:
    size = 128
position = rounded(position)
sides = [np.block([[turn("x", 0.2) @ turn("y", a), np.zeros((3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]]) for a in (0.6, 2.2)]
views = [rounded(camera(3.0) @ side) for side in sides]


def posed(pose):
    """camera.rigid of the pose, in float64: by a rotation vector, then a shift."""
    angle = np.linalg.norm(pose[:3])
    k = pose[:3] / angle if angle > 0 else np.zeros(3)
    cross = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
    return position @ (np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross).T + pose[3:]


def pictures(pose):
    return np.stack([judged(suite, projected(view, posed(pose), size)[0], faces, size)[0] for view in views])


target = rounded(pictures(np.array([0.02, -0.03, 0.025, 0.03, 0.02, -0.02])))
loss = lambda pose: float(((pictures(pose) - target) ** 2).sum())
axes = np.eye(6)
true = {h: np.array([(loss(h * a) - loss(-h * a)) / (2 * h) for a in axes]) for h in (1e-3, 3e-3)}
print("the reference's steps agree to", f"{apart(true[1e-3], true[3e-3]):.2g}", flush=True)
suite.record(reference=list(true[1e-3]), steps_apart=apart(true[1e-3], true[3e-3]))

bound = suite.bind("armchair", position=position, face=faces, target=target)


def drawn(far, along, way):
    """The pictures, and the gradient to the pose."""
    words = ["--bind", "view==[" + ",".join("[[[" + ",".join(repr(float(x)) for x in v.T.reshape(-1)) + "]]]" for v in views) + "]",
             "--bind", "along==[" + ",".join(repr(float(x)) for x in along) + "]", "--bind", f"far=={float(far)!r}"]
    suite.drun("armchair.dr", *bound, *words, "-D", f"S={size}", "-D", f"way={way}", "--step", "draw", "--out", suite.out / "drawn")
    read = lambda name: np.load(suite.out / "drawn" / f"draw.{name}.npy").astype(np.float64)
    return read("picture").reshape(len(views), size, size), np.concatenate([read("to_rotation").ravel(), read("to_translation").ravel()])


still = np.zeros(6)
for way, name in ((0, "coverage"), (1, "outlines, r = 2")):
    g = drawn(0.0, still, way)[1]
    matter = np.abs(true[1e-3]) > 0.03 * np.linalg.norm(true[1e-3])
    row = {"way": name, "pose": apart(g, true[1e-3]), "wrong_signs": int((np.sign(g) != np.sign(true[1e-3]))[matter].sum())}
    suite.record(**row, gradient=list(g))
    print(row, flush=True)

# A shift: its gradient at each place is that to `translation`.
along = np.array([0, 0, 0, 1.0, 0.6, -0.4]) / np.linalg.norm([1.0, 0.6, -0.4])
h, worst = 1e-3, 0.0
places = np.linspace(0.0, 0.02, 3 if suite.quick else 6)
value = lambda far: float(((drawn(far, along, 0)[0] - target) ** 2).sum())
slopes = []
for far in places:
    slope = float(drawn(far, along, 0)[1] @ along)
    slopes.append(((value(far + h) - value(far - h)) / (2 * h), slope))
quotients, gradients = np.array(slopes).T
row = {"motion": apart(quotients, gradients), "worst": float(np.max(np.abs(quotients - gradients) / np.abs(gradients)))}
suite.record(**row)
print(row, flush=True)
PYTHON
