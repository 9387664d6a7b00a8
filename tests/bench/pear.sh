#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# pear.sh BUILD_FOLDER [--fine] [--device NAME] [--quick]: how good the fit of docs/examples/pear is, and how long it takes; --quick: that
# alone. Also its texture on the exact shape, and its shape on SwiftShader; --fine also fits 2,562 vertices in 600 steps. Figures on
# stdout and in bench-out/pear/figures.json.
set -euo pipefail
source "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/suite.bash"
suite pear "$@"
fine=${rest[0]-} pear=$root/docs/examples/pear

begin=$(date +%s%N)
DR_DEVICE=$device bash "$pear/run.sh" "$build" "$out" > "$out/run.txt"
seconds=$((($(date +%s%N) - begin) / 1000000))

run() { "$bin/drun" "$@" --device "$device"; }
on_swiftshader() { device='' VK_ICD_FILENAMES=$DR_SWIFTSHADER_ICD VK_DRIVER_FILES=$DR_SWIFTSHADER_ICD "$@"; }
target=$out/target
pictures=(--bind "view=$target/render.view.npy" --bind "mask=$target/render.mask.npy" --bind "image=$target/render.image.npy")
truth=(--bind "true_position=$target/meshes.pear_position.npy" --bind "true_face=$target/meshes.pear_face.npy")
shape() {  # shape MESH_FOLDER STEPS SMOOTHNESS OUT: fits the shape alone
  local mesh=$1 steps=$2 smoothness=$3 to=$4
  run "$pear/fit.dr" -D "steps=$steps" -D "smoothness=$smoothness" --bind "position=$mesh/meshes.position.npy" --bind "face=$mesh/meshes.face.npy" \
    "${pictures[@]}" "${truth[@]}" --step "fit_shape=$steps" --step measure_shape --out "$to" > /dev/null
}

# With the pear's own vertices, only the texture is sought.
exact=(--bind "position=$target/meshes.pear_position.npy" --bind "face=$target/meshes.pear_face.npy" --bind "uv=$target/meshes.pear_uv.npy"
  --bind "uv_face=$target/meshes.pear_uv_face.npy")
texture() {
  run "$pear/fit.dr" "${exact[@]}" "${pictures[@]}" --step fit_texture=150 --out "$out/exact" > "$out/exact.txt"
  run "$here/cases/pear_texels.dr" -I "$pear" "${exact[@]}" --bind "view=$target/render.view.npy" \
    --bind "mask=$target/render.mask.npy" --bind "albedo=$out/exact/albedo.npy" --out "$out/texels" > "$out/texels.txt"
}

rm -rf "$out/texels" "$out/swiftshader" "$out/fine"  # of an earlier run
if [[ -z $quick ]]; then
  texture
  if [[ -n ${DR_SWIFTSHADER_ICD-} ]]; then on_swiftshader shape "$target" 150 30.0 "$out/swiftshader"; fi
fi
if [[ $fine == --fine ]]; then
  run "$pear/target.dr" -D coarse=16 --step meshes --out "$out/mesh_16" > /dev/null
  shape "$out/mesh_16" 600 480.0 "$out/fine"
fi

/usr/bin/python3 - "$out" "$seconds" << 'END'
import json, sys
from pathlib import Path
import numpy as np
out, milliseconds = Path(sys.argv[1]), int(sys.argv[2])
log = lambda folder: [json.loads(line) for line in (out / folder / "log.jsonl").read_text().splitlines()]
last = lambda folder, step: [r for r in log(folder) if r["step"] == step][-1]
overlap = np.concatenate([np.load(out / f"held_out_{k}/measure_pictures.overlap.npy").ravel() for k in (1, 2)])
noise = [10 ** (-last(f"held_out_{k}", "measure_pictures")["psnr"] / 10) for k in (1, 2)]
figures = {
    "mean distance after 150 steps, % of the radius": 100 * last("fit", "measure_shape")["distance"],
    "least overlap with 12 other views": float(overlap.min()),
    "PSNR of 12 other views, dB": float(-10 * np.log10(np.mean(noise))),
    "seconds of the demo": milliseconds / 1000,
}
if (out / "texels").exists():
    figures["PSNR of texels on the exact shape, dB"] = last("texels", "judge")["texel_psnr"]
if (out / "swiftshader").exists():
    a, b = (np.load(out / f / "position.npy").astype(np.float64) for f in ("fit", "swiftshader"))
    extent = np.linalg.norm(np.load(out / "target/meshes.pear_position.npy"), axis=1).max()
    figures["SwiftShader's mean distance, % of the radius"] = 100 * last("swiftshader", "measure_shape")["distance"]
    figures["SwiftShader and lavapipe apart, mean over vertices, % of the radius"] = float(
        100 * np.linalg.norm(a - b, axis=1).mean() / extent)
if (out / "fine").exists():
    figures["mean distance of 2,562 vertices after 600 steps, %"] = 100 * last("fine", "measure_shape")["distance"]
for name, value in figures.items():
    print(f"{name:<72}{value:10.4f}")
(out / "figures.json").write_text(json.dumps(figures, indent=1))
END
