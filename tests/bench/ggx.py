# SPDX-License-Identifier: Apache-2.0
"""GGX on a device against mpmath. ggx.py points FOLDER COUNT draws points; ggx.py judge FOLDER compares what the device made of them."""
import json
import sys
from pathlib import Path

import mpmath
import numpy as np

mpmath.mp.dps = 50
UNIT = 2.0 ** -24


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def points(folder, count):
    """Half within the lobe, a part of which mirrors exactly; half anywhere; cosines from 1e-3, alpha from 2e-3, uniform in their logarithm."""
    rng = np.random.default_rng(1)
    normal = unit(rng.normal(size=(count, 3)))
    alpha = 2e-3 * 500.0 ** rng.random(count)
    alpha[: count // 8] = 2e-3
    def leaning(cosine):
        aside = unit(np.cross(normal, rng.normal(size=(count, 3))))
        return cosine[:, None] * normal + np.sqrt(1 - cosine[:, None] ** 2) * aside
    camera = leaning(1e-3 ** rng.random(count))
    mirrored = 2 * np.sum(camera * normal, -1, keepdims=True) * normal - camera
    spread = 4 * rng.random((count, 1)) * alpha[:, None] * unit(rng.normal(size=(count, 3)))
    spread[: count // 16] = 0
    light = np.where(np.arange(count)[:, None] % 2 == 0, unit(mirrored + spread), leaning(1e-3 ** rng.random(count)))
    light = np.where(np.sum(light * normal, -1, keepdims=True) < 1e-3, mirrored, light)
    for name, values in (("normal", normal), ("to_light", light), ("to_camera", camera), ("alpha", alpha)):
        np.save(folder / f"{name}.npy", values.astype(np.float32))


def dot(p, q):
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]


def vector(v):
    return [mpmath.mpf(float(x)) for x in np.atleast_1d(v)]


def density(n, h, a):
    # Of directions whose lengths are not quite 1 in float32.
    k = a * dot(n, n) * dot(h, h) / (dot(n, n) * dot(h, h) - dot(n, h) ** 2 + a * a * dot(n, h) ** 2)
    return k * k / mpmath.pi


def visible(n_l, n_v, a):
    missed = lambda c: mpmath.sqrt(c * c + a * a * (1 - c * c))
    return 1 / (2 * (n_l * missed(n_v) + n_v * missed(n_l)))


def whole(n, l, v, a):
    h = [x + y for x, y in zip(l, v)]
    slope = (1 - dot(v, h) / mpmath.sqrt(dot(h, h))) ** 5
    return dot(n, l) * density(n, h, a) * visible(dot(n, l), dot(n, v), a) * (mpmath.mpf("0.7") + mpmath.mpf("0.3") * slope)


def judge(folder):
    """D by the device's own h, V by its own cosines, the whole by the directions that were given."""
    load = lambda name, n=1: np.load(folder / f"{name}.npy").reshape(-1, n)
    normal, light, camera = (load(n, 3) for n in ("normal", "to_light", "to_camera"))
    alpha, h, n_l, n_v = load("alpha")[:, 0], load("out/terms.h", 3), load("out/terms.n_l"), load("out/terms.n_v")
    found = {"D": load("out/terms.density"), "V": load("out/terms.visible"), "the whole": load("out/terms.whole")}
    errors = {name: [] for name in found}
    for i in range(len(alpha)):
        n, a = vector(normal[i]), mpmath.mpf(float(alpha[i]))
        expected = {"D": density(n, vector(h[i]), a), "V": visible(vector(n_l[i])[0], vector(n_v[i])[0], a),
                    "the whole": whole(n, vector(light[i]), vector(camera[i]), a)}
        for name, e in expected.items():
            errors[name].append(float(abs(mpmath.mpf(float(found[name][i, 0])) / e - 1)))
    share = np.array(errors["D"]) / (4 * UNIT / alpha.astype(float) + 8 * UNIT)
    figures = {"points": len(alpha), "D over its bound": float(share.max()), **{k: float(max(e)) for k, e in errors.items()},
               **{k + ", 99.9%": float(np.quantile(e, 0.999)) for k, e in errors.items()}}
    print(json.dumps(figures))
    return figures


if __name__ == "__main__":
    folder = Path(sys.argv[2])
    if sys.argv[1] == "points":
        points(folder, int(sys.argv[3]))
    else:
        judge(folder)
