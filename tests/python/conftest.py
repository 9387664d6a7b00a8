# SPDX-License-Identifier: Apache-2.0
"""Devices for the tests: the evaluator everywhere, lavapipe and SwiftShader where they are."""
import os

import pytest

DEVICES = ["reference"] + (["lavapipe"] if os.environ.get("DR_LAVAPIPE_ICD") else [])


@pytest.fixture(params=DEVICES)
def device(request):
    return request.param
