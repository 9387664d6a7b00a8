# SPDX-License-Identifier: Apache-2.0
"""compile_programs.py BIN OUT DEVICE [--quick]: what whole programs cost to compile, from text to bundle, and what the driver takes for
their shaders: chains, loops, wide programs, and soft rasterizers that keep K faces a pixel.

Times are of processors (user and system), which other work on the machine changes least; no cache holds anything. The driver's is what
one run of the program takes beyond one run of a program of one operation: nearly all of it is the making of pipelines. The figures go to OUT/programs.json, a JSON object a line."""
import json
import os
import resource
import shutil
import subprocess
import sys
import time
from pathlib import Path

bin, out, device = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]
quick = "--quick" in sys.argv[4:]
library = Path(__file__).resolve().parents[2] / "docs" / "examples"
LIMIT = 600  # seconds for one command


def chain(length):
    lines = [f"let x{k} = sin(x{k - 1}) * 0.{1000 + k};" for k in range(1, length + 1)]
    return f"param x0 : float = 1.0;\n" + "\n".join(lines) + f"\nstep fit {{ x0 <- x0 - grad(x{length}, x0); output y = x{length}; }}\n", []


def lets(length):
    lines = [f"let x{k} = x{k - 1} * 1.5 + {k}.0;" for k in range(1, length + 1)]
    return "input x0 : float;\n" + "\n".join(lines) + f"\nstep go {{ output y = x{length}; }}\n", ["--bind", "x0==0.5"]


def loop(trips):
    return (f"param p : vec2[W] = vec2(0.3, 0.4);\nfn f(x: vec2) -> vec2 {{ vec2(sin(x.y) * 0.9, cos(x.x) * 0.9) }}\n"
            f"let q = {{ var a = p; for i in 0..{trips} {{ a = f(a); }} a }};\nlet e = sum(dot(q, q));\n"
            "step fit { p <- p - 0.1 * grad(e, p); output e; }\n"), ["--symbol", "W=64"]


def wide(count):
    lines = [f"let a{k} = sin(x * {k}.0 + 0.5);" for k in range(count)]
    outputs = ", ".join(f"o{k} = a{k}" for k in range(count))
    return "input x : float[W];\n" + "\n".join(lines) + f"\nstep go {{ output {outputs}; }}\n", ["--bind", "x==[0.5, 1.5]"]


def soft(nearest):
    return f"""import std.camera;
import std.hardsoftras;
import std.loss;
import std.mesh;
import std.optim;
const S = 24;
param position : vec3[V];
param albedo : vec3[V] = 0.5;
input face : ivec3[F];
let layer = float(coord(1, 1, 2).z);
let view = camera.perspective(40.0) * camera.look_at(camera.orbit(90.0 * layer, 20.0, 4.0));
let soft = hardsoftras.rasterize(camera.project(view, position), face, S, S, radius = 2.0, nearest = {nearest}, everywhere = true);
let alpha = hardsoftras.silhouette(soft);
let color = hardsoftras.blend(soft, fn(s) {{ hardsoftras.interpolate(s, albedo) }}, background = vec3(0.1));
let e = mean(alpha * alpha) + 0.1 * loss.l2(color, vec3(0.3)) + 0.01 * mesh.laplacian(position, face);
step fit {{
  minimize e over position, albedo with optim.adam(rate = 0.02);
  output e, alpha, color;
}}
""", ["--bind", f"position={library / 'sphere.obj'}:position", "--bind", f"face={library / 'sphere.obj'}:indices"]


def timed(command, env):
    """Processor seconds, seconds, and whether it succeeded."""
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    try:
        done = subprocess.run(command, env=env, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, timeout=LIMIT)
        problem = "" if done.returncode == 0 else (done.stderr.strip().splitlines() or ["failed"])[0]
    except subprocess.TimeoutExpired:
        problem = f"more than {LIMIT} s"
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return used, time.monotonic() - begin, problem


base = None  # the run of the first program, of one operation
programs = [("lets", lets, [1]),
            ("chain", chain, [100, 1000] if quick else [100, 400, 1000, 10000]),
            ("lets", lets, [10000]),
            ("loop", loop, [128] if quick else [128, 1024]),
            ("wide", wide, [100] if quick else [100, 1000]),
            ("soft rasterizer, K", soft, [1, 8] if quick else [1, 2, 4, 8, 16, 32, 64])]
out.mkdir(parents=True, exist_ok=True)
print(f"\n{'program':24} {'size':>6} {'drc s':>8} {'wall s':>8} {'shaders':>8} {'MB':>7} {'driver s':>9}")
with open(out / "programs.json", "w") as file:
    for name, make, sizes in programs:
        for size in sizes:
            text, bind = make(size)
            source, bundle, cache = out / "program.dr", out / "program.drb", out / "cache"
            source.write_text("edition 1;\n" + text)
            env = dict(os.environ, DRC_CACHE_DIR=str(cache), MESA_SHADER_CACHE_DISABLE="true")
            shutil.rmtree(cache, ignore_errors=True)
            bundle.unlink(missing_ok=True)
            used, wall, problem = timed([bin / "drc", "build", source, "--emit", "bundle", "-o", bundle, "--no-cache"], env)
            row = {"bench": "compile programs", "program": name, "size": size, "drc_s": round(used, 3), "wall_s": round(wall, 3)}
            driver = None
            if not problem:
                report = subprocess.run([bin / "drc", "inspect", "--json", bundle], stdout=subprocess.PIPE, text=True).stdout
                row["shaders"], row["megabytes"] = len(json.loads(report).get("shaders", [])), round(bundle.stat().st_size / 1e6, 2)
                run = [bin / "drun", bundle, *bind, "--device", device, "--out", out / "run"]
                whole, _, problem = timed(run, env)
                if base is None:
                    base = whole
                driver = row["driver_s"] = round(max(whole - base, 0), 3)
            if problem:
                row["problem"] = problem
            file.write(json.dumps(row) + "\n")
            print(f"{name:24} {size:6} {used:8.2f} {wall:8.2f} {row.get('shaders', 0):8} {row.get('megabytes', 0):7} "
                  f"{'-' if driver is None else f'{driver:.2f}':>9} {problem}", flush=True)
shutil.rmtree(out / "cache", ignore_errors=True)
