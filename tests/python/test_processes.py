# SPDX-License-Identifier: Apache-2.0
"""Threads, interrupts, pickling, fork and spawn."""
import concurrent.futures
import multiprocessing
import os
import pickle
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

import dressi

FIT = """edition 1;
param x : float[W];
input target : float[W];
let error = mean((x - target) * (x - target));
step fit { x <- x - 0.1 * grad(error, x); output error; }
"""
LONG = """edition 1;
input a : float[W];
step s { output b = reduce(sum, i in 0..20000) { sin(a + float(i)) }; }
"""


def fitted(device, seed):
    random = np.random.default_rng(seed)
    run = dressi.compile(FIT, device=device).bind(x=np.zeros(100), target=random.normal(size=100))
    for _ in range(20):
        run.step("fit", times=3)
    return np.array(run["x"])


def test_programs_of_several_threads_share_a_device(device):
    alone = [fitted(device, seed) for seed in range(4)]
    with concurrent.futures.ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda seed: fitted(device, seed), range(4)))
    for one, other in zip(alone, together):
        np.testing.assert_array_equal(one, other)


def test_one_run_may_be_called_by_two_threads(device):
    run = dressi.compile(FIT, device=device).bind(x=np.zeros(10), target=np.ones(10))
    with concurrent.futures.ThreadPoolExecutor(2) as pool:
        for done in [pool.submit(run.step, "fit", 5) for _ in range(10)]:
            assert done.result()["error"] >= 0
    once = dressi.compile(FIT, device=device).bind(x=np.zeros(10), target=np.ones(10))
    once.step("fit", 50)
    np.testing.assert_array_equal(run["x"], once["x"])  # fifty runs, one after the other


def test_others_go_on_while_a_step_runs(device):
    """The lock of the interpreter is free: another thread counts on during one call that takes long."""
    run = dressi.compile(LONG, device=device).bind(a=np.zeros(2000))
    run.step()
    counted, ended = [0], threading.Event()

    def count():
        while not ended.is_set():
            counted[0] += 1
            time.sleep(0.001)

    thread = threading.Thread(target=count)
    thread.start()
    before, start = counted[0], time.monotonic()
    run["a"] = np.ones(2000)
    run.step(outputs=[])
    took, during = time.monotonic() - start, counted[0] - before
    ended.set()
    thread.join()
    if took < 0.02:
        pytest.skip(f"the step took {took * 1e3:.1f} ms: too short to tell")
    assert during >= 3


def test_an_interrupt_ends_a_run_after_its_step_on_a_device(device):
    program = f"""
import dressi, numpy as np
run = dressi.compile({FIT!r}, device={device!r}).bind(x=np.zeros(20), target=np.ones(20))
print("ready", flush=True)
try:
    run.step("fit", times=10**9)
except KeyboardInterrupt:
    print("x", run["x"].shape, bool((run["x"] != 0).all()), "error" in run.step("fit"), flush=True)
"""
    child = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    assert child.stdout.readline() == "ready\n"
    time.sleep(0.3)
    child.send_signal(2)
    out, _ = child.communicate(timeout=30)
    assert out == "x (20,) True True\n" and child.returncode == 0


def test_what_can_be_pickled_and_what_says_that_it_cannot(device):
    program = dressi.compile(FIT, device=device)
    copied = pickle.loads(pickle.dumps(program))
    assert copied.steps == program.steps and copied.leaves == program.leaves
    # It has its text with it: gradients can be asked for.
    assert "fit.adjoint" in copied.with_adjoint("fit", ["x"], ["error"]).steps
    run = program.bind(x=np.zeros(3), target=np.ones(3))
    with pytest.raises(TypeError, match="a run cannot be pickled.*pickle its program and its leaves"):
        pickle.dumps(run)
    with pytest.raises(TypeError, match="a device cannot be pickled"):
        pickle.dumps(dressi.Device(device))
    # What a step gives is an array like others.
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(run["x"])), np.zeros(3))


def in_child(program, target):
    run = program.bind(x=np.zeros(len(target)), target=target)
    run.step("fit", times=200)
    return np.array(run["x"])


