#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Sums, minima and maxima of pictures of many sizes: each input counts once, and sums are those of the tree that
# compiler/backend/emit/reduce.cpp promises, to the bit.
# usage: reductions_test.sh DRUN
set -eu
drun=$(readlink -f "$1")
source "$(dirname "${BASH_SOURCE[0]}")/on_lavapipe.sh" "reductions on lavapipe"
cat > sums.dr << 'END'
edition 1;
input w : float[N, 3];
input v : float[2, 1, N];
step look {
  output all = sum(w), least = min(w), most = max(w), rows = sum(w, over = x), columns = sum(w, over = y),
         pairs = sum(vec2(w, -w), over = (x, y)),
         // Lists that the reductions compute themselves, and those whose layers a GPU's lanes add up in loops.
         of_layers = sum(v, over = layers), less = sum(-v, over = layers),
         second = sum(-w.at(ivec2(coord(N).x, 1))), third = min(2.0 * w.at(ivec2(coord(N).x, 2)));
}
END
# Where subgroups are a GPU's, eight invocations share what one folds on a processor.
gpu_profile teams.json
drun=$drun python3 - << 'END'
import os, random, struct, subprocess
from array import array

random.seed(7)


def npy(name, values, shape):
    header = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    with open(name, "wb") as f:
        f.write(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode() + values.tobytes())


def read(name):
    with open(name, "rb") as f:
        data = f.read()
    return array("f", data[10 + struct.unpack("<H", data[8:10])[0]:])


def tree(values):
    """Groups of eight, of eight such groups, of 64 of those, and so on. Python's floats are wide enough to round once."""
    one = array("f", [0])

    def add(values):
        one[0] = 0
        for x in values:
            one[0] += x
        return one[0]

    while True:
        eights = [add(values[k:k + 8]) for b in range(0, len(values), 64) for k in range(b, min(b + 64, len(values)), 8)]
        values = array("f", [add(eights[k:k + 8]) for k in range(0, len(eights), 8)])
        if len(values) == 1:
            return values[0]


for n, profile in ((n, profile) for profile in ("lavapipe", "teams.json") for n in (1, 2, 21, 22, 43, 64, 65, 1365, 1366, 4096, 4097, 87400, 270000)):
    w = array("f", [random.uniform(-1, 1) * 10.0 ** random.randrange(-6, 6) for _ in range(3 * n)])
    npy("w.npy", w, (3, n))
    npy("v.npy", w[:2 * n], (n, 1, 2))
    subprocess.run([os.environ["drun"], "sums.dr", "--bind", "w=w.npy", "--bind", "v=v.npy", "--step", "look", "--out", "out", "--profile", profile], check=True,
                   stdout=subprocess.DEVNULL)
    got = {name: read(f"out/look.{name}.npy") for name in ("all", "least", "most", "rows", "columns", "pairs", "of_layers", "less", "second", "third")}
    total = tree(w)
    expected = {"all": [total], "least": [min(w)], "most": [max(w)],
                "rows": [tree(w[y * n:(y + 1) * n]) for y in range(3)],
                "columns": [tree(array("f", [w[x], w[n + x], w[2 * n + x]])) for x in range(n)],
                "of_layers": [tree(w[k:2 * n:2]) for k in (0, 1)], "less": [-tree(w[k:2 * n:2]) for k in (0, 1)],
                "pairs": [total, -total], "second": [-tree(w[n:2 * n])], "third": [2 * min(w[2 * n:])]}
    for name, values in expected.items():
        assert list(got[name]) == list(values), f"{n}, {profile}: {name} is {got[name][:3]}, expected {values[:3]}"
END
echo "reductions: every size is right"
