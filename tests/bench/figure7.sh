#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# figure7.sh BUILD_FOLDER [--device NAME] [--quick]: the paper's Figure 7 (figures.dr): settings of the blending for a sphere of 1,000 faces,
# from antialiasing to SoftRas: radius, rim, layers, edge mask, sigma = r / 7 and 2 r / 7. A grid of pictures, and the border step: the most
# that coverage lacks of 1 where the blended band meets the covered pixels beside it. A sigmoid of distance / sigma leaves
# 1 / (1 + exp(r / sigma)) there: 0.0009 and 0.029.
set -euo pipefail
PYTHONDONTWRITEBYTECODE=1 PYTHONPATH=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")") exec /usr/bin/python3 - "$@" << 'END'
import numpy as np
from suite import Suite, plt

suite = Suite("figure7")
bound = suite.uv_sphere(25, 21)[:4]
position = np.load(bound[1].partition("=")[2])
bound += suite.bind("sphere", color=np.where((np.floor(4 * position + 0.5).sum(1) % 2 == 0)[:, None], [0.9, 0.6, 0.2], [0.2, 0.4, 0.6]))
settings = {"hard": {"way": 2}}
for way, kind, K in ((0, "outlines", 1), (1, "all edges, K = 1", 1), (1, "all edges, K = 3", 3)):
    for R, rim, share, everywhere, what in ((8, 1, 7, 0, "r = 8, rim 1, σ = r/7"), (4, 4, 7, 0, "r = 4, σ = r/7"), (4, 4, 3.5, 0, "r = 4, σ = 2r/7"),
                                            (8, 8, 7, 0, "r = 8, σ = r/7"), (8, 8, 3.5, 0, "r = 8, σ = 2r/7"), (8, 8, 3.5, 1, "r = 8, σ = 2r/7, no mask")):
        settings[f"{kind}\n{what}"] = {"way": way, "K": K, "R": float(R), "rim": float(rim), "share": float(share), "everywhere": everywhere}
figure, panels = plt.subplots(3, 6, figsize=(15, 8.6))
for panel, (name, consts) in zip(panels.flat, list(settings.items())[1:]):
    suite.drun("figures.dr", "-D", "S=128", *bound, *(w for k, v in consts.items() for w in ("-D", f"{k}={v}")), "--out", suite.out / "look")
    picture, covered, blended = (np.squeeze(np.load(suite.out / "look" / f"look.{k}.npy")) for k in ("picture", "covered", "blended"))
    plain = np.pad((blended == 0) & (covered == 1), 1)
    beside = (plain[2:, 1:-1] | plain[:-2, 1:-1] | plain[1:-1, 2:] | plain[1:-1, :-2]) & (blended == 1)
    step = float((1 - covered)[beside].max()) if beside.any() else 0.0
    due = 1 / (1 + float(np.exp(consts["rim"] * consts["share"] / consts["R"])))
    suite.record(setting=name.replace("\n", ", "), **consts, border_step=step, border_step_of_the_sigmoid=due, soft_pixels=int(((covered > 0) & (covered < 1)).sum()))
    print(f"{name.replace(chr(10), ', '):48} border step {step:.4f} (of the sigmoid {due:.4f})", flush=True)
    panel.imshow(np.clip(picture, 0, 1))
    panel.axis("off")
    panel.set_title(f"{name}\nborder step {step:.3f}", fontsize=7)
suite.save(figure, "plot")
END
