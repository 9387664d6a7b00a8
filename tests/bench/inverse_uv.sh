#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# inverse_uv.sh BUILD_FOLDER [STEPS] [--device NAME] [--quick]: the pear's texture by exact gradients of texels and by inverse UV, 200 steps at each of three
# rates (--quick: 40 at one, pictures and texture of 128²): how far the texels that pictures show are from the truth, over iterations and over seconds. A table on
# stdout, bench-out/inverse_uv/plot.png and figures.json.
set -euo pipefail
source "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/suite.bash"
suite inverse_uv "$@"
default=200 size=256 rates=(0.2 0.05 0.0125) rounds=5
if [[ -n $quick ]]; then default=40 size=128 rates=(0.2) rounds=2; fi
steps=${rest[0]:-$default}
run() { "$bin/drun" "$@" --device "$device" > "$out/run.txt" || { cat "$out/run.txt"; exit 1; }; }
target=$out/target
run "$root/docs/examples/pear/target.dr" -D "W=$size" -D "H=$size" -D "T=$size" --step render --step meshes --out "$target"
fit() {  # fit INVERSE RATE OUT OPTION...
  run "$here/cases/inverse_uv.dr" -I "$root/docs/examples/pear" -D "T=$size" -D "inverse=$1" --bind "rate==$2" --bind "steps==$steps.0" --bind "position=$target/meshes.pear_position.npy" --bind "face=$target/meshes.pear_face.npy" --bind "uv=$target/meshes.pear_uv.npy" \
    --bind "uv_face=$target/meshes.pear_uv_face.npy" --bind "view=$target/render.view.npy" --bind "mask=$target/render.mask.npy" \
    --bind "image=$target/render.image.npy" --out "$3" "${@:4}"
}
course=()
for ((k = 0; k < steps / 5; ++k)); do course+=(--step fit=5 --step measure); done
for inverse in 0 1 2; do
  for rate in "${rates[@]}"; do fit "$inverse" "$rate" "$out/${inverse}_$rate" "${course[@]}"; done
done
# Time of an iteration while several are under way: the least of so many runs of 20, in turns.
declare -A least
for ((k = 0; k < rounds; ++k)); do
  for inverse in 0 1 2; do
    fit "$inverse" 0.05 "$out/timed" --step fit=22 --log-every 10 --timing
    us=$(sed -n 's/^fit: \([0-9.]*\) us a run while.*/\1/p' "$out/run.txt")
    least[$inverse]=$(printf '%s\n' "$us" ${least[$inverse]-} | sort -g | head -1)
  done
done

/usr/bin/python3 - "$out" "${least[0]}" "${least[1]}" "${least[2]}" "${rates[@]}" << 'END'
import json, sys
from pathlib import Path
import matplotlib
matplotlib.use("Agg")
import matplotlib.pyplot as plt
out = Path(sys.argv[1])
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4), dpi=120, sharey=True)
figures = []
ways = (("exact scatter", "#7a9a2b"), ("inverse UV", "#c8963c"), ("inverse UV, the same pixels", "#4a6fa5"))
for inverse, ((name, color), us) in enumerate(zip(ways, sys.argv[2:5])):
    seconds = float(us) * 1e-6
    for rate, style in zip(sys.argv[5:], ("--", "-", ":")):
        log = [json.loads(line) for line in (out / f"{inverse}_{rate}" / "log.jsonl").read_text().splitlines()]
        errors = [r["texel_error"] for r in log if "texel_error" in r]
        runs = range(5, 5 * len(errors) + 1, 5)
        left.plot(runs, errors, style, color=color, label=f"{name}, rate {rate}")
        right.plot([seconds * r for r in runs], errors, style, color=color)
        # What it takes to come within these of the truth.
        reached = {limit: next((r for r, e in zip(runs, errors) if e <= limit), None) for limit in (0.05, 0.02, 0.002)}
        figures.append({"gradients": name, "rate": float(rate), "iteration_ms": 1000 * seconds, "error": errors[-1], "iterations_to": reached})
        there = ", ".join(f"{limit} " + ("never" if r is None else f"after {r} iterations, {r * seconds:.2f} s") for limit, r in reached.items())
        print(f"{name:<28} rate {rate:<7} {1000 * seconds:7.1f} ms an iteration; error {errors[-1]:.4f} at the end, {there}")
left.set_xlabel("iterations")
right.set_xlabel("seconds")
left.set_ylabel("texel error (rms)")
for axes in (left, right):
    axes.set_yscale("log")
    axes.grid(alpha=0.25, which="both")
figure.legend(*left.get_legend_handles_labels(), frameon=False, fontsize=7, loc="upper center", ncol=6)
figure.tight_layout(rect=(0, 0, 1, 0.95))
figure.savefig(out / "plot.png")
(out / "figures.json").write_text(json.dumps(figures, indent=1))
END
