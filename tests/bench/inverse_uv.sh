#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# inverse_uv.sh BUILD_FOLDER [STEPS]: the pear's texture by exact gradients of texels and by inverse UV, each at three
# rates: how far the texels that pictures show are from the truth, over iterations and over seconds. A table on
# stdout, bench-out/inverse_uv/plot.png and figures.json. DR_DEVICE chooses the device; without it, lavapipe.
set -euo pipefail
build=$(cd "$1" && pwd)
steps=${2:-200}
root=$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/../.." && pwd)
out=$PWD/bench-out/inverse_uv
mkdir -p "$out"
if [[ -z ${DR_DEVICE-} && -n ${DR_LAVAPIPE_ICD-} ]]; then export VK_ICD_FILENAMES=$DR_LAVAPIPE_ICD VK_DRIVER_FILES=$DR_LAVAPIPE_ICD; fi
run() { "$build/bin/drun" "$@" --device "${DR_DEVICE-}" > "$out/run.txt" || { cat "$out/run.txt"; exit 1; }; }
target=$out/target
run "$root/docs/examples/pear/target.dr" --step render --step meshes --out "$target"
fit() {  # fit INVERSE RATE TRUTH STEPS OUT
  run "$root/tests/bench/inverse_uv.dr" -I "$root/docs/examples/pear" -D "inverse=$1" -D "rate=$2" -D "truth_too=$3" \
    -D "steps=$steps" --bind "position=$target/pear_position.npy" --bind "face=$target/pear_face.npy" --bind "uv=$target/pear_uv.npy" \
    --bind "uv_face=$target/pear_uv_face.npy" --bind "view=$target/view.npy" --bind "mask=$target/mask.npy" \
    --bind "image=$target/image.npy" --step "fit=$4" --log-every 5 --out "$5"
}
now() { date +%s%N; }
for inverse in false true; do
  for rate in 0.2 0.05 0.0125; do fit "$inverse" "$rate" true "$steps" "$out/${inverse}_$rate"; done
done
# Time of an iteration: the least of five runs of 21 less the least of five runs of one, in turns.
declare -A least
for _ in 1 2 3 4 5; do
  for inverse in false true; do
    for count in 1 21; do
      begin=$(now)
      fit "$inverse" 0.05 false "$count" "$out/timed"
      took=$(($(now) - begin)) key=$inverse$count
      if [[ -z ${least[$key]-} || $took -lt ${least[$key]} ]]; then least[$key]=$took; fi
    done
  done
done
for inverse in false true; do echo "$(((${least[${inverse}21]} - ${least[${inverse}1]}) / 20))" > "$out/$inverse.ns"; done

/usr/bin/python3 - "$out" << 'END'
import json, sys
from pathlib import Path
import matplotlib
matplotlib.use("Agg")
import matplotlib.pyplot as plt
out = Path(sys.argv[1])
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4), dpi=120, sharey=True)
figures = []
for inverse, name, color in (("false", "exact scatter", "#7a9a2b"), ("true", "inverse UV", "#c8963c")):
    seconds = int((out / f"{inverse}.ns").read_text()) * 1e-9
    for rate, style in (("0.2", "--"), ("0.05", "-"), ("0.0125", ":")):
        log = [json.loads(line) for line in (out / f"{inverse}_{rate}" / "log.jsonl").read_text().splitlines()]
        runs, errors = zip(*((r["run"], r["texel_error"]) for r in log))
        left.plot(runs, errors, style, color=color, label=f"{name}, rate {rate}")
        right.plot([seconds * r for r in runs], errors, style, color=color)
        # What it takes to come within these of the truth.
        reached = {limit: next((r for r, e in zip(runs, errors) if e <= limit), None) for limit in (0.05, 0.02, 0.002)}
        figures.append({"gradients": name, "rate": float(rate), "iteration_ms": 1000 * seconds, "error": errors[-1], "iterations_to": reached})
        there = ", ".join(f"{limit} " + ("never" if r is None else f"after {r} iterations, {r * seconds:.2f} s") for limit, r in reached.items())
        print(f"{name:<14} rate {rate:<7} {1000 * seconds:7.1f} ms an iteration; error {errors[-1]:.4f} at the end, {there}")
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
