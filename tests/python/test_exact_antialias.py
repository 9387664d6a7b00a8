# SPDX-License-Identifier: Apache-2.0
"""`dressi.nvdiffrast.antialias(exact=True)`: areas against those of polygons clipped by hand, gradients against differences."""
import os

import numpy as np
import pytest

import dressi
import dressi.nvdiffrast as dr
from dressi.nvdiffrast import _core

DEVICES = ["reference"] + (["lavapipe"] if os.environ.get("DR_LAVAPIPE_ICD") else [])
SIZE = 12


def disk(count, rings=1, radius=0.6, center=(0.07, -0.04)):
    """A flat disk before the camera in clip space: `rings` rings of triangles around the middle, w = 1."""
    angle = 2 * np.pi * (np.arange(count) + 0.3) / count
    rim = np.stack([np.cos(angle), np.sin(angle)], 1)
    place = np.concatenate([[[0, 0]]] + [rim * radius * (r + 1) / rings for r in range(rings)]) + center
    faces = [(0, 1 + k, 1 + (k + 1) % count) for k in range(count)]
    for r in range(rings - 1):
        a, b = 1 + r * count, 1 + (r + 1) * count
        for k in range(count):
            n = (k + 1) % count
            faces += [(a + k, b + k, b + n), (a + k, b + n, a + n)]
    pos = np.c_[place, np.zeros(len(place)), np.ones(len(place))].astype(np.float32)
    return pos[None], np.array(faces, np.int32), (rim * radius + center + 1) / 2 * SIZE


def clipped_area(polygon, x, y):
    """How much of the pixel (x, y) a convex polygon covers, by cutting it at the pixel's sides."""
    for axis, limit, sign in ((0, x, 1), (0, x + 1, -1), (1, y, 1), (1, y + 1, -1)):
        cut = []
        for k in range(len(polygon)):
            p, q = polygon[k - 1], polygon[k]
            d, e = sign * (p[axis] - limit), sign * (q[axis] - limit)
            if (d < 0) != (e < 0):
                cut.append(p + (q - p) * d / (d - e))
            if e >= 0:
                cut.append(q)
        polygon = cut
        if len(polygon) < 3:
            return 0.0
    p = np.array(polygon)
    q = np.roll(p, -1, 0)
    return 0.5 * abs((p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum())


def drawn(device, pos, tri, resolution=(SIZE, SIZE)):
    dr.set_device(device)
    rast, _ = dr.rasterize(dr.RasterizeVkContext(device), pos, tri, resolution)
    return rast, (rast[..., 3:] > 0).astype(np.float32)


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("rings", [1, 9])  # faces of many pixels, and those smaller than one at the rim
@pytest.mark.parametrize("way", [1, -1])
def test_pixels_are_covered_by_their_area(device, rings, way):
    pos, tri, rim = disk(40 if rings > 1 else 7, rings)
    rast, color = drawn(device, pos, tri[:, ::way].copy())
    out = dr.antialias(color, rast, pos, tri[:, ::way].copy(), exact=True)
    expected = [[clipped_area(list(rim), x, y) for x in range(SIZE)] for y in range(SIZE)]
    np.testing.assert_allclose(out[0, :, :, 0], expected, atol=2e-5)


@pytest.mark.parametrize("device", DEVICES)
def test_gradients_are_those_of_the_area(device):
    pos, tri, _ = disk(30, 4)
    rast, color = drawn(device, pos, tri)
    seed = np.random.default_rng(5).normal(size=color.shape).astype(np.float32)
    _, back = _core.antialias_exact(device, color, rast, pos, tri)
    found = back([seed])["pos"]

    def value(moved):
        return float((_core.antialias_exact("reference", color, rast, moved, tri)[0][0].astype(np.float64) * seed).sum())

    for vertex, axis in ((len(pos[0]) - 3, 0), (len(pos[0]) - 3, 1), (len(pos[0]) - 14, 0)):
        high, low = pos.copy(), pos.copy()
        high[0, vertex, axis] += 1e-3
        low[0, vertex, axis] -= 1e-3
        step = float(high[0, vertex, axis]) - float(low[0, vertex, axis])
        assert found[0, vertex, axis] == pytest.approx((value(high) - value(low)) / step, rel=2e-3, abs=2e-3)
    inner = 1 + 30  # corners of the inner rings bound nothing
    assert np.abs(found[0, :inner]).max() < 1e-4 * np.abs(found).max()


@pytest.mark.parametrize("device", DEVICES)
def test_parts_before_parts_mix_their_own_colours(device):
    # A red square that covers all, and a green one before it whose side runs through the middle of column 5.
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], np.float32)
    edge = 2 * 5.25 / SIZE - 1
    near = np.array([[-1, -1], [edge, -1], [edge, 1], [-1, 1]], np.float32)
    place = np.concatenate([np.c_[square * 1.5, np.full(4, 0.5)], np.c_[near * [1, 1.5] - [0.5, 0] * (near < 0), np.zeros(4)]])
    place[4:, 0] = [-1.5, edge, edge, -1.5]
    pos = np.c_[place, np.ones(8)].astype(np.float32)[None]
    tri = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]], np.int32)
    rast, _ = drawn(device, pos, tri)
    color = np.where(rast[..., 3:] > 2, [0, 1, 0], [1, 0, 0]).astype(np.float32)
    out = dr.antialias(color, rast, pos, tri, exact=True)
    expected = color.copy()
    expected[:, :, 5] = [0.75, 0.25, 0]
    np.testing.assert_allclose(out, expected, atol=1e-5)


