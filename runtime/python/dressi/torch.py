# SPDX-License-Identifier: Apache-2.0
"""Programs inside PyTorch's graphs.

    render = dressi.torch.function(program, "render", ["position", "face"], ["picture"])
    loss = ((render(position, face) - photo) ** 2).mean()
    loss.backward()                                    # position.grad, by the program's own derivative
"""
from __future__ import annotations

import functools
import itertools
import weakref
from typing import Any, Callable, List, Mapping, Sequence, SupportsIndex

import torch as _torch

from . import _library as c
from ._arrays import Type
from ._function import Call, Function, Kept
from ._program import Program

_numbers = itertools.count()


def function(
    program: Program,
    step: str | None = None,
    inputs: Sequence[str] = (),
    outputs: Sequence[str] | None = None,
    *,
    constants: Mapping[str, Any] | None = None,
    symbols: Mapping[str, SupportsIndex] | None = None,
) -> Callable[..., _torch.Tensor | Any]:
    """A function of tensors: the step's `outputs` (all by default) from the leaves `inputs`, in that order.

    The result is one tensor where one output is asked for, else a tuple, which types do not tell apart. Gradients come from a step that the compiler adds
    to the program; leaves of integers, such as faces, get none, nor do tensors of integers. Gradients have the type and
    device of their tensors. Outputs of floats have the type that PyTorch's own operators give the tensors of floats among the
    arguments, float32 where there are none. What is no tensor is copied at the call, and `constants`, leaves that keep their values, are
    copied here. The step's `step_index` counts the calls of the function; the gradient of a call has that of the call. Under
    `torch.compile` it is one opaque op, where torch has `torch.library.custom_op`.
    """
    core = Function(program, step, inputs, outputs, constants, symbols)
    opaque = _custom_op(core) if hasattr(_torch.library, "custom_op") else None
    apply = _Call.apply

    def run(*tensors: Any, **named: Any) -> Any:
        if named or len(tensors) != len(core.inputs):
            rest = core.inputs[len(tensors) :]
            wrong = [f"'{name}'" + (" twice" if name in core.inputs else "") for name in named if name not in rest]
            if wrong or len(tensors) + len(named) != len(core.inputs):
                found = ", ".join(wrong) or f"{len(tensors) + len(named)} of them"
                raise TypeError(f"expected the tensors {', '.join(core.inputs)}, found {found}")
            tensors = (*tensors, *(named[name] for name in rest))
        devices = [value.device for value in tensors if isinstance(value, _torch.Tensor)]
        where = devices[0] if devices else None
        # Torch counts no changes of what is no tensor: a backward pass needs what was there at the call.
        given = [
            value if isinstance(value, _torch.Tensor) else _torch.as_tensor(value, device=where).clone() for value in tensors
        ]
        # An op of the library takes longer to call, and is needed by the compiler alone.
        results = opaque(*given) if opaque is not None and _torch.compiler.is_compiling() else apply(core, *given)
        return results[0] if len(core.outputs) == 1 else tuple(results)

    run.__name__ = f"dressi_{core.step}"
    run.__doc__ = f"{', '.join(core.outputs)} of the step '{core.step}', from {', '.join(core.inputs)}."
    run.core = core  # type: ignore[attr-defined]
    return run


def _has_gradient(core: Function, tensors: Sequence[Any]) -> list[bool]:
    return [name in core.changed and tensor.is_floating_point() for name, tensor in zip(core.inputs, tensors)]


def _like(core: Function, tensors: Sequence[Any]) -> Any:
    """An empty tensor of the type and device that results of floats have."""
    floats = [tensor for tensor, has in zip(tensors, _has_gradient(core, tensors)) if has]
    # As PyTorch has it, numbers count only among themselves.
    types = [tensor.dtype for tensor in floats if tensor.ndim] or [tensor.dtype for tensor in floats]
    dtype = functools.reduce(_torch.promote_types, types) if types else _torch.float32
    first = (floats or tensors)[:1]
    return _torch.empty(0, dtype=dtype, device=first[0].device if first else None)


