#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# table2.sh BUILD_FOLDER [--device NAME] [--quick]: the paper's Table 2: substages and stages of the pear's steps for geometry and
# texture, six views of 256² and 642 vertices, a first run and later ones, for which the reactive cache leaves the prologue out, by
# built-in profile. From `drc build --report`; nothing runs on a device. `schedules.sh tables` has the same with parts of
# packing switched off.
set -euo pipefail
PYTHONDONTWRITEBYTECODE=1 PYTHONPATH=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")") exec /usr/bin/python3 - "$@" << 'END'
import json
import numpy as np
from suite import Suite, here, plt

suite = Suite("table2")
profiles = sorted(p.stem for p in (here / "../../compiler/target/profiles").glob("*.json"))
symbols = "V=642 F=1280 A=2562 N=6 W=256 H=256 P=2562 Q=5120 face_edges=1920".split()
titles = {"fit_shape": "geometry", "fit_texture": "texture"}
rows = []
for profile in profiles:
    report = json.loads(suite.call("drc", "build", here / "../../docs/examples/pear/fit.dr", "--report=json", "--profile", profile, "-o",
                                   "/dev/null", *(w for s in symbols for w in ("--symbol", s))))
    for step in report["steps"]:
        if step["name"] in titles:
            later = step["after_the_first_run"]
            row = {"step": step["name"], "kind": titles[step["name"]], "profile": profile, "substages": sum(step["passes"].values()),
                   "stages": step["stages"], "least_stages": step["least_stages"], "substages_later": later["passes"],
                   "stages_later": later["stages"], "least_stages_later": later["least_stages"]}
            suite.record(**row)
            rows.append(row)
            print("{kind:9} {profile:15} {substages:3} / {stages:2} -> {substages_later:3} / {stages_later:2}".format(**row), flush=True)
figure, panels = plt.subplots(1, 2, figsize=(11, 4), sharey=True)
for panel, title in zip(panels, titles.values()):
    mine = [r for r in rows if r["kind"] == title]
    for k, field in enumerate(("substages", "substages_later", "stages", "stages_later")):
        panel.bar(np.arange(len(mine)) + 0.2 * k - 0.3, [r[field] for r in mine], 0.19, label=field.replace("_", ", "))
    panel.set_xticks(range(len(mine)), [r["profile"] for r in mine], rotation=30, ha="right")
    panel.set_title(title)
panels[0].legend()
suite.save(figure, "plot")
END
