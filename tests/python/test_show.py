# SPDX-License-Identifier: Apache-2.0
"""What a program says about itself: why a gradient is what it is, and its commands."""
import warnings
import xml.etree.ElementTree as xml

import numpy as np
import pytest

import dressi

FIT = """edition 1;
param x : float[W];
param unused : float;
input rough : float[W];
let flat = floor(rough) * x;
let error = mean(x * x) + mean(clamp(flat, 0.0, 1.0));
step fit { x <- x - 0.1 * grad(error, x); output error; }
"""

MEAN = """edition 1;
param x : float[W];
let middle = mean(x);
step center { x <- x - middle; output middle; }
"""


def test_explain_grad_says_where_a_gradient_flows_and_where_it_is_cut():
    program = dressi.compile(FIT, device="reference")
    flows = program.explain_grad("error", "x")
    assert flows and flows.flows and flows.summary == "the gradient of 'error' with respect to 'x' flows"
    assert all(path[0]["name"] == "error" and path[-1]["name"] == "x" for path in flows.paths)
    assert flows.paths[0][-1]["place"].startswith("<program>:2:") and flows.clamps[0]["place"].startswith("<program>:6:")
    cut = program.explain_grad("error", "rough")
    assert not cut and not cut.paths and cut.cuts[0]["place"].startswith("<program>:5:")
    assert "'floor' is constant between its jumps" in cut.summary and "^" in str(cut)
    assert cut._repr_html_().startswith("<pre>the gradient of &#x27;error&#x27;")
    assert "does not depend on 'unused'" in program.explain_grad("error", "unused").summary
    with pytest.raises(dressi.Error, match="no output or let 'eror', did you mean 'error'"):
        program.explain_grad("eror", "x")
    with pytest.raises(dressi.Error, match="no leaf or let 'y'"):
        program.explain_grad("error", "y")
    with pytest.raises(dressi.Error, match="a bundle holds no program text to explain"):
        dressi.load(program.bundle, device="reference").explain_grad("error", "x")


def test_a_schedule_lists_what_commands_read_and_write():
    program = dressi.compile(MEAN, device="reference")
    schedule = program.schedule()
    assert schedule.step == "center" and {c["kind"] for c in schedule} <= {"dispatch", "draw", "fill", "copy", "reduce"}
    assert any("<program>:3" in line for c in schedule for line in c["lines"])
    writers = [k for k, c in enumerate(schedule) if "x" in c["writes"]]
    readers = [k for k, c in enumerate(schedule) if "x" in c["reads"]]
    assert min(readers) < min(writers) == max(writers)
    for start, to, names in schedule.flows():
        assert start < to and set(names) <= set(schedule[start]["writes"]) & set(schedule[to]["reads"])
    picture = xml.fromstring(schedule._repr_svg_())
    space = "{http://www.w3.org/2000/svg}"
    assert len(picture.findall(f"{space}g/{space}rect")) == len(schedule)
    assert len(picture.findall(f"{space}path")) == len(schedule.flows()) > 0
    with pytest.raises(dressi.Error, match="no step 'fti'"):
        program.schedule("fti")


def test_a_computed_initial_value_is_no_step_of_its_own(device):
    """It fills its leaf before anything reads it, and nobody need bind it."""
    program = dressi.compile(
        """edition 1;
import std.random;
input scale : float;
param ramp : float[8] = scale * float(coord(8).x);
param noise : float[64] = random.uniform(coord(64), 1u);
step look { output sum_ = reduce(sum, i in 0..8) { ramp.at(i) }; }
step fit { ramp <- ramp + 1.0; noise <- noise * 1.0; output ramp_ = ramp; }
""",
        device=device,
    )
    assert program.steps == ["look", "fit"]
    assert "ramp" in program.leaves and not any("initial" in name for name in program.leaves)
    run = program.bind(scale=2.0)
    assert run.step("look")["sum_"] == 56
    np.testing.assert_array_equal(run.step("fit", times=3)["ramp_"], 2 * np.arange(8) + 2)
    np.testing.assert_array_equal(run["ramp"], 2 * np.arange(8) + 3)
    given = program.bind(scale=2.0, ramp=np.ones(8))
    assert given.step("look")["sum_"] == 8
    early = program.bind(scale=3.0)
    np.testing.assert_array_equal(early["ramp"], 3 * np.arange(8))
    again = dressi.load(program.bundle, device=device).bind(scale=1.0)
    assert again.step("look")["sum_"] == 28
    assert np.unique(program.bind(scale=0.0)["noise"]).size > 60
    with pytest.raises(dressi.Error, match="scale"):
        program.bind().step("look")


def test_what_is_not_finite_is_warned_of_once(device):
    program = dressi.compile(
        "edition 1;\nparam p : float[W] = 1.0;\ninput t : float[W];\nstep look { output wide = 1.0 / t, fine = t + 1.0; }\n"
        "step spoil { p <- p / t; }\n",
        device=device,
    )
    hint = "" if device == "reference" else ".*check_finite"  # the evaluator has no commands to look behind
    run = program.bind(t=[1.0, 0.0, 2.0])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert run.step("look", outputs=["fine"])["fine"][1] == 1
    with pytest.warns(dressi.NotFiniteWarning, match=r"output 'look.wide' has Inf at element \(1, 0, 0\)" + hint):
        run.step("look")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run.step("look")
    with pytest.warns(dressi.NotFiniteWarning, match="left a NaN or Inf by run 3|leaf 'p' has Inf"):
        run.step("spoil", times=3)
        assert np.isinf(run["p"][1])


def test_warnings_that_are_errors_tell_of_all_at_once(device):
    program = dressi.compile("edition 1;\ninput a : float;\nstep f { output x = 1.0 / a, y = 2.0 / a; }\n", device=device)
    run = program.bind(a=0.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error", dressi.NotFiniteWarning)
        with pytest.raises(dressi.NotFiniteWarning, match="(?s)'f.x' has Inf.*'f.y' has Inf"):
            run.step()
        run["a"] = 1.0
        assert run.step() == {"x": 1, "y": 2}
        if device != "reference":  # which has no commands to look behind
            run["a"] = np.nan
            assert run.check_finite() is not None
            run["a"] = 1.0
            assert run.step() == {"x": 1, "y": 2}