def _as(tensor: Any, like: Any) -> Any:
    return tensor.to(dtype=like.dtype if tensor.is_floating_point() else tensor.dtype, device=like.device)


class _OnCuda:
    """Calls of a run with tensors of its GPU, in the order of torch's stream: the host waits for nothing."""

    def __init__(self, core: Function, run: Kept) -> None:
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

    def forward(self, call: Call, tensors: Sequence[Any]) -> list[Any]:
        self.run.holds = None
        keep = self._fill(tensors)
        self.run.set_runs(self.core.step, call.step_index)
        results = self._call(self.step, self.inputs, self.results)
        self.run.holds = weakref.ref(call)
        del keep
        return results

    def backward(self, call: Call, tensors: Sequence[Any], seeds: Sequence[Any]) -> dict[str, Any]:
        core = self.core
        if self.run.holds is None or self.run.holds() is not call:  # another call came between
            self.run.holds = None
            keep = self._fill(tensors)
            if not c.library.dressi_cuda_run(
                self.run._handle, _torch._C._cuda_getCurrentRawStream(self.number), None, self.inputs, len(self.inputs), None, 0
            ):
                c.checked(0)
            self.run.holds = weakref.ref(call)
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
        self.run.set_runs(core._back, call.step_index)
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
            if type_.is_matrix:  # column by column
                shape = (*shape[:-2], shape[-1], shape[-2])
            self.made.append((shape, getattr(_torch, type_.scalar), type_.is_matrix))

    def make(self) -> list[Any]:
        tensors = []
        for array, (shape, dtype, is_matrix) in zip(self.arrays, self.made):
            tensor = _torch.empty(shape, dtype=dtype, device=self.device)
            array.array.data = tensor.data_ptr()
            tensors.append(tensor.transpose(-1, -2) if is_matrix else tensor)
        return tensors


def _on_cuda(core: Function, run: Kept, tensors: Sequence[Any]) -> _OnCuda | None:
    """Where all tensors are on the GPU of the run, which shares its memory."""
    if not core.shares or not any(t.is_cuda for t in tensors) or run.device.cuda is None:
        return None
    if run.on_cuda is None:
        run.on_cuda = _OnCuda(core, run)
    return run.on_cuda if run.on_cuda.takes(tensors) else None


def _forward(core: Function, tensors: Sequence[Any]) -> tuple[list[Any], Call]:
    like = _like(core, tensors)

    def on(run: Kept) -> tuple[list[Any], Call]:
        on_cuda = _on_cuda(core, run, tensors)
        if on_cuda is None:
            return core.forward_on(run, arrays)
        call = Call({}, run, core.calls, on_cuda=True)
        return on_cuda.forward(call, tensors), call

    arrays = dict(zip(core.inputs, tensors))
    with core.lock:
        results, call = core.on_run(arrays, on)
        core.calls += 1
    made = results if call.on_cuda else map(_torch.from_numpy, results)
    return [_as(result, like) for result in made], call


def _backward(core: Function, call: Call, tensors: Sequence[Any], seeds: Sequence[Any]) -> list[Any]:
    if call.on_cuda:
        with core.lock:
            on_cuda = _on_cuda(core, call.run, tensors)
            assert on_cuda is not None  # as in the forward call
            made = on_cuda.backward(call, tensors, seeds)
    else:
        given = {name: seed for name, seed in zip(core.outputs, seeds) if seed is not None and name in core.seeded}
        made = {name: _torch.from_numpy(array) for name, array in core.backward(call, given).items()}
    named = zip(core.inputs, tensors, _has_gradient(core, tensors))
    return [_as(made[name], tensor) if has else None for name, tensor, has in named]


class _Once(_torch.autograd.Function):
    """A gradient, which depends on `sources` in a way that nobody knows the derivative of."""

    @staticmethod
    def forward(ctx: Any, gradient: Any, *sources: Any) -> Any:
        return gradient.view_as(gradient)

    @staticmethod
    def backward(ctx: Any, *_: Any) -> Any:
        raise c.Error(
            "the gradient of a function of Dressi has no derivative of its own (a double backward): let the program compute "
            "the first gradient with grad(), as an output"
        )


