# SPDX-License-Identifier: Apache-2.0
"""Between arrays in their natural shapes and the dense ones of the C interface.

`vec3[V]` is (V, 3), `float[W, H]` is (H, W), `vec3[W, H, N]` is (N, H, W, 3), `mat4[N]` is (N, 4, 4) with rows first.
"""
from __future__ import annotations

import ctypes
import functools
import weakref
from typing import TYPE_CHECKING, Any

from . import _library as c

if TYPE_CHECKING:
    import numpy as np

_KINDS = ["float32", "float64", "int32", "uint32", "bool"]


class Type:
    """The type and extent of a leaf or output, as the program says it."""

    def __init__(self, name: str, extent: list[str]) -> None:
        self.name = name
        self.extent = extent
        self.is_matrix = name.startswith("mat")
        digits = name[-1] if name[-1].isdigit() else "1"
        self.rows = int(digits)
        self.components = self.rows * self.rows if self.is_matrix else self.rows
        if self.is_matrix or name == "float" or name.startswith("vec"):
            self.scalar = "float32"
        else:
            self.scalar = {"i": "int32", "u": "uint32", "b": "bool"}[name[0]]
        w, h, layers = extent
        rank = 3 if layers != "1" else 2 if h != "1" else 1 if w != "1" else 0
        # Slowest first, as arrays have it.
        self.dims = [layers, h, w][3 - rank :]

    @property
    def element_shape(self) -> tuple[int, ...]:
        if self.is_matrix:
            return (self.rows, self.rows)
        return (self.rows,) if self.rows > 1 else ()

    def __str__(self) -> str:
        dims = self.dims[::-1]
        return self.name + (f"[{', '.join(dims)}]" if dims else "")

    def shape_text(self) -> str:
        words = [*self.dims, *map(str, self.element_shape)]
        return f"({words[0]},)" if len(words) == 1 else f"({', '.join(words)})"


def _as_numpy(name: str, value: Any) -> np.ndarray:
    import numpy as np

    if isinstance(value, np.ndarray) or not hasattr(value, "__dlpack__"):
        try:
            return np.asarray(value)
        except Exception as error:
            raise c.BindError(f"'{name}' cannot be read as an array: {error}") from error
    # Tensors of other libraries; gradients do not flow into what is bound.
    if hasattr(value, "detach"):
        value = value.detach()
    kind = value.__dlpack_device__()[0]
    if int(kind) not in (1, 3):  # neither the processor's memory nor pinned memory
        value = value.cpu() if hasattr(value, "cpu") else np.asarray(value)
    try:
        return np.from_dlpack(value)
    except Exception:
        return np.asarray(value)


def _converted(name: str, type_: Type, array: np.ndarray) -> np.ndarray:
    import numpy as np

    wanted = np.dtype(type_.scalar)
    if array.dtype == wanted:
        return array
    kind = array.dtype.kind
    allowed = {"float32": "fiub", "int32": "iu", "uint32": "iu", "bool": "b"}[type_.scalar]
    if kind not in allowed:
        raise c.BindError(f"'{name}' is {type_}: expected scalars of type {wanted}, found {array.dtype}")
    if wanted.kind in "iu" and array.size:
        low, high = int(array.min()), int(array.max())
        limits = np.iinfo(wanted)
        if low < limits.min or high > limits.max:
            raise c.BindError(f"'{name}' is {type_}: {low if low < limits.min else high} does not fit {wanted}")
    return array.astype(wanted)


def to_dense(name: str, type_: Type, value: Any) -> tuple[c.Array, Any]:
    """The array that the C interface takes, and what must live as long."""
    import numpy as np

    array = _converted(name, type_, _as_numpy(name, value))
    rank, element = len(type_.dims), type_.element_shape
    right = array.ndim == rank + len(element) and array.shape[rank:] == element and 0 not in array.shape
    for dim, found in zip(type_.dims, array.shape):
        right = right and (not dim.isdigit() or int(dim) == found)
    if not right:
        raise c.BindError(
            f"'{name}' is {type_}: expected an array of shape {type_.shape_text()}, found {tuple(array.shape)}"
        )
    if type_.is_matrix:
        array = np.swapaxes(array, -1, -2)
    array = np.ascontiguousarray(array)
    layers, height, width = ([1, 1, 1] + list(array.shape[:rank]))[-3:]
    dense = c.Array(_KINDS.index(type_.scalar), type_.components, width, height, layers, array.ctypes.data, None)
    return dense, array


@functools.lru_cache(maxsize=256)
def _buffer_type(size: int) -> type[ctypes.Array[ctypes.c_byte]]:
    return type("Buffer", (ctypes.c_byte * size,), {})


def from_dense(type_: Type, dense: c.Array) -> np.ndarray:
    """An array that owns what `dense` points to."""
    import numpy as np

    kind = np.dtype(_KINDS[dense.kind])
    count = dense.components * dense.width * dense.height * dense.layers
    buffer = _buffer_type(count * kind.itemsize).from_address(dense.data)
    owned = c.Array()
    ctypes.pointer(owned)[0] = dense
    weakref.finalize(buffer, c.library.dressi_array_free, ctypes.byref(owned)).atexit = False
    array = np.frombuffer(buffer, kind)
    extent = (dense.layers, dense.height, dense.width)[3 - len(type_.dims) :]
    array = array.reshape(extent + type_.element_shape)
    if type_.scalar != "float32" and dense.kind == _KINDS.index("float64"):
        array = array.astype(type_.scalar)  # the evaluator computes integers in float64
    return np.swapaxes(array, -1, -2) if type_.is_matrix else array
