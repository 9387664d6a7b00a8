# SPDX-License-Identifier: Apache-2.0
"""Programs inside PyTorch's graphs.

    render = dressi.torch.function(program, "render", ["position", "face"], ["picture"])
    loss = ((render(position, face) - photo) ** 2).mean()
    loss.backward()                                    # position.grad, by the program's own derivative
"""
from __future__ import annotations

import itertools
import weakref
from typing import Any, Mapping, Sequence

import torch as _torch

from . import _library as c
from ._arrays import Type
from ._function import Call, Function
from ._program import Program, Run

_numbers = itertools.count()


def function(
    program: Program,
    step: str | None = None,
    inputs: Sequence[str] = (),
    outputs: Sequence[str] | None = None,
    *,
    constants: Mapping[str, Any] | None = None,
    symbols: Mapping[str, int] | None = None,
) -> Any:
    """A function of tensors: the step's `outputs` (all by default) from the leaves `inputs`, in that order.

    The result is one tensor where one output is asked for, else a tuple. Gradients come from a step that the compiler adds
    to the program; leaves of integers, such as faces, get none. Results and gradients have the type and device of the
    inputs. `constants` are leaves that stay as they are. Under `torch.compile` it is one opaque op, where torch has
    `torch.library.custom_op`.
    """
    core = Function(program, step, inputs, outputs, constants, symbols)
    opaque = _custom_op(core) if hasattr(_torch.library, "custom_op") else None
    apply = _Call.apply

    def run(*tensors: Any, **named: Any) -> Any:
        if named or len(tensors) != len(core.inputs):
            tensors = (*tensors, *(named.pop(name) for name in core.inputs[len(tensors) :] if name in named))
            if named or len(tensors) != len(core.inputs):
                raise TypeError(f"expected the tensors {', '.join(core.inputs)}, found {len(tensors)} of them")
        given = [value if isinstance(value, _torch.Tensor) else _torch.as_tensor(value) for value in tensors]
        # An op of the library takes longer to call, and is needed by the compiler alone.
        results = opaque(*given) if opaque is not None and _torch.compiler.is_compiling() else apply(core, *given)
        return results[0] if len(core.outputs) == 1 else tuple(results)

    run.__name__ = f"dressi_{core.step}"
    run.__doc__ = f"{', '.join(core.outputs)} of the step '{core.step}', from {', '.join(core.inputs)}."
    run.core = core  # type: ignore[attr-defined]
    return run


def _like(core: Function, tensors: Sequence[Any]) -> Any:
    """The tensor whose type and device results have: the first one that may have a gradient."""
    for name, tensor in zip(core.inputs, tensors):
        if name in core.changed:
            return tensor
    return _torch.empty(0)


def _tensor(array: Any, like: Any) -> Any:
    tensor = _torch.from_numpy(array)
    if not tensor.is_floating_point():
        return tensor.to(like.device)
    return tensor.to(dtype=like.dtype, device=like.device)


