# SPDX-License-Identifier: Apache-2.0
"""Steps as functions with derivatives: Function, and PyTorch where it is."""
import concurrent.futures
import gc
import warnings
import weakref

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


COUNTED = """edition 1;
import std.random;
input x : float[N];
let scale = random.uniform(coord(N), 1u);
step s { output y = scale * x, scale_ = scale, index = step_index; }
"""


def test_a_derivative_has_the_step_index_of_its_call(device):
    function = Function(dressi.compile(COUNTED, device=device), "s", ["x"])
    calls = [function.forward({"x": np.ones(4 + k // 2)}) for k in range(4)]
    scales = [scale for (_, scale, _), _ in calls]
    assert [int(index) for (_, _, index), _ in calls] == [0, 1, 2, 3] and len({scale[0] for scale in scales}) == 4
    for k in (2, 0, 3, 3, 1):
        gradient = function.backward(calls[k][1], {"y": np.ones(len(scales[k]))})["x"]
        np.testing.assert_array_equal(gradient, scales[k])
    (_, again, index), call = function.forward({"x": np.ones(4)})
    assert index == 4
    np.testing.assert_array_equal(function.backward(call, {"y": np.ones(4)})["x"], again)


def test_a_call_that_fails_leaves_the_one_before_it_whole(device):
    text = "edition 1;\ninput x : float[N];\ninput i : int[N];\nstep s { output y = x * x * float(i); }\n"
    function = Function(dressi.compile(text, device=device), "s", ["x", "i"])
    one, i = np.array([1.0, 2.0, 3.0]), np.ones(3, np.int64)
    _, call = function.forward({"x": one, "i": i})
    with pytest.raises(dressi.BindError, match="does not fit int32"):
        function.forward({"x": 10 * one, "i": i << 40})
    np.testing.assert_array_equal(function.backward(call, {"y": np.ones(3)})["x"], 2 * one)


def test_runs_are_kept_for_some_sizes_and_no_others(device):
    function = Function(dressi.compile(PROGRAM, device=device), "make", INPUTS, ["total"])
    runs = weakref.WeakSet()
    for _ in range(2):
        calls = [function.forward(data(w, 1))[1] for w in range(1, 25)]
        runs.update(call.run for call in calls)
        for call in calls:
            function.backward(call, {"total": np.float32(1)})
        del calls, call
        gc.collect()
        assert len(runs) <= 16
    held = weakref.ref(function.forward(data())[1])
    assert held() is None  # nor is what a call was given


MESH = """edition 1;
input x : vec3[V];
input face : ivec3[F];
let edge = topology(face).edge;
step s { output length = sum(distance(x.at(edge.x), x.at(edge.y))), count = edge.width; }
"""


def test_meshes_of_equal_shapes_may_have_other_edges(device):
    function = Function(dressi.compile(MESH, device=device), "s", ["x", "face"])
    x = np.random.default_rng(1).normal(size=(4, 3))
    square, triangle = (np.array([[0, 1, 2], last], np.int32) for last in ([0, 2, 3], [0, 1, 2]))
    edges = {5: [(0, 1), (1, 2), (0, 2), (2, 3), (0, 3)], 3: [(0, 1), (1, 2), (0, 2)]}
    calls = []
    for face in (square, triangle, triangle, square, square[::-1]):
        (length, count), call = function.forward({"x": x, "face": face})
        assert int(count) == (3 if face is triangle else 5)
        assert length == pytest.approx(sum(np.linalg.norm(x[a] - x[b]) for a, b in edges[int(count)]), rel=1e-5)
        calls.append((int(count), call))
    assert len({id(call.run) for _, call in calls}) == 2
    for count, call in calls:
        expected = np.zeros((4, 3))
        for a, b in edges[count]:
            direction = (x[a] - x[b]) / np.linalg.norm(x[a] - x[b])
            expected[a] += direction
            expected[b] -= direction
        np.testing.assert_allclose(function.backward(call, {"length": 1.0})["x"], expected, rtol=1e-4, atol=1e-5)
    with pytest.raises(dressi.Error, match="face"):
        function.forward({"x": x, "face": square - 7})


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


SCALED = "edition 1;\ninput x : float[N];\ninput y : float;\nstep s { output z = x * y; }\n"


def test_constants_keep_their_values(device):
    y = np.array(2.0)
    function = Function(dressi.compile(SCALED, device=device), "s", ["x"], constants={"y": y})
    for n in (2, 3):
        assert function.forward({"x": np.ones(n)})[0][0].tolist() == [2] * n
        y[...] = 5


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


def test_torch_gradients_of_matrices_that_are_not_square(torch, device):
    import dressi.torch

    text = "edition 1;\ninput m : mat2x3[N];\ninput v : vec2[N];\nstep s { output y = m * v, twice = 2.0 * m; }\n"
    function = dressi.torch.function(dressi.compile(text, device=device), "s", ["m", "v"])
    generator = torch.Generator().manual_seed(1)
    m, v = (torch.rand(4, *size, generator=generator).requires_grad_() for size in ((3, 2), (2,)))
    y, twice = function(m, v)
    torch.testing.assert_close(y, (m @ v[..., None])[..., 0])
    torch.testing.assert_close(twice, 2 * m)
    (y.sum() + (twice * m.detach()).sum()).backward()
    torch.testing.assert_close(m.grad, v.detach()[:, None].expand(4, 3, 2) + 2 * m.detach())
    torch.testing.assert_close(v.grad, m.detach().sum(1))


def test_torch_tells_of_wrong_calls(torch):
    import dressi.torch

    function = dressi.torch.function(dressi.compile(PROGRAM, device="reference"), "make", INPUTS, OUTPUTS)
    a, b = torch.zeros(3, 4, 2), torch.zeros(4)
    for given, named, found in [
        ([a], {}, "1 of them"),
        ([a], {"b": b}, "2 of them"),
        ([a] * 5, {}, "5 of them"),
        ([a, b], {"a": a}, "'a' twice"),
        ([a, b], {"z": b, "index": b}, "'z'"),
    ]:
        with pytest.raises(TypeError, match=f"expected the tensors a, b, unused, index, found {found}$"):
            function(*given, **named)
    with pytest.raises(dressi.BindError, match=r"\(H, W, 2\)"):
        function(*[torch.zeros(3, 4), *tensors(torch, torch.float32)[1:]])


def test_torch_results_have_the_type_of_the_tensors_of_floats(torch):
    import dressi.torch

    text = "edition 1;\ninput a : float;\ninput x : float[N];\nstep s { output y = a * x; }\n"
    function = dressi.torch.function(dressi.compile(text, device="reference"), "s", ["a", "x"])
    x = torch.tensor([0.25, 0.5, 0.75], requires_grad=True)
    for a in (2, 2.0, np.int32(2), np.float64(2), torch.tensor(2), torch.tensor(2.0, dtype=torch.float64)):
        y = function(a, x)
        assert y.dtype is torch.float32 and y.tolist() == [0.5, 1.0, 1.5]
        x.grad = None
        y.sum().backward()
        assert x.grad.tolist() == [2, 2, 2]
    assert function(True, x).tolist() == [0.25, 0.5, 0.75]
    assert function(0.5, torch.tensor([1, 2])).tolist() == [0.5, 1.0]
    assert function(2, torch.tensor([0, 1, 255], dtype=torch.uint8)).tolist() == [0, 2, 510]
    for one, other in [(torch.float64, torch.float32), (torch.float16, torch.float16), (torch.float32, torch.float16)]:
        tensors = torch.ones((), dtype=one), torch.ones(3, dtype=other)
        assert function(*tensors).dtype is (tensors[0] * tensors[1]).dtype is other


def test_torch_gradients_cannot_be_differentiated_again(torch, device):
    import dressi.torch

    text = "edition 1;\ninput x : float[N];\nstep s { output y = x * x; }\n"
    function = dressi.torch.function(dressi.compile(text, device=device), "s", ["x"])
    x = torch.tensor([2.0], requires_grad=True)
    # Seeds that are constant, and seeds that depend on x.
    for loss in (lambda y: y.sum(), lambda y: (y * y).sum()):
        (gradient,) = torch.autograd.grad(loss(function(x)) + x.pow(3).sum(), x, create_graph=True)
        assert gradient.item() == torch.autograd.grad(loss(x * x) + x.pow(3).sum(), x)[0].item()
        with pytest.raises(dressi.Error, match="double backward.*compute the first gradient with grad"):
            torch.autograd.grad((gradient**2).sum(), x)


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


def test_torch_compile_keeps_the_step_index_of_each_call(torch):
    if not hasattr(torch, "compile") or not hasattr(torch.library, "custom_op"):
        pytest.skip("this torch has no custom ops")
    import dressi.torch

    function = dressi.torch.function(dressi.compile(COUNTED, device="reference"), "s", ["x"], ["y", "scale_"])
    compiled = torch.compile(lambda x: function(x), backend="aot_eager", fullgraph=True)
    x = torch.ones(4, requires_grad=True)
    (one, scale), (other, other_scale) = compiled(x), compiled(x)
    assert not torch.equal(scale, other_scale)
    for y, expected in ((one, scale), (other, other_scale)):
        x.grad = None
        y.sum().backward()
        torch.testing.assert_close(x.grad, expected.detach())


def test_torch_arrays_of_numpy_may_change_after_the_call(torch, device):
    import dressi.torch

    function = dressi.torch.function(dressi.compile(SCALED, device=device), "s", ["x", "y"])
    x, y = np.ones(4, np.float32), torch.tensor(2.0, requires_grad=True)
    z = function(x, y)
    x[:] = 100
    function(x, y)
    assert torch.autograd.grad(z.sum(), y)[0] == 4


def test_torch_constants_keep_their_values(torch, device):
    import dressi.torch

    y = torch.tensor(2.0)
    function = dressi.torch.function(dressi.compile(SCALED, device=device), "s", ["x"], constants={"y": y})
    for n in (2, 3):
        assert function(torch.ones(n)).tolist() == [2] * n
        y.fill_(5)


def test_torch_calls_are_not_blamed_for_a_gradient_before_them(torch, device):
    import dressi.torch

    function = dressi.torch.function(dressi.compile(SCALED, device=device), "s", ["x", "y"])
    x, y = torch.ones(3, requires_grad=True), torch.tensor(2.0, requires_grad=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error", dressi.NotFiniteWarning)
        with pytest.raises(dressi.NotFiniteWarning, match="'s.adjoint.y' has NaN"):
            function(x, y).backward(torch.full((3,), float("nan")))
        function(x, y).sum().backward()
    assert y.grad == 3
