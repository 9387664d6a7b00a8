#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# human.sh BUILD_FOLDER [--device NAME] [--quick]: time against error of std.strands' layers and of std.skin's samples, and how far the profile of
# std.skin is from a Monte Carlo walk of light in a half space. (--quick: fewer of each.)
set -euo pipefail
PYTHONDONTWRITEBYTECODE=1 PYTHONPATH=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")") exec /usr/bin/python3 - "$@" << 'PYTHON'
import numpy as np
from suite import Suite

suite = Suite("human")


def made(step, output, *constants):
    file = suite.out / f"{step}.npy"
    suite.drun("human.dr", *constants, "--step", step, "--save", f"{step}.{output}={file}")
    return np.load(file)


def rows(kind, step, output, name, counts, truth, part=slice(None)):
    """Times of a step, and how far its output is from the truth in a part of the picture, over a constant of the program."""
    cells = [({kind: n}, "human.dr", step, 5, ("-D", f"{name}={n}", "--no-skip", "cache")) for n in counts]
    for record in suite.race(cells):
        apart = np.abs(made(step, output, "-D", f"{name}={record[kind]}") - truth)[part, part]
        record.update(mean=float(apart.mean()), most=float(apart.max()))
        print(f"{kind} {record[kind]}: {record['us'] / 1000:.2f} ms, mean error {apart.mean():.2e}, largest {apart.max():.2e}", flush=True)


def walked(albedo, count, rng):
    """How far from where it fell in light comes out, in mean free paths: it falls in diffusely, scatters evenly, and meets the same index outside."""
    def unit(cosine):
        turn, sine = 2 * np.pi * rng.random(len(cosine)), np.sqrt(1 - cosine**2)
        return np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine], 1)

    way, at, found = unit(np.sqrt(rng.random(count))), np.zeros((count, 3)), []
    while len(at):
        at = at - np.log(rng.random(len(at)))[:, None] * way
        left = at[:, 2] < 0
        ends = at[left] - way[left] * (at[left, 2] / way[left, 2])[:, None]
        found.append(np.hypot(ends[:, 0], ends[:, 1]))
        at = at[~left]
        at = at[rng.random(len(at)) < albedo]
        way = unit(2 * rng.random(len(at)) - 1)
    return np.sort(np.concatenate(found))


few = suite.quick
rows("layers", "strands", "hair", "nearest", [2, 8] if few else [2, 4, 6, 8, 12], made("strands", "hair", "-D", "nearest=16"))
rows("samples", "skin", "out", "samples", [16, 64] if few else [16, 32, 64, 128, 256, 512], made("truth", "exact").reshape(1, -1, 3),
     slice(64, 192))  # farther from the border than light goes
rng, count = np.random.default_rng(1), 100_000 if few else 1_000_000
for albedo in (0.3, 0.6, 0.9, 0.99, 0.999):
    radii = walked(albedo, count, rng)
    seen = len(radii) / count
    reach = 1 / (1.9 - seen + 3.5 * (seen - 0.8) ** 2)
    x = np.linspace(0.02, 20, 2000)
    apart = np.abs(np.searchsorted(radii, x * reach) / len(radii) - (1 - 0.25 * np.exp(-x) - 0.75 * np.exp(-x / 3))).max()
    suite.record(walk=albedo, albedo=seen, apart=float(apart))
    print(f"walk: surface albedo {seen:.3f}: the part of light within a distance differs by {apart:.4f} at most", flush=True)
PYTHON
