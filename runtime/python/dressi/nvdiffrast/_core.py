# SPDX-License-Identifier: Apache-2.0
"""The operations on arrays of NumPy: each gives its results, and a function from their seeds to gradients by argument.

Each is a program beside this file, compiled once for a device and a set of options.
"""
from __future__ import annotations

import functools
import operator
import os
import pathlib
import threading
from typing import Any, Callable, Sequence

import numpy as np

from .._function import Function
from .._library import Error
from .._program import Device, Program, Run, compile

# Gradients of the arguments that have one, by name.
Back = Callable[[Sequence[Any]], dict[str, np.ndarray]]


@functools.lru_cache(maxsize=64)
def program(name: str, device: Device | str, *defines: tuple[str, int]) -> Program:
    return compile(pathlib.Path(__file__).with_name(f"{name}.dr"), device=device, defines=dict(defines))


@functools.lru_cache(maxsize=64)
def _function(
    name: str,
    device: Device | str,
    defines: tuple[tuple[str, int], ...],
    step: str,
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
    symbols: tuple[tuple[str, int], ...] = (),
) -> Function:
    return Function(program(name, device, *defines), step, inputs, outputs, symbols=dict(symbols))


def _check(ok: bool, words: str) -> None:
    if not ok:
        raise Error(words)


def _count(name: str, value: Any) -> int:
    try:
        return operator.index(value)
    except TypeError:
        raise Error(f"{name}: expected whole numbers, found {value!r}") from None


def _counts(name: str, values: Any) -> list[int]:
    try:
        listed = list(values)
    except TypeError:
        raise Error(f"{name}: expected a list of whole numbers, found {values!r}") from None
    return [_count(name, value) for value in listed]


def _floats(name: str, array: Any, ndims: Sequence[int], last: Sequence[int] = ()) -> np.ndarray:
    array = np.asarray(array)
    _check(array.dtype.kind == "f", f"{name}: expected a tensor of floats, found {array.dtype}")
    _check(array.ndim in ndims and 0 not in array.shape, f"{name}: expected {' or '.join(map(str, ndims))} dimensions, found shape {array.shape}")
    _check(not last or array.shape[-1] in last, f"{name}: expected a last dimension of {' or '.join(map(str, last))}, found shape {array.shape}")
    return np.ascontiguousarray(array, np.float32)


def _agree(name: str, array: Any, shape: tuple[int, ...], of: str) -> None:
    _check(array.shape == shape, f"{name}: expected shape {shape} to fit {of}, found shape {array.shape}")


def _first(name: str, count: int, pictures: int, shape: tuple[int, ...]) -> None:
    known = "1" if pictures == 1 else f"1 or {pictures}"
    _check(count in (1, pictures), f"{name}: expected {known} in the first dimension, found shape {shape}")


def _ints(name: str, array: Any) -> np.ndarray:
    array = np.asarray(array)
    _check(array.dtype.newbyteorder("=") == np.int32, f"{name}: expected a tensor of int32, found {array.dtype}")
    return np.ascontiguousarray(array, np.int32)


def _faces(tri: Any) -> np.ndarray:
    tri = _ints("tri", tri)
    _check(tri.ndim == 2 and tri.shape[1] == 3 and tri.shape[0] > 0, f"tri: expected shape [triangles, 3], found {tri.shape}")
    _check(tri.shape[0] < 1 << 24, "tri: a picture of floats counts 2^24 triangles")
    return tri


def _in_range(tri: np.ndarray, vertices: int, what: str) -> None:
    low, high = int(tri.min()), int(tri.max())
    _check(0 <= low and high < vertices, f"tri: names vertex {low if low < 0 else high}, {what} has {vertices}")


# ---- rasterize ----


