#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""What run.sh measured and drew, as pictures and one page to look at. usage: report.py OUT_DIR"""
import base64
import io
import json
import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

out = Path(sys.argv[1])
here = Path(__file__).resolve().parent


def load(name):
    return np.load(out / f"{name}.npy")


def log(folder):
    return [json.loads(line) for line in (out / folder / "log.jsonl").read_text().splitlines()]


def picture(image):
    """Linear values as the bytes of an sRGB picture."""
    x = np.clip(image, 0.0, 1.0)
    x = np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.power(np.maximum(x, 0.0031308), 1 / 2.4) - 0.055)
    return (x * 255.0 + 0.5).astype(np.uint8)


def cropped(pixels, shown, margin=10):
    """Without the borders where nothing is `shown`."""
    ys, xs = (np.flatnonzero(shown.any(axis=axis)) for axis in (1, 0))
    return pixels[max(ys[0] - margin, 0):ys[-1] + margin + 1, max(xs[0] - margin, 0):xs[-1] + margin + 1]


def png(pixels):
    memory = io.BytesIO()
    plt.imsave(memory, pixels, format="png")
    return memory.getvalue()


def inline(data, kind="image/png"):
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


def distance_to_surface(points, vertices, faces):
    """Of each point from the faces around the vertex that is nearest to it."""
    nearest = np.concatenate([
        np.argmin((vertices**2).sum(1) - 2.0 * p @ vertices.T, axis=1) for p in np.array_split(points, 16)])
    around = [[] for _ in vertices]
    for f, corners in enumerate(faces):
        for v in corners:
            around[v].append(f)
    width = max(map(len, around))
    table = np.array([a + a[:1] * (width - len(a)) for a in around])[nearest]
    a, b, c = (vertices[faces[table, k]] for k in range(3))
    p = points[:, None, :]

    def dot(x, y):
        return (x * y).sum(-1)

    def segment(a, b):
        t = np.clip(dot(p - a, b - a) / dot(b - a, b - a), 0.0, 1.0)
        return np.linalg.norm(p - a - t[..., None] * (b - a), axis=-1)

    n = np.cross(b - a, c - a)
    inside = (dot(np.cross(b - a, p - a), n) >= 0) & (dot(np.cross(c - b, p - b), n) >= 0) & (
        dot(np.cross(a - c, p - c), n) >= 0)
    edges = np.minimum(np.minimum(segment(a, b), segment(b, c)), segment(c, a))
    return np.where(inside, np.abs(dot(n, p - a)) / np.linalg.norm(n, axis=-1), edges).min(axis=1)


def curve(file, title, label, lines, logarithmic=True):
    figure, axes = plt.subplots(figsize=(5.4, 3.2), dpi=120)
    for x, y, name, color in lines:
        axes.plot(x, y, label=name, color=color, linewidth=2)
    if logarithmic:
        axes.set_yscale("log")
    axes.set_title(title, loc="left", fontsize=11)
    axes.set_xlabel("step")
    axes.set_ylabel(label)
    axes.grid(alpha=0.25, which="both")
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    if len(lines) > 1:
        axes.legend(frameon=False)
    figure.tight_layout()
    figure.savefig(out / file)
    plt.close(figure)
    return inline((out / file).read_bytes())


def main():
    records = log("fit")
    shape = [r for r in records if r["step"] == "fit_shape"]
    texture = [r for r in records if r["step"] == "fit_texture"]
    final = next(r for r in records if r["step"] == "measure_shape")

    # Shapes on the way, and how far they are from the pear.
    path = np.concatenate([load("fit/path").reshape(-1, *load("fit/position").shape), load("fit/position")[None]])
    vertices, faces = load("target/meshes.pear_position").astype(np.float64), load("target/meshes.pear_face")
    extent = np.linalg.norm(vertices, axis=1).max()
    stops = [10 * k for k in range(len(path) - 1)] + [shape[-1]["run"]]
    off = distance_to_surface(path.reshape(-1, 3).astype(np.float64), vertices, faces).reshape(len(path), -1)
    far = 100.0 * off.mean(axis=1) / extent

    figures = {
        "LOSS": curve("loss.png", "How unlike the pictures are", "mean square", [
            ([r["run"] for r in shape], [r["loss"] for r in shape], "silhouettes", "#7a9a2b"),
            ([r["run"] for r in texture], [r["loss"] for r in texture], "colours", "#c8963c")]),
        "DISTANCE": curve("distance.png", "How far vertices are from the pear", "% of its radius",
                          [(stops, far, "mean", "#7a9a2b")]),
    }

    # Each camera: what was given, the start, the shape, and the result.
    mask, image = load("target/render.mask"), load("target/render.image")
    shown = np.maximum(mask.max(axis=0), (load("start/show.shaded").min(axis=(0, 3)) < 1.0))
    rows = []
    for k in range(len(mask)):
        cells = []
        for name, pixels in (
            ("target", image[k] + (1.0 - mask[k])[..., None]),
            ("before", load("start/show.shaded")[k]),
            ("shape", load("shape/show.shaded")[k]),
            ("after", load("fit/fit_texture.picture")[k] + (load("fit/fit_texture.picture")[k].sum(-1) == 0)[..., None]),
        ):
            data = png(picture(cropped(pixels, shown)))
            (out / f"view_{k}_{name}.png").write_bytes(data)
            cells.append(f'<img src="{inline(data)}" alt="view {k}, {name}">')
        rows.append("<tr><td>" + "</td><td>".join(cells) + "</td></tr>")

    overlap, noise = [], []
    for folder in ("held_out_1", "held_out_2"):
        overlap += load(f"{folder}/measure_pictures.overlap").ravel().tolist()
        noise += [10.0 ** (-r["psnr"] / 10.0) for r in log(folder)]
    facts = [
        ("mean distance from the pear", f"{100.0 * final['distance']:.2f} %", "of its radius"),
        ("farthest vertex", f"{100.0 * final['farthest']:.1f} %", "of its radius"),
        ("silhouettes of 12 views never shown", f"{100.0 * min(overlap):.1f} %", "overlap, the worst one"),
        ("colours of 12 views never shown", f"{-10.0 * np.log10(np.mean(noise)):.1f} dB", "peak signal to noise"),
    ]

    uv, uv_face, face = load("target/meshes.uv"), load("target/meshes.uv_face"), load("target/meshes.face")
    data = {
        "face": face.ravel().tolist(),
        "uv": np.round(uv[uv_face.ravel()].ravel(), 5).tolist(),
        "path": [np.round(p.ravel(), 4).tolist() for p in path],
        "stops": stops,
        "texture": inline(png(picture(load("fit/albedo")))),
    }
    page = (here / "report.html").read_text()
    values = {
        "FACTS": "".join(f"<li><b>{v}</b><span>{n}</span><i>{u}</i></li>" for n, v, u in facts),
        "ROWS": "\n".join(rows), "DATA": json.dumps(data, separators=(",", ":")),
        "STEPS": f"{shape[-1]['run']} + {texture[-1]['run']}", **figures,
    }
    for name, value in values.items():
        page = page.replace(f"@{name}@", value)
    (out / "report.html").write_text(page)


main()
