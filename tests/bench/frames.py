# SPDX-License-Identifier: Apache-2.0
"""Frames of glTF meshes beside Mitsuba 3's, and tangents of uv beside MikkTSpace's.

frames.py tangents FOLDER      tangents as MikkTSpace has them, of what the step `tangents` left there: mikk.npy
frames.py apart FOLDER NAME    how far the two normals are apart
frames.py frames FOLDER NAME   what Mitsuba makes of the mesh and the textures there, and how far ours is off, a line of JSON for each light

Mitsuba's light is not held up by the mesh, as ours here: light and BRDF are sampled by turns, weighed by the balance heuristic, without a ray
to the light. `shadowed` is what that ray changes in Mitsuba's own frame.
"""
import json
import sys
from pathlib import Path

import numpy as np


def load(folder, name):
    array = np.load(folder / f"{name}.npy").astype(np.float64)
    return array.reshape(array.shape[-3:]) if array.ndim > 3 else array


def unit(v):
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-30)


def mikk(position, normal, uv, face):
    """Of each vertex the mean over corners that have its place, normal and uv and wind alike, of the directions of u on their faces, laid into
    the plane of the normal, by the corners' angles."""
    p, q = position[face], uv[face]
    (e, f), (s, t) = (p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), (q[:, 1] - q[:, 0], q[:, 2] - q[:, 0])
    area = s[:, 0] * t[:, 1] - s[:, 1] * t[:, 0]
    along = np.where(area[:, None] != 0, (t[:, 1:] * e - s[:, 1:] * f) * np.sign(area)[:, None], 0)
    key = np.concatenate([position, normal, uv], 1).round(7)
    _, place = np.unique(key, axis=0, return_inverse=True)
    place = place.reshape(-1)
    sums = np.zeros((2, place.max() + 1, 3))
    winds = (area < 0).astype(int)
    for c in range(3):
        n = unit(normal[face[:, c]])
        flat = lambda v: unit(v - n * (v * n).sum(-1, keepdims=True))
        a, b = flat(p[:, (c + 1) % 3] - p[:, c]), flat(p[:, (c + 2) % 3] - p[:, c])
        angle = np.arccos(np.clip((a * b).sum(-1), -1, 1))
        np.add.at(sums, (winds, place[face[:, c]]), flat(along) * angle[:, None])
    side = np.zeros(len(position), int)
    side[face.reshape(-1)] = np.repeat(winds, 3)
    return np.concatenate([unit(sums[side, place]), np.where(side == 1, 1.0, -1.0)[:, None]], 1)


def tell_apart(folder, name):
    apart = load(folder, "tangents.apart")
    apart = apart[apart >= 0]
    print(json.dumps({"mesh": name, "normals apart, degrees": {"mean": float(apart.mean()), "median": float(np.median(apart)),
                                                               "95%": float(np.quantile(apart, 0.95)), "99%": float(np.quantile(apart, 0.99))}}))


