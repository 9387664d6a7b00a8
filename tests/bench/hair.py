# SPDX-License-Identifier: Apache-2.0
"""Hair against mpmath. hair.py points FOLDER COUNT draws points; hair.py judge FOLDER compares what was made of them with the formulas that
pbrt-v4 documents (Physically Based Rendering, 4th edition, 9.9), with M by its exact definition instead of pbrt's approximation."""
import mpmath as mp
import numpy as np

from suite import points_or_judge, tell_errors

mp.mp.dps = 40


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def points(folder, count):
    """Roughness from 0.08 to 1, half of the light near R's mirrored inclination; variances from 1e-4, scales from 1e-3."""
    rng = np.random.default_rng(1)
    tangent, camera, light = (unit(rng.normal(size=(count, 3))) for _ in range(3))
    across = unit(np.cross(tangent, light))
    sine = -np.sum(tangent * camera, -1, keepdims=True) + 0.1 * rng.normal(size=(count, 1))
    near = np.clip(sine, -0.999, 0.999) * tangent + np.sqrt(1 - np.clip(sine, -0.999, 0.999) ** 2) * across
    light = np.where(np.arange(count)[:, None] % 2 == 0, unit(near), light)
    fiber = np.stack([rng.uniform(0.08, 1, count), rng.uniform(0.08, 1, count), rng.uniform(1, 2, count), rng.uniform(-5, 5, count)], -1)
    for name, values in (("tangent", tangent), ("to_light", light), ("to_camera", camera), ("fiber", fiber),
                         ("melanin", rng.random((count, 2)) * [0.99, 1]), ("h", rng.uniform(-0.999, 0.999, count)),
                         ("variance", 10 ** rng.uniform(-4, 1.4, count)), ("scale", 10 ** rng.uniform(-3, 0.6, count)),
                         ("phi", rng.uniform(-10, 10, count))):
        np.save(folder / f"{name}.npy", values.astype(np.float32))


def spread_along(sin_i, cos_i, sin_o, cos_o, v):
    a = cos_i * cos_o / v
    return mp.exp(-sin_i * sin_o / v) * mp.besseli(0, a) / (2 * v * mp.sinh(1 / v))


def wrapped(phi):
    return phi - 2 * mp.pi * mp.nint(phi / (2 * mp.pi))


def logistic(x, s):
    cdf = lambda y: 1 / (1 + mp.exp(-y / s))
    density = mp.exp(-abs(x) / s) / (s * (1 + mp.exp(-abs(x) / s)) ** 2)
    return density / (cdf(mp.pi) - cdf(-mp.pi))


def dielectric(cosine, eta):
    sine2 = (1 - cosine ** 2) / eta ** 2
    inside = mp.sqrt(1 - sine2)
    parallel = (eta * cosine - inside) / (eta * cosine + inside)
    perpendicular = (cosine - eta * inside) / (cosine + eta * inside)
    return (parallel ** 2 + perpendicular ** 2) / 2


def attenuation(cos_o, eta, h, absorption):
    sin_o = mp.sqrt(1 - cos_o ** 2)
    cos_t = mp.sqrt(1 - (sin_o / eta) ** 2)
    bent = mp.sqrt(eta ** 2 - sin_o ** 2) / cos_o
    cos_gamma = mp.sqrt(1 - (h / bent) ** 2)
    kept = mp.exp(-absorption * 2 * cos_gamma / cos_t)
    f = dielectric(cos_o * mp.sqrt(1 - h ** 2), eta)
    parts = [f, (1 - f) ** 2 * kept]
    parts.append(parts[1] * kept * f)
    parts.append(parts[2] * f * kept / (1 - kept * f))
    return parts, mp.asin(h / bent)


