# SPDX-License-Identifier: Apache-2.0
"""What editors and type checkers are told. The package is Python with its types beside it; what is compiled is behind the table of
ctypes, which is held to dressi.h."""
import ctypes
import importlib.util
import inspect
import os
import pathlib
import re
import subprocess
import sys

import pytest

import dressi
from dressi import _library

ROOT = pathlib.Path(__file__).parents[2]
PACKAGE = pathlib.Path(dressi.__file__).parent
HEADER = ROOT / "runtime" / "c" / "dressi.h"


def kind_of(words):
    """A type of C as the table has it: "text", "int", "size", "int64", "void", or a pointer to something."""
    words = re.sub(r"\bconst\b", "", words)
    stars, name = words.count("*"), words.replace("*", " ").split()[0]
    if stars == 0:
        return {"dressi_error_kind": "int", "size_t": "size", "int64_t": "int64"}.get(name, name)
    if name == "char":
        return "text" if stars == 1 else "texts"
    if name in ("dressi_array", "dressi_named_array", "int64_t", "size_t", "int"):
        return f"{name}*"
    return "pointer"


KINDS = {
    None: "void", ctypes.c_int: "int", ctypes.c_char_p: "text", ctypes.c_void_p: "pointer", ctypes.c_size_t: "size",
    ctypes.c_int64: "int64", ctypes.POINTER(_library.Array): "dressi_array*", ctypes.POINTER(_library.NamedArray): "dressi_named_array*",
    ctypes.POINTER(ctypes.c_int64): "int64_t*", ctypes.POINTER(ctypes.c_size_t): "size_t*", ctypes.POINTER(ctypes.c_int): "int*",
    ctypes.POINTER(ctypes.c_char_p): "texts", _library.Warn: "dressi_warn",
}  # fmt: skip


def header_functions():
    text = re.sub(r"/\*.*?\*/", "", HEADER.read_text(), flags=re.S)
    for result, name, arguments in re.findall(r"DRESSI_API ([\w\s*]+?)(\w+)\(([^)]*)\);", text):
        names = [re.sub(r"\w+\s*$", "", a) if not a.strip() == "void" else "" for a in arguments.split(",")]
        yield name, kind_of(result), [kind_of(a) for a in names if a.strip()]


def test_the_table_of_ctypes_is_the_header():
    found = {name: (result, arguments) for name, result, arguments in header_functions()}
    assert len(found) > 30 and set(found) == set(_library._functions)
    for name, (result, arguments) in _library._functions.items():
        expected = found[name]
        given = [KINDS[a] for a in arguments]
        # Bytes go in as text does, and what is no text comes out as an address.
        as_bytes = [g if e != "pointer" or g != "text" else e for g, e in zip(given, expected[1])]
        assert (KINDS[result], as_bytes) == expected, name
    version = re.search(r"#define DRESSI_ABI_VERSION (\d+)", HEADER.read_text())
    assert version and int(version[1]) == _library.ABI_VERSION
    struct = re.search(r"typedef struct dressi_array \{(.*?)\}", HEADER.read_text(), re.S)
    fields = re.findall(r"(\w+)(?=[,;])", re.sub(r"/\*.*?\*/", "", struct[1]))
    assert fields == [name for name, _ in _library.Array._fields_]


def public_functions():
    for module in ["dressi", "dressi.nvdiffrast", "dressi.torch"]:
        if module == "dressi.torch" and importlib.util.find_spec("torch") is None:
            continue
        space = importlib.import_module(module)
        for name in getattr(space, "__all__", ["function"]):
            value = getattr(space, name)
            yield f"{module}.{name}", value, None
            if inspect.isclass(value):
                for member, function in vars(value).items():
                    if isinstance(function, property):
                        function = function.fget
                    if inspect.isfunction(function) and (not member.startswith("_") or member == "__init__"):
                        yield f"{module}.{name}.{member}", function, value


# Nothing is left to say: their names are the convention of somebody else.
SAY_NOTHING = re.compile(r".*\.(__init__|get_log_level|release_context|Rasterize\w+|dtype|Device\.name)$")


def test_all_that_is_public_is_typed_and_says_what_it_does():
    count, silent = 0, []
    for name, value, owner in public_functions():
        count += 1
        documented = inspect.getdoc(value)
        if owner is None or owner.__mro__[1] is object:
            if not documented and not SAY_NOTHING.match(name):
                silent.append(name)
        if inspect.isfunction(value):
            signature = inspect.signature(value)
            for parameter in list(signature.parameters.values())[owner is not None :]:
                assert parameter.annotation is not parameter.empty, f"{name}: {parameter.name} has no type"
            assert signature.return_annotation is not signature.empty, f"{name} says not what it returns"
    assert count > 60 and not silent
    assert (PACKAGE / "py.typed").exists()


