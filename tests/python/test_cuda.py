# SPDX-License-Identifier: Apache-2.0
"""Memory and streams shared with CUDA, on the NVIDIA GPU that DR_PYTHON_GPU names; and what the others say."""
import gc
import os
import warnings

import numpy as np
import pytest

import dressi

GPU = os.environ.get("DR_PYTHON_GPU")
gpu = pytest.mark.skipif(not GPU, reason="no GPU")

PROGRAM = """edition 1;
param level : float[W, H];
input turn : mat3[N];
input face : ivec3[F];
let heavy = sin(level) * 2.0;
step look { output heavy, colour = vec3(heavy, level, 1.0), moved = turn * vec3(1.0, 2.0, 3.0), faces = topology(face).edge_faces; }
step raise { level <- level + 1.0;  output old = level; }
"""


@pytest.fixture
def torch():
    torch = pytest.importorskip("torch")
    if not torch.cuda.is_available():
        pytest.skip("torch has no GPU")
    return torch


def bound(device=GPU, w=40, h=30, **options):
    program = dressi.compile(PROGRAM, device=device, **options)
    return program.bind(level=np.zeros((h, w)), turn=np.arange(18).reshape(2, 3, 3), face=[[0, 1, 2]])


@gpu
def test_leaves_and_outputs_are_tensors_of_the_same_memory(torch):
    run = bound()
    level = torch.from_dlpack(run["level"])
    assert level.is_cuda and level.shape == (30, 40) and level.dtype is torch.float32
    old = None
    for k in range(5):
        run.step("raise", outputs=[])
        old = torch.from_dlpack(run.output("old", step="raise")) if old is None else old
        assert (level == k + 1).all() and (old == k).all()
        level += torch.ones_like(level) * 0  # on torch's stream
    level.copy_(torch.linspace(0, 3, 1200, device="cuda").reshape(30, 40))
    found = run.step("look")
    np.testing.assert_allclose(found["heavy"], 2 * np.sin(np.linspace(0, 3, 1200).reshape(30, 40)), atol=1e-5)
    level.zero_()
    assert (run.step("look", outputs=["heavy"])["heavy"] == 0).all()  # nothing is skipped
    again = torch.as_tensor(run["level"], device="cuda")  # by __cuda_array_interface__
    assert again.data_ptr() == level.data_ptr()
    torch.testing.assert_close(torch.from_dlpack(run["turn"]).cpu(), torch.arange(18.0).reshape(2, 3, 3))


@gpu
def test_outputs_that_were_written_to_are_made_again(torch):
    text = """edition 1;
    input x : float[N];
    step one { output w = 3.0 * x, x_ = x; }
    step other { output v = 2.0 * x; }
    """
    run = dressi.compile(text, device=GPU).bind(x=np.ones(4))
    for name, expected in (("w", 3), ("x_", 1)):
        for _ in range(3):
            run.step("one", outputs=[])
            run.step("other", outputs=[])
        torch.from_dlpack(run.output(name, step="one")).mul_(255)
        assert (run.step("other")["v"] == 2).all()
        assert (run["x"] == 1).all() and (run.step("one")[name] == expected).all()  # what is a leaf was copied
        assert (torch.from_dlpack(run.output(name, step="one")) == expected).all()


@gpu
def test_matrices_that_are_not_square_have_rows_first(torch):
    import dressi.torch

    text = "edition 1;\ninput m : mat2x3[N];\ninput v : vec2[N];\nstep s { output y = m * v, twice = 2.0 * m; }\n"
    program = dressi.compile(text, device=GPU)
    m, v = (torch.rand(4, *size, device="cuda") for size in ((3, 2), (2,)))
    run = program.bind(m=m, v=v)
    run.step("s", outputs=[])
    torch.testing.assert_close(torch.from_dlpack(run["m"]), m)
    torch.testing.assert_close(torch.from_dlpack(run.output("twice", step="s")), 2 * m)
    m.requires_grad_()
    y, twice = dressi.torch.function(program, "s", ["m", "v"])(m, v)
    torch.testing.assert_close(y, (m @ v[..., None])[..., 0])
    torch.testing.assert_close(twice, 2 * m)
    (y.sum() + (twice * m.detach()).sum()).backward()
    torch.testing.assert_close(m.grad, v[:, None].expand(4, 3, 2) + 2 * m.detach())


