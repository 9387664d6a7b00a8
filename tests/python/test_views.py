# SPDX-License-Identifier: Apache-2.0
"""Memory that NumPy and the device share, and how long it lives."""
import gc
import itertools
import os

import numpy as np
import pytest

import dressi

lavapipe = pytest.mark.skipif(not os.environ.get("DR_LAVAPIPE_ICD"), reason="no lavapipe")

PROGRAM = """edition 1;
param level : float[W, H];
input face : ivec3[F];
state runs : float;
let heavy = sin(level) * 2.0;
step look { output heavy, faces = topology(face).edge_faces; }
step raise { level <- level + 1.0;  output old = level; }
"""


def bound(device, w=4, h=3):
    program = dressi.compile(PROGRAM, device=device)
    return program.bind(level=np.zeros((h, w)), face=[[0, 1, 2]])


@lavapipe
def test_a_leaf_is_a_live_view_and_so_is_an_output():
    run = bound("lavapipe")
    view = run["level"]
    run.step("raise")
    assert (view == 1).all() and np.shares_memory(view, run["level"])
    old = run.output("old", step="raise")
    assert (old == 0).all() and np.shares_memory(old, run.output("old", step="raise"))
    mine = run.step("raise")["old"]
    run.step("raise")
    assert (mine == 1).all() and (old == 2).all() and (view == 3).all()
    run["level"] = np.full((3, 4), 7)
    assert (view == 7).all()


@lavapipe
def test_what_is_written_to_a_view_counts_in_the_next_run():
    run = bound("lavapipe")
    run.step("look")
    run["level"][1, 2] = 1  # written, and given back before the run
    assert run.step("look")["heavy"][1, 2] == pytest.approx(2 * np.sin(1), rel=1e-5)
    view = run["level"]
    run.step("look")
    view[0, 0] = 1
    assert run.step("look")["heavy"][0, 0] == pytest.approx(2 * np.sin(1), rel=1e-5)
    view[0, 1] = 1
    del view
    assert run.step("look")["heavy"][0, 1] == pytest.approx(2 * np.sin(1), rel=1e-5)
    before = run.counters("look")["skipped_commands"]
    run.step("look")
    run.step("look")
    assert run.counters("look")["skipped_commands"] > before  # without views, what is there is not made again


@lavapipe
def test_an_output_that_was_written_to_is_made_again():
    run = bound("lavapipe")
    run.step("look")
    run.output("heavy", step="look")[:] = 9
    assert (run.step("look")["heavy"] == 0).all()


@lavapipe
def test_outputs_that_were_written_to_are_made_again_by_every_step():
    text = """edition 1;
    input x : float[N];
    step one { output w = 3.0 * x; }
    step other { output v = 2.0 * x; }
    """
    for held, between in itertools.product((False, True), repeat=2):
        run = dressi.compile(text, device="lavapipe").bind(x=np.ones(4))
        for _ in range(3):
            run.step("one", outputs=[])
            run.step("other", outputs=[])
        view = run.output("w", step="one")
        view *= 255
        if not held:
            del view
        if between:
            run.step("other", outputs=[])
        for times in (1, 2, 3):
            assert (run.step("one", times)["w"] == 3).all() and (run.step("other", times)["v"] == 2).all()


@lavapipe
def test_an_output_that_is_a_leaf_is_a_copy():
    text = """edition 1;
    input photo : float[N];
    input face : ivec3[F];
    step look { output picture = photo, half = 0.5 * photo, edges = topology(face).edge; }
    """
    run = dressi.compile(text, device="lavapipe").bind(photo=np.ones(4), face=[[0, 1, 2]])
    run.step()
    for name in ("picture", "edges"):
        with pytest.raises(ValueError, match="read-only"):
            run.output(name)[:] = 7
    # What the last run read, until another one.
    run["photo"][:] = 4
    assert (run.output("picture") == 1).all() and (run.step("look")["half"] == 2).all()
    assert (run.output("picture") == 4).all()


def test_copies_say_that_writing_to_them_would_be_lost():
    run = bound("reference")
    with pytest.raises(ValueError, match="read-only"):
        run["level"][:] = 1
    with pytest.raises(ValueError, match="read-only"):
        run["face"][:] = 1


@lavapipe
def test_memory_lives_as_long_as_its_views():
    views = []
    for k in range(20):
        run = bound("lavapipe", 100 + k, 50)
        run.step("raise")
        views.append((run["level"], run.output("old", step="raise")))
        del run
        gc.collect()
    junk = [np.full((100, 100), 3.0) for _ in range(50)]
    for level, old in views:
        level += 1
        assert (level == 2).all() and (old == 0).all() and len(junk) == 50


@lavapipe
def test_tensors_that_are_freed_early_were_copied():
    run = bound("lavapipe", 300, 200)
    array = np.ones((200, 300), np.float32)
    run["level"] = array
    array[:] = np.nan
    del array
    assert (run.step("raise")["old"] == 1).all()


@lavapipe
def test_views_go_on_by_dlpack_and_the_buffer_protocol():
    run = bound("lavapipe")
    again = np.from_dlpack(run["level"])
    view = memoryview(run["level"])
    run.step("raise")
    assert (again == 1).all() and view.shape == (3, 4) and view[2, 3] == 1
    assert run["level"].__dlpack_device__() == (1, 0)


@lavapipe
def test_a_view_binds_to_its_own_leaf_and_to_others():
    run = bound("lavapipe")
    view = run["level"]
    view[:] = 2
    run["level"] = view
    run["level"] = view[::-1]
    assert (run.step("raise")["old"] == 2).all()


def test_arrays_of_a_gpu_come_by_their_librarys_copy():
    class Tensor:
        __cuda_array_interface__ = {"shape": (3, 4), "typestr": "<f4", "data": (0, False), "version": 3}

    class WithCopy(Tensor):
        def get(self):
            return np.full((3, 4), 5, np.float32)

    run = bound("reference")
    with pytest.raises(dressi.BindError, match="lives on a GPU"):
        run["level"] = Tensor()
    run["level"] = WithCopy()
    assert (run["level"] == 5).all()


def test_the_evaluator_takes_float64_as_it_is():
    run = bound("reference", 1, 1)
    for value, expected in [
        (0.1, 0.1),
        (np.array(0.1, ">f8"), 0.1),
        (np.array(0.1, np.float32), np.float32(0.1)),
        (np.array(0.1, np.longdouble), 0.1),
        (2**24 + 1, 2**24 + 1),
        (1e300, 1e300),
    ]:
        run["level"] = np.reshape(value, (1, 1))
        assert run["level"][0, 0] == expected
    if np.finfo(np.longdouble).max > np.finfo(np.float64).max:
        with pytest.raises(dressi.BindError, match="does not fit float64"):
            run["level"] = np.full((1, 1), np.longdouble(10) ** 400)


@lavapipe
def test_views_and_runs_come_and_go_without_growth():
    resource = pytest.importorskip("resource")
    run = bound("lavapipe", 64, 64)

    def many():
        for k in range(2000):
            run["level"] = np.full((64, 64), k, np.float32)
            run.step("raise")
            assert run["level"][0, 0] == k + 1

    many()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    many()
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 4096  # KiB
