# SPDX-License-Identifier: Apache-2.0
"""Programs inside PyTorch's graphs.

    render = dressi.torch.function(program, "render", ["position", "face"], ["picture"])
    loss = ((render(position, face) - photo) ** 2).mean()
    loss.backward()                                    # position.grad, by the program's own derivative
"""
from __future__ import annotations

import itertools
from typing import Any, Mapping, Sequence

import torch as _torch

from ._function import Function
from ._program import Program

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
    if hasattr(_torch.library, "custom_op"):
        call = _custom_op(core)
    else:
        call = lambda *tensors: _Call.apply(core, *tensors)  # noqa: E731

    def run(*tensors: Any, **named: Any) -> Any:
        given = [*tensors, *(named.pop(name) for name in core.inputs[len(tensors) :] if name in named)]
        if named or len(given) != len(core.inputs):
            raise TypeError(f"expected the tensors {', '.join(core.inputs)}, found {len(given)} of them")
        results = call(*(value if isinstance(value, _torch.Tensor) else _torch.as_tensor(value) for value in given))
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


def _forward(core: Function, tensors: Sequence[Any]) -> tuple[list[Any], Any]:
    arrays, call = core.forward(dict(zip(core.inputs, tensors)))
    like = _like(core, tensors)
    return [_tensor(array, like) for array in arrays], call


def _backward(core: Function, call: Any, tensors: Sequence[Any], seeds: Sequence[Any]) -> list[Any]:
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
        from ._function import Call

        arrays = dict(zip(core.inputs, tensors))
        return [g for g in _backward(core, Call(arrays, core._run(arrays)), tensors, seeds) if g is not None]

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
            symbols.update(core.program.leaf_types[leaf].symbols_of(array.shape))
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
