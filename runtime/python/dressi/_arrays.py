# SPDX-License-Identifier: Apache-2.0
"""Between arrays in their natural shapes and the dense ones of the C interface.

`vec3[V]` is (V, 3), `float[W, H]` is (H, W), `vec3[W, H, N]` is (N, H, W, 3), `mat4[N]` is (N, 4, 4) with rows first
(`mat2x3[N]`, of 2 columns, is (N, 3, 2)).
"""
from __future__ import annotations

import ctypes
import re
from typing import TYPE_CHECKING, Any, Mapping, Sequence

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
        digits = re.findall(r"\d", name) or ["1"]
        self.rows = int(digits[-1])  # mat2x3 has 2 columns of 3 rows
        self.columns = int(digits[0]) if self.is_matrix else 1
        self.components = self.rows * self.columns
        if self.is_matrix or name == "float" or name.startswith("vec"):
            self.scalar = "float32"
        else:
            self.scalar = {"i": "int32", "u": "uint32", "b": "bool"}[name[0]]
        self.kind = _KINDS.index(self.scalar)
        w, h, layers = extent
        rank = 3 if layers != "1" else 2 if h != "1" else 1 if w != "1" else 0
        # Slowest first, as arrays have it.
        self.dims = [layers, h, w][3 - rank :]
        self.rank = rank
        # Those that are known, by axis.
        self.known = [(axis, int(dim)) for axis, dim in enumerate(self.dims) if dim.isdigit()]
        self.element_shape: tuple[int, ...] = (
            (self.rows, self.columns) if self.is_matrix else (self.rows,) if self.rows > 1 else ()
        )
        self.ndim = rank + len(self.element_shape)

    def __str__(self) -> str:
        dims = self.dims[::-1]
        return self.name + (f"[{', '.join(dims)}]" if dims else "")

    def shape_text(self) -> str:
        words = [*self.dims, *map(str, self.element_shape)]
        return f"({words[0]},)" if len(words) == 1 else f"({', '.join(words)})"

    def fits(self, shape: Sequence[int]) -> bool:
        """Whether an array of this shape may hold it, as far as that is known without the values of symbols."""
        return (
            len(shape) == self.ndim
            and shape[self.rank :] == self.element_shape
            and 0 not in shape
            and all(shape[axis] == size for axis, size in self.known)
        )

    def shape(self, symbols: Mapping[str, Any]) -> tuple[Any, ...]:
        """The shape of an array that holds it where symbols have these values."""
        return tuple(_evaluate(dim, symbols) for dim in self.dims) + self.element_shape

    def symbols_of(self, shape: Sequence[Any]) -> dict[str, Any]:
        """The values that an array of this shape gives symbols that are extents of their own."""
        return {dim: size for dim, size in zip(self.dims, shape) if dim.isidentifier()}

    def dense(self, shape: tuple[int, ...], address: int, kind: int | None = None) -> c.Array:
        """As the C interface has an array of this shape there."""
        layers, height, width = (1,) * (3 - self.rank) + shape[: self.rank]
        return c.Array(self.kind if kind is None else kind, self.components, width, height, layers, address, None)


def _evaluate(dim: str, symbols: Mapping[str, Any]) -> Any:
    if not re.fullmatch(r"[\w\s()+*/-]+", dim):
        raise c.Error(f"cannot read the extent '{dim}'")
    missing = [name for name in re.findall(r"[A-Za-z_]\w*", dim) if name not in symbols]
    if missing:
        has, them = ("has", "it") if len(missing) == 1 else ("have", "them")
        raise c.BindError(f"{' and '.join(missing)} {has} no value yet: bind a leaf that has {them}, or give a shape")
    # Division rounds down in both; names are those of symbols alone, which may be words of Python's.
    text = re.sub(r"[A-Za-z_]\w*", r"of_\g<0>", dim).replace("/", "//")
    return eval(text, {"__builtins__": {}}, {f"of_{name}": size for name, size in symbols.items()})


