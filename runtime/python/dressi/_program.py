# SPDX-License-Identifier: Apache-2.0
"""Programs, devices and runs."""
from __future__ import annotations

import ctypes
import functools
import json
import operator
import os
import pathlib
import sys
import time
import warnings
import weakref
from typing import TYPE_CHECKING, Any, Mapping, Sequence, SupportsIndex, TypedDict

from . import _library as c
from ._arrays import Type, from_dense, to_dense
from ._cuda import CudaArray, current_stream, source, tell_of_copy
from ._show import Counters, GradientExplanation, NotFinite, Schedule, Timing, table

if TYPE_CHECKING:
    import numpy as np

_VIEW = 1  # of dressi_leaf_view
_STOPPED = 2  # of dressi_watched_step


class DeviceInfo(TypedDict, total=False):
    """What is known of a device. The evaluator has no version, no driver and no memory to share."""

    name: str
    kind: str
    profile: str
    api_version: str
    driver: str
    shares_memory: bool  # with CUDA


class Device:
    """A Vulkan device, by a part of its name or its number, or the float64 evaluator ("reference"), which needs none."""

    def __init__(self, name: str | int = "", *, validation: bool = False) -> None:
        self._handle = c.checked(c.library.dressi_device_open(c.encoded(str(name), "the name of a device", c.DeviceError), validation), c.DeviceError)
        c.freed_with(self, c.library.dressi_device_free, self._handle)
        self.info: DeviceInfo = json.loads(c.library.dressi_device_info(self._handle))

    @property
    def name(self) -> str:
        return self.info["name"]

    @functools.cached_property
    def cuda(self) -> int | None:
        """The number that CUDA has for it, where they share memory. Otherwise None; on an NVIDIA GPU a warning says why."""
        if not self.info.get("shares_memory"):
            return None
        try:
            return c.checked(c.library.dressi_cuda_device(self._handle)) - 1
        except c.Error as error:
            tell_of_copy(self, str(error))
            return None

    def __repr__(self) -> str:
        return f"dressi.Device({self.name!r})"

    def __reduce__(self) -> Any:
        raise TypeError("a device cannot be pickled; open it again in the other process by its name")


def devices() -> list[dict[str, str]]:
    """The Vulkan devices of this machine: name, kind, api_version, driver."""
    return json.loads(c.checked(c.library.dressi_devices(), c.DeviceError))


@functools.lru_cache(maxsize=None)
def _open_by_name(name: str, process: int) -> Device:
    return Device(name)


def _device(device: Device | str | int | None) -> Device:
    if isinstance(device, Device):
        return device
    return _open_by_name("" if device is None else str(device), os.getpid())


