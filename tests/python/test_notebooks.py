# SPDX-License-Identifier: Apache-2.0
"""The notebooks of the documentation run, and what notebooks show is well formed."""
import json
import os
import pathlib
import zlib

import numpy as np
import pytest

import dressi

FOLDER = pathlib.Path(__file__).parents[2] / "docs" / "notebooks"
lavapipe = pytest.mark.skipif(not os.environ.get("DR_LAVAPIPE_ICD"), reason="no lavapipe")


def run_cells(name):
    """The names that a notebook's cells define: those before PyTorch is wanted, where it is not there."""
    names = {}
    for cell in json.loads((FOLDER / f"{name}.ipynb").read_text())["cells"]:
        assert not cell.get("outputs"), "notebooks are kept without outputs"
        source = "".join(cell["source"])
        if cell["cell_type"] != "code":
            continue
        if "import torch" in source:
            names["has_torch"] = True
            try:
                import torch  # noqa: F401
            except ImportError:
                return {**names, "has_torch": False}
        exec(compile(source, f"{name}.ipynb", "exec"), names)
    return names


@lavapipe
def test_the_first_fit():
    names = run_cells("first_fit")
    np.testing.assert_allclose(names["run"]["center"], [37, 29], atol=0.01)
    np.testing.assert_allclose(names["run"]["radius"], 12.5, atol=0.01)
    if names["has_torch"]:
        np.testing.assert_allclose(names["center"].detach(), [37, 29], atol=0.01)


@lavapipe
def test_a_texture_by_nvdiffrast():
    names = run_cells("texture_by_nvdiffrast")
    assert 0.3 < names["photo"].max() <= 1.001
    if names["has_torch"]:
        assert names["loss"].item() < 1e-3


@pytest.mark.parametrize("shape", [(3, 5), (3, 5, 1), (3, 5, 2), (3, 5, 3), (3, 5, 4)])
def test_pictures_are_png(shape):
    png = dressi.Picture(np.linspace(-0.5, 1.5, int(np.prod(shape))).reshape(shape))._repr_png_()
    assert png[:8] == b"\x89PNG\r\n\x1a\n" and png[16:24] == b"\0\0\0\5\0\0\0\3"
    start = png.index(b"IDAT") + 4
    rows = zlib.decompress(png[start : start + int.from_bytes(png[start - 8 : start - 4], "big")])
    channels = {0: 1, 2: 3, 6: 4}[png[25]]
    assert len(rows) == 3 * (1 + 5 * channels) and rows[1] == 0 and rows[-1] in (0, 255)
    with pytest.raises(dressi.Error, match="for a picture"):
        dressi.Picture(np.zeros((2, 2, 5)))


PROGRAM = """edition 1;
param a : float[W] = 1.0;
let wrong = log(a);
step s { a <- a - 1.0;  output wrong; }
"""


@lavapipe
def test_the_first_nan_is_told_with_its_line_and_nothing_changes():
    run = dressi.compile(PROGRAM, device="lavapipe").bind(symbols={"W": 4})
    assert run.check_finite() is None
    run.step()
    found = run.check_finite()
    assert "-Inf" in str(found) and "<program>:3" in str(found) and found.element == (0, 0, 0)
    assert (run["a"] == 0).all() and run.counters().runs == 1


@lavapipe
def test_a_nan_is_found_in_programs_of_meshes():
    text = """edition 1;
import std.random;
param x : float[V];
param noise : float[3] = random.uniform(coord(3), 1u);
input face : ivec3[F];
let t = topology(face);
step s { x <- x - 1.0;  output y = log(x), e = t.edge_faces, n = noise; }
"""
    run = dressi.compile(text, device="lavapipe").bind(x=np.ones(3), face=[[0, 1, 2]])
    assert run.check_finite() is None
    run.step()
    assert "<program>:7" in str(run.check_finite())


@lavapipe
def test_tables_of_notebooks():
    program = dressi.compile(PROGRAM, device="lavapipe")
    assert "<td>float[W]</td>" in program._repr_html_()
    run = program.bind(symbols={"W": 4})
    run.step()
    timing = run.timing()
    assert timing.milliseconds >= 0 and "<program>:" in str(timing) and timing._repr_html_().startswith("<table>")
    assert "left out" in run.counters()._repr_html_()
    with pytest.raises(AttributeError, match="no counter 'steps'"):
        run.counters().steps


def test_notebooks_show_diagnostics_instead_of_a_traceback():
    with pytest.raises(dressi.CompileError) as error:
        dressi.compile("edition 1;\nlet x = 1.0 +;\n", device="reference")
    shown = error.value._render_traceback_()
    assert shown[0].startswith("<program>:2:") and any("^" in line for line in shown)
