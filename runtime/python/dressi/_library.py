# SPDX-License-Identifier: Apache-2.0
"""The C interface (runtime/c/dressi.h) as ctypes: the library, its types, and its errors as exceptions.

ctypes releases the GIL during each call, and one wheel serves every version of Python.
"""
from __future__ import annotations

import ctypes
import os
import pathlib
import weakref
from typing import Any

ABI_VERSION = 1


class Error(Exception):
    """What Dressi says no to: the message is one sentence, or the diagnostics of a program."""


class CompileError(Error):
    """A program that is wrong. The text has line and caret, as `drc check` prints them."""

    def _render_traceback_(self) -> list[str]:
        return str(self).splitlines()  # notebooks show this in the place of a traceback through our own functions


class BindError(Error, ValueError):
    """Data that does not fit a leaf: its name, shape, type or device."""


class DeviceError(Error, RuntimeError):
    """No such device, no memory, a limit of the device, or the device was lost."""


class Stopped(Error):
    """The page of `Run.watch` was told to stop the run. Leaves hold what the runs so far made."""


class NotFiniteWarning(RuntimeWarning):
    """An output or a leaf that was read holds a NaN or Inf, or a pass of a step left one. Each is told of once a run."""


class InternalError(Error):
    """A mistake of Dressi itself. The message says where what reproduces it is kept."""


class Array(ctypes.Structure):
    """dressi_array"""

    _fields_ = [
        ("kind", ctypes.c_int32),
        ("components", ctypes.c_int32),
        ("width", ctypes.c_int64),
        ("height", ctypes.c_int64),
        ("layers", ctypes.c_int64),
        ("data", ctypes.c_void_p),
        ("owner", ctypes.c_void_p),
    ]


class NamedArray(ctypes.Structure):
    """dressi_named_array"""

    _fields_ = [("name", ctypes.c_char_p), ("array", Array)]


Warn = ctypes.CFUNCTYPE(None, ctypes.c_char_p, ctypes.c_void_p)  # dressi_warn

_text, _handle, _array = ctypes.c_char_p, ctypes.c_void_p, ctypes.POINTER(Array)
_pairs = ctypes.POINTER(ctypes.c_char_p)
_numbers, _named = ctypes.POINTER(ctypes.c_int64), ctypes.POINTER(NamedArray)
_functions: dict[str, tuple[Any, list[Any]]] = {
    "dressi_abi_version": (ctypes.c_int, []),
    "dressi_version": (_text, []),
    "dressi_error": (_text, []),
    "dressi_error_kind_of_last": (ctypes.c_int, []),
    "dressi_array_free": (None, [_array]),
    "dressi_devices": (_text, []),
    "dressi_device_open": (_handle, [_text, ctypes.c_int]),
    "dressi_device_free": (None, [_handle]),
    "dressi_device_info": (_text, [_handle]),
    "dressi_compile": (_handle, [_text, _text, _handle, _pairs]),
    "dressi_bundle_read": (_handle, [_text, ctypes.c_size_t]),
    "dressi_bundle_free": (None, [_handle]),
    "dressi_bundle_bytes": (ctypes.c_void_p, [_handle, ctypes.POINTER(ctypes.c_size_t)]),
    "dressi_bundle_info": (_text, [_handle]),
    "dressi_explain_gradient": (_text, [_text, _text, _pairs, _text, _text]),
    "dressi_schedule": (_text, [_handle, _text]),
    "dressi_run_open": (_handle, [_handle, _handle, _pairs]),
    "dressi_run_free": (None, [_handle]),
    "dressi_on_warning": (ctypes.c_int, [_handle, Warn, ctypes.c_void_p]),
    "dressi_bind": (ctypes.c_int, [_handle, _text, _array]),
    "dressi_bind_symbol": (ctypes.c_int, [_handle, _text, ctypes.c_int64]),
    "dressi_step": (ctypes.c_int, [_handle, _text, ctypes.c_int]),
    "dressi_set_runs": (ctypes.c_int, [_handle, _text, ctypes.c_int64]),
    "dressi_output": (ctypes.c_int, [_handle, _text, _text, _array]),
    "dressi_leaf": (ctypes.c_int, [_handle, _text, _array]),
    "dressi_leaf_view": (ctypes.c_int, [_handle, _text, _array]),
    "dressi_output_view": (ctypes.c_int, [_handle, _text, _text, _array]),
    "dressi_cuda_device": (ctypes.c_int, [_handle]),
    "dressi_cuda_stream": (ctypes.c_int, [_handle, _handle]),
    "dressi_cuda_wait": (ctypes.c_int, [_handle, _handle]),
    "dressi_cuda_leaf": (ctypes.c_int, [_handle, _text, _array, _numbers]),
    "dressi_cuda_output": (ctypes.c_int, [_handle, _text, _text, _array, _numbers]),
    "dressi_cuda_run": (ctypes.c_int, [_handle, _handle, _text, _named, ctypes.c_size_t, _named, ctypes.c_size_t]),
    "dressi_dlpack": (_handle, [_array, ctypes.c_int, ctypes.c_int, ctypes.c_int, _numbers, _numbers]),
    "dressi_watch": (_text, [_handle, ctypes.c_int]),
    "dressi_watch_end": (ctypes.c_int, [_handle]),
    "dressi_watched_step": (ctypes.c_int, [_handle, _text, ctypes.c_int, ctypes.POINTER(ctypes.c_int)]),
    "dressi_counters": (_text, [_handle, _text]),
    "dressi_timed_step": (_text, [_handle, _text]),
    "dressi_checked_step": (_text, [_handle, _text]),
}


