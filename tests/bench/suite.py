# SPDX-License-Identifier: Apache-2.0
"""What the suites of tests/bench/ share: arguments, runs of drun in turns, records and plots.

A suite is NAME.sh BUILD_FOLDER [--device NAME] [--quick]. It writes bench-out/NAME/figures.jsonl, a record a measurement,
plots as SVG and PNG, and run.json: device, commit, date. Without --device it runs on lavapipe where DR_LAVAPIPE_ICD names it.

Times are of the device while several runs are under way: drun's `us a run while several are under way`, wall clock over runs
that follow each other in one process, the first one not counted, the median of its batches. `race` does that several times for
each of some programs, in turns, so that what else the machine does meets all alike, and gives median, least and most.
"""
import datetime, json, os, re, shutil, statistics, subprocess, sys
from pathlib import Path

import matplotlib
matplotlib.use("Agg")
import matplotlib.pyplot as plt
import matplotlib.ticker
import numpy as np

plt.rcParams.update({"axes.grid": True, "grid.alpha": 0.25, "legend.frameon": False, "svg.hashsalt": "dressi"})
here = Path(__file__).resolve().parent


class Failed(Exception):
    """A tool's call, and what it said."""


def complain(kind, problem, trace):
    if kind is not Failed:
        return sys.__excepthook__(kind, problem, trace)
    sys.stderr.write(f"{problem.args[0]}\n{problem.args[1]}\n")


sys.excepthook = complain


