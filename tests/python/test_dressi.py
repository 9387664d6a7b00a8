# SPDX-License-Identifier: Apache-2.0
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
import warnings

import numpy as np
import pytest

import dressi
from conftest import DEVICES

FIT = """edition 1;
param offset : vec3;
input position : vec3[V];
input target : vec3[V];
let moved = position + offset;
let error = mean(dot(moved - target, moved - target));
step fit {
  offset <- offset - 0.1 * grad(error, offset);
  output error;
}
"""

SHAPES = """edition 1;
input list : vec3[V];
input picture : float[W, H];
input views : vec3[W, H, N];
input pose : mat4[N];
input face : ivec3[F];
input turn : mat3;
step copy {
  output list_ = list * 1.0;
  output picture_ = picture + 1.0;
  output views_ = views * 2.0;
  output pose_ = pose * 1.0;
  output moved = pose * vec4(1.0, 2.0, 3.0, 1.0);
  output face_ = face + ivec3(1);
  output turned = turn * vec3(1.0, 2.0, 3.0);
}
"""


def cloud(count=50, seed=1):
    random = np.random.default_rng(seed)
    return random.normal(size=(count, 3)).astype(np.float32)


def test_a_fit_in_ten_lines(device):
    position = cloud()
    program = dressi.compile(FIT, device=device)
    run = program.bind(position=position, target=position + [1.0, 2.0, 3.0], offset=np.zeros(3))
    first = run.step("fit")["error"]
    last = run.step("fit", times=100)["error"]
    assert first == pytest.approx(14.0, rel=1e-5)
    assert last < 1e-6
    np.testing.assert_allclose(run["offset"], [1, 2, 3], atol=1e-4)


