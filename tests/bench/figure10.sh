#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# figure10.sh BUILD_FOLDER [--device NAME] [--quick]: the paper's Figure 10: how the error falls on each device. The fit of figure11.dr
# (K = 3, r = 2, 64² pixels, 642 vertices; 200 steps, --quick: 50) on lavapipe, SwiftShader and the device that is named, as far as they are there:
# the mean distance after each tenth, in a table and a plot, and the most by which it differs between devices.
set -euo pipefail
PYTHONDONTWRITEBYTECODE=1 PYTHONPATH=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")") exec /usr/bin/python3 - "$@" << 'END'
import json, os, subprocess
import numpy as np
from suite import Suite, here, plt
from skull import skull, vertices

given = os.environ.copy()
suite = Suite("figure10")
steps = 50 if suite.quick else 200
bound = suite.icosphere(3)
sphere = vertices(bound[1].partition("=")[2].rpartition(":")[0])
faces = bound[3]
bound = suite.bind("start", position=0.8 * sphere) + ["--bind", faces]
bound += suite.bind("target", true_position=skull(sphere / np.linalg.norm(sphere, axis=1, keepdims=True))[:, None] * sphere / np.linalg.norm(sphere, axis=1, keepdims=True))
bound += ["--bind", faces.replace("face=", "true_face=", 1)]
places = {name: given[f"DR_{name.upper()}_ICD"] for name in ("lavapipe", "swiftshader") if given.get(f"DR_{name.upper()}_ICD")}
if suite.device:
    places[suite.device] = ""
figure, axes = plt.subplots(figsize=(7, 4.5))
courses = {}
for name, driver in places.items():
    environment = dict(given, VK_ICD_FILENAMES=driver, VK_DRIVER_FILES=driver) if driver else given
    ways = [w for _ in range(10) for w in ("--step", f"fit={steps // 10}", "--step", "measure")]
    subprocess.run([suite.build / "bin" / "drun", here / "cases" / "figure11.dr", "--device", "" if driver else name, "-D", "S=64", "--bind", f"steps=={steps}.0",
                    "--bind", "radius==[[2, 2]]", "--bind", "trial==0",
                    *bound, *ways, "--log-every", str(steps), "--out", suite.out / name], env=environment, stdout=subprocess.DEVNULL, check=True)
    log = [json.loads(line) for line in (suite.out / name / "log.jsonl").read_text().splitlines()]
    courses[name] = [100 * float(row["distance"]) for row in log if "distance" in row]
    suite.record(device=name, steps=steps, course=courses[name])
    print(f"{name:12}", " ".join(f"{d:.4f}" for d in courses[name]), flush=True)
    axes.plot(np.arange(1, 11) * (steps // 10), courses[name], marker="o", markersize=3, label=name)
if len(courses) > 1:
    apart = np.ptp(np.array(list(courses.values())), axis=0).max()
    suite.record(apart=float(apart))
    print(f"at most {apart:.4f} apart, % of the radius")
axes.set(xlabel="steps", ylabel="mean distance, % of the radius", yscale="log")
axes.legend()
suite.save(figure, "plot")
END