class Suite:
    def __init__(self, name, arguments=None):
        words = list(sys.argv[1:] if arguments is None else arguments)
        self.name, self.quick, self.device = name, False, os.environ.get("DR_DEVICE", "")
        if not words or words[0].startswith("-"):
            self.usage("expected a build folder first")
        self.build = Path(words.pop(0)).resolve()
        while words:
            word = words.pop(0)
            if word == "--quick":
                self.quick = True
            elif word == "--device" and words:
                self.device = words.pop(0)
            else:
                self.usage(f"found {word}")
        if not self.device and os.environ.get("DR_LAVAPIPE_ICD"):
            os.environ["VK_ICD_FILENAMES"] = os.environ["VK_DRIVER_FILES"] = os.environ["DR_LAVAPIPE_ICD"]
        self.out = Path("bench-out").resolve() / name
        self.out.mkdir(parents=True, exist_ok=True)
        self.records = []
        self.log = open(self.out / "figures.jsonl", "w")
        devices = self.call("drun", "devices").splitlines()
        chosen = [d for d in devices if self.device.lower() in d.lower() or d.startswith(self.device + ":")] or devices
        (self.out / "run.json").write_text(json.dumps({
            "device": chosen[0].split(": ", 1)[-1] if chosen else "", "commit": commit(), "quick": self.quick,
            "date": datetime.datetime.now(datetime.timezone.utc).strftime("%Y-%m-%d %H:%M UTC"), "processors": os.cpu_count()}, indent=1))

    def usage(self, problem):
        sys.stderr.write(f"{self.name}: {problem}; usage: {self.name}.sh BUILD_FOLDER [--device NAME] [--quick]\n")
        sys.exit(2)

    def record(self, **fields):
        self.records.append(fields)
        self.log.write(json.dumps({"bench": self.name, **fields}) + "\n")
        self.log.flush()

    def call(self, tool, *arguments):
        """What a tool of the build prints. Raises Failed with its messages."""
        done = subprocess.run([str(self.build / "bin" / tool), *map(str, arguments)], capture_output=True, text=True)
        if done.returncode != 0:
            raise Failed(f"{tool} {' '.join(map(str, arguments))}", done.stderr.strip())
        return done.stdout

    def drun(self, program, *arguments):
        return self.call("drun", here / "cases" / program, "--device", self.device, *arguments)

    def pace(self, program, step, runs, arguments):
        """us a run of a step, and what drun printed."""
        said = self.drun(program, *arguments, "--step", f"{step}={runs + 2}", "--log-every", max(runs // 5, 1), "--timing",
                         "--counters")
        return float(re.search(rf"^{step}: ([\d.]+) us a run while", said, re.M)[1]), said

    def race(self, cells, rounds=None):
        """cells: [(fields, program, step, runs, arguments)]. Gives records of fields, us, us_least, us_most, and megabytes that a run
        reads and writes, run in turns after one round that fills the caches of compiler and driver. What cannot run is recorded with its `problem`, and left out."""
        rounds = rounds or (3 if self.quick else 5)
        running = []
        for cell in cells:
            fields, program, step, _, arguments = cell
            try:
                _, said = self.pace(program, step, 1, arguments)
                run, moved = re.search(rf"^{step}: (\d+) runs? .*bytes (\d+) run", said, re.M).groups()
                running.append((cell, [], int(moved) / int(run) / 1e6))
            except Failed as failed:
                self.record(**fields, problem=failed.args[1])
                print(text(fields), " does not run:", failed.args[1], flush=True)
        for _ in range(rounds):
            for (_, program, step, runs, arguments), times, _ in running:
                times.append(self.pace(program, step, runs, arguments)[0])
        for (fields, _, _, runs, _), times, megabytes in running:
            us = statistics.median(times)
            self.record(**fields, us=us, us_least=min(times), us_most=max(times), megabytes=megabytes, rounds=rounds, runs=runs)
            print(text(fields), f"  {us / 1000:.3f} ms ({min(times) / 1000:.3f} to {max(times) / 1000:.3f}), {megabytes:.2f} MB", flush=True)
        return self.records[len(self.records) - len(running):]

    def against_evaluator(self, program, step, outputs, arguments, options=()):
        """How far outputs of a step's first run are from the float64 evaluator's, which is given the device's faces, tags and
        pinned values: by output (array of the device, array of the evaluator, relative L2). `options` are drun's alone."""
        folder = self.out / "frame"
        shutil.rmtree(folder, ignore_errors=True)
        self.drun(program, *arguments, *options, "--step", step, "--dump-raster", folder / "decisions", "--out", folder)
        saves = [word for name in outputs for word in ("--save", f"{step}.{name}={folder / ('expected.' + name)}.npy")]
        self.call("drc", "eval", here / "cases" / program, *arguments, "--step", step, "--freeze", folder / "decisions", *saves)
        result = {}
        for name in outputs:
            found, expected = (np.load(folder / file).astype(np.float64) for file in (f"{step}.{name}.npy", f"expected.{name}.npy"))
            result[name] = (found, expected, float(np.linalg.norm(found - expected) / np.linalg.norm(expected)))
        return result

    def save(self, figure, name):
        figure.tight_layout()
        for end in ("svg", "png"):
            figure.savefig(self.out / f"{name}.{end}", dpi=120)
        plt.close(figure)

    def icosphere(self, levels):
        """A unit sphere of 20 * 4^levels triangles: arguments that bind position and face."""
        mesh = self.out / f"sphere_{levels}.obj"
        mesh.write_text(subprocess.run(["awk", "-v", f"levels={levels}", "-f", here / "icosphere.awk"], capture_output=True, text=True,
                                       check=True).stdout)
        return ["--bind", f"position={mesh}:position", "--bind", f"face={mesh}:indices"]

    def uv_sphere(self, around, rings):
        """A sphere around the y axis of 2 * around * (rings - 1) triangles: drun's arguments that bind position, face, uv
        and uv_face. It has a seam in its texture coordinates only."""
        k, r = np.meshgrid(np.arange(around + 1), np.arange(rings + 1))
        uv = np.stack([k / around, r / rings], -1)
        theta, phi = np.pi * r / rings, 2 * np.pi * k / around
        ring = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), np.sin(theta) * np.cos(phi)], -1)
        position = np.concatenate([[[0, 1, 0]], ring[1:-1, :-1].reshape(-1, 3), [[0, -1, 0]]])
        vertex = np.clip(1 + (r - 1) * around + k % around, 1, len(position) - 2)
        vertex[0], vertex[-1] = 0, len(position) - 1
        corner = np.arange(uv.shape[0] * uv.shape[1]).reshape(uv.shape[:2])

        def faces(of):
            a, b, c, d = of[:-1, :-1], of[1:, :-1], of[1:, 1:], of[:-1, 1:]
            return np.concatenate([np.stack([a, b, c], -1)[:-1].reshape(-1, 3), np.stack([a, c, d], -1)[1:].reshape(-1, 3)])

        return self.bind(f"sphere_{around}_{rings}", position=position, face=faces(vertex), uv=uv.reshape(-1, 2), uv_face=faces(corner))

    def mesh(self, file):
        """Positions and triangles of an OBJ file, or of the parts of a glTF file as their nodes turn them."""
        if Path(file).suffix == ".gltf":
            return gltf_mesh(Path(file))
        position, faces = [], []
        for line in Path(file).read_text().splitlines():
            word, *rest = line.split() or [""]
            if word == "v":
                position.append([float(x) for x in rest[:3]])
            elif word == "f":
                corner = [int(x.partition("/")[0]) for x in rest]
                corner = [k - 1 if k > 0 else len(position) + k for k in corner]
                faces += [[corner[0], corner[k], corner[k + 1]] for k in range(1, len(corner) - 1)]
        return np.array(position), np.array(faces)

    def bind(self, prefix, **arrays):
        """Writes arrays, and gives drun's arguments that bind them. Floats as float32, integers as int32."""
        arguments = []
        for name, array in arrays.items():
            path = self.out / f"{prefix}.{name}.npy"
            array = np.asarray(array)
            np.save(path, array.astype(np.float32 if array.dtype.kind == "f" else np.int32))
            arguments += ["--bind", f"{name}={path}"]
        return arguments