def test_spawned_processes_take_programs(device):
    program = dressi.compile(FIT, device=device)
    target = np.arange(4.0)
    with concurrent.futures.ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        np.testing.assert_allclose(pool.submit(in_child, program, target).result(), in_child(program, target))


def told_in_fork(use):
    """What an exception of `use` says in a forked process, and how that ends."""
    reader, writer = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            use()
            text = "nothing"
        except BaseException as error:  # whatever it is, the parent must know
            text = f"{type(error).__name__}: {error}"
        os.write(writer, text.encode())
        os._exit(0)
    os.close(writer)
    with os.fdopen(reader) as end:
        text = end.read()
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0
    return text


def test_after_a_fork_whatever_touches_the_device_says_so(device):
    program = dressi.compile(FIT, device=device)
    run = program.bind(x=np.zeros(3), target=np.ones(3))
    run.step()
    opened = dressi.Device(device)
    for use in (
        lambda: run.step(),
        lambda: run.bind(x=np.ones(3)),
        lambda: run.__setitem__("x", np.ones(3)),
        lambda: run["x"],
        lambda: run.output("error"),
        lambda: run.empty("x"),
        lambda: run.counters(),
        lambda: run.timing(),
        lambda: run.check_finite(),
        lambda: run.set_runs("fit", 0),
        lambda: run.watch(),
        lambda: dressi.compile(FIT, device=opened),
        lambda: program.on(opened).bind(),
    ):
        assert "was opened before this process was forked" in told_in_fork(use)


def test_a_forked_process_may_end_with_the_runs_of_its_parent(device):
    run = dressi.compile(FIT, device=device).bind(x=np.zeros(3), target=np.ones(3))
    run.step()
    code = f"""
import dressi, numpy as np, os, gc
run = dressi.compile({FIT!r}, device={device!r}).bind(x=np.zeros(3), target=np.ones(3))
run.step()
view = run["x"]
pid = os.fork()
if pid == 0:
    del run, view
    gc.collect()
    raise SystemExit(0)
print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), float(run.step()["error"]) < 1)
"""
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert out.stdout == "0 True\n", out.stderr


@pytest.mark.skipif(not os.environ.get("DR_LAVAPIPE_ICD"), reason="no lavapipe")
def test_a_forked_process_opens_devices_of_its_own():
    code = f"""
import dressi, numpy as np, os
parent = dressi.compile({FIT!r}, device="reference").bind(x=np.zeros(3), target=np.ones(3))
parent.step()
pid = os.fork()
if pid == 0:
    # Nothing of Vulkan was opened before: what is opened here is whole.
    run = dressi.compile({FIT!r}, device="lavapipe").bind(x=np.zeros(3), target=np.ones(3))
    os._exit(0 if run.step()["error"] == 1 else 1)
print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]))
"""
    assert subprocess.check_output([sys.executable, "-c", code], text=True, timeout=60) == "0\n"


@pytest.mark.skipif(not os.environ.get("DR_LAVAPIPE_ICD"), reason="no lavapipe")
def test_functions_go_on_in_a_forked_process():
    import dressi.nvdiffrast as dr
    from dressi._function import Function

    text = "edition 1;\ninput x : float[N];\nstep s { output y = x * x; }\n"
    function = Function(dressi.compile(text, device="lavapipe"), "s", ["x"])
    pos, tri = np.array([[[-4, -4, 0, 1], [4, -4, 0, 1], [0, 8, 0, 1]]], np.float32), np.array([[0, 1, 2]], np.int32)

    def use():
        (y,), call = function.forward({"x": np.arange(3.0)})
        gradient = function.backward(call, {"y": np.ones(3)})["x"]
        rast, _ = dr.rasterize(dr.RasterizeVkContext("lavapipe"), pos, tri, (8, 8))
        return y.tolist() == [0, 1, 4] and gradient.tolist() == [0, 2, 4] and (rast[..., 3] == 1).all()

    assert use()
    _, call = function.forward({"x": np.arange(3.0)})

    def use_in_child():
        assert use()
        function.backward(call, {"y": np.ones(3)})  # what was called before the fork is the parent's

    assert "was opened before this process was forked" in told_in_fork(use_in_child)
    assert use()