def test_arrays_have_natural_shapes(device):
    random = np.random.default_rng(2)
    v, w, h, n, f = 5, 4, 3, 2, 6
    data = {
        "list": random.normal(size=(v, 3)),
        "picture": random.normal(size=(h, w)),
        "views": random.normal(size=(n, h, w, 3)),
        "pose": random.normal(size=(n, 4, 4)),
        "face": random.integers(0, 100, size=(f, 3)),
        "turn": random.normal(size=(3, 3)),
    }
    program = dressi.compile(SHAPES, device=device)
    assert program.leaves["views"] == "vec3[W, H, N]"
    out = program.bind(data).step("copy")
    for name, factor, more in [("list", 1, 0), ("picture", 1, 1), ("views", 2, 0), ("pose", 1, 0), ("face", 1, 1)]:
        np.testing.assert_allclose(out[name + "_"], data[name] * factor + more, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(out["moved"], data["pose"] @ np.array([1, 2, 3, 1.0]), rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(out["turned"], data["turn"] @ np.array([1, 2, 3.0]), rtol=1e-4, atol=1e-5)
    assert out["face_"].dtype == np.int32


@pytest.mark.parametrize(
    "name, value, words",
    [
        ("position", np.zeros((5, 2)), ["'position' is vec3[V]", "(V, 3)", "(5, 2)"]),
        ("position", np.zeros((0, 3)), ["(V, 3)", "(0, 3)"]),
        ("position", np.zeros((5, 3), complex), ["float32", "complex128"]),
        ("positon", np.zeros((5, 3)), ["no leaf 'positon'", "did you mean 'position'"]),
        ("position", [[1, 2], [3]], ["'position' cannot be read as an array"]),
        ("position", np.full((50, 3), "x"), ["float32"]),
    ],
)
def test_wrong_data_is_told_with_what_was_expected(name, value, words):
    program = dressi.compile(FIT, device="reference")
    with pytest.raises(dressi.BindError) as error:
        program.bind({name: value})
    for word in words:
        assert word in str(error.value)


def masked():
    return np.ma.masked_array(np.zeros((5, 3)), np.eye(5, 3) > 0)


@pytest.mark.parametrize(
    "call, kind, words",
    [
        (lambda p: p.bind(position=masked()), dressi.BindError, "masked array"),
        (lambda p: p.bind(position=np.full((5, 3), 1e300)), dressi.BindError, "1e\\+300 does not fit float32"),
        (lambda p: p.bind({1: 2}), TypeError, "a leaf is named by text, such as 'offset', found 1"),
        (lambda p: p.bind(symbols={"V": 2.5}), TypeError, "symbol 'V': expected a whole number, found 2.5"),
        (lambda p: p.bind(symbols={"V": 2**70}), dressi.BindError, "is too large"),
        (lambda p: p.bind(symbols={"V\0": 3}), dressi.BindError, "the name of a symbol contains a zero byte"),
        (lambda p: p.bind(symbols=1.0), TypeError, "symbols: expected a dict of names and counts, found 1.0"),
        (lambda p: dressi.Device("lavapipe\0"), dressi.DeviceError, "the name of a device contains a zero byte"),
        (lambda p: dressi.Device("\ud800"), dressi.DeviceError, "the name of a device is not valid Unicode"),
        (lambda p: p.explain_grad(None, "x"), TypeError, "expected text for the name of a loss, found None"),
        (lambda p: p.bind(symbols={"V": 0}), dressi.BindError, "not between 1 and 2\\^31"),
        (lambda p: p.bind().step("fit", times=1.5), TypeError, "times: expected a whole number, found 1.5"),
        (lambda p: p.bind().empty("position"), dressi.BindError, "V has no value yet: bind a leaf that has it"),
        (lambda p: p.bind().empty("position", (-1, 3)), dressi.BindError, "found \\(-1, 3\\)"),
        (lambda p: p.bind().watch(-5), dressi.Error, "expected a port from 1 to 65535, or 0 for any, found -5"),
        (lambda p: dressi.compile("a\0b.dr"), dressi.CompileError, "the file's name contains a zero byte"),
        (lambda p: dressi.load("a\0b.drb"), dressi.Error, "the file's name contains a zero byte"),
        (lambda p: p.bind().watch("here"), TypeError, "port: expected a whole number, found 'here'"),
        (lambda p: dressi.compile("edition 1;\n\0\n", device="lavapipe"), dressi.CompileError, "zero byte"),
        (lambda p: dressi.compile("edition 1;\n// \udc80\n"), dressi.CompileError, "the program is not valid Unicode"),
        (lambda p: dressi.compile(""), dressi.CompileError, "expected the name of a file or the text of a program"),
        (lambda p: dressi.compile(None), TypeError, "expected the name of a file or the text of a program, found a NoneType"),
    ],
)
def test_what_was_not_meant_is_told(call, kind, words):
    program = dressi.compile(FIT, device="reference")
    if kind is dressi.BindError and "1e" in words:
        program = dressi.compile(FIT, device=DEVICES[-1]) if len(DEVICES) > 1 else pytest.skip("the evaluator takes it")
    with pytest.raises(kind, match=words):
        call(program)


def test_tensors_of_torch_that_are_no_arrays():
    torch = pytest.importorskip("torch")
    run = dressi.compile(FIT, device="reference").bind(target=np.zeros((2, 3)), offset=np.zeros(3))
    for tensor in (torch.ones(2, 3).bfloat16(), torch._neg_view(-torch.ones(2, 3)), torch.ones(2, 3, requires_grad=True)):
        assert run.bind(position=tensor).step("fit", outputs="error")["error"] > 0
    for tensor in (torch.ones(2, 3).to_sparse(), torch.ones(2, 3, device="meta")):
        with pytest.raises(dressi.BindError, match="'position' cannot be read as an array"):
            run.bind(position=tensor)
    with pytest.raises(dressi.BindError, match="complex"):
        run.bind(position=torch.ones(2, 3, dtype=torch.complex64).conj())


MATRICES = """edition 1;
input a : mat2x3[N];
param b : mat3x2 = mat3x2(vec2(1.0, 2.0), vec2(3.0, 4.0), vec2(5.0, 6.0));
step copy { output a_ = 2.0 * a, b_ = b + mat3x2(0.0), moved = a * vec2(1.0, 2.0), square = b * a, c = mat2x4(1.0); }
"""


def test_matrices_that_are_not_square_have_rows_first(device):
    program = dressi.compile(MATRICES, device=device)
    assert program.leaves == {"a": "mat2x3[N]", "b": "mat3x2"}
    types = {"a_": "mat2x3[N]", "b_": "mat3x2", "moved": "vec3[N]", "square": "mat2[N]", "c": "mat2x4"}
    assert program.outputs("copy") == types
    a, b = np.random.default_rng(1).normal(size=(5, 3, 2)).astype(np.float32), np.arange(1, 7).reshape(3, 2).T
    run = program.bind(a=a)
    np.testing.assert_array_equal(run["b"], b)
    for given in (b, 10 * b):
        run["b"] = given
        out = run.step()
        np.testing.assert_array_equal(run["a"], a)
        np.testing.assert_array_equal(run["b"], given)
        np.testing.assert_array_equal(out["a_"], 2 * a)
        np.testing.assert_array_equal(out["b_"], given)
        np.testing.assert_array_equal(run.output("b_"), given)
        np.testing.assert_allclose(out["moved"], a @ [1, 2], rtol=1e-5)
        np.testing.assert_allclose(out["square"], given @ a, rtol=1e-5, atol=1e-5)
        np.testing.assert_array_equal(out["c"], np.eye(4, 2))
    assert run.empty("a").shape == (5, 3, 2)
    with pytest.raises(dressi.BindError, match=r"'a' is mat2x3\[N\]: expected an array of shape \(N, 3, 2\), found \(5, 2, 3\)"):
        run["a"] = a.swapaxes(1, 2)


EDGES = """edition 1;
input face : ivec3[F];
input long : float[face_edges];
input pair : vec2[face_edges + V];
step s { output edges = topology(face).edge_faces, total = sum(long) + sum(pair.x); }
"""


def test_extents_that_count_edges_are_known_by_the_faces(device):
    program = dressi.compile(EDGES, device=device)
    for face, edges in ([[0, 1, 2], [0, 2, 3]], 5), ([[0, 1, 1], [2, 2, 2]], 1), ([[0, 0, 0]], 1):
        run = program.bind(face=face, symbols={"V": 2})
        assert run.empty("long").shape == (edges,) and run.empty("pair").shape == (edges + 2, 2)
        assert len(run.step()["edges"]) == edges
        on_gpu = dressi.CudaArray(run, "edges", "s", program.output_types["s"]["edges"])
        assert on_gpu.shape == (edges,)
    with pytest.raises(dressi.BindError, match="V and face_edges have no value yet: bind a leaf that has them"):
        program.bind().empty("pair")


def test_integers_that_do_not_fit_are_told():
    program = dressi.compile("edition 1;\ninput i : int[V];\nstep s { output o = i; }\n", device="reference")
    with pytest.raises(dressi.BindError, match="3000000000 does not fit int32"):
        program.bind(i=[1, 3_000_000_000])
    with pytest.raises(dressi.BindError, match="expected scalars of type int32, found float64"):
        program.bind(i=[0.5])


def test_extents_agree_and_a_failed_bind_leaves_nothing(device):
    run = dressi.compile(FIT, device=device).bind(position=cloud(5))
    with pytest.raises(dressi.BindError):
        run.bind(target=cloud(6))
    run.bind(target=cloud(5), offset=np.zeros(3))
    assert run.step()["error"] >= 0


def test_names_alone_and_symbols_that_are_words_of_python(tmp_path):
    (tmp_path / "twice.dr").write_text("edition 1;\nfn of(x: float) -> float { 2.0 * x }\n")
    text = "edition 1;\nimport twice;\nparam a : float[lambda];\nstep look { output tot = sum(twice.of(a)); }\n"
    program = dressi.compile(text, device="reference", include=str(tmp_path))
    assert program.bind(a=[1, 2]).empty("a").shape == (2,)
    adjoint = program.with_adjoint("look", "a", "tot").bind({"a": [1, 2], "look.adjoint.tot": 3.0})
    assert adjoint.step("look.adjoint")["a"].tolist() == [6, 6]


def test_a_run_keeps_its_sizes():
    text = "edition 1;\ninput face : ivec3[F];\nstep s { output edges = topology(face).edge_faces; }\n"
    for device in DEVICES[1:]:
        run = dressi.compile(text, device=device).bind(face=[[0, 1, 2], [0, 2, 3]])
        assert len(run.step()["edges"]) == 5
        with pytest.raises(dressi.BindError, match="'F' is 2 since leaf 'face' was first bound, but 1 now: a run keeps its sizes"):
            run.bind(face=[[0, 1, 2]])
        with pytest.raises(dressi.BindError, match="a topology of 6 for 'edge', and had one of 5 when it was first bound"):
            run.bind(face=[[0, 1, 2], [3, 4, 5]])
        assert len(run.bind(face=[[0, 1, 3], [0, 3, 2]]).step()["edges"]) == 5


def test_diagnostics_keep_line_and_caret():
    with pytest.raises(dressi.CompileError) as error:
        dressi.compile("edition 1;\nlet x = vec3(1.0) + vec4(1.0);\n", device="reference")
    assert "<program>:2:" in str(error.value) and "^" in str(error.value)
    with pytest.raises(dressi.CompileError, match="cannot read 'nowhere.dr'"):
        dressi.compile("nowhere.dr")


def test_steps_and_outputs_that_are_not_there_are_told(device):
    run = dressi.compile(FIT, device=device).bind(position=cloud(), target=cloud(), offset=np.zeros(3))
    for call, words in [
        (lambda: run.step("fti"), "no step 'fti'; there are fit"),
        (lambda: run.step("fit", times=0), "at least one run"),
        (lambda: run.step("fit", outputs=["los"]), "no output 'los'; there are error"),
        (lambda: run["ofset"], "did you mean 'offset'"),
        (lambda: run.bind(symbols={None: 3}), "expected the name of a symbol, found None"),
    ]:
        with pytest.raises(dressi.Error, match=words):
            call()
    # Whatever gives the names, each is fetched.
    assert list(run.step("fit", outputs=(name for name in ["error"]))) == ["error"]


def test_a_file_that_is_no_text_is_told(tmp_path):
    (tmp_path / "bad.dr").write_bytes(b"edition 1;\nstep s { output x = 1.0; }  // \xff\n")
    with pytest.raises(dressi.CompileError, match="bad.dr:2: expected text in UTF-8, found the byte 0xff"):
        dressi.compile(str(tmp_path / "bad.dr"), device="reference")


@pytest.mark.parametrize("device", [name for name in DEVICES if name != "reference"])  # which has no commands to look behind
def test_warnings_that_are_errors_stop_a_run(device):
    text = "edition 1;\nparam x : float = 1.0;\nstep s { x <- x * 1e30; output y = x; }\n"
    run = dressi.compile(text, device=device).bind()
    with warnings.catch_warnings():
        warnings.simplefilter("error", dressi.NotFiniteWarning)
        assert run.check_finite("s") is None
        with pytest.raises(dressi.NotFiniteWarning):
            run.step("s", times=1000)
        found = run.check_finite("s")
    assert found is not None


def test_defines_bundles_and_the_reference(device, tmp_path):
    text = "edition 1;\nconst K : int = 2;\ninput a : float[W];\nstep s { output b = a * float(K); }\n"
    program = dressi.compile(text, device=device, defines={"K": 5})
    a = np.arange(4.0)
    np.testing.assert_array_equal(program.bind(a=a).step()["b"], a * 5)
    program.save(tmp_path / "five.drb")
    again = dressi.load(tmp_path / "five.drb", device=device)
    np.testing.assert_array_equal(again.bind(a=a).step()["b"], a * 5)
    np.testing.assert_array_equal(dressi.reference(program).bind(a=a).step()["b"], a * 5)
    copied = pickle.loads(pickle.dumps(program))
    np.testing.assert_array_equal(copied.bind(a=a).step()["b"], a * 5)
    with pytest.raises(TypeError, match="cannot be pickled"):
        pickle.dumps(program.bind(a=a))


def test_arrays_outlive_their_run(device):
    def picture():
        run = dressi.compile(FIT, device=device).bind(position=cloud(), target=cloud(), offset=np.ones(3))
        return run.step()["error"], run["position"]

    error, position = picture()
    junk = [np.zeros(1000) for _ in range(100)]
    assert len(junk) == 100 and error > 0
    np.testing.assert_array_equal(position, cloud())


def test_tensors_of_other_libraries_come_in_by_dlpack():
    class Tensor:
        def __init__(self, array):
            self.array = array

        def __dlpack__(self, **_):
            return self.array.__dlpack__()

        def __dlpack_device__(self):
            return self.array.__dlpack_device__()

    position = cloud()
    run = dressi.compile(FIT, device="reference").bind(position=Tensor(position), target=position, offset=np.zeros(3))
    assert run.step()["error"] == 0


def test_non_contiguous_arrays_are_copied_right(device):
    wide = np.random.default_rng(3).normal(size=(5, 6)).astype(np.float32)
    program = dressi.compile("edition 1;\ninput a : float[W, H];\nstep s { output b = a + 0.0; }\n", device=device)
    np.testing.assert_array_equal(program.bind(a=wide[::2, ::-1]).step()["b"], wide[::2, ::-1])
    np.testing.assert_array_equal(program.bind(a=wide.T).step()["b"], wide.T)


def test_the_order_of_bytes_is_looked_at(device):
    values = np.arange(6, dtype=">f4").reshape(2, 3)
    program = dressi.compile("edition 1;\ninput a : float[W, H];\nstep s { output b = a + 0.0; }\n", device=device)
    np.testing.assert_array_equal(program.bind(a=values).step()["b"], values)
    np.testing.assert_array_equal(program.bind(a=values.astype(">f8")).step()["b"], values)


def test_two_threads_use_one_device(device):
    results = {}

    def fit(seed):
        position = cloud(seed=seed)
        run = dressi.compile(FIT, device=device).bind(position=position, target=position + seed, offset=np.zeros(3))
        run.step("fit", times=200)
        results[seed] = run["offset"]

    threads = [threading.Thread(target=fit, args=(seed,)) for seed in (1, 2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for seed in (1, 2):
        np.testing.assert_allclose(results[seed], np.full(3, seed), atol=1e-3)


def test_new_arrays_every_step_do_not_pile_up():
    resource = pytest.importorskip("resource")
    run = dressi.compile(FIT, device="reference").bind(position=cloud(), target=cloud(), offset=np.zeros(3))

    def many():
        for seed in range(300):
            run["target"] = cloud(seed=seed)
            run.step()

    many()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for _ in range(4):
        many()
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 4096  # KiB


@pytest.mark.skipif(not os.environ.get("DR_LAVAPIPE_ICD"), reason="no lavapipe")
def test_a_limit_of_the_device_is_an_error_of_the_device():
    program = dressi.compile("edition 1;\nparam x : mat4[V] = mat4(1.0);\nstep s { x <- x * 2.0; output x; }\n", device="lavapipe")
    run = program.bind(symbols={"V": 2_000_000_000})
    for call in (run.step, run.timing, lambda: run.step(times=2), lambda: run["x"]):
        with pytest.raises(dressi.DeviceError, match="the device allows"):
            call()


def test_a_fork_is_told_about_the_device(device):
    run = dressi.compile(FIT, device=device).bind(position=cloud(), target=cloud(), offset=np.zeros(3))
    run.step()
    pid = os.fork()
    if pid == 0:
        try:
            run.step()
        except dressi.DeviceError as error:
            os._exit(0 if "forked" in str(error) else 2)
        os._exit(1)
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0


def test_an_interrupt_ends_a_run_after_its_step():
    program = """
import signal, sys, dressi, numpy as np
text = '''%s'''
run = dressi.compile(text, device="reference").bind(position=np.ones((20, 3)), target=np.ones((20, 3)), offset=np.zeros(3))
print("ready", flush=True)
try:
    run.step("fit", times=10**9)
except KeyboardInterrupt:
    print("offset", run["offset"].shape, flush=True)
""" % FIT
    child = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    assert child.stdout.readline() == "ready\n"
    time.sleep(0.5)
    child.send_signal(signal.SIGINT)
    out, _ = child.communicate(timeout=30)
    assert out == "offset (3,)\n" and child.returncode == 0


def test_import_is_quick_and_needs_no_vulkan():
    environment = {**os.environ, "VK_DRIVER_FILES": "/dev/null", "VK_ICD_FILENAMES": "/dev/null"}
    code = "import time; t = time.perf_counter(); import dressi; print(time.perf_counter() - t, 'numpy' in __import__('sys').modules)"
    seconds, numpy = subprocess.check_output([sys.executable, "-c", code], env=environment, text=True).split()
    assert numpy == "False"
    assert float(seconds) < 5  # it takes some hundredths of a second; a loaded machine may take longer


def test_a_bundle_that_lets_loops_run_on(device):
    text = "edition 1;\ninput a : float[W];\nstep s { output b = reduce(sum, i in 0..W) { a.at(i) }; }\n"
    bundle = dressi.compile(text, device="reference", profile="swiftshader").bundle
    program = dressi.load(bundle, device=device)
    if device != "lavapipe":
        assert program.bind(a=np.ones(9)).step()["b"] == 9
        return
    with pytest.raises(dressi.Error, match="whose devices let loops run on"):
        program.bind(a=np.ones(9))


def test_a_program_of_one_line_is_text_and_no_name(device, tmp_path, monkeypatch):
    line = "edition 1; input a : float; step s { output twice = 2.0 * a; }"
    assert dressi.compile(line, device=device).bind(a=3).step("s")["twice"] == 6
    with pytest.raises(dressi.CompileError, match="cannot read 'no such file.dr'"):
        dressi.compile("no such file.dr", device=device)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "odd;name.dr").write_text(line.replace("2.0", "5.0") + "\n")
    assert dressi.compile("odd;name.dr", device=device).bind(a=3).step("s")["twice"] == 15


KNOWN = """edition 1;
input strength : float = 1.0;
input tint : vec3;
input many : float[4];
param a : float = 0.5;
fn layered(factor: float, a: float) -> float { const if known_zero(factor) { a } else { factor * exp(a) + a } }
step go { output y = layered(strength, a) + layered(tint.x, a) + sum(many); }
"""


def test_what_is_known_when_a_program_is_compiled(device):
    data = {"tint": [0.0, 0.0, 0.0], "many": np.zeros(4, np.float32)}
    open_to_all = dressi.compile(KNOWN, device=device).bind(strength=0.0, **data).step("go")["y"]
    for tint in (0, [0, 0, 0], np.zeros(3)):
        program = dressi.compile(KNOWN, device=device, known={"strength": 0, "tint": tint})
        run = program.bind(many=data["many"])
        assert run.step("go")["y"] == open_to_all == 1.0
        for same in (0, 0.0, -0.0, np.float32(0)):
            assert program.bind(strength=same, **data).step("go")["y"] == 1.0
        with pytest.raises(dressi.BindError, match="'strength' was given"):
            program.bind(strength=2.0)
        with pytest.raises(dressi.BindError, match="'tint' was given"):
            program.bind(tint=[0.0, 1.0, 0.0])
        assert program.bind(**data).step("go")["y"] == 1.0
    # What is not zero makes nothing zero, and stays open.
    other = dressi.compile(KNOWN, device=device, known={"strength": 2.0}).bind(**data)
    assert other.step("go")["y"] == pytest.approx(1.0 + 2.0 * np.exp(0.5), rel=1e-6)


def test_scalars_of_numpy_define_consts():
    text = "edition 1;\nconst ON : bool = true;\nconst K : int = 1;\nconst X : float = 0.0;\n"
    text += "step s { output y = const if ON { X } else { float(K) }; }\n"
    for off in (False, np.bool_(False), np.array(False)):
        assert dressi.compile(text, device="reference", defines={"ON": off, "K": np.int64(7)}).bind().step()["y"] == 7
    for x in (0.25, np.float32(0.25), np.array(0.25)):
        assert dressi.compile(text, device="reference", defines={"ON": np.bool_(True), "X": x}).bind().step()["y"] == 0.25


def test_programs_find_their_modules_from_another_folder(tmp_path, monkeypatch):
    for place, factor in (("here", 2), ("there", 3)):
        (tmp_path / place / "more").mkdir(parents=True)
        (tmp_path / place / "helper.dr").write_text(f"edition 1;\nfn scaled(x: float) -> float {{ {factor}.0 * x }}\n")
        (tmp_path / place / "more" / "extra.dr").write_text(f"edition 1;\nfn moved(x: float) -> float {{ x + {factor}.0 }}\n")
    text = "edition 1;\nimport helper;\nimport extra;\ninput x : float;\nstep s { output y = helper.scaled(extra.moved(x)); }\n"
    (tmp_path / "here" / "main.dr").write_text(text)
    monkeypatch.chdir(tmp_path / "here")
    programs = [dressi.compile(source, device="reference", include=["more"]) for source in ("main.dr", text)]
    programs += [pickle.loads(pickle.dumps(program)) for program in programs]
    for place in ("here", "there", ""):
        monkeypatch.chdir(tmp_path / place)
        for program in programs:
            adjoint = program.with_adjoint("s", ["x"], ["y"])
            run = adjoint.with_adjoint("s.adjoint", ["s.adjoint.y"], ["x"]).bind({"x": 1, "s.adjoint.y": 1})
            assert run.step("s")["y"] == 6 and run.step("s.adjoint")["x"] == 2
            assert program.explain_grad("y", "x").flows


def test_options_given_twice():
    from dressi import _program
    for key, first, second in (("known:strength", "0", "0.5"), ("define:K", "1", "1")):
        with pytest.raises(dressi.CompileError, match=f"'{key}' is given twice, as '{first}' and '{second}'"):
            _program._compiled("p.dr", KNOWN, [(key, first), ("lower", "auto"), (key, second)], "reference")


def test_a_bundle_takes_no_options_of_compiling(tmp_path):
    file = tmp_path / "p.drb"
    dressi.compile(KNOWN, device="reference").save(file)
    assert dressi.compile(file, device="reference").steps == ["go"]
    with pytest.raises(TypeError, match="p.drb' is compiled already: known, pack must be given where"):
        dressi.compile(file, device="reference", known={"strength": 0}, pack="naive")
    file.write_bytes(file.read_bytes()[:1000])
    with pytest.raises(dressi.Error, match="p.drb': the bundle is cut off: it has 1000 of "):
        dressi.load(file)


@pytest.mark.parametrize("wrong", [{"strenght": 0}, {"a": 0}, {"many": 0}, {"many": [0, 0, 0, 0]}, {"tint": [0, 0]},
                                   {"strength": []}, {"strength": float("nan")}])
def test_what_cannot_be_known(wrong):
    with pytest.raises(dressi.CompileError, match="known"):
        dressi.compile(KNOWN, known=wrong)
