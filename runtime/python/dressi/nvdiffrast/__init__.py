# SPDX-License-Identifier: Apache-2.0
"""The operations of nvdiffrast (Laine et al. 2020) under their names: a program changes its import line and runs on any Vulkan
device, with the same bits every run.

    import dressi.nvdiffrast as dr

Signatures and conventions are nvdiffrast's: clip space is OpenGL's, row 0 is the bottom of a picture, face numbers count from 1.
Arguments are tensors of PyTorch, with gradients, or arrays of NumPy, without. Operations without a context run on the device of
the context that was made last (`set_device` says another). What differs: triangles are not snapped to a grid of 1/16 pixel,
so that pixels on edges may be decided otherwise; faces beyond pos, ranges beyond tri, and sizes that do not agree, are errors.
"""
from __future__ import annotations

import functools as _functools
import sys
from typing import TYPE_CHECKING, Any, Generic, Sequence, TypeVar

import numpy as _np

from .._library import Error
from .._program import Device, _device as _open
from . import _core

# Results are tensors where an argument that may have a gradient is one, else arrays.
if TYPE_CHECKING:
    import torch as _torch

    _Array = TypeVar("_Array", _np.ndarray, _torch.Tensor)
else:
    _Array = TypeVar("_Array")

__all__ = [
    "DepthPeeler",
    "RasterizeCudaContext",
    "RasterizeGLContext",
    "RasterizeVkContext",
    "antialias",
    "antialias_construct_topology_hash",
    "get_log_level",
    "interpolate",
    "rasterize",
    "set_device",
    "set_log_level",
    "texture",
    "texture_construct_mip",
]

_device: Device | str = ""
_log_level = 1


def set_device(device: Device | str | int) -> None:
    """The device of operations without a context: part of a device's name, its number, "reference", or a `dressi.Device`."""
    global _device
    _open(device)  # or says that there is none
    _device = device if isinstance(device, Device) else str(device)


def get_log_level() -> int:
    return _log_level


def set_log_level(level: int) -> None:
    """Kept for programs that set it; nothing is logged."""
    global _log_level
    _log_level = level


class RasterizeVkContext:
    """The device that rasterizes. `device` is part of its name, its number, "reference", or a `dressi.Device`; devices of PyTorch are
    taken as the first one. A `DeviceError` says where there is none."""

    def __init__(self, device: Any = None, output_db: bool = True, mode: str = "automatic") -> None:
        name = "" if device is None else str(device)
        if name in ("cpu", "cuda") or name.startswith("cuda:"):
            name = ""
        set_device(device if isinstance(device, Device) else name)
        self.device = _device
        self.output_db = output_db
        self.active_depth_peeler: DepthPeeler[Any] | None = None

    def set_context(self) -> None:
        """Kept for programs that call it, as is `release_context`."""

    def release_context(self) -> None:
        pass


class RasterizeCudaContext(RasterizeVkContext):
    def __init__(self, device: Any = None) -> None:
        super().__init__(device)


class RasterizeGLContext(RasterizeVkContext):
    def __init__(self, output_db: bool = True, mode: str = "automatic", device: Any = None) -> None:
        super().__init__(device, output_db, mode)


# ---- Between the operations and who calls them ----


def _is_tensor(value: Any) -> bool:
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(value, torch.Tensor)


def _array(value: Any) -> Any:
    return value.detach().cpu().numpy() if _is_tensor(value) else value


def _apply(operation: Any, differentiable: dict[str, Any], fixed: dict[str, Any]) -> tuple[Any, ...]:
    """Runs `operation(arrays)`, which gives results and the way back; as a node of PyTorch's graph where there are differentiable
    tensors. That one keeps the fixed ones, too, so that what was written to since is noticed."""
    if not any(_is_tensor(value) for value in differentiable.values()):
        return tuple(operation({**differentiable, **{name: _array(value) for name, value in fixed.items()}})[0])
    from ._torch import Node

    given = {**differentiable, **fixed}
    return Node.apply(operation, list(given), *given.values())


def rasterize(
    glctx: RasterizeVkContext, pos: _Array, tri: Any, resolution: Sequence[int], ranges: Any = None, grad_db: bool = True
) -> tuple[_Array, _Array]:
    """(u, v, z/w, triangle) and (du/dX, du/dY, dv/dX, dv/dY) for each pixel, [minibatch, height, width, 4] each.

    `pos` is [minibatch, vertices, 4], or [vertices, 4] with `ranges` [pictures, 2] of first triangles and counts within `tri`. Gradients of
    u and v, and with `grad_db` those of their derivatives, reach `pos`.
    """
    _check_context(glctx)
    if glctx.active_depth_peeler is not None:
        raise Error("inside a DepthPeeler its rasterize_next_layer() rasterizes")

    def operation(arrays: dict[str, Any]) -> tuple[list[Any], Any]:
        layers = _core.Layers(arrays["pos"], arrays["tri"], resolution, arrays["ranges"])
        results, back, _ = _core.rasterize(glctx.device, layers)
        return _db(glctx, results), lambda seeds: back([seeds[0], seeds[1] if grad_db and glctx.output_db else None])

    return _apply(operation, {"pos": pos}, {"tri": tri, "ranges": ranges})