def differentiable_once(gradients: Sequence[Any], sources: Sequence[Any]) -> list[Any]:
    """What a backward pass gives: gradients that refuse to be differentiated again by what they were made of."""
    if not _torch.is_grad_enabled():  # nobody asked for create_graph
        return list(gradients)
    return [None if gradient is None else _Once.apply(gradient, *sources) for gradient in gradients]


class _Call(_torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, core: Function, *tensors: Any) -> Any:
        results, ctx.call = _forward(core, tensors)
        ctx.core = core
        ctx.save_for_backward(*tensors)
        ctx.mark_non_differentiable(*(r for name, r in zip(core.outputs, results) if name not in core.seeded))
        return tuple(results)

    @staticmethod
    def backward(ctx: Any, *seeds: Any) -> Any:
        tensors = ctx.saved_tensors  # which complain where one was written to since
        with _torch.no_grad():
            gradients = _backward(ctx.core, ctx.call, tensors, seeds)
        return (None, *differentiable_once(gradients, [*tensors, *seeds]))


def _custom_op(core: Function) -> Any:
    """The same as an op of torch's library: forward and backward are two, since an op keeps nothing."""
    library: Any = _torch.library  # whose custom_op some versions lack
    name = f"dressi::{core.step.replace('.', '_')}_{next(_numbers)}"

    def forward(tensors):  # type: ignore[no-untyped-def]
        results, call = _forward(core, tensors)
        return [*results, _torch.tensor(call.step_index, device="cpu")]

    def backward(tensors, seeds, step_index):  # type: ignore[no-untyped-def]
        arrays = dict(zip(core.inputs, tensors))

        def on(run: Kept) -> list[Any]:
            on_cuda = _on_cuda(core, run, tensors) is not None
            call = Call({} if on_cuda else arrays, run, int(step_index), on_cuda)
            return [g for g in _backward(core, call, tensors, seeds) if g is not None]

        with core.lock:
            return core.on_run(arrays, on)

    # Torch 2.6 knows no `list[Tensor]` here.
    several: Any = List[_torch.Tensor]
    forward.__annotations__ = {"tensors": several, "return": several}
    backward.__annotations__ = {"tensors": several, "seeds": several, "step_index": _torch.Tensor, "return": several}
    forward_op = library.custom_op(name, mutates_args=())(forward)
    backward_op = library.custom_op(f"{name}_backward", mutates_args=())(backward)

    @forward_op.register_fake
    def _(tensors):  # type: ignore[no-untyped-def]
        like, types = _like(core, tensors), core.program.output_types[core.step]
        symbols = dict(core.symbols)
        for leaf, tensor in zip(core.inputs, tensors):
            symbols.update(core.program.leaf_types[leaf].symbols_of(tensor.shape))
        for leaf, array in core.constants.items():
            symbols.update(core.program.leaf_types[leaf].symbols_of(array.shape))
        results = [
            like.new_empty(types[out].shape(symbols), dtype=None if out in core.seeded else getattr(_torch, types[out].scalar))
            for out in core.outputs
        ]
        return [*results, _torch.empty((), dtype=_torch.int64, device="cpu")]

    @backward_op.register_fake
    def _(tensors, seeds, step_index):  # type: ignore[no-untyped-def]
        return [_torch.empty_like(tensor) for tensor, has in zip(tensors, _has_gradient(core, tensors)) if has]

    def setup_context(ctx, inputs, output):  # type: ignore[no-untyped-def]
        *ctx.likes, step_index = output
        ctx.save_for_backward(*inputs[0], step_index)

    def back(ctx, grads):  # type: ignore[no-untyped-def]
        *tensors, step_index = ctx.saved_tensors
        seeds = [_torch.zeros_like(like) if g is None else g for g, like in zip(grads, ctx.likes)]
        gradients = iter(backward_op(tensors, seeds, step_index))
        return [next(gradients) if has else None for has in _has_gradient(core, tensors)]

    forward_op.register_autograd(back, setup_context=setup_context)
    return lambda *tensors: forward_op(list(tensors))[:-1]
