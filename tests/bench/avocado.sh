#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# avocado.sh BUILD_FOLDER [MESH [FRAMES]] [--device NAME] [--quick]: milliseconds of a frame's silhouette and gradients, forward and backward, at 256²
# to 2048² (--quick: 512²; the paper's Table 4) and of eight views of 128², of the Avocado in $DR_SHARED_DATA, or shared/data beside the sources. For distances to
# outlines, and to all edges of the nearest one and three faces. `wall` is the time that passes, the best of three (one) runs of
# FRAMES frames less runs of none; `cpu` the processor time of that. Also as bench-out/avocado/figures.json.
set -euo pipefail
source "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/suite.bash"
suite avocado "$@"
mesh=${rest[0]:-${DR_SHARED_DATA:-$root/../shared/data}/gltf/Avocado/Avocado.gltf}
if [[ ! -e $mesh ]]; then echo "avocado: skipped, there is no $mesh"; exit 0; fi
/usr/bin/python3 - "$bin/drun" "$here/cases/avocado.dr" "$mesh" "${rest[1]:-60}" "$device" "$quick" << 'END'
import json, os, subprocess, sys, time

drun, program, mesh, frames, device, quick = *sys.argv[1:4], int(sys.argv[4]), *sys.argv[5:7]
rounds = 1 if quick else 3

def run(size, views, layers, frames):
    """Wall and processor time of a whole run, in ms."""
    before, begin = os.times(), time.monotonic()
    done = subprocess.run([drun, program, "-D", f"S={size}", "-D", f"N={views}", "-D", f"K={layers}", "--bind", f"position={mesh}:position", "--bind",
                           f"face={mesh}:indices", "--step", f"frame={frames}", "--log-every", str(frames), "--device",
                           device], capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(done.stderr)
    wall, after = time.monotonic() - begin, os.times()
    used = after.children_user + after.children_system - before.children_user - before.children_system
    return 1000 * wall, 1000 * used

figures = []
print(f"{'size':>5} {'views':>5} {'distances to':<20} {'wall ms':>9} {'cpu ms':>9}")
for size, views in ((256, 1), (512, 1)) if quick else ((128, 8), (256, 1), (512, 1), (1024, 1), (2048, 1)):
    for layers, name in ((0, "outlines"), (1, "all edges, K = 1"), (3, "all edges, K = 3")):
        count = max(frames * 256 // size // views, 2)
        run(size, views, layers, 1)  # fills the caches of compiler and driver
        # What the first frame prepares and what starting costs is in both.
        short = [run(size, views, layers, 1) for _ in range(rounds)]
        long = [run(size, views, layers, 1 + count) for _ in range(rounds)]
        wall, cpu = ((min(t[i] for t in long) - min(t[i] for t in short)) / count for i in (0, 1))
        print(f"{size:>5} {views:>5} {name:<20} {wall:9.1f} {cpu:9.1f}", flush=True)
        figures.append({"size": size, "views": views, "distances": name, "wall_ms": wall, "cpu_ms": cpu})
with open("bench-out/avocado/figures.json", "w") as file:
    json.dump(figures, file, indent=1)
END