class _OnCuda:
    """Calls of a run with tensors of its GPU, in the order of torch's stream: the host waits for nothing."""

    def __init__(self, core: Function, run: Run) -> None:
        assert run.device.cuda is not None  # _on_cuda asked
        self.core, self.run, self.number = core, run, run.device.cuda
        program = run.program
        self.types = [program.leaf_types[name] for name in core.inputs]
        self.from_host = [name in program._from_host for name in core.inputs]
        self.bound: list[Any] = [None] * len(core.inputs)  # of those: a tensor, and its version
        self.inputs = (c.NamedArray * len(core.inputs))()
        for given, name in zip(self.inputs, core.inputs):
            given.name = name.encode()
        self.seeds = (c.NamedArray * len(core.seeded))()
        for given, name in zip(self.seeds, core.seeded):
            given.name = f"{core._back}.{name}".encode()
        self.step, self.back = core.step.encode(), core._back.encode()
        self.known = False

    def _sizes(self, tensors: Sequence[Any]) -> None:
        """Shapes, once: they are those of the run."""
        symbols = self.run.symbols
        for name, type_, given, tensor in zip(self.core.inputs, self.types, self.inputs, tensors):
            shape = tuple(tensor.shape)
            if not type_.fits(shape):
                raise c.BindError(f"'{name}' is {type_}: expected an array of shape {type_.shape_text()}, found {shape}")
            symbols.update(type_.symbols_of(shape))
            given.array = type_.dense(shape, 0)
        outputs = self.run.program.output_types[self.core.step]
        self.seed_types = [outputs[name] for name in self.core.seeded]
        for type_, given in zip(self.seed_types, self.seeds):
            given.array = type_.dense(type_.shape(symbols), 0)
        self.results = _Results([(name, outputs[name]) for name in self.core.outputs], symbols, self.number)
        changed = [(name, self.run.program.leaf_types[name]) for name in self.core.changed]
        self.gradients = _Results(changed, symbols, self.number)
        self.known = True

    def takes(self, tensors: Sequence[Any]) -> bool:
        return all(t.get_device() == self.number or host for t, host in zip(tensors, self.from_host))

    def _fill(self, tensors: Sequence[Any]) -> list[Any]:
        """Says where the inputs are; the result must live until the call."""
        if not self.known:
            self._sizes(tensors)
        keep = []
        for k, tensor in enumerate(tensors):
            if self.from_host[k]:
                held = self.bound[k]
                if held is None or held[0]() is not tensor or held[1] != tensor._version:
                    self.run._bind(self.core.inputs[k], tensor)
                    self.bound[k] = (weakref.ref(tensor), tensor._version)
                continue
            tensor = _dense(tensor, self.types[k])
            keep.append(tensor)
            self.inputs[k].array.data = tensor.data_ptr()
        return keep

    def _call(self, step: bytes, given: Any, results: _Results) -> list[Any]:
        tensors = results.make()
        stream = _torch._C._cuda_getCurrentRawStream(self.number)
        self.run._stream = stream
        if not c.library.dressi_cuda_run(
            self.run._handle, stream, step, given, len(given), results.arrays, len(results.arrays)
        ):
            c.checked(0)
        return tensors

    def forward(self, tensors: Sequence[Any]) -> list[Any]:
        keep = self._fill(tensors)
        results = self._call(self.step, self.inputs, self.results)
        del keep
        return results

    def backward(self, call: Call, tensors: Sequence[Any], seeds: Sequence[Any]) -> dict[str, Any]:
        core = self.core
        if core._last.get(id(self.run)) is not call:  # another call came between
            keep = self._fill(tensors)
            if not c.library.dressi_cuda_run(
                self.run._handle, _torch._C._cuda_getCurrentRawStream(self.number), None, self.inputs, len(self.inputs), None, 0
            ):
                c.checked(0)
            core._last[id(self.run)] = call
            del keep
        keep = []
        by_name = dict(zip(core.outputs, seeds))
        for type_, name, given in zip(self.seed_types, core.seeded, self.seeds):
            seed = by_name[name]
            if seed is None:
                seed = _torch.zeros(type_.shape(self.run.symbols), device=f"cuda:{self.number}")
            seed = _dense(seed, type_)
            keep.append(seed)
            given.array.data = seed.data_ptr()
        results = self._call(self.back, self.seeds, self.gradients)
        del keep
        return dict(zip(core.changed, results))


def _dense(tensor: Any, type_: Type) -> Any:
    """As the run has it: float32 or 32-bit integers, one after the other."""
    if type_.is_matrix:
        tensor = tensor.transpose(-1, -2)
    wanted = getattr(_torch, type_.scalar)
    if tensor.dtype is not wanted:
        if type_.scalar != "float32":
            raise c.BindError(f"expected a tensor of {type_.scalar} for {type_}, found {tensor.dtype}")
        tensor = tensor.to(wanted)
    return tensor if tensor.is_contiguous() else tensor.contiguous()


class _Results:
    """New tensors for the results of a call."""

    def __init__(self, named: Sequence[tuple[str, Type]], symbols: Mapping[str, int], number: int) -> None:
        self.arrays = (c.NamedArray * len(named))()
        self.device = _torch.device("cuda", number)
        self.made = []
        for (name, type_), array in zip(named, self.arrays):
            shape = type_.shape(symbols)
            array.name, array.array = name.encode(), type_.dense(shape, 0)
            self.made.append((shape, getattr(_torch, type_.scalar), type_.is_matrix))

    def make(self) -> list[Any]:
        tensors = []
        for array, (shape, dtype, is_matrix) in zip(self.arrays, self.made):
            tensor = _torch.empty(shape, dtype=dtype, device=self.device)
            array.array.data = tensor.data_ptr()
            tensors.append(tensor.transpose(-1, -2) if is_matrix else tensor)
        return tensors


def _on_cuda(core: Function, tensors: Sequence[Any]) -> _OnCuda | None:
    """Where all tensors are on the GPU of the run, which shares its memory."""
    if not any(t.is_cuda for t in tensors) or not core.shares:
        return None
    run = core._run(dict(zip(core.inputs, tensors)))
    if run.device.cuda is None:
        return None
    calls = run.__dict__.get("_on_cuda")
    if calls is None:
        calls = run._on_cuda = _OnCuda(core, run)  # type: ignore[attr-defined]
    return calls if calls.takes(tensors) else None


