# SPDX-License-Identifier: Apache-2.0
"""Memory shared with CUDA: what leaves and outputs of a run on an NVIDIA GPU are for torch, JAX and CuPy, and the way back."""
from __future__ import annotations

import ctypes
import sys
import warnings
from typing import TYPE_CHECKING, Any, NamedTuple

from . import _library as c
from ._arrays import TYPESTR, Type

if TYPE_CHECKING:
    import numpy as np

    from ._program import Device, Run

KDL_CUDA = 2  # DLPack's number for the kind of device


class CudaArray:
    """What a leaf or an output holds on an NVIDIA GPU, where it is.

    `torch.from_dlpack(array)`, `jax.dlpack.from_dlpack(array)` and `cupy.asarray(array)` give tensors of the same memory: they show
    what later runs make of it, and what is written to a leaf's counts in the next run. Streams of CUDA and runs wait for each
    other. To NumPy it is a copy: `numpy.asarray(array)`, and operators and methods of NumPy's arrays work on one.
    """

    def __init__(self, run: Run, name: str, step: str | None, type_: Type) -> None:
        self._run, self._name, self._step, self._type = run, name, step, type_
        try:
            self.shape: tuple[int, ...] = type_.shape(run.symbols)
        except c.BindError:  # a symbol that only the run knows, or a leaf that is not bound, which it says
            self.shape = run._copy(name, step).shape
        self.ndim = len(self.shape)

    @property
    def dtype(self) -> np.dtype[Any]:
        import numpy as np

        return np.dtype(self._type.scalar)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        array = self._run._copy(self._name, self._step)
        return array if dtype is None else array.astype(dtype)

    def _lent(self) -> tuple[c.Array, tuple[int, ...]]:
        """The memory, and the strides of its array in scalars."""
        dense, stride = c.Array(), ctypes.c_int64()
        self._run._use_stream(current_stream(self._run.device))
        name = self._name.encode()
        if self._step is None:
            done = c.library.dressi_cuda_leaf(self._run._handle, name, ctypes.byref(dense), ctypes.byref(stride))
        else:
            done = c.library.dressi_cuda_output(
                self._run._handle, self._step.encode(), name, ctypes.byref(dense), ctypes.byref(stride)
            )
        c.checked(done, c.DeviceError)
        type_ = self._type
        strides = (1, type_.rows) if type_.is_matrix else (1,) * len(type_.element_shape)
        step = stride.value
        for size in reversed(self.shape[: type_.rank]):
            strides = (step, *strides)
            step *= size
        return dense, strides

    def __dlpack_device__(self) -> tuple[int, int]:
        ordinal = self._run.device.cuda
        return (1, 0) if ordinal is None else (KDL_CUDA, ordinal)

    def __dlpack__(self, *, stream: Any = None, **_: Any) -> Any:
        ordinal = self._run.device.cuda
        if ordinal is None:
            return self.__array__().__dlpack__()
        dense, strides = self._lent()
        if stream is not None and stream != -1:
            c.checked(c.library.dressi_cuda_wait(self._run._handle, stream), c.DeviceError)
        sizes = ctypes.c_int64 * self.ndim
        tensor = c.library.dressi_dlpack(
            ctypes.byref(dense), KDL_CUDA, ordinal, self.ndim, sizes(*self.shape), sizes(*strides)
        )
        return _new_capsule(c.checked(tensor), b"dltensor", _unused)

    @property
    def __cuda_array_interface__(self) -> dict[str, Any]:
        if self._run.device.cuda is None:
            raise AttributeError("the memory is not shared with CUDA")
        dense, strides = self._lent()
        self._held = _Held(dense)  # as long as this array, which the one that is made of it holds
        return {
            "version": 3,
            "shape": self.shape,
            "strides": tuple(4 * s for s in strides),
            "typestr": TYPESTR[dense.kind],
            "data": (dense.data, False),
            "stream": current_stream(self._run.device) or 1,
        }

    def __setitem__(self, key: Any, value: Any) -> None:
        if self._step is not None:
            raise ValueError("an output is read-only: the next run makes it")
        array = self.__array__()
        array[key] = value
        self._run[self._name] = array

    def __len__(self) -> int:
        if not self.shape:
            raise TypeError("len() of an array of no dimensions")
        return self.shape[0]

    def __iter__(self) -> Any:
        return iter(self.__array__())

    def __bool__(self) -> bool:
        return bool(self.__array__())

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.__array__(), name)  # NumPy's methods, of a copy

    def __repr__(self) -> str:
        return f"dressi.CudaArray({self._name!r}, shape={self.shape}, dtype={self._type.scalar}, device={self._run.device.name!r})"

    __hash__ = None  # type: ignore[assignment]


def _operators() -> None:
    binary = "add sub mul truediv floordiv mod pow matmul and or xor lt le gt ge eq ne".split()
    binary += [f"r{name}" for name in binary[:11]]
    unary = "neg pos abs invert float int index".split()
    for name in [*binary, *unary, "getitem"]:

        def act(self: CudaArray, *others: Any, _name: str = f"__{name}__") -> Any:
            return getattr(self.__array__(), _name)(*(o.__array__() if isinstance(o, CudaArray) else o for o in others))

        setattr(CudaArray, f"__{name}__", act)


_operators()


class _Held:
    __slots__ = ("_dense",)

    def __init__(self, dense: c.Array) -> None:
        self._dense = dense

    def __del__(self, free: Any = c.library.dressi_array_free, byref: Any = ctypes.byref) -> None:
        free(byref(self._dense))


