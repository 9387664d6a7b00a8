#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# memory.sh BUILD_FOLDER [--device NAME] [--quick]: what a frame, forward and backward, holds of memory: by outlines (scale.dr), by
# all edges of three faces (avocado.dr) and antialiased (table4.dr) for a silhouette, and for a texture (table5.dr), each grown alone in
# triangles, pixels, views or texels. `held` is the most that drun allocates of the device and the host, `planned` what the plan says
# of values, `lower_bound` what lives for ever and the most that any command needs around it (drc build --report). Also what each
# more pixel, triangle, view or texel takes, from the two largest sizes. Nothing here is a time.
set -euo pipefail
PYTHONDONTWRITEBYTECODE=1 PYTHONPATH=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")") exec /usr/bin/python3 - "$@" << 'END'
import functools, json, re
import numpy as np
from suite import Suite, here, plt

suite = Suite("memory")
base = {"triangles": 5_000, "pixels": 256, "views": 1, "texels": 128}
sizes = {"triangles": (5_000, 50_000) if suite.quick else (5_000, 50_000, 200_000), "pixels": (256, 512) if suite.quick else (256, 512, 1024),
         "views": (1, 4) if suite.quick else (1, 4, 16), "texels": (128, 512) if suite.quick else (128, 512, 1024)}
device = json.loads((suite.out / "run.json").read_text())["device"]
profile = "lavapipe" if "llvmpipe" in device else "swiftshader" if "SwiftShader" in device else "nvidia-h200"
programs = {
    "outlines": ("scale.dr", ("triangles", "pixels", "views"), lambda at: {"S": at["pixels"], "N": at["views"]}),
    "faces, K = 3": ("avocado.dr", ("triangles", "pixels"), lambda at: {"S": at["pixels"], "K": 3}),
    "antialias": ("table4.dr", ("triangles", "pixels"), lambda at: {"size": at["pixels"]}),
    "texture": ("table5.dr", ("triangles", "pixels", "texels"), lambda at: {"size": at["pixels"], "T": at["texels"]}),
}


@functools.cache  # all start from the same
def measure(name, *at):
    at = dict(zip(base, at))
    source, _, consts = programs[name]
    program = suite.out / source  # the frame alone: the plan is that of all steps
    program.write_text((here / source).read_text().partition("step look")[0])
    around = round((at["triangles"] * 0.65) ** 0.5)
    rings = round(at["triangles"] / (2 * around)) + 1
    faces, vertices = 2 * around * (rings - 1), around * (rings - 1) + 2
    position, face, uv, uv_face = (suite.uv_sphere(around, rings)[k : k + 2] for k in (0, 2, 4, 6))
    bound = [*position, *face]
    if name == "outlines":
        bound += ["--bind", "rate==1e-9", "--bind", "gain==1e-3"]
    elif name == "antialias":
        bound += ["--bind", position[1].replace("position=", "goal="), "--bind", "rate==1e-9"]
    elif name == "texture":
        bound += [*uv, *uv_face, "--bind", "rate==1e-9", "--bind", "hold==1"]
    defines = [w for k, v in consts(at).items() for w in ("-D", f"{k}={v}")]
    said = suite.drun(program, *bound, *defines, "--step", "frame=2", "--counters")
    held = int(re.search(r"host, (\d+) at most", said)[1])
    symbols = {"V": vertices, "F": faces}
    if name == "texture":
        symbols["A"] = (around + 1) * (rings + 1)
    elif name != "faces, K = 3":
        symbols["face_edges"] = 3 * faces // 2
    text = suite.call("drc", "build", program, "--report=json", *defines, "--profile", profile, "-o", "/dev/null",
                      *(w for k, v in symbols.items() for w in ("--symbol", f"{k}={v}")))
    plan = json.loads(text)["memory"]
    return {"held": held, **{k: plan[k] for k in ("planned", "lower_bound", "persistent", "unshared")}}


figure, axes = plt.subplots(figsize=(8, 4))
bars = []
for name, (_, grown, _) in programs.items():
    for axis in grown:
        rows = []
        for value in sizes[axis]:
            found = measure(name, *{**base, axis: value}.values())
            rows.append((float(value) ** (2 if axis in ("pixels", "texels") else 1), found))
            suite.record(program=name, **{**base, axis: value}, **found)
        (x0, a), (x1, b) = rows[-2:]
        each = {k: (b[k] - a[k]) / (x1 - x0) for k in ("held", "planned", "lower_bound")}
        one = axis[:-1]
        suite.record(program=name, per=one, **each, held_at_the_end=b["held"])
        print(f"{name:13} {b['held'] / 2**20:7.1f} MiB at {sizes[axis][-1]:,} {axis}; each {one} {each['held']:10,.0f} bytes held,"
              f" {each['planned']:10,.0f} planned, {each['lower_bound']:10,.0f} at least ({each['held'] / max(each['lower_bound'], 1e-9):.2f} times)", flush=True)
        bars.append((f"{name}\na {one}", each))
x = np.arange(len(bars))
for k, (kind, label) in enumerate((("lower_bound", "at least"), ("planned", "planned"), ("held", "held"))):
    axes.bar(x + 0.27 * (k - 1), [b[1][kind] for b in bars], 0.25, label=label)
axes.set(yscale="log", ylabel="bytes each")
axes.set_xticks(x, [b[0] for b in bars], fontsize=6)
axes.legend()
suite.save(figure, "plot")
END
