# SPDX-License-Identifier: Apache-2.0
"""Mitsuba 3's gradients of a silhouette, for gradients.sh --with-mitsuba: mitsuba_silhouette.py FOLDER SIZE DISTANCE SAMPLES...

FOLDER holds position.npy, face.npy and target.npy. Of the sum of squared differences from the target, by projective sampling of what the camera
sees, with as many samples a pixel for picture and gradient: a line of JSON for each count of samples, with the milliseconds of a step. The gradients
to vertices moved in pixels, of five steps with other seeds each, lie in FOLDER/SAMPLES.npy.
"""
import json, statistics, sys, time
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_rgb")
folder, size, distance, counts = Path(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]), map(int, sys.argv[4:])
position, face, target = (np.load(folder / f"{name}.npy") for name in ("position", "face", "target"))
steps = 5

glow = mi.Properties()
glow["emitter"] = mi.load_dict({"type": "area", "radiance": {"type": "rgb", "value": 1.0}})
mesh = mi.Mesh("mesh", len(position), len(face), props=glow)
inside = mi.traverse(mesh)
inside["vertex_positions"], inside["faces"] = np.ravel(position).astype(np.float32), np.ravel(face).astype(np.uint32)
inside.update()
scene = mi.load_dict({
    "type": "scene", "mesh": mesh,
    "sensor": {"type": "perspective", "fov": 45.0, "near_clip": 0.1, "far_clip": 100.0,
               "to_world": mi.ScalarTransform4f().look_at([0, 0, distance], [0, 0, 0], [0, 1, 0]),
               "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}, "pixel_format": "luminance",
                        "sample_border": True}}})
params = mi.traverse(scene)
place = next(k for k in params.keys() if k.endswith("vertex_positions"))
wanted = mi.TensorXf(target.reshape(size, size, 1))
# How far a vertex moves in the world as it moves a pixel.
pixel = 2 * (distance - position[:, 2:]) / (size / np.tan(np.radians(22.5))) * [[1, -1]]

for samples in counts:
    integrator = mi.load_dict({"type": "direct_projective", "sppc": 0, "sppp": samples, "sppi": 0})
    found, times = [], []
    for step in range(steps + 2):
        params[place] = mi.Float(np.ravel(position).astype(np.float32))
        dr.enable_grad(params[place])
        params.update()
        dr.sync_thread()
        begin = time.perf_counter()
        picture = mi.render(scene, params, integrator=integrator, spp=samples, seed=2 * step, seed_grad=2 * step + 1)
        dr.backward(dr.sum(dr.square(picture - wanted), axis=None))
        gradient = dr.grad(params[place])
        dr.eval(gradient)
        dr.sync_thread()
        times.append(1000 * (time.perf_counter() - begin))
        found.append(np.array(gradient, dtype=np.float64).reshape(-1, 3)[:, :2] * pixel)
    np.save(folder / f"{samples}.npy", np.stack(found[2:]))
    print(json.dumps({"samples": samples, "ms": statistics.median(times[2:]), "ms_least": min(times[2:]), "ms_most": max(times[2:])}), flush=True)