def test_layers_ranges_and_torch():
    torch = pytest.importorskip("torch")
    device = DEVICES[-1]
    one, tri, _ = disk(9)
    two = one + np.array([0.1, 0.05, 0, 0], np.float32)
    pos = torch.tensor(np.concatenate([one, two]), requires_grad=True)
    rast, _ = dr.rasterize(dr.RasterizeVkContext(device), pos, torch.tensor(tri), (SIZE, SIZE))
    color = (rast[..., 3:] > 0).float().repeat(1, 1, 1, 5).requires_grad_()
    out = dr.antialias(color, rast, pos, torch.tensor(tri), exact=True)
    for layer, alone in enumerate((one, two)):
        single, shown = drawn(device, alone, tri)
        expected = dr.antialias(shown, single, alone, tri, exact=True)
        np.testing.assert_array_equal(out[layer, ..., 4].detach().numpy(), expected[0, ..., 0])
    out.square().sum().backward()
    assert pos.grad.abs().sum() > 0 and color.grad.shape == color.shape
    flat = torch.tensor(one[0])  # range mode: both pictures show the same vertices
    ranges = torch.tensor([[0, len(tri)], [0, len(tri)]], dtype=torch.int32)
    rast, _ = dr.rasterize(dr.RasterizeVkContext(device), flat, torch.tensor(tri), (SIZE, SIZE), ranges=ranges)
    out = dr.antialias((rast[..., 3:] > 0).float(), rast, flat, torch.tensor(tri), exact=True)
    assert torch.equal(out[0], out[1])


def test_meshes_of_as_many_faces_need_not_hang_together_alike():
    device = DEVICES[-1]
    pos, tri, rim = disk(7)
    apart = pos[0][tri].reshape(1, -1, 4), np.arange(tri.size, dtype=np.int32).reshape(-1, 3)
    for p, t in ((pos, tri), apart, (pos, tri)):
        rast, color = drawn(device, p, t)
        made = dr.antialias_construct_topology_hash(t)
        out = dr.antialias(color, rast, p, t, topology_hash=made, exact=True)
        np.testing.assert_array_equal(out, dr.antialias(color, rast, p, t, exact=True))
        assert out.sum() == pytest.approx(sum(clipped_area(list(rim), x, y) for y in range(SIZE) for x in range(SIZE)), rel=1e-4)
    with pytest.raises(dressi.Error, match="made of other triangles"):
        dr.antialias(color, rast, pos, tri, topology_hash=dr.antialias_construct_topology_hash(tri[:3]), exact=True)


def test_too_many_outlines_are_told():
    pos, tri, _ = disk(7)
    rast, color = drawn("reference", pos, tri)
    with pytest.raises(dressi.Error, match="outlines: expected 1 to 64 faces in a tile, found 0"):
        dr.antialias(color, rast, pos, tri, exact=True, outlines=0)
