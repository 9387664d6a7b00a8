# SPDX-License-Identifier: Apache-2.0
"""Many steps with new tensors each, and what goes away too early. A few rounds as a test; `test_endurance.py STEPS [DEVICE]` runs as many
steps as asked, which is how the figures of docs/howto/python.md were taken, also with a library built for AddressSanitizer."""
import gc
import os
import sys

import numpy as np
import pytest

import dressi

FIT = """edition 1;
param offset : vec3;
input position : vec3[V];
input target : vec3[V];
let moved = position + offset;
let error = mean(dot(moved - target, moved - target));
step fit { offset <- offset - 0.1 * grad(error, offset); output error, moved; }
step look { output error; }
"""


def resident():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") // 1024


def tensors(seed):
    """New arrays, as NumPy and, where it is there, as tensors of torch."""
    random = np.random.default_rng(seed)
    array = random.normal(size=(64, 3)).astype(np.float32)
    torch = sys.modules.get("torch")
    return torch.from_numpy(array) if torch is not None and seed % 2 else array


def step_often(run, steps):
    kept = None
    for k in range(steps):
        run["target"] = tensors(k)
        run.bind(position=tensors(k + 1), offset=np.zeros(3, np.float32))
        out = run.step("fit")
        if k % 7 == 0:
            kept = run["offset"], run.output("moved", step="fit"), out["moved"]  # the views before are given back
    return kept


def runs_that_come_and_go(program, rounds):
    for k in range(rounds):
        run = program.bind(position=tensors(k), target=tensors(k + 1), offset=np.zeros(3))
        run.step("fit")
        views = run["position"], run.output("moved", step="fit")
        del run
        assert np.isfinite(views[0]).all() and np.isfinite(views[1]).all()


def gone_too_early(device):
    """What is let go in an order that nobody plans."""
    program = dressi.compile(FIT, device=dressi.Device(device))
    array = tensors(2).copy() if isinstance(tensors(2), np.ndarray) else tensors(2).clone()
    run = program.bind(position=array, target=tensors(4), offset=np.zeros(3))
    del array  # what was bound is copied
    gc.collect()
    run.step("fit")
    view, output = run["position"], run.output("moved", step="fit")
    half = view[::2].T
    del program
    gc.collect()
    run.step("fit")  # a program that is gone
    del run
    gc.collect()
    before = half.copy()
    junk = [np.full(1000, k) for k in range(50)]
    np.testing.assert_array_equal(half, before)  # views of a run, a program and a device that are gone
    if view.flags.writeable:
        view[:] = 1.0
    assert len(junk) == 50 and output.shape == (64, 3)


def exceptions_in_hooks(device, rounds):
    torch = pytest.importorskip("torch")
    import dressi.torch

    class Mistake(Exception):
        pass

    def fail(_):
        raise Mistake

    program = dressi.compile(FIT, device=device)
    error = dressi.torch.function(program, "look", ["position", "target"], ["error"], constants={"offset": np.zeros(3)})
    expected = None
    for k in range(rounds):
        position = torch.ones(64, 3, requires_grad=True)
        position.register_hook(fail)
        with pytest.raises(Mistake):
            error(position, torch.zeros(64, 3)).backward()
        again = torch.ones(64, 3, requires_grad=True)
        error(again, torch.zeros(64, 3)).backward()
        expected = again.grad.clone() if expected is None else expected
        assert torch.equal(again.grad, expected)


def test_what_goes_away_too_early_breaks_nothing(device):
    gone_too_early(device)
    exceptions_in_hooks(device, 3)


def test_memory_does_not_grow(device):
    program = dressi.compile(FIT, device=device)
    run = program.bind(position=tensors(0), target=tensors(1), offset=np.zeros(3))
    step_often(run, 500)
    runs_that_come_and_go(program, 15)
    before = resident()
    step_often(run, 1000)
    runs_that_come_and_go(program, 30)
    gc.collect()
    assert resident() - before < 4096  # KiB; a leak of a view or of a run would be more


def main():
    steps, device = int(sys.argv[1]), sys.argv[2] if len(sys.argv) > 2 else "lavapipe"
    try:
        import torch  # noqa: F401
    except ImportError:
        print("no torch: arrays of NumPy alone")
    gone_too_early(device)
    if "torch" in sys.modules:
        exceptions_in_hooks(device, 10)
    program = dressi.compile(FIT, device=device)
    run = program.bind(position=tensors(0), target=tensors(1), offset=np.zeros(3))
    step_often(run, steps // 10)
    runs_that_come_and_go(program, 20)
    before = resident()
    for part in range(5):
        step_often(run, steps // 5)
        runs_that_come_and_go(program, 20)
        gc.collect()
        print(f"{(part + 1) * (steps // 5)} steps: {resident() - before:+d} KiB", flush=True)


if __name__ == "__main__":
    main()
