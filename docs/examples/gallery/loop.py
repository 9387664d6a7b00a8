#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""A search of one's own around a program: Barzilai's and Borwein's steps, which ask it for an error and its slope. usage: loop.py [DEVICE]"""
import sys
from pathlib import Path

import dressi
import numpy as np

SIZE = 64
TRUTH = np.array([0.3, 0.8, -0.2])


def search(device, most=100):
    """The lamp that is found, and the error at each call."""
    program = dressi.compile(str(Path(__file__).with_name("loop.dr")), device=device)
    run = program.bind(photo=np.zeros((SIZE, SIZE)), lamp=TRUTH)
    run["photo"] = run.step("gradient", outputs=["drawn"])["drawn"]
    errors = []

    def slope_at(lamp):
        run["lamp"] = lamp
        out = run.step("gradient", outputs=["error", "slope"])
        errors.append(float(out["error"]))
        return np.asarray(out["slope"], np.float64).ravel()

    lamp = np.array([0.0, 1.0, 0.0])
    slope, rate = slope_at(lamp), 0.1
    while len(errors) < most and np.abs(slope).max() > 1e-7:
        further = lamp - rate * slope
        next_slope = slope_at(further)
        moved, turned = further - lamp, next_slope - slope
        rate = abs(moved @ turned) / (turned @ turned)
        lamp, slope = further, next_slope
    return lamp, errors


if __name__ == "__main__":
    found, errors = search(sys.argv[1] if len(sys.argv) > 1 else "lavapipe")
    print(f"{len(errors)} calls; the lamp is {np.abs(found - TRUTH).max():.2g} off, the error {errors[0]:.2g} -> {errors[-1]:.2g}")