class Layers:
    """A mesh and what each layer shows of it."""

    def __init__(self, pos: Any, tri: Any, resolution: Sequence[int], ranges: Any) -> None:
        self.pos = _floats("pos", pos, (2, 3), (4,))
        self.tri = _faces(tri)
        sizes = _counts("resolution", resolution)
        _check(len(sizes) == 2 and min(sizes) > 0, f"resolution: expected two positive numbers, found {tuple(sizes)}")
        self.height, self.width = sizes
        self.is_range = self.pos.ndim == 2
        if self.is_range:
            _check(ranges is not None, "pos has two dimensions, which is range mode: ranges are missing")
            self.ranges = _ints("ranges", ranges)
            shape, count = self.ranges.shape, len(self.tri)
            _check(len(shape) == 2 and shape[1] == 2 and shape[0] > 0, f"ranges: expected shape [pictures, 2], found {shape}")
            for first, length in self.ranges.tolist():
                within = 0 <= first and 0 <= length <= count - first
                _check(within, f"ranges: expected a first triangle and a count within tri's {count}, found [{first}, {length}]")
        else:
            # nvdiffrast does not look at ranges here either.
            self.ranges = np.zeros((len(self.pos), 2), np.int32)
        pixels = len(self.ranges) * self.height * self.width
        _check(pixels < 1 << 30, f"resolution: expected fewer than 2^30 pixels in all pictures, found {pixels}")
        _in_range(self.tri, self.pos.shape[-2], "pos")
        self.stack = self.pos[None] if self.is_range else self.pos
        self.stride = int(len(self.stack) > 1)


_finding = threading.Lock()  # what is bound to a finder is there until it has found


@functools.lru_cache(maxsize=16)
def _finder(device: Device | str, defines: tuple[tuple[str, int], ...], width: int, height: int, *_key: Any) -> Run:
    return program("rasterize", device, *defines).bind(symbols={"W": width, "H": height})


def rasterize(
    device: Device | str, layers: Layers, above: tuple[np.ndarray, np.ndarray] | None = None
) -> tuple[list[np.ndarray], Back, np.ndarray]:
    """(rast, rast_db), the way back to pos, and the depths. `above`: only what lies behind these depths is seen, or at them with a larger
    face number than these."""
    n, pos = len(layers.ranges), layers.stack[:, None]
    defines = (("RANGES", int(layers.is_range)), ("STRIDE", layers.stride), ("PEEL", int(above is not None)))
    # A run keeps its sizes, and is of no use to a process that was forked since.
    run = _finder(device, defines, layers.width, layers.height, pos.shape, layers.tri.shape, n, os.getpid())
    with _finding:
        run.bind(pos=pos, tri=layers.tri, range=layers.ranges[:, None, None])
        if above is not None:
            run["above"], run["above_face"] = above
        face = run.step("find")["face_"]
    return weigh(device, layers, face)


def weigh(device: Device | str, layers: Layers, face: np.ndarray) -> tuple[list[np.ndarray], Back, np.ndarray]:
    """What `rasterize` gives where pixels see these faces (-1 is none)."""
    defines = (("STRIDE", layers.stride),)
    inside = _function("rasterize", device, defines, "weigh", ("pos", "tri", "face"), ("rast", "rast_db", "depth"))
    (rast, rast_db, depth), call = inside.forward({"pos": layers.stack[:, None], "tri": layers.tri, "face": face})
    shape = layers.pos.shape

    def back(seeds: Sequence[Any]) -> dict[str, np.ndarray]:
        given = {name: _seed(s) for name, s in zip(("rast", "rast_db"), seeds) if s is not None}
        return {"pos": inside.backward(call, given)["pos"].reshape(shape)}

    return [rast, rast_db], back, depth


def _seed(array: Any) -> np.ndarray:
    return np.ascontiguousarray(array, np.float32)


# ---- interpolate ----


def channels(diff_attrs: Any) -> str | list[int] | None:
    """What `interpolate` was asked for the derivatives of, as it is now."""
    if isinstance(diff_attrs, str):
        _check(diff_attrs == "all", f'diff_attrs: expected a list of channels or "all", found {diff_attrs!r}')
        return diff_attrs
    return None if diff_attrs is None else _counts("diff_attrs", diff_attrs)