def _check_context(glctx: Any) -> None:
    if not isinstance(glctx, RasterizeVkContext):
        raise Error(f"expected a RasterizeVkContext, found a {type(glctx).__name__}")


def _db(glctx: RasterizeVkContext, results: list[Any]) -> list[Any]:
    return results if glctx.output_db else [results[0], results[1][..., :0]]


class DepthPeeler(Generic[_Array]):
    """Layers of a mesh, one behind the other:

        with DepthPeeler(glctx, pos, tri, resolution) as peeler:
            for _ in range(4):
                rast, rast_db = peeler.rasterize_next_layer()
    """

    def __init__(
        self, glctx: RasterizeVkContext, pos: _Array, tri: Any, resolution: Sequence[int], ranges: Any = None, grad_db: bool = True
    ) -> None:
        _check_context(glctx)
        self.raster_ctx, self.grad_db = glctx, grad_db
        self.pos: _Array = pos
        self._tri, self._ranges, self._resolution = tri, ranges, resolution
        self._above: Any = None

    def __enter__(self) -> DepthPeeler[_Array]:
        if self.raster_ctx.active_depth_peeler is not None:
            raise Error("this context has an active DepthPeeler already")
        self.raster_ctx.active_depth_peeler = self
        self._above = None
        return self

    def __exit__(self, *_: Any) -> None:
        self.raster_ctx.active_depth_peeler = None
        self._above = None

    def rasterize_next_layer(self) -> tuple[_Array, _Array]:
        """As `rasterize`, of the surface behind those that came before."""
        if self.raster_ctx.active_depth_peeler is not self:
            raise Error("rasterize_next_layer() needs the peeler's `with` around it")
        glctx = self.raster_ctx

        def operation(arrays: dict[str, Any]) -> tuple[list[Any], Any]:
            layers = _core.Layers(arrays["pos"], arrays["tri"], self._resolution, arrays["ranges"])
            if self._above is None:
                size = (len(layers.ranges), layers.height, layers.width)
                self._above = _np.full(size, -2, _np.float32), _np.full(size, -1, _np.int32)
            results, back, depth = _core.rasterize(glctx.device, layers, self._above)
            # Behind a pixel that sees nothing there is nothing.
            face = results[0][..., 3].astype(_np.int32) - 1
            self._above = _np.where(face >= 0, depth, 2), _np.where(face >= 0, face, 2**31 - 1).astype(_np.int32)
            return _db(glctx, results), lambda seeds: back([seeds[0], seeds[1] if self.grad_db and glctx.output_db else None])

        return _apply(operation, {"pos": self.pos}, {"tri": self._tri, "ranges": self._ranges})


def interpolate(
    attr: _Array | _np.ndarray,
    rast: _Array | _np.ndarray,
    tri: Any,
    rast_db: _Array | _np.ndarray | None = None,
    diff_attrs: Sequence[int] | str | None = None,
) -> tuple[_Array, _Array]:
    """Attributes [minibatch, vertices, channels] (1 in front, or two dimensions: for all pictures) at each pixel, and for the
    channels `diff_attrs` (a list, or "all") their derivatives by X and Y, which take `rast_db`."""
    chosen = _core.channels(diff_attrs)
    given: dict[str, Any] = {"attr": attr, "rast": rast}
    if chosen:
        given["rast_db"] = rast_db

    def operation(arrays: dict[str, Any]) -> tuple[list[Any], Any]:
        return _core.interpolate(_device, arrays["attr"], arrays["rast"], arrays["tri"], arrays.get("rast_db"), chosen)

    return _apply(operation, given, {"tri": tri})


class _Mip:
    def __init__(self, levels: list[Any]) -> None:
        self.levels = levels


def texture_construct_mip(tex: Any, max_mip_level: int | None = None, cube_mode: bool = False) -> _Mip:
    """The levels beyond `tex`, for `texture(..., mip=...)`: gradients reach `tex` through them."""
    _check_dimensions(tex, cube_mode)
    return _Mip(_core.pyramid(tex, _core.max_level(max_mip_level)))


def _check_dimensions(tex: Any, cube: bool) -> None:
    if len(tex.shape) != (5 if cube else 4):
        raise Error(f"tex: expected {5 if cube else 4} dimensions, found shape {tuple(tex.shape)}")