_new_capsule = ctypes.pythonapi.PyCapsule_New
_new_capsule.restype, _new_capsule.argtypes = ctypes.py_object, [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
_is_capsule = ctypes.pythonapi.PyCapsule_IsValid
_is_capsule.restype, _is_capsule.argtypes = ctypes.c_int, [ctypes.c_void_p, ctypes.c_char_p]
_capsule_pointer = ctypes.pythonapi.PyCapsule_GetPointer
_capsule_pointer.restype, _capsule_pointer.argtypes = ctypes.c_void_p, [ctypes.c_void_p, ctypes.c_char_p]


class _DlTensor(ctypes.Structure):
    """DLManagedTensor"""

    _fields_ = [
        ("data", ctypes.c_void_p),
        ("device_type", ctypes.c_int32),
        ("device_id", ctypes.c_int32),
        ("ndim", ctypes.c_int32),
        ("code", ctypes.c_uint8),
        ("bits", ctypes.c_uint8),
        ("lanes", ctypes.c_uint16),
        ("shape", ctypes.POINTER(ctypes.c_int64)),
        ("strides", ctypes.POINTER(ctypes.c_int64)),
        ("byte_offset", ctypes.c_uint64),
        ("context", ctypes.c_void_p),
        ("deleter", ctypes.CFUNCTYPE(None, ctypes.c_void_p)),
    ]


@ctypes.PYFUNCTYPE(None, ctypes.c_void_p)
def _delete_unused(capsule: int) -> None:
    """A capsule that nobody took the tensor of."""
    if _is_capsule(capsule, b"dltensor"):
        pointer = _capsule_pointer(capsule, b"dltensor")
        _DlTensor.from_address(pointer).deleter(pointer)


ctypes.pythonapi.Py_IncRef(ctypes.py_object(_delete_unused))  # capsules may outlive this module
_unused = ctypes.cast(_delete_unused, ctypes.c_void_p)


class Source(NamedTuple):
    """Somebody's array of CUDA: dense, of the shape and type of a leaf, and what keeps it."""

    address: int
    shape: tuple[int, ...]
    stream: int
    keep: Any


def current_stream(device: Device) -> int:
    """The stream that torch works on, if torch does; else the default one."""
    torch = sys.modules.get("torch")
    if torch is None or not torch.cuda.is_initialized():
        return 0
    return torch._C._cuda_getCurrentRawStream(device.cuda)


def source(value: Any, type_: Type, device: Device) -> Source | None:
    """The value as one that can be copied on the device; None where it goes over the host."""
    if type(value).__module__ == "numpy":
        return None
    if hasattr(value, "detach"):
        return _of_torch(value.detach(), type_, device) if value.is_cuda else None
    if isinstance(value, CudaArray) or not hasattr(value, "__dlpack_device__") and not hasattr(value, "__cuda_array_interface__"):
        return None
    if hasattr(value, "__dlpack_device__"):
        kind, number = value.__dlpack_device__()
        if int(kind) != KDL_CUDA or device.cuda is None or int(number) != device.cuda:
            return None
        return _of_dlpack(value, type_, current_stream(device))
    return _of_interface(value.__cuda_array_interface__, type_, current_stream(device), value)


def _of_torch(tensor: Any, type_: Type, device: Device) -> Source | None:
    import torch

    if device.cuda is None or tensor.get_device() != device.cuda:
        return None
    if type_.scalar == "float32":
        if not tensor.is_floating_point() and tensor.dtype not in (torch.int32, torch.int64, torch.uint8):
            return None
        tensor = tensor.to(torch.float32)
    elif str(tensor.dtype) != f"torch.{type_.scalar}":
        return None  # whether the numbers fit is looked at on the host
    shape = tuple(tensor.shape)
    if type_.is_matrix and tensor.ndim >= 2:
        tensor = tensor.transpose(-1, -2)
    tensor = tensor.contiguous()
    return Source(tensor.data_ptr(), shape, current_stream(device), tensor)


def _of_dlpack(value: Any, type_: Type, stream: int) -> Source | None:
    capsule = value.__dlpack__(stream=stream or 1)
    if not _is_capsule(id(capsule), b"dltensor"):
        return None
    tensor = _DlTensor.from_address(_capsule_pointer(id(capsule), b"dltensor"))
    shape = tuple(tensor.shape[k] for k in range(tensor.ndim))
    code = {0: "int", 1: "uint", 2: "float"}.get(tensor.code, "")
    dense, strides = 1, []
    for size in reversed(shape):
        strides.append(dense)
        dense *= size
    is_dense = not tensor.strides or all(
        shape[k] == 1 or tensor.strides[k] == strides[-1 - k] for k in range(tensor.ndim)
    )
    if f"{code}{tensor.bits}" != type_.scalar or tensor.lanes != 1 or not is_dense or type_.is_matrix:
        return None
    return Source(tensor.data + tensor.byte_offset, shape, stream, capsule)


def _of_interface(interface: dict[str, Any], type_: Type, stream: int, value: Any) -> Source | None:
    if interface["typestr"] != TYPESTR[type_.kind] or interface.get("strides") is not None or type_.is_matrix:
        return None
    own = interface.get("stream")
    return Source(interface["data"][0], tuple(interface["shape"]), stream if own is None else own, value)


_told: set[str] = set()


def tell_of_copy(device: Device, why: str) -> None:
    """Once for each device."""
    if device.name not in _told:
        _told.add(device.name)
        warnings.warn(f"arrays of CUDA are copied over the host to '{device.name}': {why}", RuntimeWarning, stacklevel=4)
