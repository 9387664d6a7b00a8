# SPDX-License-Identifier: Apache-2.0
"""A step as a function of arrays, with its derivative: what PyTorch and `dressi.nvdiffrast` are two users of."""
from __future__ import annotations

import collections
import threading
from typing import TYPE_CHECKING, Any, Mapping, Sequence

from . import _library as c
from ._program import Program, Run, _device

if TYPE_CHECKING:
    import numpy as np


class Call:
    """What `Function.forward` was called with: `Function.backward` goes on from there."""

    def __init__(self, arrays: dict[str, Any], run: Run) -> None:
        self.arrays = arrays
        self.run = run


class Function:
    """Outputs of a step as a function of leaves, and the way back, which the compiler makes of the same program.

    `inputs` and `outputs` are names of leaves and of the step's outputs, in the order of arguments and results. Leaves and
    outputs of integers may be among them: they have no gradient. `constants` are bound once to each run.
    """

    def __init__(
        self,
        program: Program,
        step: str | None,
        inputs: Sequence[str],
        outputs: Sequence[str] | None = None,
        constants: Mapping[str, Any] | None = None,
        symbols: Mapping[str, int] | None = None,
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
        self.constants = dict(constants or {})
        self.symbols = dict(symbols or {})
        for name in [*self.inputs, *self.constants]:
            program._leaf_type(name)
        for name in self.outputs:
            program._output_type(self.step, name)
        self.changed = [name for name in self.inputs if program.leaf_types[name].scalar == "float32"]
        self.seeded = [name for name in self.outputs if types[name].scalar == "float32"]
        if not self.seeded:
            raise c.Error(f"no output of the step '{self.step}' that is asked for is made of floats")
        self.program = program.with_adjoint(self.step, self.changed, self.seeded) if self.changed else program
        self._back = f"{self.step}.adjoint"
        self.shares = bool(_device(program._device).info.get("shares_memory"))  # memory with CUDA
        self._runs: collections.OrderedDict[Any, Run] = collections.OrderedDict()
        self._last: dict[int, Call] = {}  # by the id of a run: whose arrays it holds
        self.lock = threading.RLock()  # what a call binds is there until it has its results

    def forward(self, arrays: Mapping[str, Any]) -> tuple[list[np.ndarray], Call]:
        """The outputs, and what `backward` wants to know."""
        with self.lock:
            call = Call(dict(arrays), self._run(arrays))
            self._bind(call)
            results = call.run.step(self.step, outputs=self.outputs)
        return [results[name] for name in self.outputs], call

    def backward(self, call: Call, seeds: Mapping[str, Any]) -> dict[str, np.ndarray]:
        """Gradients by leaf of the sum over outputs, each times its seed. An output without a seed has zeros."""
        with self.lock:
            return self._backward(call, seeds)

    def _backward(self, call: Call, seeds: Mapping[str, Any]) -> dict[str, np.ndarray]:
        import numpy as np

        run = call.run
        if self._last.get(id(run)) is not call:  # another call came between
            self._bind(call)
        shapes = run.program.output_types[self.step]
        symbols = run.symbols
        for name in self.seeded:
            seed = seeds.get(name)
            if seed is None:
                seed = np.zeros(shapes[name].shape(symbols), np.float32)
            run._bind(f"{self._back}.{name}", seed)
        return run.step(self._back)

    def _bind(self, call: Call) -> None:
        for name, array in call.arrays.items():
            call.run._bind(name, array)
        self._last[id(call.run)] = call

    def _run(self, arrays: Mapping[str, Any]) -> Run:
        """One for each set of shapes: symbols of a run keep their values."""
        missing = [name for name in self.inputs if name not in arrays]
        if missing:
            raise c.BindError(f"no data for {', '.join(missing)}")
        key = tuple(arrays[name].shape for name in self.inputs)
        run = self._runs.get(key)
        if run is None:
            run = self.program.bind(self.constants, symbols=self.symbols)
            self._runs[key] = run
            if len(self._runs) > _MAX_RUNS:
                _, old = self._runs.popitem(last=False)
                self._last.pop(id(old), None)
        self._runs.move_to_end(key)
        return run


_MAX_RUNS = 16  # sets of shapes whose runs are kept