def whole(t, wi, wo, radial, azimuthal, eta, tilt, absorption, h):
    cross = lambda a, b: [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    inner = lambda a, b: sum(x * y for x, y in zip(a, b))
    length = mp.sqrt(inner(t, t))
    x = [c / length for c in t]
    y = cross(x, [mp.mpf("0.36"), mp.mpf("0.48"), mp.mpf("0.8")])
    y = [c / mp.sqrt(inner(y, y)) for c in y]
    z = cross(x, y)
    local = lambda w: [inner(w, a) / mp.sqrt(inner(w, w)) for a in (x, y, z)]
    wi, wo = local(wi), local(wo)
    sin_o, sin_i = wo[0], wi[0]
    cos_o, cos_i = mp.sqrt(1 - sin_o ** 2), mp.sqrt(1 - sin_i ** 2)
    phi = mp.atan2(wi[2], wi[1]) - mp.atan2(wo[2], wo[1])
    gamma_o = mp.asin(h)
    parts, gamma_t = attenuation(cos_o, eta, h, absorption)
    v = (mp.mpf("0.726") * radial + mp.mpf("0.812") * radial ** 2 + mp.mpf("3.7") * radial ** 20) ** 2
    s = mp.sqrt(mp.pi / 8) * (mp.mpf("0.265") * azimuthal + mp.mpf("1.194") * azimuthal ** 2 + mp.mpf("5.372") * azimuthal ** 22)
    total = spread_along(sin_i, cos_i, sin_o, cos_o, 4 * v) * parts[3] / (2 * mp.pi)
    for p, (shift, wide) in enumerate(((2, 1), (-1, mp.mpf("0.25")), (-4, 4))):
        angle = mp.radians(shift * tilt)
        sin_p = sin_o * mp.cos(angle) + cos_o * mp.sin(angle)
        cos_p = abs(cos_o * mp.cos(angle) - sin_o * mp.sin(angle))
        about = 2 * p * gamma_t - 2 * gamma_o + p * mp.pi
        total += spread_along(sin_i, cos_i, sin_p, cos_p, wide * v) * parts[p] * logistic(wrapped(phi - about), s)
    return total


def judge(folder):
    """M, N and A by the operands that the terms were given, the whole by the directions."""
    load = lambda name: np.load(folder / f"{name}.npy").astype(float)
    given = {k: load(k) for k in ("tangent", "to_light", "to_camera", "fiber", "h", "variance", "scale", "phi")}
    found = {k: load(f"out/terms.{k}") for k in ("light", "camera", "absorption", "m", "n", "mirrored", "tt", "trt", "rest", "whole")}
    errors = {k: [] for k in ("m", "n", "a", "whole")}
    exact = lambda v: [mp.mpf(float(x)) for x in v]
    for i in range(len(given["h"])):
        (sin_i, cos_i), (sin_o, cos_o) = ([x / mp.hypot(*p) for x in p] for p in (exact(found["light"][i]), exact(found["camera"][i])))
        v, s, phi = (mp.mpf(float(given[k][i])) for k in ("variance", "scale", "phi"))
        m = spread_along(sin_i, cos_i, sin_o, cos_o, v)
        z = abs(sin_i * cos_o + sin_o * cos_i)
        scale_m = abs(m) * (1 + z / v) + mp.mpf(10) ** -30
        errors["m"].append(float(abs(mp.mpf(float(found["m"][i])) - m) / scale_m))
        n = logistic(wrapped(phi), s)
        errors["n"].append(float(abs(mp.mpf(float(found["n"][i])) - n) / (n * (1 + abs(phi) / s) + mp.mpf(10) ** -30)))
        absorption = exact(found["absorption"][i])
        fiber, h = exact(given["fiber"][i]), mp.mpf(float(given["h"][i]))
        parts, _ = attenuation(cos_o, fiber[2], h, absorption[0])
        got = [float(found[k][i]) for k in ("mirrored", "tt", "trt", "rest")]
        errors["a"].append(max(float(abs(g - e)) for g, e in zip(got, parts)))
        w = whole(exact(given["tangent"][i]), exact(given["to_light"][i]), exact(given["to_camera"][i]), fiber[0], fiber[1], fiber[2], fiber[3],
                  absorption[0], h)
        errors["whole"].append(float(abs(mp.mpf(float(found["whole"][i])) - w) / (w + mp.mpf(10) ** -3)))
    names = {"m": "M over 1 + slope / v", "n": "N over 1 + phi / s", "a": "A, absolute", "whole": "the whole"}
    tell_errors(len(given["h"]), {names[k]: e for k, e in errors.items()})


points_or_judge(points, judge)