def interpolate(
    device: Device | str, attr: Any, rast: Any, tri: Any, rast_db: Any = None, diff_attrs: str | Sequence[int] | None = None
) -> tuple[list[Any], Back]:
    """[out, out_da] (out_da has no channels without `diff_attrs`) and the way back to attr, rast and rast_db."""
    attr, rast, tri = _floats("attr", attr, (2, 3)), _floats("rast", rast, (4,), (4,)), _faces(tri)
    stack = attr[None] if attr.ndim == 2 else attr
    n, h, w, _ = rast.shape
    _first("attr", len(stack), n, attr.shape)
    _in_range(tri, stack.shape[1], "attr")
    channels = stack.shape[2]
    if diff_attrs == "all":
        chosen = np.arange(channels, dtype=np.int32)
    else:
        chosen = np.asarray([] if diff_attrs is None else diff_attrs, np.int32).reshape(-1)
    _check(not len(chosen) or (chosen.min() >= 0 and chosen.max() < channels), f"diff_attrs: attr has {channels} channels, found {list(chosen)}")
    _check(not len(chosen) or rast_db is not None, "diff_attrs needs rast_db")
    arrays = {"attr": stack, "tri": tri, "rast": rast.reshape(n, h * w, 1, 4)}
    if len(chosen):
        rast_db = _floats("rast_db", rast_db, (4,), (4,))
        _agree("rast_db", rast_db, rast.shape, "rast")
        arrays["rast_db"] = rast_db.reshape(n, h * w, 1, 4)
        arrays["chosen"] = chosen
    step, outputs = ("mix_all", ("out", "out_da")) if len(chosen) else ("mix", ("out",))
    stride = int(len(stack) > 1)
    mix = _function("interpolate", device, (("STRIDE", stride),), step, tuple(arrays), outputs)
    results, call = mix.forward(arrays)
    results[0] = results[0].reshape(n, h, w, channels)
    if len(chosen):
        results[1] = results[1].reshape(n, h, w, 2 * len(chosen))

    def back(seeds: Sequence[Any]) -> dict[str, np.ndarray]:
        shapes = {"out": (n, h * w, channels), "out_da": (n, h * w, len(chosen), 2)}
        given = {name: _seed(s).reshape(shapes[name]) for name, s in zip(outputs, seeds) if s is not None}
        gradients = mix.backward(call, given)
        like = {"attr": attr.shape, "rast": rast.shape, "rast_db": rast.shape}
        return {name: gradient.reshape(like[name]) for name, gradient in gradients.items()}

    return (results if len(chosen) else [results[0], np.zeros((n, h, w, 0), np.float32)]), back


# ---- antialias ----


def opposite_vertices(tri: np.ndarray) -> np.ndarray:
    """For each face, beyond its edges 1-2, 2-0 and 0-1: the vertex of the other face there, or the corner itself."""
    tri = _faces(tri)
    count = len(tri)
    own = tri.T.reshape(-1).astype(np.int64)  # corners 0, 1, 2 of all faces: each is opposite its edge
    ends = np.stack([np.roll(tri, -1, 1).T.reshape(-1), np.roll(tri, -2, 1).T.reshape(-1)], 1)
    edges = np.sort(ends, 1)
    _, edge = np.unique(edges, axis=0, return_inverse=True)
    edge = edge.reshape(-1)
    # Of each edge the first two different vertices, in the order of faces.
    order = np.lexsort((np.tile(np.arange(count), 3), edge))
    starts = np.r_[True, edge[order][1:] != edge[order][:-1]]
    first = np.empty(edge.max() + 1, np.int64)
    first[edge[order][starts]] = own[order][starts]
    others = order[own[order] != first[edge[order]]]
    second = np.full_like(first, -1)
    _, at = np.unique(edge[others], return_index=True)
    second[edge[others][at]] = own[others][at]
    beyond = np.where(own == first[edge], second[edge], first[edge])
    return np.where(beyond >= 0, beyond, own).reshape(3, count).T.astype(np.int32).copy()


def neighbours(tri: np.ndarray) -> np.ndarray:
    """For each face, beyond its edges 0-1, 1-2 and 2-0: the other face there; -1 where there is none, or more than one."""
    tri = _faces(tri)
    edges = np.sort(np.stack([tri, np.roll(tri, -1, 1)], 2).reshape(-1, 2), 1)
    order = np.lexsort((edges[:, 1], edges[:, 0]))
    ordered = edges[order]
    starts = np.flatnonzero(np.r_[True, (ordered[1:] != ordered[:-1]).any(1)])
    first = order[starts[np.diff(np.r_[starts, len(order)]) == 2]]
    second = order[starts[np.diff(np.r_[starts, len(order)]) == 2] + 1]
    beyond = np.full(len(edges), -1, np.int32)
    beyond[first], beyond[second] = second // 3, first // 3
    return beyond.reshape(-1, 3)


