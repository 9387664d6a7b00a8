# SPDX-License-Identifier: Apache-2.0
"""The dense target of figure10.sh and figure11.sh: a star-shaped surface somewhat like a skull."""
import numpy as np


def skull(direction):
    """Distance from the origin of the surface in directions of length 1 (y up, z to the front)."""
    x, y, z = direction.T
    bump = lambda cx, cy, cz, wide: np.exp(-((np.abs(x) - cx) ** 2 + (y - cy) ** 2 + (z - cz) ** 2) / wide)
    radius = 0.78 + 0.12 * np.clip(y, 0, 1) ** 2 + 0.05 * np.clip(-z, 0, 1)   # the cranium
    radius -= 0.20 * bump(0.36, 0.10, 0.90, 0.035)                            # eyes
    radius -= 0.11 * bump(0.0, -0.20, 0.97, 0.012)                            # nose
    radius += 0.07 * bump(0.58, -0.18, 0.76, 0.030)                           # cheeks
    radius += 0.14 * bump(0.0, -0.75, 0.62, 0.100)                            # jaw
    radius -= 0.10 * bump(0.95, 0.0, 0.28, 0.060)                             # temples
    radius -= 0.08 * bump(0.50, -0.75, 0.30, 0.050)                           # below the cheeks
    teeth = bump(0.0, -0.52, 0.85, 0.030) * (0.5 + 0.5 * np.sin(40 * x))
    return radius - 0.015 * teeth


def vertices(obj):
    """Vertices of an OBJ file."""
    return np.array([line.split()[1:4] for line in open(obj) if line.startswith("v ")], dtype=np.float64)