def _as(tensor: Any, like: Any) -> Any:
    return tensor.to(like.dtype) if tensor.is_floating_point() and tensor.dtype is not like.dtype else tensor


def _forward(core: Function, tensors: Sequence[Any]) -> tuple[list[Any], Any]:
    with core.lock:
        return _forward_alone(core, tensors)


def _forward_alone(core: Function, tensors: Sequence[Any]) -> tuple[list[Any], Any]:
    on_cuda = _on_cuda(core, tensors)
    if on_cuda is not None:
        like = _like(core, tensors)
        results = [_as(result, like) for result in on_cuda.forward(tensors)]
        call = Call({}, on_cuda.run)
        core._last[id(on_cuda.run)] = call
        return results, call
    arrays, call = core.forward(dict(zip(core.inputs, tensors)))
    like = _like(core, tensors)
    return [_tensor(array, like) for array in arrays], call


def _backward(core: Function, call: Any, tensors: Sequence[Any], seeds: Sequence[Any]) -> list[Any]:
    on_cuda = call.run.__dict__.get("_on_cuda")
    if on_cuda is not None and not call.arrays:
        with core.lock:
            made = on_cuda.backward(call, tensors, seeds)
        return [_as(made[name], tensor) if name in made else None for name, tensor in zip(core.inputs, tensors)]
    given = {name: seed for name, seed in zip(core.outputs, seeds) if seed is not None and name in core.seeded}
    gradients = core.backward(call, given)
    return [_tensor(gradients[name], tensor) if name in gradients else None for name, tensor in zip(core.inputs, tensors)]


class _Call(_torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, core: Function, *tensors: Any) -> Any:
        results, ctx.call = _forward(core, tensors)
        ctx.core = core
        ctx.save_for_backward(*tensors)
        ctx.mark_non_differentiable(*(r for name, r in zip(core.outputs, results) if name not in core.seeded))
        return tuple(results)

    @staticmethod
    @_torch.autograd.function.once_differentiable
    def backward(ctx: Any, *seeds: Any) -> Any:
        # Saved tensors complain where one was written to since.
        return (None, *_backward(ctx.core, ctx.call, ctx.saved_tensors, seeds))


def _custom_op(core: Function) -> Any:
    """The same as an op of torch's library: forward and backward are two, since an op keeps nothing."""
    library = _torch.library
    name = f"dressi::{core.step.replace('.', '_')}_{next(_numbers)}"
    List, Tensor = list, _torch.Tensor

    def forward(tensors):  # type: ignore[no-untyped-def]
        return _forward(core, tensors)[0]

    def backward(tensors, seeds):  # type: ignore[no-untyped-def]
        arrays = dict(zip(core.inputs, tensors))
        call = Call({} if _on_cuda(core, tensors) else arrays, core._run(arrays))
        return [g for g in _backward(core, call, tensors, seeds) if g is not None]

    forward.__annotations__ = {"tensors": List[Tensor], "return": List[Tensor]}
    backward.__annotations__ = {"tensors": List[Tensor], "seeds": List[Tensor], "return": List[Tensor]}
    forward_op = library.custom_op(name, mutates_args=())(forward)
    backward_op = library.custom_op(f"{name}_backward", mutates_args=())(backward)

    @forward_op.register_fake
    def _(tensors):  # type: ignore[no-untyped-def]
        like, types = _like(core, tensors), core.program.output_types[core.step]
        symbols = dict(core.symbols)
        for leaf, tensor in zip(core.inputs, tensors):
            symbols.update(core.program.leaf_types[leaf].symbols_of(tensor.shape))
        for leaf, array in core.constants.items():
            symbols.update(core.program.leaf_types[leaf].symbols_of(_torch.as_tensor(array).shape))
        return [
            like.new_empty(types[out].shape(symbols), dtype=None if out in core.seeded else getattr(_torch, types[out].scalar))
            for out in core.outputs
        ]

    @backward_op.register_fake
    def _(tensors, seeds):  # type: ignore[no-untyped-def]
        return [_torch.empty_like(tensor) for name, tensor in zip(core.inputs, tensors) if name in core.changed]

    def setup_context(ctx, inputs, output):  # type: ignore[no-untyped-def]
        ctx.save_for_backward(*inputs[0])
        ctx.likes = output

    def back(ctx, grads):  # type: ignore[no-untyped-def]
        tensors = list(ctx.saved_tensors)
        seeds = [_torch.zeros_like(like) if g is None else g for g, like in zip(grads, ctx.likes)]
        gradients = iter(backward_op(tensors, seeds))
        return [next(gradients) if name in core.changed else None for name in core.inputs]

    forward_op.register_autograd(back, setup_context=setup_context)
    return lambda *tensors: forward_op(list(tensors))
