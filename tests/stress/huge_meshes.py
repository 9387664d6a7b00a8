# SPDX-License-Identifier: Apache-2.0
"""Meshes of sizes from 1e30 to 1e38 through the library (huge_meshes.dr, huge_library.dr), on each device, against the float64 evaluator.

An output that a device writes is near the evaluator's, or holds a NaN or Inf of which drun warned by name: a finite
number that is wrong, or one that is not finite without a word, is a failure.

usage: huge_meshes.py DRUN PROGRAM [STEP ...]
DR_HUGE_SIZES="1 1e30 1e34 1.5e38" looks at more sizes.
"""
import os
import pathlib
import subprocess
import sys
import tempfile

try:
    import numpy as np
except ImportError:
    print("huge_meshes.py is left out: this Python has no NumPy")
    sys.exit(1 if os.environ.get("CI") else 77)

# SwiftShader takes longest, and has the largest size.
SIZES = tuple(float(size) for size in os.environ.get("DR_HUGE_SIZES", "1e30 1.5e38").split())
NEAR = 2e-3  # of an output's largest number; gradients of outlines are of few digits
LEAST = 1e-36  # below it numbers may be subnormal, and 0 on a device


def globe(rounds=2):
    """An octahedron of radius 1, each face cut into four `rounds` times, turned so that no edge is along an axis."""
    places = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
    faces = [(0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4), (2, 0, 5), (1, 2, 5), (3, 1, 5), (0, 3, 5)]
    for _ in range(rounds):
        known, finer = {}, []

        def middle(a, b):
            key = (min(a, b), max(a, b))
            if key not in known:
                known[key] = len(places)
                places.append(tuple((np.array(places[a]) + np.array(places[b])) / 2))
            return known[key]

        for a, b, c in faces:
            x, y, z = middle(a, b), middle(b, c), middle(c, a)
            finer += [(a, x, z), (x, b, y), (z, y, c), (x, y, z)]
        faces = finer
    p = np.array(places, float)
    p /= np.linalg.norm(p, axis=1, keepdims=True)
    turn, _ = np.linalg.qr(np.array([[0.8, 0.3, 0.1], [-0.2, 0.9, 0.4], [0.3, -0.5, 0.7]]))
    # Unlike radii: the nearest face and the farthest vertex are one.
    p *= 1 + 0.2 * np.random.default_rng(1).random((len(p), 1))
    return p @ (turn * np.sign(np.linalg.det(turn))), np.array(faces, np.int32)


def run(drun, program, folder, device, size, steps):
    out = folder / f"{device}_{size:g}"
    command = [drun, program, "--device", device, "-b", f"p={folder / f'p_{size:g}.npy'}", "-b", f"face={folder / 'face.npy'}"]
    for step in steps:
        command += ["--step", step]
    done = subprocess.run([*command, "--out", out], capture_output=True, text=True, timeout=600)
    if done.returncode != 0:
        sys.exit(f"{device}, {size:g}: exit code {done.returncode}\n{done.stderr}")
    return {f.stem: np.load(f) for f in out.glob("*.npy") if "." in f.stem}, done.stderr


def problem(name, found, expected, words):
    """What is wrong with an output, or nothing."""
    if not np.isfinite(found).all():
        return None if f"output '{name}' " in words else "not finite, without a word"
    if not np.isfinite(expected).all():
        return "finite where the evaluator has NaN or Inf"
    error = np.abs(found.astype(float) - expected).max()
    most = np.abs(expected).max()
    if most <= LEAST or error <= NEAR * most:
        return None
    return f"wrong without a word: differs by {error:.3g} of {most:.3g}"


def main():
    drun, program, steps = sys.argv[1], pathlib.Path(sys.argv[2]), sys.argv[3:]
    devices = [d for d, icd in (("llvmpipe", "DR_LAVAPIPE_ICD"), ("SwiftShader", "DR_SWIFTSHADER_ICD")) if os.environ.get(icd)]
    if not devices:
        print("no device: set DR_LAVAPIPE_ICD or DR_SWIFTSHADER_ICD")
        return 77
    os.environ["VK_ICD_FILENAMES"] = ":".join(os.environ[i] for i in ("DR_LAVAPIPE_ICD", "DR_SWIFTSHADER_ICD") if os.environ.get(i))
    steps = steps or [line.split()[1] for line in program.read_text().splitlines() if line.startswith("step ")]
    compared = warned = wrong = 0
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        places, faces = globe()
        np.save(folder / "face.npy", faces)
        for size in SIZES:
            np.save(folder / f"p_{size:g}.npy", (places * size).astype(np.float32))
            expected, _ = run(drun, program, folder, "reference", size, steps)
            for device in devices if size == SIZES[-1] else devices[:1]:
                found, words = run(drun, program, folder, device, size, steps)
                for output in sorted(expected):
                    compared += 1
                    warned += not np.isfinite(found[output]).all()
                    what = problem(output, found[output], expected[output], words)
                    if what or (size == 1.0 and "NaN or Inf" in words):
                        wrong += 1
                        print(f"{device}, {size:g}, {output}: {what or words}")
    print(f"{compared} outputs, {warned} not finite, {wrong} wrong or without a word")
    return 1 if wrong or compared == 0 else 0


sys.exit(main())
