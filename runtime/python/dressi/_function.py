# SPDX-License-Identifier: Apache-2.0
"""A step as a function of arrays, with its derivative: what PyTorch and `dressi.nvdiffrast` are two users of."""
from __future__ import annotations

import os
import threading
import weakref
from typing import TYPE_CHECKING, Any, Callable, Mapping, Sequence, SupportsIndex

from . import _library as c
from ._arrays import as_numpy
from ._program import Program, Run, _device, _whole

if TYPE_CHECKING:
    import numpy as np


class Kept(Run):
    """A run of a function, for one set of shapes in one process."""

    key: Any = None
    holds: Any = None  # a weak reference to the call whose arrays are bound
    on_cuda: Any = None  # what torch.py knows of tensors that are bound


class Call:
    """What `Function.forward` was called with: `Function.backward` goes on from there."""

    def __init__(self, arrays: dict[str, Any], run: Kept, step_index: int, on_cuda: bool = False) -> None:
        self.arrays = arrays  # none on CUDA, where torch.py has them
        self.run = run
        self.step_index = step_index
        self.on_cuda = on_cuda


class Function:
    """Outputs of a step as a function of leaves, and the way back, which the compiler makes of the same program.

    `inputs` and `outputs` are names of leaves and of the step's outputs, in the order of arguments and results. Leaves and
    outputs of integers may be among them: they have no gradient. `constants` are copied here, and bound once to each run. The step's
    `step_index` counts the calls, and a call's derivative has that of the call.
    """

    def __init__(
        self,
        program: Program,
        step: str | None,
        inputs: Sequence[str],
        outputs: Sequence[str] | None = None,
        constants: Mapping[str, Any] | None = None,
        symbols: Mapping[str, SupportsIndex] | None = None,
    ) -> None:
        self.step = program._step(step)
        types = program.output_types[self.step]
        inputs = [inputs] if isinstance(inputs, str) else inputs
        outputs = [outputs] if isinstance(outputs, str) else outputs
        named = [*inputs, *(constants or {})]
        for names in (named, list(outputs or [])):
            if twice := [name for name in names if names.count(name) > 1]:
                raise c.Error(f"'{twice[0]}' is there twice")
        if changes := program._steps[self.step]["changes"]:
            raise c.Error(
                f"the step '{self.step}' changes {', '.join(changes)}: the gradient would be that of other values than the "
                "outputs; give a step that only has outputs"
            )
        self.inputs = list(inputs)
        self.outputs = list(types if outputs is None else outputs)
        for name in named:
            program._leaf_type(name)
        self.constants = {name: _copied(name, value) for name, value in (constants or {}).items()}
        self.symbols = {name: _whole(f"symbol '{name}'", count) for name, count in (symbols or {}).items()}
        for name in self.outputs:
            program._output_type(self.step, name)
        self.changed = [name for name in self.inputs if program.leaf_types[name].scalar == "float32"]
        self.seeded = [name for name in self.outputs if types[name].scalar == "float32"]
        if not self.seeded:
            raise c.Error(f"no output of the step '{self.step}' that is asked for is made of floats")
        self.program = program.with_adjoint(self.step, self.changed, self.seeded) if self.changed else program
        self._back = f"{self.step}.adjoint"
        self.shares = bool(_device(program._device).info.get("shares_memory"))  # memory with CUDA
        self._runs: list[Kept] = []  # the one that was used last is first
        self.calls = 0  # that gave results
        self.lock = threading.RLock()  # what a call binds is there until it has its results

    def forward(self, arrays: Mapping[str, Any]) -> tuple[list[np.ndarray], Call]:
        """The outputs, and what `backward` wants to know."""
        with self.lock:
            made = self.on_run(arrays, lambda run: self.forward_on(run, arrays))
            self.calls += 1
        return made

    def forward_on(self, run: Kept, arrays: Mapping[str, Any]) -> tuple[list[np.ndarray], Call]:
        call = Call(dict(arrays), run, self.calls)
        self._bind(call)
        run.set_runs(self.step, call.step_index)
        results = run.step(self.step, outputs=self.outputs)
        return [results[name] for name in self.outputs], call

    def backward(self, call: Call, seeds: Mapping[str, Any]) -> dict[str, np.ndarray]:
        """Gradients by leaf of the sum over outputs, each times its seed. An output without a seed has zeros."""
        with self.lock:
            return self._backward(call, seeds)

    def _backward(self, call: Call, seeds: Mapping[str, Any]) -> dict[str, np.ndarray]:
        import numpy as np

        run = call.run
        if run.holds is None or run.holds() is not call:  # another call came between
            self._bind(call)
        shapes = run.program.output_types[self.step]
        symbols = run.symbols
        for name in self.seeded:
            seed = seeds.get(name)
            if seed is None:
                seed = np.zeros(shapes[name].shape(symbols), np.float32)
            run._bind(f"{self._back}.{name}", seed)
        run.set_runs(self._back, call.step_index)
        return run.step(self._back)

    def _bind(self, call: Call) -> None:
        run = call.run
        run.holds = run.on_cuda = None  # where this fails, the run holds arrays of two calls
        for name, array in call.arrays.items():
            run._bind(name, array)
        run.holds = weakref.ref(call)

    def on_run(self, arrays: Mapping[str, Any], use: Callable[[Kept], Any]) -> Any:
        """What `use` makes of a run for arrays of these shapes. A run keeps its sizes, and equal shapes may mean others, such as the
        number of a mesh's edges: where no run that is kept takes the arrays, a new one does, or says what is wrong."""
        if missing := [name for name in self.inputs if name not in arrays]:
            raise c.BindError(f"no data for {', '.join(missing)}")
        key = (os.getpid(), *(arrays[name].shape for name in self.inputs))  # a device is not to be used in a process forked since
        for run in [run for run in self._runs if run.key == key]:
            try:
                result = use(run)
            except c.Error as error:
                if type(error) not in (c.Error, c.BindError):
                    raise
                continue
            self._runs.remove(run)
            break
        else:
            run = Kept(self.program, _device(self.program._device))
            run.key = key
            run.bind(self.constants, symbols=self.symbols)
            result = use(run)
        self._runs.insert(0, run)
        del self._runs[_MAX_RUNS:]
        return result


_MAX_RUNS = 16  # that are kept


def _copied(name: str, value: Any) -> Any:
    """A constant for all runs, whatever is written to what was given. Tensors stay where they are."""
    return value.detach().clone() if hasattr(value, "detach") else as_numpy(name, value).copy()