def _load() -> ctypes.CDLL:
    name = "libdressi.so"
    own = pathlib.Path(__file__).parent / name
    path = os.environ.get("DRESSI_LIBRARY") or (str(own) if own.exists() else name)
    try:
        library = ctypes.CDLL(path)
    except OSError as error:
        raise ImportError(
            f"cannot load {path}: {error}. Install the package (pip install .), or set DRESSI_LIBRARY to {name} of a build"
        ) from error
    version = getattr(library, "dressi_abi_version", None)
    found = version() if version else "none"
    if found != ABI_VERSION:
        raise ImportError(f"{path} has version {found} of the C interface, expected {ABI_VERSION}")
    for function, (result, arguments) in _functions.items():
        entry = getattr(library, function, None)
        if entry is None:
            raise ImportError(f"{path} is older than this package: it has no function {function}")
        entry.restype, entry.argtypes = result, arguments
    return library


library = _load()

# By dressi_error_kind; a user's error is of the kind that the caller names.
_kinds = {2: DeviceError, 3: InternalError}


def checked(result: Any, mistake: type[Error] = Error) -> Any:
    """The result of a call; raises where it is NULL or 0."""
    if result:
        return result
    text = (library.dressi_error() or b"").decode(errors="replace").rstrip()
    raise _kinds.get(library.dressi_error_kind_of_last(), mistake)(text)


def freed_with(owner: Any, free: Any, handle: Any) -> None:
    """Frees a handle when its owner is gone."""
    weakref.finalize(owner, free, handle).atexit = False


def encoded(text: str, what: str, kind: type[Error] = CompileError) -> bytes:
    """As the C interface takes text, which ends at a zero byte."""
    if not isinstance(text, str):
        raise TypeError(f"expected text for {what}, found {text!r}")
    if "\0" in text:
        raise kind(f"{what} contains a zero byte")
    try:
        return text.encode()
    except UnicodeEncodeError as error:
        raise kind(f"{what} is not valid Unicode: {error}") from error


def pairs(options: list[tuple[str, str]]) -> Any:
    """Pairs of words as the C interface takes them."""
    words = [encoded(word, "an option") for pair in options for word in pair]
    return (ctypes.c_char_p * (len(words) + 1))(*words, None)
