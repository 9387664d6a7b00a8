# SPDX-License-Identifier: Apache-2.0
"""Dressi: a compiler for differentiable rendering, from Python.

    import dressi, numpy as np
    program = dressi.compile("fit.dr", device="lavapipe")
    run = program.bind(position=v, face=f, target=images)
    out = run.step("fit", times=100, progress=True)
    print(out["error"], run["position"].shape)

Arrays have their natural shapes: `vec3[V]` is (V, 3), `vec3[W, H, N]` is (N, H, W, 3), `mat4[N]` is (N, 4, 4), rows first.
"""
from ._cuda import CudaArray
from ._library import BindError, CompileError, DeviceError, Error, InternalError, NotFiniteWarning, Stopped, library as _c
from ._program import Device, Program, Run, Watch, compile, devices, load, reference
from ._show import Counters, GradientExplanation, NotFinite, Picture, Schedule, Timing

__version__: str = _c.dressi_version().decode()
__all__ = [
    "BindError",
    "CompileError",
    "Counters",
    "CudaArray",
    "Device",
    "DeviceError",
    "Error",
    "GradientExplanation",
    "InternalError",
    "NotFinite",
    "NotFiniteWarning",
    "Picture",
    "Program",
    "Run",
    "Schedule",
    "Stopped",
    "Timing",
    "Watch",
    "compile",
    "devices",
    "load",
    "reference",
]
