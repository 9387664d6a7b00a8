#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# blending.sh BUILD_FOLDER [--device NAME] [--quick]: the forms of colour at outlines (blending.dr): `mean` is the paper's Eq. 5, in
# `layer` the background takes part in it, in `over` coverage mixes with the background. `bias`: a sphere of 1,280 faces in one
# colour, relative L2 of the evaluator's gradient against that of exact area coverage, vertex by vertex and of the whole
# (see coverage.py). Then a fit of a sphere to an ellipsoid's radii, place and colours by the colours of four pictures of 64² alone,
# which are supersampled: what is left of each after 100 steps (--quick: 40).
set -euo pipefail
PYTHONDONTWRITEBYTECODE=1 PYTHONPATH=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")") exec /usr/bin/python3 - "$@" << 'END'
import json
import numpy as np
from coverage import distance_from, true_gradient
from suite import Suite, here, plt, text

suite = Suite("blending")
forms = {"mean": 2, "layer": 1, "over": 0}
size, steps = (64, 40) if suite.quick else (128, 100)
ways = {"outlines": (0, 1), "outlines, 3 layers": (0, 3), "all edges, K = 1": (1, 1), "all edges, K = 3": (1, 3)}
consts = lambda way, form: ["-D", f"way={ways[way][0]}", "-D", f"K={ways[way][1]}", "-D", f"form={forms[form]}"]
mesh = suite.icosphere(3)
for way in ways:
    for form in forms:
        files = {name: suite.out / f"{name}.npy" for name in ("to_slide", "pixel")}
        suite.call("drc", "eval", here / "cases" / "blending.dr", "-D", f"S={size}", *consts(way, form), *mesh, "--step", "gradient",
                   *(w for name, file in files.items() for w in ("--save", f"{name}={file}")))
        found, points = (np.load(files[name]).astype(np.float64).reshape(-1, 2) for name in ("to_slide", "pixel"))
        row = {"way": way, "form": form, "pixels": size, **distance_from(found, true_gradient(points), points, size)}
        suite.record(**row)
        print(text(row), flush=True)

suite.drun("blending.dr", *mesh, "--step", "target", "--out", suite.out / "target")
mesh += ["--bind", f"image={suite.out / 'target' / 'target.image.npy'}"]
kinds = ("radii_off", "middle_off", "color_off")
figure, axes = plt.subplots(1, 3, figsize=(12, 3.4))
for way, style in (("outlines", "-"), ("all edges, K = 3", "--")):
    for form, color in zip(forms, ("C3", "C0", "C2")):
        out = suite.out / "fit"
        suite.drun("blending.dr", *mesh, *consts(way, form), "-D", f"steps={steps}", "--step", f"fit={steps}", "--log-every", 2, "--out", out)
        log = [json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()]
        for ax, key in zip(axes, kinds):
            ax.plot([r["run"] for r in log], [r[key] for r in log], style, color=color, label=f"{form}, {way}")
        row = {"way": way, "form": form, "steps": steps, **{key: log[-1][key] for key in kinds}}
        suite.record(**row)
        print(text(row), flush=True)
for ax, name in zip(axes, ("radii", "middle", "colours, rms")):
    ax.set(xlabel="steps", title=name, yscale="log")
axes[0].legend(fontsize=7)
suite.save(figure, "plot")
END