class Program:
    """A compiled program. `compile` makes one; `bind` gives it data."""

    def __init__(
        self,
        bundle: bytes,
        device: Device | str | int | None = None,
        _handle: int | None = None,
        _source: tuple[str, str, list[tuple[str, str]], str] | None = None,
    ) -> None:
        self._handle = _handle or c.checked(c.library.dressi_bundle_read(bundle, len(bundle)), c.Error)
        c.freed_with(self, c.library.dressi_bundle_free, self._handle)
        self._device = device
        self._source = _source  # name, text, options, and the folder that relative paths are of; none of a bundle
        info = json.loads(c.library.dressi_bundle_info(self._handle))
        self._leaves = info.get("leaves") or []
        self._steps = {step["name"]: step for step in info.get("steps") or []}
        self.leaf_types: dict[str, Type] = {leaf["name"]: Type(leaf["type"], leaf["extent"]) for leaf in self._leaves}
        self._from_host = {leaf["name"] for leaf in self._leaves if leaf["from_host"]}
        self.output_types: dict[str, dict[str, Type]] = {
            name: {out["name"]: Type(out["type"], out["extent"]) for out in step["outputs"]}
            for name, step in self._steps.items()
        }

    @property
    def steps(self) -> list[str]:
        """The names of its steps, in the order written."""
        return list(self._steps)

    @property
    def leaves(self) -> dict[str, str]:
        """Each leaf with its type: {"position": "vec3[V]"}."""
        return {name: str(type_) for name, type_ in self.leaf_types.items()}

    def outputs(self, step: str) -> dict[str, str]:
        """Each output of a step with its type."""
        return {name: str(type_) for name, type_ in self.output_types[self._step(step)].items()}

    @property
    def bundle(self) -> bytes:
        """The bytes that `drun` and `dressi.load` take."""
        size = ctypes.c_size_t()
        data = c.library.dressi_bundle_bytes(self._handle, ctypes.byref(size))
        return ctypes.string_at(data, size.value)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the bundle, whole or not at all."""
        target = pathlib.Path(path)
        part = target.with_name(f"{target.name}.{os.getpid()}.tmp")
        try:
            part.write_bytes(self.bundle)
            os.replace(part, target)
        finally:
            part.unlink(missing_ok=True)

    def on(self, device: Device | str | int | None) -> Program:
        """The same program for runs on another device."""
        return Program(self.bundle, device, None, self._source)

    def with_adjoint(self, step: str | None, inputs: Sequence[str], outputs: Sequence[str]) -> Program:
        """The program with one step more, `STEP.adjoint`: its outputs, named as the leaves `inputs`, are the gradients of the sum
        over the step's `outputs`, each times a leaf `STEP.adjoint.OUTPUT` of its type and extent. It counts its own runs: where the step
        looks at `step_index`, `Run.set_runs` gives its adjoint that of the run whose gradient it is to be."""
        inputs, outputs = ([names] if isinstance(names, str) else names for names in (inputs, outputs))
        name, text, options = self._text("differentiate")
        adjoint = f"{self._step(step)}:{','.join(inputs)}:{','.join(outputs)}"
        return _compiled(name, text, [*options, ("adjoint", adjoint)], self._device)

    def explain_grad(self, loss: str, leaf: str) -> GradientExplanation:
        """Why the gradient of an output or `let` with respect to a leaf or `let` is what it is: along which values it flows, and
        where it is cut. No number is computed."""
        name, text, options = self._text("explain")
        names = c.encoded(loss, "the name of a loss", c.Error), c.encoded(leaf, "the name of a leaf", c.Error)
        answer = c.library.dressi_explain_gradient(name.encode(), text.encode(), c.pairs(options), *names)
        return GradientExplanation(json.loads(c.checked(answer)))

    def schedule(self, step: str | None = None) -> Schedule:
        """The commands of a step, with what each reads and writes. Notebooks show them as a picture."""
        step = self._step(step)
        return Schedule(step, json.loads(c.checked(c.library.dressi_schedule(self._handle, step.encode()))))

    def bind(self, arrays: Mapping[str, Any] | None = None, /, *, symbols: Mapping[str, SupportsIndex] | None = None, **more: Any) -> Run:
        """A run with these leaves bound: `program.bind(position=v, face=f)`, or a dict for names that are no words of Python."""
        return Run(self, _device(self._device)).bind({**(arrays or {}), **more}, symbols=symbols)

    def __repr__(self) -> str:
        return f"dressi.Program(steps={self.steps}, leaves={self.leaves})"

    def _repr_html_(self) -> str:
        leaves = [(leaf["kind"], leaf["name"], str(self.leaf_types[leaf["name"]])) for leaf in self._leaves]
        outputs = [(f"output of {step}", *pair) for step in self._steps for pair in self.outputs(step).items()]
        return table(("", "name", "type"), leaves + outputs)

    def __reduce__(self) -> Any:
        device = self._device.name if isinstance(self._device, Device) else self._device
        return Program, (self.bundle, device, None, self._source)

    def _text(self, what: str) -> tuple[str, str, list[tuple[str, str]]]:
        """What to compile again, with the modules that it was compiled with, also when this process has moved to another folder."""
        if self._source is None:
            raise c.Error(f"a bundle holds no program text to {what}: compile the program from its text")
        name, text, options, folder = self._source
        if folder != _folder():
            name = os.path.join(folder, name)
            options = [(key, os.path.join(folder, value) if key == "include" else value) for key, value in options]
        return name, text, options

    def _step(self, name: str | None) -> str:
        if name is None:
            if len(self._steps) == 1:
                return next(iter(self._steps))
            raise c.Error(f"the program has several steps, name one of {', '.join(self._steps)}")
        if name not in self._steps:
            raise c.Error(f"the program has no step '{name}'; there are {', '.join(self._steps)}")
        return name

    def _output_type(self, step: str, name: str) -> Type:
        types = self.output_types[step]
        if name not in types:
            raise c.Error(f"the step '{step}' has no output '{name}'; there are {', '.join(types)}")
        return types[name]

    def _leaf_type(self, name: str) -> Type:
        types = self.leaf_types
        if name not in types:
            if not isinstance(name, str):
                raise TypeError(f"a leaf is named by text, such as '{next(iter(types), 'position')}', found {name!r}")
            import difflib

            nearest = difflib.get_close_matches(name, types, 1)
            hint = f", did you mean '{nearest[0]}'?" if nearest else f"; there are {', '.join(types)}"
            raise c.BindError(f"the program has no leaf '{name}'{hint}")
        return types[name]


class Run:
    """A program with data on a device. `step` runs it, `run["leaf"]` reads a leaf, `run["leaf"] = x` binds one."""

    def __init__(self, program: Program, device: Device, *, store_all: bool = False) -> None:
        self.program = program
        self.device = device
        self._shares = bool(device.info.get("shares_memory"))
        self._stream: int | None = None  # of CUDA, once it has seen memory of the run
        options = c.pairs([("store_all", "on" if store_all else "off"), ("share", "on" if self._shares else "off")])
        self._handle = c.checked(c.library.dressi_run_open(device._handle, program._handle, options), c.DeviceError)
        c.freed_with(self, c.library.dressi_run_free, self._handle)
        self.symbols: dict[str, int] = {}  # those that have values
        self._known: set[str] = set()  # leaves that gave theirs
        self._exact = device.name == "reference"  # it computes in float64
        self._watch: Watch | None = None
        self._words: list[str] = []  # of warnings that are not told yet
        said = self._words.append
        self._warn = c.Warn(lambda text, _: said(text.decode(errors="replace")))  # lives as long as the run
        c.library.dressi_on_warning(self._handle, self._warn, None)

    def _tell(self) -> None:
        hint = "" if self._exact else ": Run.check_finite says where it begins"  # the evaluator has no commands to look behind
        words = []
        while self._words:
            words.append(self._words.pop(0))
        for k, text in enumerate(words):
            try:
                warnings.warn(text + hint, c.NotFiniteWarning, stacklevel=3)
            except c.NotFiniteWarning:  # warnings are errors: one tells all, so that none is left for a later run
                raise c.NotFiniteWarning("\n".join(words[k:]) + hint) from None

    def bind(self, arrays: Mapping[str, Any] | None = None, /, *, symbols: Mapping[str, SupportsIndex] | None = None, **more: Any) -> Run:
        """Gives leaves their data, which is copied, and symbols that no leaf determines their values. Returns the run."""
        if symbols is not None and not isinstance(symbols, Mapping):
            raise TypeError(f"symbols: expected a dict of names and counts, found {symbols!r}; a leaf of that name goes into a dict: bind({{'symbols': …}})")
        for symbol, value in (symbols or {}).items():
            if not isinstance(symbol, str):
                raise c.BindError(f"expected the name of a symbol, found {symbol!r}")
            count = _whole(f"symbol '{symbol}'", value)
            c.checked(c.library.dressi_bind_symbol(self._handle, c.encoded(symbol, "the name of a symbol", c.BindError), count), c.BindError)
            self.symbols[symbol] = count
        for name, value in {**(arrays or {}), **more}.items():
            self._bind(name, value)
        return self

    def _bind(self, name: str, value: Any) -> None:
        type_ = self.program._leaf_type(name)
        if self._shares and name not in self.program._from_host and self._bind_on_device(name, type_, value):
            return
        dense, keep = to_dense(name, type_, value, self._exact)
        if not c.library.dressi_bind(self._handle, name.encode(), ctypes.byref(dense)):
            c.checked(0, c.BindError)
        if name not in self._known:
            self._known.add(name)
            self.symbols.update(type_.symbols_of(keep.shape))
        del keep

    def _bind_on_device(self, name: str, type_: Type, value: Any) -> bool:
        """Whether it is an array of CUDA that could be copied there, in the order of its stream."""
        found = source(value, type_, self.device)
        if found is None:
            return False
        if not type_.fits(found.shape):
            raise c.BindError(f"'{name}' is {type_}: expected an array of shape {type_.shape_text()}, found {found.shape}")
        given = c.NamedArray(name.encode(), type_.dense(found.shape, found.address))
        self._stream = found.stream
        if not c.library.dressi_cuda_run(self._handle, found.stream, None, ctypes.byref(given), 1, None, 0):
            c.checked(0, c.BindError)
        if name not in self._known:
            self._known.add(name)
            self.symbols.update(type_.symbols_of(found.shape))
        return True

    def _use_stream(self, stream: int) -> None:
        if stream != self._stream:
            c.checked(c.library.dressi_cuda_stream(self._handle, stream), c.DeviceError)
            self._stream = stream

    def empty(self, leaf: str, shape: Sequence[SupportsIndex] | None = None) -> Any:
        """Memory of Dressi for a leaf, to be written to: zeros of that shape, or of the one that is known. What is written to it is
        what the leaf holds, without a copy: on a processor it is an array of NumPy, on an NVIDIA GPU one for CUDA."""
        import numpy as np

        type_ = self.program._leaf_type(leaf)
        if shape is None:
            sizes = type_.shape({**self._edges(type_), **self.symbols})
        else:
            sizes = tuple(_whole("shape", size) for size in shape)
        if any(size < 1 for size in sizes):
            raise c.BindError(f"'{leaf}' is {type_}: expected an array of shape {type_.shape_text()}, found {sizes}")
        self[leaf] = np.zeros(sizes, type_.scalar)
        return self[leaf]

    def _edges(self, type_: Type) -> dict[str, int]:
        """The symbols of its extent that count the edges of faces that are bound, such as `face_edges`: steps give them values."""
        import numpy as np

        found = {}
        for name in self._known:
            symbol = f"{name.replace('.', '_')}_edges"
            if self.program.leaf_types[name].name == "ivec3" and any(symbol in dim for dim in type_.dims):
                face = np.reshape(self._leaf(name), (-1, 3))
                sides = np.sort(np.stack([face, np.roll(face, -1, 1)], 2).reshape(-1, 2), 1)
                found[symbol] = max(1, len(np.unique(sides[sides[:, 0] < sides[:, 1]], axis=0)))
        return found

    def step(
        self, name: str | None = None, times: SupportsIndex = 1, *, outputs: Sequence[str] | None = None, progress: bool = False
    ) -> dict[str, np.ndarray]:
        """Runs a step `times` times and returns its outputs as arrays: all, or those that `outputs` names.

        Ctrl-C ends it between two runs of the step; leaves then hold what those runs made. `progress` writes a line to
        stderr now and then, with the outputs that are one number.
        """
        name = self.program._step(name)
        times = _whole("times", times)
        if times < 1:
            raise c.Error(f"expected at least one run of a step, found {times}")
        if self._stream is not None:
            self._use_stream(current_stream(self.device))
        types = self.program.output_types[name]
        if outputs is not None:
            outputs = [outputs] if isinstance(outputs, str) else list(outputs)
        for wanted in outputs or ():
            if wanted not in types:
                self.program._output_type(name, wanted)
        if times == 1 and not progress and self._watch is None:
            if not c.library.dressi_step(self._handle, name.encode(), 1):
                c.checked(0)
        else:
            self._run_many(name, times, progress)
        results = {wanted: self._fetch(name, wanted) for wanted in (types if outputs is None else outputs)}
        self._tell()
        return results

    def _run_many(self, name: str, times: int, progress: bool) -> None:
        done, chunk, shown = 0, 1, time.monotonic()
        while done < times:
            start = time.monotonic()
            count = min(chunk, times - done)
            if self._watch is None:
                c.checked(c.library.dressi_step(self._handle, name.encode(), count), c.Error)
            else:
                count = self._watched_step(name, count)
            done += count
            self._tell()  # where warnings are errors, the run stops here
            now = time.monotonic()
            if now - start < 0.05:
                chunk *= 2  # so that Ctrl-C is heard soon, and short steps are not held up
            elif now - start > 0.2:
                chunk = max(1, chunk // 2)
            if progress and count and (now - shown > 0.5 or done == times):
                shown = now
                self._show_progress(name, done, times)

    def _watched_step(self, name: str, count: int) -> int:
        """As many runs as the page of `watch` wants now."""
        made = ctypes.c_int()
        answer = c.checked(c.library.dressi_watched_step(self._handle, name.encode(), count, ctypes.byref(made)))
        if answer == _STOPPED:
            assert self._watch is not None
            self._watch.close()
            raise c.Stopped("the page of watch() was told to stop the run")
        return made.value

    def watch(self, port: SupportsIndex = 0) -> Watch:
        """Serves a page about this run on the loopback address, at `port` or any that is free: numbers that steps give as curves,
        outputs as pictures, speed, what was left out, and buttons to pause, step and stop. Stop raises `Stopped` from `step`.
        While nobody looks it costs next to nothing. The page ends with `close`, with `with`, or with the run."""
        number = _whole("port", port)
        if not 0 <= number < 1 << 16:
            raise c.Error(f"expected a port from 1 to 65535, or 0 for any, found {number}")
        address = c.checked(c.library.dressi_watch(self._handle, number))
        self._watch = Watch(self, address.decode())
        return self._watch

    def _fetch(self, step: str, name: str) -> np.ndarray:
        dense = c.Array()
        if not c.library.dressi_output(self._handle, step.encode(), name.encode(), ctypes.byref(dense)):
            c.checked(0)
        return from_dense(self.program.output_types[step][name], dense)

    def _copy(self, name: str, step: str | None) -> np.ndarray:
        """Of a leaf, or of an output."""
        dense = c.Array()
        if self._stream is not None:
            self._use_stream(current_stream(self.device))
        if step is not None:
            copied = self._fetch(step, name)
        else:
            c.checked(c.library.dressi_leaf(self._handle, name.encode(), ctypes.byref(dense)))
            copied = from_dense(self.program.leaf_types[name], dense)
        self._tell()
        return copied

    def output(self, name: str, *, step: str | None = None) -> Any:
        """An output of the last run of a step. On a device that is the processor it is the memory that the device
        computes in: the next run of any step overwrites it, with what is written to it. So it is on an NVIDIA GPU, as a
        `CudaArray`. Elsewhere, and where its memory is a leaf's, it is a copy; NumPy's cannot be written to."""
        step = self.program._step(step)
        type_ = self.program._output_type(step, name)
        if self._shares and type_.scalar != "bool":
            return CudaArray(self, name, step, type_)
        dense = c.Array()
        found = c.checked(c.library.dressi_output_view(self._handle, step.encode(), name.encode(), ctypes.byref(dense)))
        self._tell()
        return from_dense(type_, dense, writable=found == _VIEW)

    def __getitem__(self, leaf: str) -> Any:
        """What a leaf holds. On a device that is the processor it is a live view: it shows what later runs make of the leaf, and
        what is written to it counts in the next run. So it is on an NVIDIA GPU, as a `CudaArray`. Elsewhere, and of bools and
        faces that tables are made of, it is a copy that is not writable.
        """
        value = self._leaf(leaf)
        self._tell()
        return value

    def _leaf(self, leaf: str) -> Any:
        type_ = self.program._leaf_type(leaf)
        if self._shares and leaf not in self.program._from_host:
            return CudaArray(self, leaf, None, type_)
        dense = c.Array()
        found = c.checked(c.library.dressi_leaf_view(self._handle, leaf.encode(), ctypes.byref(dense)))
        return from_dense(type_, dense, writable=found == _VIEW)

    def __setitem__(self, leaf: str, value: Any) -> None:
        self._bind(leaf, value)

    def set_runs(self, step: str, runs: SupportsIndex) -> None:
        """How often the step counts as having run: its `step_index` in the next run."""
        c.checked(c.library.dressi_set_runs(self._handle, self.program._step(step).encode(), _whole("runs", runs)), c.Error)

    def counters(self, step: str | None = None) -> Counters:
        """What the runs of a step did, and what they left out."""
        return Counters(json.loads(c.checked(c.library.dressi_counters(self._handle, self.program._step(step).encode()))))

    def timing(self, step: str | None = None) -> Timing:
        """Runs a step once, and says how many nanoseconds each of its commands took on the device, with their lines."""
        return Timing(json.loads(c.checked(c.library.dressi_timed_step(self._handle, self.program._step(step).encode()))))

    def check_finite(self, step: str | None = None) -> NotFinite | None:
        """The first NaN or Inf that the next run of a step would store, with the lines of the program that make it; None where all
        is finite. A second run beside this one looks: this one stays as it is."""
        step = self.program._step(step)
        runs = self.counters(step)["runs"]
        other = Run(self.program, self.device, store_all=True)
        other.bind(symbols=self.symbols)
        for leaf in self.program._steps[step]["leaves"]:
            if leaf in self.program.leaf_types:
                other._bind(leaf, self._leaf(leaf))
        self._words.clear()  # of reading leaves: what is found says more, and no later step is told of them
        other.set_runs(step, runs)
        found = json.loads(c.checked(c.library.dressi_checked_step(other._handle, step.encode())))
        return NotFinite(found) if found else None

    def __repr__(self) -> str:
        return f"dressi.Run(steps={self.program.steps}, device={self.device.name!r})"

    def __reduce__(self) -> Any:
        raise TypeError("a run cannot be pickled: it holds memory of a device; pickle its program and its leaves")

    def _show_progress(self, step: str, done: int, times: int) -> None:
        numbers = [
            f"{name} {float(self.output(name, step=step)):.6g}"
            for name, type_ in self.program.output_types[step].items()
            if not type_.dims and type_.name == "float"
        ]
        end = "\n" if done == times else ""
        print(f"\r{step} {done}/{times}  {'  '.join(numbers)}", end=end, file=sys.stderr, flush=True)


def _whole(what: str, value: Any) -> int:
    """A number that the C interface has room for; what is no whole number is refused, not cut off."""
    try:
        number = operator.index(value)
    except TypeError:
        raise TypeError(f"{what}: expected a whole number, found {value!r}") from None
    if not -(2**62) < number < 2**62:
        raise c.BindError(f"{what}: {number} is too large")
    return number


class Watch:
    """The page of a run that is watched: `url` is its address, with the token that it asks for."""

    def __init__(self, run: Run, url: str) -> None:
        self.url = url
        self._run = weakref.ref(run)

    def close(self) -> None:
        """The page says that the run is over, and is no more."""
        run = self._run()
        if run is not None and run._watch is self:
            run._watch = None
            c.checked(c.library.dressi_watch_end(run._handle))

    def __enter__(self) -> Watch:
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"dressi.Watch({self.url!r})"

    def _repr_html_(self) -> str:
        return f'<a href="{self.url}" target="_blank" rel="noopener">watch the run</a>'


def compile(
    source: str | os.PathLike[str],
    *,
    device: Device | str | int | None = None,
    defines: Mapping[str, Any] | None = None,
    known: Mapping[str, float | Sequence[float]] | None = None,
    include: Sequence[str | os.PathLike[str]] = (),
    profile: str | None = None,
    lower: str = "auto",
    raster: str = "auto",
    scatter: str = "auto",
    pack: str = "fused",
    floats: str = "strict",
    ablate: Sequence[str] = (),
) -> Program:
    """Compiles a program: the file `fit.dr`, or text (a str with a line break or a semicolon).

    `device` is part of a device's name, its number, "reference" or a `Device`; the program is compiled for its profile, or
    for `profile`. `defines` replaces consts of the program. `known` has values of inputs of one element that stay: what they make zero
    is left out, and where that rests on a value, binding another is an error. A program that is wrong raises `CompileError`, whose text has
    line and caret.
    """
    name = "<program>"
    if not isinstance(source, (str, os.PathLike)):
        raise TypeError(f"expected the name of a file or the text of a program, found a {type(source).__name__}")
    if isinstance(source, str) and not source.strip():
        raise c.CompileError("expected the name of a file or the text of a program, found none")
    if isinstance(source, os.PathLike) or not _is_text(source):
        path = pathlib.Path(source)
        if path.suffix == ".drb":
            given = {"defines": defines, "known": known, "include": include, "profile": profile, "ablate": ablate}
            chosen = {"lower": lower != "auto", "raster": raster != "auto", "scatter": scatter != "auto"}
            chosen |= {"pack": pack != "fused", "floats": floats != "strict"}
            names = [key for key, value in (given | chosen).items() if value]
            if names:
                raise TypeError(f"'{path}' is compiled already: {', '.join(names)} must be given where the program is compiled")
            return load(path, device=device)
        name = str(path)
        c.encoded(name, "the file's name")
        try:
            source = path.read_text(encoding="utf-8")
        except OSError as error:
            raise c.CompileError(f"cannot read '{path}': {error.strerror}") from error
        except UnicodeDecodeError as error:
            line = path.read_bytes().count(b"\n", 0, error.start) + 1
            raise c.CompileError(f"{path}:{line}: expected text in UTF-8, found the byte {error.object[error.start]:#04x}") from error
    where = _device(device)
    options = [("lower", lower), ("raster", raster), ("scatter", scatter), ("pack", pack), ("float", floats)]
    if profile is not None:
        options.append(("profile", profile))
    options += [("ablate", part) for part in ablate]
    folders = [include] if isinstance(include, (str, os.PathLike)) else include
    options += [("include", os.fspath(folder)) for folder in folders]
    options += [(f"define:{key}", _define(value)) for key, value in (defines or {}).items()]
    options += [(f"known:{key}", _numbers(value)) for key, value in (known or {}).items()]
    return _compiled(name, source, options, device if device is not None else where)


def _is_text(source: str) -> bool:
    """Whether it is a program, and no file's name. Every statement ends with a semicolon."""
    return "\n" in source or (";" in source and not os.path.exists(source))


