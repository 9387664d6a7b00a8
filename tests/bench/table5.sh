#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# table5.sh BUILD_FOLDER [--device NAME] [--quick]: the paper's Table 5, a frame of a texture's fit forward and backward (table5.dr),
# for spheres of 14,208 and 55,000 triangles in pictures of 2048² (--quick: 512²), by size of the texture and by how texels'
# gradients are summed. `moves` says whether the mesh does, else the reactive cache leaves its raster out. Times are `us a run
# while several are under way`; see suite.py. Before that, gradients are held against the evaluator's, in a small picture.
set -euo pipefail
PYTHONDONTWRITEBYTECODE=1 PYTHONPATH=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")") exec /usr/bin/python3 - "$@" << 'END'
from suite import Suite, lines, plt

suite = Suite("table5")
size = 512 if suite.quick else 2048
cells = []
for triangles, sphere in ((14208, (96, 75)), (55000, (220, 126))):
    bound = [*suite.uv_sphere(*sphere), "--bind", "rate==1e-6", "--bind", "hold==1"]
    if triangles == 14208:
        for scatter in ("exact", "atomic"):
            _, _, error = suite.against_evaluator("table5.dr", "look", ["gradient"], [*bound, "-D", "size=128", "-D", "T=128"],
                                                  ["--scatter", scatter])["gradient"]
            print(f"scatter={scatter}: gradient {error:.1e} from the evaluator's, relative L2, at 128² and a texture of 128²")
            suite.record(triangles=triangles, pixels=128, texture=128, scatter=scatter, gradient_error=error)
    for texture in (512, 1024) if suite.quick else (1024, 2048, 4096):
        for scatter in ("exact", "atomic"):
            for moves in ("true",) if suite.quick else ("true", "false"):
                cells.append(({"triangles": triangles, "pixels": size, "texture": texture, "scatter": scatter, "moves": moves == "true"},
                              "table5.dr", "frame", 2000 if suite.device else 5,
                              [*bound, "-D", f"size={size}", "-D", f"T={texture}", "--scatter", scatter, "-D", f"moves={moves}"]))

rows = suite.race(cells, 3)
figure, axes = plt.subplots(figsize=(6.5, 4))
lines(axes, [r for r in rows if r["moves"]], "texture", lambda r: f"{r['triangles']:,} triangles, {r['scatter']}")
axes.set(xlabel="texture's side, texels", ylabel="ms a frame", title=f"Table 5 at {size}²", ylim=(0, None))
axes.legend()
suite.save(figure, "plot")
END
