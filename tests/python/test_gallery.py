# SPDX-License-Identifier: Apache-2.0
"""The Python loop of docs/examples/gallery finds its lamp."""
import importlib.util
from pathlib import Path

import numpy as np


def test_loop_finds_the_lamp(device):
    file = Path(__file__).resolve().parents[2] / "docs/examples/gallery/loop.py"
    spec = importlib.util.spec_from_file_location("gallery_loop", file)
    loop = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loop)
    lamp, errors = loop.search(device)
    assert np.abs(lamp - loop.TRUTH).max() < 1e-5
    assert errors[-1] < 1e-9 * errors[0]