def _compiled(name: str, text: str, options: list[tuple[str, str]], device: Device | str | int | None) -> Program:
    handle = c.library.dressi_compile(c.encoded(name, "the file's name"), c.encoded(text, "the program"), _device(device)._handle, c.pairs(options))
    return Program(b"", device, c.checked(handle, c.CompileError), (name, text, options, _folder()))


def _folder() -> str:
    try:
        return os.getcwd()
    except OSError:  # it was removed
        return ""


def _define(value: Any) -> str:
    if getattr(value, "ndim", None) == 0:
        value = value.item()  # a scalar of NumPy or PyTorch
    return str(value).lower() if isinstance(value, bool) else str(value)


def _numbers(value: Any) -> str:
    value = value.tolist() if hasattr(value, "tolist") else value
    return ",".join(repr(float(number)) for number in (value if isinstance(value, Sequence) else [value]))


def load(bundle: bytes | bytearray | memoryview | str | os.PathLike[str], *, device: Device | str | int | None = None) -> Program:
    """A program that `drc build --emit=bundle` or `Program.save` wrote: its bytes, or its file."""
    if isinstance(bundle, (bytes, bytearray, memoryview)):
        return Program(bytes(bundle), device)
    path = pathlib.Path(bundle)
    if "\0" in str(path):
        raise c.Error("the file's name contains a zero byte")
    try:
        content = path.read_bytes()
    except OSError as error:
        raise c.Error(f"cannot read '{path}': {error.strerror}") from error
    try:
        return Program(content, device)
    except c.Error as error:
        raise type(error)(f"'{path}': {error}") from None


def reference(program: Program | str | os.PathLike[str], **options: Any) -> Program:
    """The same program on the float64 evaluator, the judge of all devices."""
    return program.on("reference") if isinstance(program, Program) else compile(program, device="reference", **options)