def texture(
    tex: _Array | _np.ndarray,
    uv: _Array | _np.ndarray,
    uv_da: _Array | _np.ndarray | None = None,
    mip_level_bias: _Array | _np.ndarray | None = None,
    mip: _Mip | Sequence[_Array | _np.ndarray] | None = None,
    filter_mode: str = "auto",
    boundary_mode: str = "wrap",
    max_mip_level: int | None = None,
) -> _Array:
    """A texture [minibatch or 1, height, width, channels] (a cube: [minibatch or 1, 6, size, size, channels]) at places
    [minibatch, height, width, 2] (directions: 3).

    `filter_mode` is "nearest", "linear", "linear-mipmap-nearest", "linear-mipmap-linear" or "auto", `boundary_mode` "wrap", "clamp",
    "zero" or "cube". Levels are made of `tex`, or are those of `mip`: what `texture_construct_mip` gave, or a list of textures.
    """
    if filter_mode == "auto":
        filter_mode = "linear" if uv_da is None and mip_level_bias is None else "linear-mipmap-linear"
    for name, value, known in (("filter_mode", filter_mode, _core.FILTERS), ("boundary_mode", boundary_mode, _core.BOUNDARIES)):
        if value not in known:
            raise Error(f"{name}: expected one of {', '.join(known)}, found '{value}'")
    _check_dimensions(tex, boundary_mode == "cube")
    levels = [tex]
    if "mipmap" in filter_mode:
        if uv_da is None and mip_level_bias is None:
            raise Error(f"the filter mode '{filter_mode}' needs uv_da, mip_level_bias, or both")
        max_mip_level = _core.max_level(max_mip_level)
        stack = mip.levels if isinstance(mip, _Mip) else _core.pyramid(tex, max_mip_level) if mip is None else list(mip)
        levels += stack[:max_mip_level]
    else:
        uv_da = mip_level_bias = None
    given: dict[str, Any] = {"uv": uv, **{f"tex{k}": level for k, level in enumerate(levels)}}
    if uv_da is not None:
        given["uv_da"] = uv_da
    if mip_level_bias is not None:
        given["mip_level_bias"] = mip_level_bias

    def operation(arrays: dict[str, Any]) -> tuple[list[Any], Any]:
        textures = [arrays[f"tex{k}"] for k in range(len(levels))]
        more = arrays.get("uv_da"), arrays.get("mip_level_bias")
        return _core.texture(_device, textures, arrays["uv"], *more, filter_mode, boundary_mode)

    return _apply(operation, given, {})[0]


class _TopologyHash:
    def __init__(self, tri: Any) -> None:
        self._tri = tri

    @_functools.cached_property
    def opposite(self) -> Any:
        return _core.opposite_vertices(self._tri)

    @_functools.cached_property
    def across(self) -> Any:
        return _core.neighbours(self._tri)


def antialias_construct_topology_hash(tri: Any) -> _TopologyHash:
    """How triangles hang together, for `antialias(..., topology_hash=...)`: made once where they stay."""
    made = _TopologyHash(_np.array(_array(tri)))
    made.opposite  # what most ask for, and whether the triangles are any
    return made


def antialias(
    color: _Array | _np.ndarray,
    rast: Any,
    pos: _Array | _np.ndarray,
    tri: Any,
    topology_hash: _TopologyHash | None = None,
    pos_gradient_boost: float = 1.0,
    *,
    exact: bool = False,
    outlines: int = 64,
) -> _Array:
    """`color` [minibatch, height, width, channels] with soft edges, through which gradients reach `pos`.

    Of faces smaller than a pixel most outlines are not found, as in nvdiffrast. `exact=True` finds all: each pixel has the colours
    of both sides by the area that they cover of it, and gradients are those of the area. Of at most so many faces with `outlines` in 4 x 4
    pixels, 64 or less, that is exact, in time and memory that grow with them. No part of the mesh may lie before the near plane, and each
    picture has to show all of `tri`: one of a range of it is given that range alone, as `tri[first:first + count]`. What lies behind the first
    layer of a DepthPeeler is not for it.
    """

    def operation(arrays: dict[str, Any]) -> tuple[list[Any], Any]:
        given = (_device, arrays["color"], arrays["rast"], arrays["pos"], arrays["tri"])
        made = topology_hash
        if exact:
            return _core.antialias_exact(*given, None if made is None else made.across, outlines, pos_gradient_boost)
        return _core.antialias(*given, None if made is None else made.opposite, pos_gradient_boost)

    return _apply(operation, {"color": color, "pos": pos}, {"tri": tri, "rast": rast})[0]