# What users write has these types, and no others: an ignore that nothing needs is an error.
USED = """# mypy: warn-unused-ignores
import dressi
import dressi.nvdiffrast as dr
import numpy as np

device = dressi.Device(0)
name: str = device.info["name"]
shares: bool = device.info["shares_memory"]
wrong: str = device.info["shares_memory"]  # type: ignore[assignment]
program = dressi.compile("fit.dr", device=0)
dressi.load(bytearray(program.bundle), device=device)
dressi.load(memoryview(program.bundle)).bind(symbols={"V": np.int64(3)}).step(times=np.int64(3))

zeros = np.zeros((1, 3, 4), np.float32)
context = dr.RasterizeVkContext(device)
rast: np.ndarray = dr.rasterize(context, zeros, zeros, (8, 8))[0]
out: np.ndarray = dr.interpolate(zeros, rast, zeros, rast, "all")[0]
seen: np.ndarray = dr.antialias(dr.texture(zeros, out, out), rast, zeros, zeros)
"""
USED_WITH_TORCH = """
import dressi.torch
import torch

tensor = torch.zeros(1, 3, 4)
render = dressi.torch.function(program, "render", ["position"], ["picture"])
loss: torch.Tensor = ((render(tensor) - tensor) ** 2).mean()
no_function: str = render  # type: ignore[assignment]
image: torch.Tensor = dr.rasterize(context, tensor, zeros, (8, 8))[0]
mixed: torch.Tensor = dr.interpolate(zeros, image, zeros)[0]
soft: torch.Tensor = dr.antialias(dr.texture(zeros, mixed), image, tensor, zeros)
with dr.DepthPeeler(context, tensor, zeros, (8, 8)) as peeler:
    layer: torch.Tensor = peeler.rasterize_next_layer()[0]
color = dr.texture(tensor, zeros)
no_array: np.ndarray = color  # type: ignore[assignment]
seen_of_arrays: torch.Tensor = seen  # type: ignore[assignment]
"""


def test_a_type_checker_agrees(tmp_path):
    if subprocess.run([sys.executable, "-m", "mypy", "--version"], capture_output=True).returncode != 0:
        pytest.skip("no mypy")
    command = [sys.executable, "-m", "mypy", "--disallow-untyped-defs", "--check-untyped-defs", "--ignore-missing-imports"]
    more = USED_WITH_TORCH if importlib.util.find_spec("torch") else ""
    (tmp_path / "used.py").write_text(USED + more)
    done = subprocess.run(
        [*command, "--cache-dir=/dev/null", "-p", "dressi", "-m", "used"],
        cwd=PACKAGE.parent, env={**os.environ, "MYPYPATH": str(tmp_path)}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout


def test_what_docstrings_name_is_there():
    checked = 0
    for file in sorted(PACKAGE.rglob("*.py")):
        text = file.read_text()
        for name in re.findall(r"`(?:dressi|Run|Program|Device)\.[\w.]+", text):
            name = name.strip("`")
            value = dressi
            for part in name.removeprefix("dressi.").split("."):
                if inspect.ismodule(value) and not hasattr(value, part):
                    value = importlib.import_module(f"{value.__name__}.{part}")
                else:
                    value = getattr(value, part)
            checked += 1
        for module in re.findall(r"`std\.(\w+)", text):
            assert (ROOT / "stdlib" / "std" / f"{module}.dr").exists(), f"{file.name}: std.{module}"
            checked += 1
        for path in re.findall(r"\(?((?:docs|runtime|tests)/[\w/.]+\.(?:h|md|py))", text):
            assert (ROOT / path).exists(), f"{file.name}: {path}"
            checked += 1
    assert checked >= 5


def test_what_the_page_about_python_names_is_there():
    page = (ROOT / "docs" / "howto" / "python.md").read_text()
    owners = {"dressi": dressi, "run": dressi.Run, "program": dressi.Program, "dr": importlib.import_module("dressi.nvdiffrast")}
    # What a run has of its own, and modules, are no attributes of a class.
    named = set(re.findall(r"\b(dressi|run|program|dr)\.(\w+)", page)) - {("dressi", "h"), ("dressi", "torch"), ("run", "symbols")}
    assert len(named) >= 20
    for owner, name in sorted(named):
        assert hasattr(owners[owner], name) or importlib.util.find_spec(f"dressi.{name}"), f"{owner}.{name}"
