# SPDX-License-Identifier: Apache-2.0
"""clock.py ZIP OBJ SIDE OUT: what docs/examples/shape_from_photos.dr binds, from the 100 pictures of rendered_clock.zip: photos in linear light, masks,
cameras, and the mesh of OBJ stretched to the box that the outlines of the photos to fit leave. Photos to fit are 0, 6 .. 90, the others 3, 11 .. 99."""
import io
import json
import sys
import zipfile

import numpy as np
from PIL import Image

GRID = 64           # places to a side of the block that outlines are cut from
BLOCK = 60.0        # half its side, in the set's units
UNIT = 30.0         # the set's units to one of the program's
NEAR, FAR = 0.1, 100.0


def photo(archive, index, side):
    """Linear colours, the part of each pixel that the thing covers, the matrix from the world to the camera, focal length over half the width."""
    read = lambda name: archive.read(f"rendered_clock/{index}_{name}")
    about = json.loads(read("metadata.json"))
    srgb = np.asarray(Image.open(io.BytesIO(read("rgb.png"))).convert("RGB"), np.float64) / 255
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    mask = (np.load(io.BytesIO(read("semantic.npy")))[..., 0] == 1).astype(np.float64)
    fine = len(mask) // side
    shrunk = lambda picture: picture.reshape(side, fine, side, fine, -1).mean((1, 3))
    camera = about["camera_properties"]
    world_to_camera = np.array(camera["tf_mat"]).T
    return shrunk(linear * mask[..., None]), shrunk(mask), world_to_camera, 2 * camera["focal_length"] / camera["horizontal_aperture"]


def clip_from_camera(focal):
    deep = FAR / (FAR - NEAR)
    return np.array([[focal, 0, 0, 0], [0, -focal, 0, 0], [0, 0, -deep, -deep * NEAR], [0, 0, -1, 0]])


def hull(photos, centre):
    """The middles of the block's places that all photos have inside of their outlines; a place outside of a photo is not judged by it."""
    line = (np.arange(GRID) + 0.5) / GRID * 2 - 1
    place = np.stack(np.meshgrid(line, line, line, indexing="ij"), -1).reshape(-1, 3) * BLOCK + centre
    keep = np.ones(len(place), bool)
    for _, mask, world_to_camera, focal in photos:
        side = len(mask)
        clip = np.c_[place, np.ones(len(place))] @ (np.diag([focal, -focal, 1, 1]) @ world_to_camera).T
        pixel = np.floor((clip[:, :2] / -clip[:, 2:3] + 1) / 2 * side).astype(int)
        shown = ((pixel >= 0) & (pixel < side)).all(1) & (clip[:, 2] < 0)
        keep[shown] &= mask[pixel[shown, 1], pixel[shown, 0], 0] > 0.5
    return place[keep]


def main(source, mesh, side, out):
    archive = zipfile.ZipFile(source)
    place = np.array(json.loads(archive.read("rendered_clock/0_metadata.json"))["asset_transforms"][0][1])[3, :3]
    sets = {"": range(0, 96, 6), "new_": range(3, 100, 8)}
    photos = {prefix: [photo(archive, index, side) for index in indices] for prefix, indices in sets.items()}
    left = hull(photos[""], place)
    low, high = np.percentile(left, 2, axis=0), np.percentile(left, 98, axis=0)
    middle = (low + high) / 2
    world = np.eye(4)
    world[:3, :3] *= UNIT
    world[:3, 3] = middle
    ball = np.array([line.split()[1:4] for line in open(mesh) if line.startswith("v ")], np.float64)
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    save = lambda name, values: np.save(f"{out}/{name}.npy", np.asarray(values, np.float32))
    save("start", ball * (high - low) / 2 / UNIT)
    for prefix, taken in photos.items():
        save(prefix + "photo", [colour for colour, _, _, _ in taken])
        save(prefix + "mask", [mask[..., 0] for _, mask, _, _ in taken])
        # The camera's space in the program's units too: near and far planes are of those.
        view = [clip_from_camera(focal) @ np.diag([1 / UNIT, 1 / UNIT, 1 / UNIT, 1]) @ camera @ world for _, _, camera, focal in taken]
        save(prefix + "view", [[[matrix.T.reshape(16)]] for matrix in view])


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]), sys.argv[4])
