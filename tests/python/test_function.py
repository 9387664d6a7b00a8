# SPDX-License-Identifier: Apache-2.0
"""Steps as functions with derivatives: Function, and PyTorch where it is."""
import concurrent.futures

import numpy as np
import pytest

import dressi
from dressi._function import Function

PROGRAM = """edition 1;
input a : vec2[W, H];
input b : float[W];
input unused : float[W];
input index : int[H];
let product = a * sin(b);
step make {
  output product, total = sum(dot(a, a) * b), picked = b.at(index), index_ = index + 1;
}
"""
INPUTS, OUTPUTS = ["a", "b", "unused", "index"], ["product", "total", "picked", "index_"]


def data(w=4, h=3, seed=1):
    random = np.random.default_rng(seed)
    return {
        "a": random.normal(size=(h, w, 2)),
        "b": random.normal(size=w),
        "unused": np.zeros(w),
        "index": random.integers(0, w, h).astype(np.int32),
    }


def test_threads_may_share_a_function(device):
    torch = pytest.importorskip("torch")
    import dressi.torch

    function = dressi.torch.function(dressi.compile(PROGRAM, device=device), "make", INPUTS, OUTPUTS)
    given = {name: torch.tensor(array) for name, array in data().items()}

    def gradient(scale):
        a = torch.full((3, 4, 2), scale, dtype=torch.float64).requires_grad_()
        function(a, *(given[name] for name in INPUTS[1:]))[1].backward()
        return a.grad

    alone = [gradient(float(k)) for k in range(4)]
    with concurrent.futures.ThreadPoolExecutor(4) as pool:
        for k, found in enumerate(pool.map(gradient, [float(k % 4) for k in range(80)])):
            assert torch.equal(found, alone[k % 4])


def test_names_that_are_there_twice_are_told():
    program = dressi.compile(PROGRAM, device="reference")
    with pytest.raises(dressi.Error, match="'a' is there twice"):
        Function(program, "make", ["a", "b", "a"])
    with pytest.raises(dressi.Error, match="'b' is there twice"):
        Function(program, "make", ["a", "b"], constants={"b": np.zeros(4)})
    assert Function(program, "make", "a", "total").inputs == ["a"]


def test_a_step_that_changes_leaves_is_no_function():
    text = "edition 1;\nparam x : float[W];\nstep s { x <- x * 0.5; output y = sum(x * x); }\n"
    with pytest.raises(dressi.Error, match="the step 's' changes x: .* give a step that only has outputs"):
        Function(dressi.compile(text, device="reference"), "s", ["x"], ["y"])


def test_gradients_are_those_of_finite_differences():
    function = Function(dressi.compile(PROGRAM, device="reference"), "make", INPUTS, OUTPUTS)
    arrays = data()
    random = np.random.default_rng(5)
    results, call = function.forward(arrays)
    seeds = {name: random.normal(size=r.shape) for name, r in zip(OUTPUTS, results) if name != "index_"}
    gradients = function.backward(call, seeds)
    assert sorted(gradients) == ["a", "b", "unused"] and (gradients["unused"] == 0).all()

    def loss(changed):
        values, _ = function.forward(changed)
        return sum((seeds[name] * value).sum() for name, value in zip(OUTPUTS, values) if name in seeds)

    for name in ("a", "b"):
        for at in np.ndindex(arrays[name].shape):
            sides = []
            for step in (1e-6, -1e-6):
                moved = {**arrays, name: arrays[name].copy()}
                moved[name][at] += step
                sides.append(loss(moved))
            assert gradients[name][at] == pytest.approx((sides[0] - sides[1]) / 2e-6, rel=1e-6, abs=1e-8)


def test_calls_may_cross_and_sizes_may_change(device):
    function = Function(dressi.compile(PROGRAM, device=device), "make", INPUTS, ["total"])
    calls = [(arrays, function.forward(arrays)) for arrays in (data(), data(seed=2), data(7, 2))]
    for arrays, ((total,), call) in calls:
        gradients = function.backward(call, {"total": np.float32(2)})
        np.testing.assert_allclose(gradients["a"], 4 * arrays["a"] * arrays["b"][:, None], rtol=1e-5)
        np.testing.assert_allclose(total, (arrays["a"] ** 2 * arrays["b"][:, None]).sum(), rtol=1e-4)