def gltf_mesh(file):
    scene = json.loads(file.read_text())

    def array(index, kind, components):
        accessor = scene["accessors"][index]
        view = scene["bufferViews"][accessor["bufferView"]]
        data = (file.parent / scene["buffers"][view["buffer"]]["uri"]).read_bytes()
        begin = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        return np.frombuffer(data, kind, accessor["count"] * components, begin).reshape(-1, components)

    position, faces, before = [], [], 0
    for node in scene["nodes"]:
        x, y, z, w = node.get("rotation", [0, 0, 0, 1])
        turn = np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                         [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                         [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])
        for part in scene["meshes"][node["mesh"]]["primitives"]:
            corners = array(part["attributes"]["POSITION"], np.float32, 3).astype(np.float64)
            kind = {5121: np.uint8, 5123: np.uint16, 5125: np.uint32}[scene["accessors"][part["indices"]]["componentType"]]
            faces.append(array(part["indices"], kind, 1).reshape(-1, 3).astype(np.int64) + before)
            position.append(corners @ turn.T * node.get("scale", [1, 1, 1]) + node.get("translation", [0, 0, 0]))
            before += len(corners)
    return np.concatenate(position), np.concatenate(faces)


def fronts(suite, kind, rows, cost, error, name):
    """The rows that none has less error than for less cost, by rising cost: recorded, printed and given."""
    front = []
    for r in sorted(rows, key=lambda r: r[cost]):
        if not front or r[error] < front[-1][error]:
            front.append(r)
    suite.record(front=kind, cells=[name(r) for r in front])
    print(f"the front of {kind}:", "; ".join(f"{name(r)} {r[error]:.2g}" for r in front), flush=True)
    return front


def points_or_judge(points, judge):
    """The command line of a script that draws points and judges what was made of them: `points FOLDER COUNT` or `judge FOLDER`."""
    folder = Path(sys.argv[2])
    if sys.argv[1] == "points":
        points(folder, int(sys.argv[3]))
    else:
        judge(folder)


def tell_errors(points, errors, **more):
    """Prints a record of the largest of each kind of errors, and of what all but one in a thousand are below."""
    print(json.dumps({"points": points, **more, **{k: float(max(e)) for k, e in errors.items()},
                      **{k + ", 99.9%": float(np.quantile(e, 0.999)) for k, e in errors.items()}}))


def text(fields):
    return " ".join(f"{k}={v:.4g}" if isinstance(v, float) else f"{k}={v}" for k, v in fields.items())


def lines(axes, rows, x, label, y="us", scale=1e-3):
    """Draws records over field x, a line for each label(record), bars from the least to the most."""
    for name in dict.fromkeys(map(label, rows)):
        mine = sorted((r for r in rows if label(r) == name), key=lambda r: r[x])
        value = np.array([r[y] for r in mine]) * scale
        low, high = (np.array([r.get(f"{y}_{end}", r[y]) for r in mine]) * scale for end in ("least", "most"))
        axes.errorbar([r[x] for r in mine], value, yerr=[value - low, high - value], marker="o", markersize=4, capsize=2, label=name)
    axes.set_xscale("log")
    ticks = sorted({r[x] for r in rows})
    axes.set_xticks(ticks, [f"{t:,}" for t in ticks])
    axes.xaxis.set_minor_locator(matplotlib.ticker.NullLocator())


def commit():
    run = lambda *words: subprocess.run(["git", "-C", str(here), *words], capture_output=True, text=True).stdout.strip()
    return run("rev-parse", "--short", "HEAD") + (" with changes" if run("status", "--porcelain", "-uno") else "")
