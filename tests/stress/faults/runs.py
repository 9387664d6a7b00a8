# SPDX-License-Identifier: Apache-2.0
"""Runs that meet faults: damaged checkpoints, folders that others use, degenerate meshes on every road."""
import random
import shutil

FIT = """edition 1;
import std.optim;
param p : vec3[W, H] = 0.0;
state s : float[W, H] = 0.0;
input t : vec3[W, H];
let n = p - t;
let e = mean(dot(n, n)) + 0.001 * mean(s);
step fit { minimize e over p with optim.adam(rate = 0.01); s <- s * 0.9 + sin(p.x + float(step_index)); output error = e, img = p; }
"""
DATA = ["-b", "t==[[[1, 2, 3], [4, 5, 6]], [[7, 8, 9], [1, 0, 1]]]"]

MESHES = """edition 1;
import std.camera;
import std.hardsoftras;
import std.mesh;
import std.raster;
param position : vec3[V];
input face : ivec3[F];
let view = camera.perspective(40.0) * camera.look_at(camera.orbit(90.0, 20.0, 4.0));
let corners = camera.project(view, position);
let hit = raster.rasterize(corners, face, 16, 16);
let shade = raster.interpolate(hit, position.x);
let soft = hardsoftras.rasterize(corners, face, 16, 16, radius = 2.0, nearest = 2, everywhere = true);
let alpha = hardsoftras.silhouette(soft);
let nrm = mesh.normal(position, face);
let e = mean(alpha * alpha) + 0.01 * mean(shade) + 0.0001 * mean(dot(nrm, nrm));
step look { position <- position - 0.001 * grad(e, position); output e, alpha, shade, nrm; }
"""

# All of one device, and the same bits but for what says otherwise.
ROADS = [[], ["--pack", "naive"], ["--lower", "fragment"], ["--lower", "compute"], ["--raster", "hardware"], ["--raster", "compute"],
         ["--scatter", "rows"], ["--lower", "fragment", "--pack", "naive"], ["--ablate", "substages"], ["--ablate", "stages,remat"],
         ["--ablate", "cache"], ["--no-skip", "dead,zero,fold"], ["--no-skip", "share,slots"], ["--no-skip", "active,branches,soft"],
         ["--no-skip", "commands"], ["--raster", "hardware", "--pack", "naive", "--lower", "fragment"],
         ["--lower", "compute", "--raster", "compute", "--no-skip", "cache,soft"]]


def meshes():
    """name -> (positions, faces)"""
    corners = [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.5]]
    two = [[0, 1, 2], [0, 2, 3]]

    def scaled(by):
        return [[x * by for x in p] for p in corners]
    nan, inf = float("nan"), float("inf")
    return {
        "as it should be": (corners, two), "the same face twice": (corners, two + two), "turned round": (corners, [f[::-1] for f in two] + two),
        "one corner thrice": (corners, [[0, 0, 0]] + two), "an edge": (corners, [[0, 1, 1], [2, 3, 2]]),
        "no area": ([[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]], two), "one point": ([[0, 0, 0]] * 4, two),
        "behind": ([[x, y, z + 9] for x, y, z in corners], two), "at the camera": ([[x * 1e-6, y * 1e-6, 4.0] for x, y, _ in corners], two),
        "a needle": ([[0, 0, 0], [1, 1e-7, 0], [2, 0, 0], [1, 1, 1]], two), "tiny": (scaled(1e-30), two), "far": (scaled(1e10), two),
        "1e30": (scaled(1e30), two), "1e38": (scaled(1e38), two), "NaN": ([[nan, 0, 0]] + corners[1:], two),
        "Inf": ([[inf, -inf, 0]] + corners[1:], two), "mixed": ([[1e-10, 0, 0], [1e10, 0, 0], [0, 1, 0], [1, 1, 1e-10]], two),
    }


def damage_checkpoints(folder, run, count):
    """A byte, a cut or a swap in a file of a checkpoint, then --resume: run(name, arguments) says how it ended, 0 as ended well.
    Returns the names of those that went on, with other results than the whole run."""
    whole, kept, wrong = folder / "whole", folder / "kept", []
    (folder / "fit.dr").write_text(FIT)
    fit = ["fit.dr", *DATA, "--log-every", "1"]
    assert run("the whole run", [*fit, "--step", "fit=6", "--out", "whole"]) == 0
    assert run("its half", [*fit, "--step", "fit=3", "--out", "kept"]) == 0
    files = sorted(p.relative_to(kept) for p in kept.rglob("*") if p.is_file() and (p.name == "checkpoint.json" or "checkpoint-" in str(p)))
    rnd = random.Random(5)
    for k in range(count):
        tried = folder / "tried"
        shutil.rmtree(tried, ignore_errors=True)
        shutil.copytree(kept, tried)
        path = tried / files[k % len(files)]
        content = bytearray(path.read_bytes())
        at = rnd.randrange(len(content))
        how = rnd.choice(["bit", "byte", "cut", "twice", "gone"])
        if how == "bit":
            content[at] ^= 1 << rnd.randrange(8)
        elif how == "byte":
            content[at] = rnd.randrange(256)
        elif how == "cut":
            del content[at:]
        elif how == "twice":
            content[at:at] = content[at:at + 40]
        path.write_bytes(content)
        if how == "gone":
            path.unlink()
        name = f"{files[k % len(files)]}: {how} at {at}"
        if run(name, [*fit, "--step", "fit=6", "--resume", "--out", "tried"]) == 0:
            if any((whole / f).read_bytes() != (tried / f).read_bytes() for f in ("p.npy", "s.npy", "img.npy", "log.jsonl")):
                wrong.append(name)
    return wrong