def _blended(color: Any, rast: Any, pos: Any, tri: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """What `antialias` takes, checked."""
    color, rast = _floats("color", color, (4,)), _floats("rast", rast, (4,), (4,))
    pos, tri = _floats("pos", pos, (2, 3), (4,)), _faces(tri)
    _check(color.shape[:3] == rast.shape[:3], f"color and rast: expected pictures of one size, found shapes {color.shape} and {rast.shape}")
    _first("pos", 1 if pos.ndim == 2 else len(pos), len(color), pos.shape)
    _in_range(tri, pos.shape[-2], "pos")
    return color, rast, pos, tri


def antialias(
    device: Device | str, color: Any, rast: Any, pos: Any, tri: Any, opposite: np.ndarray | None = None, boost: float = 1.0
) -> tuple[list[np.ndarray], Back]:
    """[out] and the way back to color and pos."""
    color, rast, pos, tri = _blended(color, rast, pos, tri)
    n, h, w, _ = color.shape
    if opposite is None:
        opposite = opposite_vertices(tri)
    _check(opposite.shape == tri.shape, "topology_hash: it was made of other triangles")
    arrays = {"rast": rast.reshape(n, h * w, 1, 4), "opposite": opposite, "picture": np.array([w, h], np.int32)}
    return _blend("antialias", device, (), (), color, pos, tri, arrays, boost)


def antialias_exact(
    device: Device | str, color: Any, rast: Any, pos: Any, tri: Any, across: np.ndarray | None = None, outlines: int = 64, boost: float = 1.0
) -> tuple[list[np.ndarray], Back]:
    """As `antialias`, by the area that each face covers of a pixel; a tile of 4 x 4 pixels lists at most so many faces with `outlines`."""
    color, rast, pos, tri = _blended(color, rast, pos, tri)
    outlines = _count("outlines", outlines)
    _check(1 <= outlines <= 64, f"outlines: expected 1 to 64 faces in a tile, found {outlines}")
    if across is None:
        across = neighbours(tri)
    _check(across.shape == tri.shape, "topology_hash: it was made of other triangles")
    sizes = (("W", color.shape[2]), ("H", color.shape[1]))
    return _blend("exact", device, (("OUTLINES", outlines),), sizes, color, pos, tri, {"rast": rast, "across": across}, boost)


def _blend(
    name: str,
    device: Device | str,
    defines: tuple[tuple[str, int], ...],
    symbols: tuple[tuple[str, int], ...],
    color: np.ndarray,
    pos: np.ndarray,
    tri: np.ndarray,
    more: dict[str, np.ndarray],
    boost: float,
) -> tuple[list[np.ndarray], Back]:
    n, h, w, channels = color.shape
    stack = pos[None] if pos.ndim == 2 else pos
    arrays = {"color": color.reshape(n, h * w, channels), "pos": stack[:, None], "tri": tri, **more}
    options = (("STRIDE", int(len(stack) > 1)), *defines)
    blend = _function(name, device, options, "blend", tuple(arrays), ("out",), symbols)
    results, call = blend.forward(arrays)

    def back(seeds: Sequence[Any]) -> dict[str, np.ndarray]:
        gradients = blend.backward(call, {"out": _seed(seeds[0]).reshape(n, h * w, channels)})
        return {
            "color": gradients["color"].reshape(color.shape),
            "pos": gradients["pos"].reshape(pos.shape) * np.float32(boost),
        }

    return [results[0].reshape(color.shape)], back


# ---- texture ----

FILTERS = ("nearest", "linear", "linear-mipmap-nearest", "linear-mipmap-linear")
BOUNDARIES = ("wrap", "clamp", "zero", "cube")


def halved(level: Any) -> Any:
    """Half the width and height, each texel the mean of those that it stands for: arrays or tensors [..., height, width, channels]."""
    for axis in (-3, -2):
        size = level.shape[axis]
        if size == 1:
            continue
        if size % 2 != 0:
            raise Error(
                f"a texture of {level.shape[-2]} x {level.shape[-3]} cannot be halved on: give sizes that are powers of two, or max_mip_level"
            )
        even = (..., slice(0, None, 2)) + (slice(None),) * (-1 - axis)
        odd = (..., slice(1, None, 2)) + (slice(None),) * (-1 - axis)
        level = 0.5 * (level[even] + level[odd])
    return level


def halved_back(seed: np.ndarray, like: np.ndarray) -> np.ndarray:
    """The adjoint of `halved`, from the gradient of its result to that of `like`."""
    for axis in (-3, -2):
        if like.shape[axis] > 1:
            seed = 0.5 * np.repeat(seed, 2, axis)
    return seed


def max_level(value: Any) -> int | None:
    if value is None:
        return None
    level = _count("max_mip_level", value)
    _check(level >= 0, f"max_mip_level: expected 0 or more, found {level}")
    return level


def pyramid(tex: Any, max_level: int | None) -> list[Any]:
    """The levels beyond the first."""
    levels = [tex]
    while max(levels[-1].shape[-3:-1]) > 1 and (max_level is None or len(levels) <= max_level):
        levels.append(halved(levels[-1]))
    return levels[1:]


def texture(
    device: Device | str, levels: Sequence[Any], uv: Any, uv_da: Any, bias: Any, filter_mode: str, boundary_mode: str
) -> tuple[list[np.ndarray], Back]:
    """[out] and the way back to uv, uv_da, mip_level_bias and, as tex0, tex1, ..., the levels."""
    cube = boundary_mode == "cube"
    levels = [_floats("tex", level, (5,) if cube else (4,)) for level in levels]
    _check(not cube or levels[0].shape[1] == 6 and levels[0].shape[2] == levels[0].shape[3], f"tex: a cube has shape [layers, 6, size, size, channels], found {levels[0].shape}")
    uv = _floats("uv", uv, (4,), (3 if cube else 2,))
    n, h, w, _ = uv.shape
    layers, channels = levels[0].shape[0], levels[0].shape[-1]
    _first("tex", layers, n, levels[0].shape)
    table, start = [], 0
    for k, level in enumerate(levels):
        if k > 0:
            halves = (max(1, size // 2) for size in levels[k - 1].shape[-3:-1])
            _agree("mip", level, (*levels[0].shape[:-3], *halves, channels), "the level before it")
        table.append((level.shape[-2], level.shape[-3], start))
        start += level[0].size // channels
    mips = FILTERS.index(filter_mode) >= 2

    def wide(array: np.ndarray) -> np.ndarray:
        flat = array.reshape(n, h * w, 1, -1)
        return flat if flat.shape[-1] == 3 else np.concatenate([flat, np.zeros((n, h * w, 1, 1), np.float32)], -1)

    arrays = {
        "texels": np.concatenate([level.reshape(layers, -1, channels) for level in levels], 1),
        "uv": wide(uv),
        "table": np.array(table, np.int32),
    }
    if mips:
        bias = np.zeros((n, h, w), np.float32) if bias is None else _floats("mip_level_bias", bias, (3,))
        _agree("mip_level_bias", bias, (n, h, w), "uv")
        arrays["bias"] = bias.reshape(n, h * w, 1)
        if uv_da is not None:
            da = _floats("uv_da", uv_da, (4,))
            _agree("uv_da", da, (n, h, w, 2 * uv.shape[-1]), "uv")
            arrays["uv_dx"], arrays["uv_dy"] = wide(da[..., 0::2]), wide(da[..., 1::2])
    defines = (
        ("FILTER", FILTERS.index(filter_mode)),
        ("BOUNDARY", BOUNDARIES.index(boundary_mode)),
        ("STRIDE", int(layers > 1)),
        ("SLOPES", int("uv_dx" in arrays)),
    )
    sample = _function("texture", device, defines, "sample", tuple(arrays), ("out",))
    results, call = sample.forward(arrays)

    def back(seeds: Sequence[Any]) -> dict[str, np.ndarray]:
        gradients = sample.backward(call, {"out": _seed(seeds[0]).reshape(n, h * w, channels)})
        k = uv.shape[-1]
        out = {"uv": gradients["uv"].reshape(n, h, w, 3)[..., :k]}
        for index, (level, (_, _, first)) in enumerate(zip(levels, table)):
            size = level[0].size // channels
            out[f"tex{index}"] = gradients["texels"][:, first : first + size].reshape(level.shape)
        if "uv_dx" in gradients:
            pair = [gradients[name].reshape(n, h, w, 3)[..., :k] for name in ("uv_dx", "uv_dy")]
            out["uv_da"] = np.stack(pair, -1).reshape(n, h, w, 2 * k)
        if "bias" in gradients:
            out["mip_level_bias"] = gradients["bias"].reshape(n, h, w)
        return out

    return [results[0].reshape(n, h, w, channels)], back
