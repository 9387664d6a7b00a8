# SPDX-License-Identifier: Apache-2.0
"""environment.py FOLDER NAME ROUGHNESS: irradiance and mirrored light of a device against sums over all texels in float64."""
import json
import sys
from pathlib import Path

import numpy as np


def directions(width, height):
    azimuth = (2 * np.pi * (np.arange(width) + 0.5) / width - np.pi)[None, :]
    polar = (np.pi * (np.arange(height) + 0.5) / height)[:, None]
    d = np.stack([np.sin(polar) * np.sin(azimuth), np.cos(polar) + 0 * azimuth, np.sin(polar) * np.cos(azimuth)], -1)
    return d.reshape(-1, 3)


def solid_angles(width, height):
    edge = np.cos(np.pi * np.arange(height + 1) / height)
    return np.repeat((edge[:-1] - edge[1:]) * 2 * np.pi / width, width)


def exact(sky, alpha):
    """Irradiance over pi, and the lobe of alpha, for 32 x 16 directions."""
    height, width, _ = sky.shape
    solid = solid_angles(width, height)
    light, to = sky.reshape(-1, 3), directions(width, height)
    irradiance, lobe = [], []
    for n in directions(32, 16):
        cosine = np.maximum(to @ n, 0)
        irradiance.append((cosine * solid) @ light / np.pi)
        half2 = 0.5 * (1 + cosine)  # the squared cosine between the normal and the middle
        share = cosine * solid / (1 - half2 + alpha * alpha * half2) ** 2
        lobe.append(share @ light / share.sum())
    return np.array(irradiance), np.array(lobe)


def main():
    folder, name, roughness = Path(sys.argv[1]), sys.argv[2], float(sys.argv[3])
    load = lambda n: np.load(folder / f"filter.{n}.npy").astype(float)
    sky = load("sky")
    sky = sky.reshape(sky.shape[-3:])
    irradiance, lobe = exact(sky, roughness ** 2)
    figures = {"map": name}
    for what, truth in (("whole", irradiance), ("halved", irradiance), ("harmonics", irradiance), ("summed", lobe), ("sampled", lobe)):
        off = np.abs(load(what).reshape(-1, 3) - truth)
        # By solid angle the poles count no more than the equator; of grey light a sun's own colour counts less.
        grey = lambda light: np.sqrt(solid_angles(32, 16) @ light.mean(-1) ** 2)
        figures[what] = {"rms over mean": float(np.sqrt((off ** 2).mean()) / truth.mean()), "largest over mean": float(off.max() / truth.mean()),
                         "L2 over L2, grey, by solid angle": float(grey(load(what).reshape(-1, 3) - truth) / grey(truth))}
    print(json.dumps(figures))


main()
