#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# figure6.sh BUILD_FOLDER [--device NAME] [--quick]: the paper's Figure 6 (figures.dr): what enlarging faces and shifting soft ones
# behind hard ones make of two triangles that share an edge, a blue one in front and a red one behind, with one layer and two, and
# mostly without an edge mask. A grid of pictures, and how far each is from the hard picture where that shows a face: what soft faces hide there.
set -euo pipefail
PYTHONDONTWRITEBYTECODE=1 PYTHONPATH=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")") exec /usr/bin/python3 - "$@" << 'END'
import numpy as np
from suite import Suite, plt

suite = Suite("figure6")
bound = suite.bind("two", position=np.array([[-1.0, -0.9, 0.5], [0.9, -0.2, 0.5], [-0.7, 0.8, 0.5], [-0.4, -0.5, -0.5], [1.2, -0.9, -0.5], [0.5, 1.0, -0.5]]),
                   face=np.array([[0, 1, 2], [3, 4, 5]]), color=np.array([[0.1, 0.2, 0.8]] * 3 + [[0.8, 0.1, 0.1]] * 3))
settings = {"without Enlarge()": {"way": 2}}
for K in (1, 2):
    settings |= {f"Enlarge() without Shift(), K = {K}": {"shift": 0, "K": K}, f"Enlarge() and Shift(), K = {K}": {"K": K}}
settings |= {"with the edge mask, K = 2": {"everywhere": 0}, "outlines, with the edge mask": {"way": 0, "K": 1, "everywhere": 0}}
base = {"way": 1, "K": 2, "everywhere": 1, "shift": 1}
figure, panels = plt.subplots(2, len(settings), figsize=(3 * len(settings), 6.4))
hard = None
for (name, consts), column in zip(settings.items(), panels.T):
    suite.drun("figures.dr", *bound, *(w for k, v in consts.items() for w in ("-D", f"{k}={v}")), "--out", suite.out / "look")
    picture, covered = (np.load(suite.out / "look" / f"look.{k}.npy") for k in ("picture", "covered"))
    if hard is None:
        hard, inside = picture, np.squeeze(covered) == 1
    apart = np.abs(np.squeeze(picture) - np.squeeze(hard)).max(-1)[inside]
    suite.record(setting=name, **{**base, **consts}, mean_apart_inside=float(apart.mean()), hidden=float((apart > 0.5).mean()))
    print(f"{name:30} mean difference where faces are {apart.mean():.4f}; beyond 0.5 at {(apart > 0.5).mean():.1%} of it")
    for panel, image in zip(column, (np.squeeze(picture), np.squeeze(covered))):
        panel.imshow(np.clip(image, 0, 1), cmap="gray", vmin=0, vmax=1)
        panel.axis("off")
    column[0].set_title(f"{name}\nhidden {(apart > 0.5).mean():.1%}", fontsize=8)
suite.save(figure, "plot")
END
