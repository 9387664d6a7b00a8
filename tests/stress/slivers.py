# SPDX-License-Identifier: Apache-2.0
"""A million faces that are thin, or whose corners and sides lie exactly on pixels' borders and corners (slivers.dr), on each device.

Coverage is finite and between 0 and 1, gradients are finite, and in the first pictures the float64 evaluator agrees to 1e-5.
Corners are multiples of 1/1024 of a pixel, so that float32 and float64 have the same mesh.

usage: slivers.py DRUN PROGRAM [PICTURES]
"""
import os
import pathlib
import subprocess
import sys
import tempfile

try:
    import numpy as np
except ImportError:
    print("slivers.py is left out: this Python has no NumPy")
    sys.exit(1 if os.environ.get("CI") else 77)

SIDE, FACES, PICTURES, JUDGED = 512, 10000, 100, 1
NEAR = 1e-5


def slivers(random):
    """The corners of faces: needles up to 8 pixels long, some without any width; needles along borders; faces on the grid of half pixels."""
    start = random.uniform(-4, SIDE + 4, (FACES, 1, 2))
    long = random.uniform(-8, 8, (FACES, 1, 2))
    wide = random.choice([0.0, 0.001, 0.03], (FACES, 1, 1)) * random.uniform(-1, 1, (FACES, 1, 2))
    needles = np.concatenate([start, start + long, start + random.uniform(0, 1, (FACES, 1, 1)) * long + wide], 1)
    kind = random.integers(0, 4, FACES)
    along = np.where(kind == 1)[0]
    axis = random.integers(0, 2, len(along))
    border = np.round(needles[along, 0, axis])
    needles[along, 0, axis] = needles[along, 1, axis] = border
    grid = np.where(kind == 2)[0]
    needles[grid] = np.round(2 * needles[grid]) / 2
    corner = np.where(kind == 3)[0]
    needles[corner, 0] = np.round(needles[corner, 0])
    return (np.round(1024 * needles) / 1024).reshape(-1, 2).astype(np.float32)


def run(drun, program, folder, device):
    out = folder / device
    words = [w for n in ("place", "face", "beyond", "weight") for w in ("-b", f"{n}={folder / n}.npy")]
    done = subprocess.run([drun, program, "--device", device, *words, "--out", out], capture_output=True, text=True, timeout=900)
    if done.returncode != 0:
        sys.exit(f"{device}: exit code {done.returncode}\n{done.stderr}")
    return [np.load(out / f"draw.{n}.npy").astype(float) for n in ("alpha", "pull", "crowded")]


def main():
    drun, program = sys.argv[1], pathlib.Path(sys.argv[2])
    pictures = int(sys.argv[3]) if len(sys.argv) > 3 else PICTURES
    devices = [d for d, icd in (("llvmpipe", "DR_LAVAPIPE_ICD"), ("SwiftShader", "DR_SWIFTSHADER_ICD")) if os.environ.get(icd)]
    if not devices:
        print("no device: set DR_LAVAPIPE_ICD or DR_SWIFTSHADER_ICD")
        return 77
    os.environ["VK_ICD_FILENAMES"] = ":".join(os.environ[i] for i in ("DR_LAVAPIPE_ICD", "DR_SWIFTSHADER_ICD") if os.environ.get(i))
    random = np.random.default_rng(23)
    wrong, covered, crowded, worst = 0, 0.0, 0, 0.0
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        np.save(folder / "face.npy", np.arange(3 * FACES, dtype=np.int32).reshape(-1, 3))
        np.save(folder / "beyond.npy", np.full((FACES, 3), -1, np.int32))
        np.save(folder / "weight.npy", random.normal(size=(SIDE, SIDE)).astype(np.float32))
        for picture in range(pictures):
            np.save(folder / "place.npy", slivers(random))
            expected = run(drun, program, folder, "reference") if picture < JUDGED else None
            # SwiftShader takes long for a picture: it has the judged ones.
            for device in devices if expected else devices[:1]:
                alpha, pull, full = run(drun, program, folder, device)
                crowded += int(full.sum())
                covered += alpha.sum()
                faults = [t for t, bad in (("not finite", not (np.isfinite(alpha).all() and np.isfinite(pull).all())),
                                           ("outside of 0 to 1", alpha.min() < 0 or alpha.max() > 1 + 1e-6)) if bad]
                if expected:
                    off = np.abs(alpha - expected[0])
                    worst = max(worst, float(off.max()))
                    if off.max() > NEAR:
                        faults.append(f"{int((off > NEAR).sum())} pixels differ from the evaluator, by {off.max():.3g}")
                wrong += len(faults)
                for fault in faults:
                    print(f"{device}, picture {picture}: {fault}", flush=True)
    print(f"{pictures * FACES} faces, {covered:.1f} pixels covered, {crowded} in crowded tiles, at most {worst:.2g} from the evaluator, {wrong} wrong")
    return 1 if wrong or crowded or covered < 1 else 0


sys.exit(main())