def make_scene(mi, folder, light, sky, bsdf):
    read = lambda n: load(folder, n)
    position, face, normal, uv = read("under_lamp.placed"), read("under_lamp.face").astype(np.uint32), read("under_lamp.normals"), read("under_lamp.uv")
    mesh = mi.Mesh("mesh", len(position), len(face), has_vertex_normals=True, has_vertex_texcoords=True, props=bsdf_properties(mi, bsdf))
    parameters = mi.traverse(mesh)
    for key, values in (("vertex_positions", position), ("faces", face), ("vertex_normals", unit(normal)), ("vertex_texcoords", uv)):
        parameters[key] = values.ravel()
    parameters.update()
    turn, rise = np.radians(35.0), np.radians(20.0)
    eye = 3.6 * np.array([np.sin(turn) * np.cos(rise), np.sin(rise), np.cos(turn) * np.cos(rise)])
    size = load(folder, "under_lamp.mask").shape[0]
    if light == "lamp":
        toward = unit(np.array([0.3, 1.0, 0.7]))
        emitter = {"type": "directional", "direction": list(-toward), "irradiance": {"type": "rgb", "value": [3.0] * 3}}
    else:
        emitter = {"type": "envmap", "bitmap": mi.Bitmap(np.ascontiguousarray(sky[:, ::-1]).astype(np.float32)), "scale": 1.0}
    return mi.load_dict({"type": "scene", "mesh": mesh, "light": emitter, "camera": {
        "type": "perspective", "fov": 34.0, "fov_axis": "y", "to_world": mi.ScalarTransform4f().look_at(list(eye), [0, 0, 0], [0, 1, 0]),
        "sampler": {"type": "multijitter"}, "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}}})


def bsdf_properties(mi, bsdf):
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf)
    return properties


def unshadowed(mi, dr):
    """Direct light that nothing holds up."""
    class Unshadowed(mi.SamplingIntegrator):
        def sample(self, scene, sampler, ray, medium=None, active=True):
            si = scene.ray_intersect(ray, active)
            valid = active & si.is_valid()
            context, bsdf = mi.BSDFContext(), si.bsdf(ray)
            # By the light's own density.
            ds, weight = scene.sample_emitter_direction(si, sampler.next_2d(valid), False, valid)
            way = si.to_local(ds.d)
            value, density = bsdf.eval_pdf(context, si, way, valid)
            total = value * weight * dr.select(ds.delta, 1.0, mi.mis(ds.pdf, density))
            # And by the BRDF's.
            sample, value = bsdf.sample(context, si, sampler.next_1d(valid), sampler.next_2d(valid), valid)
            environment = scene.environment()
            if environment is not None:
                seen = dr.zeros(mi.SurfaceInteraction3f, dr.width(si))
                seen.wi = -si.to_world(sample.wo)
                towards = dr.zeros(mi.DirectionSample3f, dr.width(si))
                towards.d = si.to_world(sample.wo)
                own = environment.pdf_direction(si, towards, valid)
                total += dr.select(sample.pdf > 0, value * environment.eval(seen) * mi.mis(sample.pdf, own), 0.0)
            return dr.select(valid, total, 0.0), valid, []
    mi.mis = lambda a, b: dr.select(a > 0, a / (a + b), 0.0)
    return Unshadowed(mi.Properties())


def materials(mi, textures):
    """Mitsuba's nearest to each of ours."""
    def bitmap(values, raw=True):
        return {"type": "bitmap", "bitmap": mi.Bitmap(values.astype(np.float32)), "raw": raw, "wrap_mode": "repeat"}
    grey = lambda a: a[:, :, None]
    base, metal, rough = bitmap(textures["base"]), bitmap(grey(textures["metal"])), bitmap(grey(textures["rough"]))
    inner = {"chalk": {"type": "diffuse", "reflectance": base},
             "metal": {"type": "principled", "base_color": base, "metallic": 1.0, "roughness": rough},
             "whole": {"type": "principled", "base_color": base, "metallic": metal, "roughness": rough, "eta": 1.5}}
    both = lambda b: {"type": "twosided", "b": b}
    bumped = lambda b: {"type": "normalmap", "normalmap": bitmap(textures["normal"]), "b": b}
    return {name: both(bumped(b)) for name, b in inner.items()}


# What ours is where it takes Mitsuba's choices: by light and term.
CHANGES = {(True, "metal"): ["_apart"], (True, "whole"): ["_burley", "_apart"], (False, "metal"): ["_once", "_bent", "_sampled"]}


def frames(folder, name):
    import drjit as dr
    import mitsuba as mi
    mi.set_log_level(mi.LogLevel.Error)
    mi.set_variant("llvm_ad_rgb" if "llvm_ad_rgb" in mi.variants() else "scalar_rgb")
    textures = {key: load(folder, f"textures.{key}") for key in ("base", "metal", "rough", "normal")}
    mask = load(folder, "under_lamp.mask")[..., 0] > 0.999
    for light in ("lamp", *(p.parent.name for p in sorted(folder.glob("*/under_sky.sky.npy")))):
        sky = None if light == "lamp" else load(folder / light, "under_sky.sky")
        row = {"mesh": name, "light": light}
        for term, bsdf in materials(mi, textures).items():
            scene = make_scene(mi, folder, light, sky, bsdf)
            draw = lambda integrator: np.array(mi.render(scene, spp=64, integrator=integrator))[..., :3]
            theirs = draw(unshadowed(mi, dr))
            difference = lambda a, b: float(np.abs(a - b)[mask].mean() / b[mask].mean())
            row[term] = {}
            for way in CHANGES.get((light == "lamp", term), []) + [""]:
                ours = load(folder, f"under_lamp.{term}{way}") if light == "lamp" else load(folder / light, f"under_sky.{term}{way}")
                row[term][way.strip("_") or "ours"] = {"difference": difference(ours, theirs), "brightness": float(ours[mask].mean() / theirs[mask].mean())}
            np.save(folder / f"mitsuba.{light}.{term}.npy", theirs.astype(np.float32))
            if term == "whole":
                row["shadowed"] = difference(draw(mi.load_dict({"type": "direct"})), theirs)
        print(json.dumps(row), flush=True)


mode, folder = sys.argv[1], Path(sys.argv[2])
if mode == "tangents":
    read = lambda n: load(folder, f"shape.{n}")
    np.save(folder / "mikk.npy", mikk(read("placed"), read("normals"), read("uv"), read("face").astype(int)).astype(np.float32))
elif mode == "apart":
    tell_apart(folder, sys.argv[3])
else:
    frames(folder, sys.argv[3])
