#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# table5.sh BUILD_FOLDER [--device NAME] [--quick] [--twin]: the paper's Table 5, a frame of a texture's fit forward and backward (table5.dr),
# for spheres of 14,208 and 55,000 triangles in pictures of 2048² (--quick: the former, 512²), by size of the texture and by how texels'
# gradients are summed. `moves` says whether the mesh does, else the reactive cache leaves its raster out. Times are `us a run
# while several are under way`; see suite.py. Before that, gradients are held against the evaluator's, in a small picture, and
# first of all frames stand beside the same frame written by hand (handwritten/), in turns in one process; --twin does that alone,
# and needs no Python. The ratio is compiled over hand-written, `apart` how far the gradients are, relative L2.
set -euo pipefail
source "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/suite.bash"
suite table5 "$@"
size=2048 textures=(1024 2048 4096) rounds=9 spheres=("96 75" "220 126")
if [[ -n $quick ]]; then size=512 textures=(512 1024) rounds=3 spheres=("96 75"); fi
(
  : > "$out/handwritten.jsonl"
  "$build/bin/bench_handwritten" --heading
  for sphere in "${spheres[@]}"; do
    read -r around rings <<< "$sphere"
    awk -v around="$around" -v rings="$rings" -v textured=1 -f "$here/uv_sphere.awk" > "$out/sphere.obj"
    for texture in "${textures[@]}"; do
      for scatter in exact atomic; do
        "$build/bin/bench_handwritten" "$out/handwritten.jsonl" "$here/cases/table5.dr" "$device" "$rounds" "$scatter" "size=$size" \
          "T=$texture" -- position="$out/sphere.obj:position" face="$out/sphere.obj:indices" uv="$out/sphere.obj:uv" \
          uv_face="$out/sphere.obj:uv_indices" rate==1e-6 hold==1 ||
          printf '%9s %6s %8s  %s: not measured\n' "$((2 * around * (rings - 1)))" "$size" "$texture" "$scatter"
      done
    done
  done
)
if [[ ${rest[0]-} == --twin ]]; then exit 0; fi
set -- "$build" ${device:+--device "$device"} ${quick:+--quick}
PYTHONDONTWRITEBYTECODE=1 PYTHONPATH=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")") exec /usr/bin/python3 - "$@" << 'END'
from suite import Suite, lines, plt

suite = Suite("table5")
size = 512 if suite.quick else 2048
cells = []
for triangles, sphere in ((14208, (96, 75)),) if suite.quick else ((14208, (96, 75)), (55000, (220, 126))):
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

rows = suite.race(cells, 2 if suite.quick else 3)
figure, axes = plt.subplots(figsize=(6.5, 4))
lines(axes, [r for r in rows if r["moves"]], "texture", lambda r: f"{r['triangles']:,} triangles, {r['scatter']}")
axes.set(xlabel="texture's side, texels", ylabel="ms a frame", title=f"Table 5 at {size}²", ylim=(0, None))
axes.legend()
suite.save(figure, "plot")
END