def as_numpy(name: str, value: Any) -> np.ndarray:
    """The value as an array, without a copy where it is one of the host's memory."""
    import numpy as np

    if type(value) is np.ndarray:
        return value
    if isinstance(value, np.ma.MaskedArray) and np.ma.is_masked(value):
        raise c.BindError(f"'{name}' is a masked array, and has no values under its mask: give value.filled(...)")
    if hasattr(value, "detach"):
        return _of_torch(name, value)
    if hasattr(value, "__cuda_array_interface__"):
        for to_host in ("get", "copy_to_host"):  # CuPy's and Numba's
            if hasattr(value, to_host):
                return np.asarray(getattr(value, to_host)())
        if hasattr(value, "__array__"):  # a CudaArray of another run
            return np.asarray(value)
        raise c.BindError(
            f"'{name}' lives on a GPU, and a {type(value).__name__} has no way to the host: copy it there first"
        )
    if hasattr(value, "__dlpack_device__") and not isinstance(value, np.ndarray):
        if int(value.__dlpack_device__()[0]) not in (1, 3):  # neither the processor's memory nor pinned memory
            return np.asarray(value)
        try:
            return np.from_dlpack(value)
        except Exception:
            return np.asarray(value)
    try:
        return np.asarray(value)
    except Exception as error:
        raise c.BindError(f"'{name}' cannot be read as an array: {error}") from error


def _of_torch(name: str, tensor: Any) -> np.ndarray:
    """Gradients do not flow into what is bound."""
    tensor = tensor.detach()
    try:
        return tensor.cpu().numpy()  # the tensor itself where it is there
    except Exception:
        try:
            plain = tensor.resolve_conj().resolve_neg()
            return (plain.float() if str(plain.dtype) == "torch.bfloat16" else plain).cpu().numpy()
        except Exception as error:
            raise c.BindError(f"'{name}' cannot be read as an array: {error}") from error


def _converted(name: str, type_: Type, array: np.ndarray, typestr: str) -> np.ndarray:
    import numpy as np

    wanted = np.dtype(typestr)
    kind = array.dtype.kind
    allowed = {"float32": "fiub", "int32": "iu", "uint32": "iu", "bool": "b"}[type_.scalar]
    if kind not in allowed:
        raise c.BindError(f"'{name}' is {type_}: expected scalars of type {type_.scalar}, found {array.dtype}")
    if wanted.kind in "iu" and array.size:
        low, high = int(array.min()), int(array.max())
        limits = np.iinfo(wanted)
        if low < limits.min or high > limits.max:
            raise c.BindError(f"'{name}' is {type_}: {low if low < limits.min else high} does not fit {wanted}")
    with np.errstate(over="ignore"):
        converted = array.astype(wanted)
    if kind == "f" and array.dtype.itemsize > 4 and not np.array_equal(np.isinf(converted), np.isinf(array)):
        largest = float(np.abs(array[np.isfinite(array)]).max())
        raise c.BindError(f"'{name}' is {type_}: {largest:g} does not fit {wanted}")
    return converted


def to_dense(name: str, type_: Type, value: Any, exact: bool = False) -> tuple[c.Array, Any]:
    """The array that the C interface takes, and what must live as long. `exact`: floats are float64."""
    array = as_numpy(name, value)
    kind = type_.kind
    if array.dtype.str != TYPESTR[kind]:  # the name would not tell the order of bytes
        if exact and kind == 0:
            kind = 1
        if array.dtype.str != TYPESTR[kind]:
            array = _converted(name, type_, array, TYPESTR[kind])
    shape = array.shape
    if not type_.fits(shape):
        raise c.BindError(f"'{name}' is {type_}: expected an array of shape {type_.shape_text()}, found {tuple(shape)}")
    if type_.is_matrix:
        array = array.swapaxes(-1, -2)
    if not array.flags.c_contiguous or not array.flags.aligned:
        array = array.copy()
    return type_.dense(shape, array.__array_interface__["data"][0], kind), array


class _Memory:
    """Memory that an array of NumPy shows: given back when no array does any more."""

    __slots__ = ("_owned", "__array_interface__")

    def __init__(self, owned: c.Array, interface: dict[str, Any]) -> None:
        self._owned = owned
        self.__array_interface__ = interface

    def __del__(self, free: Any = c.library.dressi_array_free, byref: Any = ctypes.byref) -> None:
        free(byref(self._owned))


TYPESTR = ["<f4", "<f8", "<i4", "<u4", "|b1"]


def from_dense(type_: Type, dense: c.Array, writable: bool = True) -> np.ndarray:
    """An array that shows what `dense` points to, and gives it back in the end."""
    import numpy as np

    extent = (dense.layers, dense.height, dense.width)[3 - type_.rank :]
    element = type_.element_shape[::-1] if type_.is_matrix else type_.element_shape  # column by column
    interface = {
        "version": 3,
        "data": (dense.data, not writable),
        "shape": extent + element,
        "typestr": TYPESTR[dense.kind],
    }
    array = np.asarray(_Memory(dense, interface))
    if dense.kind == 1 and type_.scalar != "float32":
        array = array.astype(type_.scalar)  # the evaluator computes integers in float64
        array.flags.writeable = writable
    return array.swapaxes(-1, -2) if type_.is_matrix else array
