#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Makes the pictures of the documentation from the programs that stand in it: those of the tutorial, by running each page's
program, those of docs/examples/, and the README's pear, of what `./dr demo` left.

usage: pictures.py DRUN [DEMO_OUT_FOLDER]     DR_DEVICE chooses the device; lavapipe without it
       pictures.py DRUN --only NAME ...       those of some pages of the tutorial and programs of docs/examples/ alone
"""
import functools
import os
import re
import struct
import subprocess
import sys
import tempfile
import zlib
from pathlib import Path

import numpy as np

docs = Path(__file__).resolve().parent
drun = str(Path(sys.argv[1]).resolve())
device = os.environ.get("DR_DEVICE", "lavapipe")

# A page, how often its step `fit` runs, and how large its pictures are.
PAGES = [("shape", 60, 96), ("texture", 60, 96), ("pose", 150, 128), ("shading", 80, 128)]

# A program of the gallery, and the steps and data that its picture is made with.
MESH = ["--bind", "position=PEAR:position", "--bind", "face=PEAR:indices"]
GALLERY = {"light": ["--step", "fit"], "colours": ["--step", "fit=80"], "pose": ["--step", "fit=5"], "depth": ["--step", "fit=200"],
           "deblurring": ["--step", "fit=150"], "metal": ["--step", "fit=200"], "shadow": [*MESH, "--step", "fit=60"],
           "network": ["--step", "start", "--step", "fit=600"], "splats": ["--step", "start", "--step", "fit=300"],
           "skinning": ["--step", "fit=10"], "density": ["--step", "fit=40"]}


def srgb(image):
    """Linear values as the bytes of a picture; one component is grey."""
    image = np.repeat(image[..., None], 3, axis=-1) if image.shape[-1] != 3 else image
    x = np.clip(image, 0.0, 1.0)
    x = np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.power(np.maximum(x, 0.0031308), 1 / 2.4) - 0.055)
    return (x * 255.0 + 0.5).astype(np.uint8)


def save(path, pixels):
    """A PNG of 8-bit colours, whose bytes depend on the pixels alone."""
    chunk = lambda kind, data: struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    rows = b"".join(b"\0" + row.tobytes() for row in pixels)
    header = struct.pack(">IIBBBBB", pixels.shape[1], pixels.shape[0], 8, 2, 0, 0, 0)
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows, 9)) + chunk(b"IEND", b""))


def side_by_side(images, gap=6):
    height = max(image.shape[0] for image in images)
    white = np.full((height, gap, 3), 255, np.uint8)
    row = []
    for image in images:
        below = np.full((height - image.shape[0], image.shape[1], 3), 255, np.uint8)
        row += [np.concatenate([image, below]), white]
    return np.concatenate(row[:-1], axis=1)


def layers(array, components):
    """The layers of an output, beside each other."""
    layered = array.ndim == (4 if components == 3 else 3)
    return side_by_side([srgb(layer) for layer in array] if layered else [srgb(array)], gap=2)


def run(program, out, *options):
    subprocess.run([drun, str(program), "--device", device, "--out", str(out), *options], check=True,
                   stdout=subprocess.DEVNULL)


def tutorial(name, steps, size):
    text = (docs / "tutorial" / f"{name}.md").read_text(encoding="utf-8")
    program = re.search(r"^```dr\n(.*?)^```$", text, re.M | re.S)[1]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"{name}.dr"
        file.write_text(program)
        seen = []
        for out, options in (("before", []), ("after", ["--step", f"fit={steps}"])):
            run(file, Path(folder) / out, "-D", f"S={size}", *options, "--step", "look")
            load = lambda value: np.load(Path(folder) / out / f"look.{value}.npy")
            photo, drawn = load("photo"), load("drawn")
            components = photo.shape[-1] if photo.shape[-1] == 3 else 1
            if not seen:
                seen.append(layers(photo, components))
            seen.append(layers(drawn, components))
        save(docs / "tutorial" / f"{name}.png", side_by_side(seen))


def example(path, options, keys=("photo", "truth", "drawn")):
    """What was seen, and what was found, of a program's step `look`; beside the program."""
    options = [word.replace("PEAR", str(docs / "examples/pear.obj")) for word in options]
    with tempfile.TemporaryDirectory() as folder:
        run(docs / f"examples/{path}.dr", folder, *options, "--step", "look")
        seen = [np.load(file) for key in keys if (file := Path(folder) / f"look.{key}.npy").exists()]
    pictures = [np.concatenate(list(srgb(a)) if a.ndim == 4 else [srgb(a)], axis=1) if a.ndim != 3 or a.shape[-1] == 3
                else np.concatenate([srgb(layer) for layer in a], axis=1) for a in seen]
    save(docs / f"examples/{path}.png", side_by_side(pictures))


def pear(out):
    """Where the fit starts, the shape that it found, and the shape with its colours, in the first view."""
    target = out / "target"
    same = ["--bind", f"face={target}/meshes.face.npy", "--bind", f"uv={target}/meshes.uv.npy", "--bind", f"uv_face={target}/meshes.uv_face.npy",
            "--bind", f"view={target}/render.view.npy", "-D", "size=200"]
    plain = ["--symbol", "T=1", "--symbol", "U=1"]
    colours = ["--bind", f"albedo={out}/fit/albedo.npy"]
    images = []
    with tempfile.TemporaryDirectory() as folder:
        for position, more in ((target / "meshes.position", plain), (out / "fit/finish.drawn", plain), (out / "fit/finish.drawn", colours)):
            run(docs / "examples/pear/show.dr", folder, *same, *more, "--bind", f"position={position}.npy")
            images.append(srgb(np.load(Path(folder) / "show.shaded.npy")[0]))
    shown = (np.stack(images) != 255).any(axis=(0, 3))
    ys, xs = (np.flatnonzero(shown.any(axis=axis)) for axis in (1, 0))
    save(docs / "pear.png", side_by_side([image[ys[0] - 4:ys[-1] + 5, xs[0] - 4:xs[-1] + 5] for image in images], gap=24))


