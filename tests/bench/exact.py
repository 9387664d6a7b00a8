# SPDX-License-Identifier: Apache-2.0
"""Scenes and the judge of the suites that hold pictures and gradients against exact areas (exact_area.h): gradients.sh, colors.sh and
armchair.sh. Positions are rounded to float32 first, so that the judge and the device have the same mesh."""
import json, os, subprocess
import numpy as np
from suite import Failed, here

# What ../shared/data has, where that folder is there, with the side of a picture.
files = {"spot": ("obj/spot/cow.obj", 512), "bob": ("obj/bob/bob_tri.obj", 512), "teapot": ("obj/teapot/teapot.obj", 512),
         "armchair": ("gltf/armchair/armchair.gltf", 512), "nefertiti": ("obj/nefertiti/nefertiti-lowres.obj", 1024)}


def turn(axis, angle):
    c, s, (i, j) = np.cos(angle), np.sin(angle), {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    m = np.eye(3)
    m[i, i] = m[j, j] = c
    m[i, j], m[j, i] = -s, s
    return m


def sphere(columns, rings):
    """Positions and faces of a UV sphere, turned so that no pole lies on an axis."""
    ring, k = np.meshgrid(np.arange(1, rings + 1), np.arange(columns), indexing="ij")
    polar, azimuth = np.pi * ring / (rings + 1), 2 * np.pi * k / columns
    around = np.stack([np.sin(polar) * np.sin(azimuth), np.cos(polar), np.sin(polar) * np.cos(azimuth)], -1).reshape(-1, 3)
    s, t = np.arange(columns), (np.arange(columns) + 1) % columns
    south = 1 + rings * columns
    faces = [np.stack([0 * s, 1 + s, 1 + t], -1), np.stack([0 * s + south, south - columns + t, south - columns + s], -1)]
    for r in range(rings - 1):
        upper, lower = 1 + r * columns, 1 + (r + 1) * columns
        faces += [np.stack([upper + s, lower + s, lower + t], -1), np.stack([upper + s, lower + t, upper + t], -1)]
    return np.concatenate([[[0, 1, 0]], around, [[0, -1, 0]]]) @ (turn("z", 0.3) @ turn("y", 0.4) @ turn("x", 0.9)).T, np.concatenate(faces)


def mesh(suite, name):
    """Positions, around the origin and at most 1 away, faces, and the side of its picture; None where its file is not there."""
    file, size = files[name]
    file = here.parents[2] / "shared" / "data" / file
    if not file.exists():
        print(f"{name}: {file} is not there", flush=True)
        return None
    position, faces = suite.mesh(file)
    position = position - (position.max(0) + position.min(0)) / 2
    return position / np.linalg.norm(position, axis=1).max(), faces, size


def sides(position):
    """A mesh as it is seen from four sides."""
    return [position @ turn("y", side * np.pi / 2 + 0.1).T @ turn("x", 0.2).T for side in range(4)]


def rounded(array):
    return np.asarray(array).astype(np.float32).astype(np.float64)


def camera(distance, near=0.1, far=100.0):
    f, z = 1 / np.tan(np.radians(22.5)), far / (near - far)
    lens = np.array([[f, 0, 0, 0], [0, -f, 0, 0], [0, 0, z, near * z], [0, 0, -1, 0]])
    back = np.eye(4)
    back[2, 3] = -distance
    return rounded(lens @ back)


def projected(view, position, size):
    """Where points are in a picture, in pixels, and their depths."""
    clip = np.c_[position, np.ones(len(position))] @ view.T
    return (clip[:, :2] / clip[:, 3:] * 0.5 + 0.5) * size, clip[:, 2] / clip[:, 3]


def judged(suite, points, faces, size, adjoint=None, depth=None, color=None):
    """The exact picture and, of sum(adjoint * picture), the gradient to the points."""
    words = []
    for name, array in (("points", points), ("faces", faces.astype(np.int32)), ("adjoint", adjoint), ("depth", depth), ("color", color)):
        if array is not None:
            np.save(suite.out / f"{name}.npy", array)
            words += [] if name in ("points", "faces") else [f"--{name}", suite.out / f"{name}.npy"]
    suite.call("bench_exact_area", suite.out / "points.npy", suite.out / "faces.npy", size, size, suite.out / "exact", *words)
    picture = np.load(suite.out / "exact.picture.npy").reshape(size, size)
    return picture, None if adjoint is None else np.load(suite.out / "exact.gradient.npy").reshape(-1, 2)


def apart(found, true):
    """Relative L2."""
    return float(np.linalg.norm(found - true) / np.linalg.norm(true))


def bound_view(view):
    return ["--bind", "view==[" + ",".join(repr(float(x)) for x in view.T.reshape(-1)) + "]"]


def against_exact(suite, program, name, position, faces, view, moved, size, ways, color=None):
    """How far pictures and gradients of a program are from exact areas: a record of each of `ways`, and what runs its frame. The losses
    are the mean square against the exact picture of the mesh `moved`, and linear with white noise as its weights. Vertices at one
    place count as one, since it is rounding which of them an outline belongs to."""
    position = rounded(position)
    points, depth = projected(view, position, size)
    there, there_depth = projected(view, moved, size)
    of = lambda points, depth, adjoint=None: judged(suite, points, faces, size, adjoint, None if color is None else depth, color)
    target, exact = rounded(of(there, there_depth)[0]), of(points, depth)[0]
    noise = rounded(np.random.default_rng(5).normal(size=(size, size)))
    place = np.unique(position, axis=0, return_inverse=True)[1].ravel()
    welded = lambda g: np.stack([np.bincount(place, g[:, k]) for k in (0, 1)], -1)
    losses = {"square": (0, target, 2 * (exact - target)), "noise": (1, noise, noise)}
    true = {loss: welded(of(points, depth, adjoint)[1]) for loss, (_, _, adjoint) in losses.items()}
    cells = []
    for way, consts in ways.items():
        row = {"mesh": name, "faces": len(faces), "pixels": size, "way": way}
        for loss, (white, weights, _) in losses.items():
            prefix = f"{name}_{len(faces)}_{size}_{loss}".replace(" ", "_")
            arrays = {"position": position, "face": faces, "target": weights} | ({} if color is None else {"color": color})
            arguments = suite.bind(prefix, **arrays) + bound_view(view)
            arguments += [w for k, v in {"S": size, "white": white, **consts}.items() for w in ("-D", f"{k}={v}")]
            suite.drun(program, *arguments, "--step", "draw", "--out", suite.out / "drawn")
            drawn, found = (np.load(suite.out / "drawn" / f"draw.{n}.npy").astype(np.float64) for n in ("picture", "to_slide"))
            found, off = welded(found.reshape(-1, 2)), np.abs(drawn.reshape(size, size) - exact)
            row[loss], row[f"{loss}_whole"] = apart(found, true[loss]), apart(found.sum(0), true[loss].sum(0))
            if loss == "square":
                row["picture_mean"], row["picture_worst"] = float(off.mean()), float(off.max())
                cells.append((row, program, "frame", 2000 if suite.device else 20, arguments))
        suite.record(**row)
        print(" ".join(f"{k}={v:.4g}" if isinstance(v, float) else f"{k}={v}" for k, v in row.items()), flush=True)
    return cells


def mitsuba_python():
    """The python that has Mitsuba, or None where $DR_MITSUBA_PYTHON (python3) has none or it finds no LLVM."""
    python = os.environ.get("DR_MITSUBA_PYTHON", "python3")
    try:
        works = subprocess.run([python, "-c", "import drjit as d, mitsuba as m; m.set_variant('llvm_ad_rgb'); d.eval(d.arange(m.Float, 4) + 1)"],
                               capture_output=True).returncode == 0
    except OSError:
        works = False
    return python if works else None


def against_mitsuba(suite, python, name, position, faces, distance, moved, size, counts):
    """What Mitsuba 3's projective sampling makes of the mean-square loss of `against_exact`: a record for each count of samples a pixel, of the
    median over steps of how far one step's gradient is off."""
    position = rounded(position)
    points, there = (projected(camera(distance), p, size)[0] for p in (position, moved))
    target = rounded(judged(suite, there, faces, size)[0])
    true = judged(suite, points, faces, size, 2 * (judged(suite, points, faces, size)[0] - target))[1]
    folder = suite.out / "mitsuba"
    folder.mkdir(exist_ok=True)
    for file, array in (("position", np.float32(position)), ("face", np.int32(faces)), ("target", np.float32(target))):
        np.save(folder / f"{file}.npy", array)
    words = [python, here / "mitsuba_silhouette.py", folder, size, repr(float(distance)), *counts]
    done = subprocess.run([str(w) for w in words], capture_output=True, text=True)
    if done.returncode != 0:
        raise Failed(f"{python} mitsuba_silhouette.py", done.stderr.strip())
    rows = []
    for said in (json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")):
        off = [apart(g, true) for g in np.load(folder / f"{said['samples']}.npy")]
        rows.append({"mesh": name, "faces": len(faces), "pixels": size, "way": f"Mitsuba, {said['samples']} samples", "square": float(np.median(off)),
                     **{k.replace("ms", "us"): 1000 * v for k, v in said.items() if k.startswith("ms")}})
        suite.record(**rows[-1])
        print(" ".join(f"{k}={v:.4g}" if isinstance(v, float) else f"{k}={v}" for k, v in rows[-1].items()), flush=True)
    return rows