@pytest.mark.parametrize(
    "step, inputs, outputs, words",
    [
        ("mak", ["a"], ["total"], "no step 'mak'"),
        ("make", ["c"], ["total"], "no leaf 'c'"),
        ("make", ["a"], ["totl"], "no output 'totl'"),
        ("make", ["a"], ["index_"], "made of floats"),
    ],
)
def test_what_is_not_there_is_told(step, inputs, outputs, words):
    with pytest.raises(dressi.Error, match=words):
        Function(dressi.compile(PROGRAM, device="reference"), step, inputs, outputs)


def test_the_compiler_tells_too():
    program = dressi.compile(PROGRAM, device="reference")
    for step, leaf, output, words in [
        ("make", "index", "total", "'index' is made of int"),
        ("make", "a", "index_", "'index_' is made of int"),
    ]:
        with pytest.raises(dressi.CompileError, match=words):
            program.with_adjoint(step, [leaf], [output])
    with pytest.raises(dressi.Error, match="compile the program from its text"):
        dressi.load(program.bundle, device="reference").with_adjoint("make", ["a"], ["total"])


def test_gradients_of_gradients():
    text = PROGRAM.replace("output product,", "output slope = grad(sum(product), b), product,")
    function = Function(dressi.compile(text, device="reference"), "make", INPUTS, ["slope"])
    arrays = data()
    _, call = function.forward(arrays)
    seed = np.random.default_rng(3).normal(size=4)
    got = function.backward(call, {"slope": seed})["b"]
    np.testing.assert_allclose(got, -seed * (arrays["a"].sum((0, 2)) * np.sin(arrays["b"])), rtol=1e-9)


# ---- PyTorch ----


@pytest.fixture
def torch():
    return pytest.importorskip("torch")


def tensors(torch, dtype, grad=True):
    out = [torch.tensor(array) for array in data().values()]
    return [t.to(dtype).requires_grad_(grad) if t.is_floating_point() else t for t in out]


def test_torch_gradcheck(torch):
    import dressi.torch

    function = dressi.torch.function(dressi.compile(PROGRAM, device="reference"), "make", INPUTS, OUTPUTS[:3])
    assert torch.autograd.gradcheck(function, tensors(torch, torch.float64))


def test_torch_trains_through_a_program(torch, device):
    import dressi.torch

    total = dressi.torch.function(dressi.compile(PROGRAM, device=device), "make", INPUTS, ["total"])
    a, b, unused, index = tensors(torch, torch.float32)
    loss = (total(a.tanh(), b, unused, index) * 2 + total(a, b, unused, index)) ** 2
    loss.backward()
    x, y = a.detach().double().requires_grad_(), b.detach().double().requires_grad_()

    def plain(x, y):
        return ((x * x).sum(-1) * y).sum()

    expected = (plain(x.tanh(), y) * 2 + plain(x, y)) ** 2
    expected.backward()
    torch.testing.assert_close(loss, expected.float(), rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(a.grad, x.grad.float(), rtol=1e-4, atol=1e-3)
    torch.testing.assert_close(b.grad, y.grad.float(), rtol=1e-4, atol=1e-3)


def test_torch_tells_of_wrong_calls(torch):
    import dressi.torch

    function = dressi.torch.function(dressi.compile(PROGRAM, device="reference"), "make", INPUTS, OUTPUTS)
    with pytest.raises(TypeError, match="expected the tensors a, b, unused, index"):
        function(torch.zeros(3, 4, 2))
    with pytest.raises(dressi.BindError, match=r"\(H, W, 2\)"):
        function(*[torch.zeros(3, 4), *tensors(torch, torch.float32)[1:]])


def test_torch_compile_sees_one_op(torch):
    if not hasattr(torch, "compile") or not hasattr(torch.library, "custom_op"):
        pytest.skip("this torch has no custom ops")
    import dressi.torch

    function = dressi.torch.function(dressi.compile(PROGRAM, device="reference"), "make", INPUTS, ["product", "total"])
    given = tensors(torch, torch.float64)
    compiled = torch.compile(lambda *t: function(*t)[0].sum() * function(*t)[1], backend="aot_eager", fullgraph=True)
    compiled(*given).backward()
    found = [t.grad for t in given[:2]]
    again = tensors(torch, torch.float64)
    (function(*again)[0].sum() * function(*again)[1]).backward()
    for one, other in zip(found, again):
        torch.testing.assert_close(one, other.grad)