def large(image, times):
    """Each pixel as a square of so many."""
    return np.repeat(np.repeat(image, times, axis=0), times, axis=1)


def material_from_views():
    """Base colour, and roughness and metalness in red and green: what was looked for, and what was found."""
    program = docs / "examples/material_from_views.dr"
    mesh = [word.replace("PEAR", str(docs / "examples/pear.obj")) for word in MESH]
    with tempfile.TemporaryDirectory() as folder:
        run(program, f"{folder}/made", *mesh, "--step", "make")
        made = [word for name in ("sky_a", "sky_b", "base_made", "rest_made") for word in ("--bind", f"{name}={folder}/made/make.{name}.npy")]
        one = ["--step", "start", "--step", "fit=15", "--step", "remember"]
        run(program, f"{folder}/found", *mesh, *made, *(4 * one), "--step", "take", "--step", "fit=40")
        two = lambda a: np.concatenate([a, np.zeros_like(a[..., :1])], axis=-1)
        load = lambda name: np.load(f"{folder}/{name}.npy")
        images = [load("made/make.base_made"), load("found/base"), two(load("made/make.rest_made")), two(load("found/rest"))]
    save(docs / "examples/material_from_views.png", side_by_side([large(srgb(image), 3) for image in images]))


def sky_from_ball():
    """The sky, and what was found of it."""
    program = docs / "examples/sky_from_ball.dr"
    with tempfile.TemporaryDirectory() as folder:
        run(program, f"{folder}/made", "--step", "make")
        sky = f"{folder}/made/make.sky_made.npy"
        run(program, f"{folder}/found", "--bind", f"sky={sky}", "--step", "fit=200", "--step", "judge")
        images = [np.load(sky), np.load(f"{folder}/found/judge.sky_found.npy")]
    save(docs / "examples/sky_from_ball.png", side_by_side([large(srgb(image), 2) for image in images]))


def lamp_from_shadow():
    """The shadow by the lamp that the search starts from, by the one that it finds, and the one that was seen."""
    program = docs / "examples/lamp_from_shadow.dr"
    ball = ["--bind", f"position={docs}/examples/sphere.obj:position", "--bind", f"face={docs}/examples/sphere.obj:indices"]
    with tempfile.TemporaryDirectory() as folder:
        run(program, f"{folder}/start", *ball, "--step", "show")
        run(program, f"{folder}/found", *ball, "--step", "fit=300", "--step", "show")
        images = [np.load(f"{folder}/{name}.npy") for name in ("start/show.found", "found/show.found", "found/show.photo")]
    save(docs / "examples/lamp_from_shadow.png", side_by_side([large(srgb(0.6 * image), 2) for image in images]))


def shape_from_photos():
    """The pear from a side that was not seen, what was found of it, and the shape that was found."""
    target, size = docs / "examples/pear/target.dr", ["-D", "W=128", "-D", "H=128"]
    with tempfile.TemporaryDirectory() as folder:
        run(target, f"{folder}/seen", *size, "--step", "render", "--step", "meshes")
        run(target, f"{folder}/new", *size, "-D", "round=1", "--step", "render")
        files = {"start": "seen/meshes.position", "face": "seen/meshes.face", "view": "seen/render.view", "photo": "seen/render.image",
                 "mask": "seen/render.mask", "new_view": "new/render.view", "new_photo": "new/render.image", "new_mask": "new/render.mask"}
        bound = [word for leaf, file in files.items() for word in ("--bind", f"{leaf}={folder}/{file}.npy")]
        run(docs / "examples/shape_from_photos.dr", f"{folder}/found", *bound, "--step", "coarse=220", "--step", "fit=120", "--step", "look")
        images = [np.load(f"{folder}/found/look.{name}.npy") for name in ("photo", "drawn", "shape")]
    save(docs / "examples/shape_from_photos.png", side_by_side([large(srgb(image), 2) for image in images]))


def normal_map():
    example("normal_map", ["--step", "fit=80"], ("photo", "coarse", "drawn"))


def shape_and_texture():
    ball = docs / "examples/sphere.obj"
    example("shape_and_texture", ["--bind", f"start={ball}:position", "--bind", f"face={ball}:indices", "--step", "together=200"])


PROGRAMS = {page[0]: functools.partial(tutorial, *page) for page in PAGES}
PROGRAMS |= {f.__name__: f for f in (normal_map, shape_and_texture, material_from_views, sky_from_ball, lamp_from_shadow, shape_from_photos)}
if sys.argv[2:3] == ["--only"]:
    for name in sys.argv[3:]:
        PROGRAMS[name]()
    sys.exit()
for name, options in GALLERY.items():
    example(f"gallery/{name}", options)
for program in PROGRAMS.values():
    program()
if len(sys.argv) > 2:
    pear(Path(sys.argv[2]))