@gpu
def test_the_torch_function_keeps_calls_apart(torch):
    import dressi.torch
    from test_function import COUNTED, MESH

    function = dressi.torch.function(dressi.compile(COUNTED, device=GPU), "s", ["x"])
    calls = [(x, *function(x)) for x in (torch.ones(4 + k // 2, device="cuda", requires_grad=True) for k in range(4))]
    assert [int(index) for *_, index in calls] == [0, 1, 2, 3]
    for k in (2, 0, 3, 3, 1):
        x, y, scale, _ = calls[k]
        x.grad = None
        y.sum().backward(retain_graph=True)
        torch.testing.assert_close(x.grad, scale)
    # Meshes of one shape with other edges, calls that cross, and calls over the host between.
    function = dressi.torch.function(dressi.compile(MESH, device=GPU), "s", ["x", "face"])
    faces = [torch.tensor([[0, 1, 2], last], dtype=torch.int32) for last in ([0, 2, 3], [0, 1, 2])]
    made = {}
    for where in ("cuda", "cpu"):
        x = torch.arange(12.0, device=where).reshape(4, 3).square().requires_grad_()
        lengths = [function(x, faces[k])[0] for k in (0, 1, 1, 0)]
        if where == "cuda":
            function(x.cpu(), faces[1])
            lengths.append(function(x, faces[0])[0])
            assert lengths[-1] == lengths[0] != lengths[1]
        lengths[0].backward()
        lengths[2].backward()
        made[where] = x.grad.cpu()
    torch.testing.assert_close(made["cuda"], made["cpu"])


@gpu
@pytest.mark.parametrize("lower", ["auto", "fragment"])
def test_images_are_copied_to_where_cuda_sees_them(torch, lower):
    run = bound(lower=lower)
    run.step("look", outputs=[])
    colour = torch.from_dlpack(run.output("colour", step="look"))
    for value in (0.5, 1.5):
        run["level"] = torch.full((30, 40), value, device="cuda")
        run.step("look", outputs=[])
        expected = torch.tensor([2 * np.sin(value), value, 1.0], dtype=torch.float32)
        torch.testing.assert_close(colour.cpu(), expected.expand(30, 40, 3), atol=1e-5, rtol=0)


@gpu
def test_tensors_of_torch_are_copied_on_their_stream(torch):
    run = bound(w=1000, h=1000)
    side = torch.cuda.Stream()
    for stream in (torch.cuda.current_stream(), side, torch.cuda.current_stream()):
        with torch.cuda.stream(stream):
            tensor = torch.zeros(1000, 1000, device="cuda")
            for _ in range(200):
                tensor += 0.01  # takes longer than to ask for the copy
            run["level"] = tensor
            tensor.fill_(np.nan)  # the copy came before
            np.testing.assert_allclose(run.step("raise")["old"], 2, atol=1e-3)
    with pytest.raises(dressi.BindError, match=r"shape \(H, W\)"):
        run["level"] = torch.zeros(3, 4, 5, device="cuda")
    with pytest.raises(dressi.BindError, match="1000"):
        run["level"] = torch.zeros(3, 4, device="cuda")
    run["level"] = torch.ones(1000, 1000, device="cuda", dtype=torch.float64).T
    assert (run.step("raise")["old"] == 1).all()
    run["turn"] = torch.arange(18, device="cuda").reshape(2, 3, 3)
    np.testing.assert_allclose(run.step("look")["moved"], np.arange(18).reshape(2, 3, 3) @ [1, 2, 3])
    run["face"] = torch.tensor([[2, 1, 0]], device="cuda")
    np.testing.assert_array_equal(run["face"], [[2, 1, 0]])


@gpu
def test_memory_lives_as_long_as_its_tensors(torch):
    tensors = []
    for k in range(10):
        run = bound(w=100 + k)
        run.step("raise", outputs=[])
        tensors.append((torch.from_dlpack(run["level"]), torch.as_tensor(run.output("old", step="raise"), device="cuda")))
        run["level"].__dlpack__()  # a capsule that nobody takes
        del run
        gc.collect()
    junk = [torch.full((100, 100), 3.0, device="cuda") for _ in range(50)]
    for level, old in tensors:
        level += 1
        assert (level == 2).all() and (old == 0).all() and len(junk) == 50


@gpu
def test_empty_is_memory_to_write_to(torch):
    run = dressi.compile(PROGRAM, device=GPU).bind(turn=np.zeros((1, 3, 3)), face=[[0, 1, 2]])
    torch.from_dlpack(run.empty("level", (30, 40))).fill_(7)
    assert (run.step("raise")["old"] == 7).all()


@gpu
def test_arrays_for_cuda_are_numpys_too():
    run = bound()
    level = run["level"]
    run.step("raise")
    assert (level == 1).all() and level.sum() == 1200 and level[3, 4] == 1 and len(level) == 30 and (1 + level).max() == 2
    level[0, 0] = 5
    assert run.step("raise")["old"][0, 0] == 5
    with pytest.raises(ValueError, match="read-only"):
        run.output("old", step="raise")[0, 0] = 1


@gpu
def test_jax_sees_the_memory():
    jax = pytest.importorskip("jax")
    run = bound()
    run.step("raise", times=3)
    level = jax.dlpack.from_dlpack(run["level"])
    assert (level == 3).all() and "cuda" in str(level.device).lower()
    run["level"] = jax.numpy.full((30, 40), 8, dtype=np.float32) * 2
    assert (run.step("raise")["old"] == 16).all()


@gpu
def test_the_torch_function_is_as_on_the_host(torch):
    import dressi.torch
    from test_function import INPUTS, OUTPUTS
    from test_function import PROGRAM as SMALL
    from test_function import data

    program = dressi.compile(SMALL, device=GPU)
    for compiled in (False, True):
        made = {}
        for where in ("cuda", "cpu"):
            function = dressi.torch.function(program, "make", INPUTS, OUTPUTS)
            tensors = [torch.tensor(a, device=where) for a in data().values()]
            given = [t.float().requires_grad_() if t.is_floating_point() else t for t in tensors]
            total = lambda *g: sum((r.float() ** 2).sum() for r in function(*g))  # noqa: E731
            one, other = function(*given), function(*[g * 2 for g in given[:3]], given[3])
            assert all(t.device.type == where for t in one)
            loss = (torch.compile(total, backend="aot_eager") if compiled else total)(*given) + sum(
                (a * b).sum() for a, b in zip(one[:3], other[:3])
            )
            loss.backward()
            made[where] = [loss.detach().cpu(), *(g.grad.cpu() for g in given[:2])]
        for a, b in zip(made["cuda"], made["cpu"]):
            torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-4)


@gpu
def test_new_tensors_of_each_step_leave_nothing(torch):
    import dressi.torch

    program = dressi.compile(PROGRAM, device=GPU)
    constants = {"turn": np.zeros((1, 3, 3)), "face": [[0, 1, 2]]}
    function = dressi.torch.function(program, "look", ["level"], ["heavy"], constants=constants)

    def many(count):
        for k in range(count):
            level = torch.full((64, 64), float(k), device="cuda", requires_grad=True)
            function(level).sum().backward()
        torch.testing.assert_close(level.grad, 2 * torch.cos(level), rtol=1e-3, atol=1e-3)
        torch.cuda.synchronize()
        return torch.cuda.mem_get_info()[0]

    resource = pytest.importorskip("resource")
    free, size = many(2000), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert free - many(int(os.environ.get("DR_PYTHON_STEPS", 4000))) < 1 << 20
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - size < 4096  # KiB


def test_devices_without_cuda_say_so(device):
    found = dressi.Device(device)
    if not found.info.get("shares_memory"):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert found.cuda is None
        run = dressi.compile(PROGRAM, device=found).bind(turn=np.zeros((1, 3, 3)), face=[[0, 1, 2]])
        view = run.empty("level", (3, 4))
        assert view.shape == (3, 4) and isinstance(view, np.ndarray)
        if found.info["kind"] == "cpu":
            view[:] = 7
            assert (run.step("raise")["old"] == 7).all()
