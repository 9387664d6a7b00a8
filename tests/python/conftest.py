# SPDX-License-Identifier: Apache-2.0
"""Devices for the tests: the evaluator everywhere, lavapipe where it is, and the GPU that DR_PYTHON_GPU names."""
import os

import pytest

DEVICES = ["reference"] + (["lavapipe"] if os.environ.get("DR_LAVAPIPE_ICD") else [])
DEVICES += [os.environ["DR_PYTHON_GPU"]] if os.environ.get("DR_PYTHON_GPU") else []


@pytest.fixture(params=DEVICES)
def device(request):
    return request.param
