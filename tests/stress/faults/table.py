#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Breaks Dressi on purpose, by category, and prints a table: how many inputs there were, how many ended in a signal, took more
than 20 s of processor time (or two minutes, where they wait) or were wrong without a word, and how many were right or answered.
The first three are to be zero: else the exit code is 1. What was found stands below the table, one line each.

usage: table.py BUILD [--only NAME,...] [--many] [--folder FOLDER]
  --only    sources, runs, bundles, mutations, readers, files, checkpoints, kills, hands, meshes, api, install
  --many    the counts of docs/results/faults.md (an hour) and not those of a test (a minute or two)
  --folder  .dr programs and .drb bundles of yours, which join the sources and bundles
"""
import argparse
import os
import re
import resource
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.dont_write_bytecode = True
import files
import runs
import sources

LONGEST = 20  # seconds of processor time: those of the clock say how busy a machine is
PATIENCE = 120  # seconds of the clock
HERE = Path(__file__).resolve().parent
TESTS = HERE.parent.parent


def limit():
    resource.setrlimit(resource.RLIMIT_CPU, (LONGEST, LONGEST + 5))


class Row:
    def __init__(self, name):
        self.name, self.tried, self.crashed, self.hung, self.wrong, self.answered, self.ran, self.bad = name, 0, 0, 0, 0, 0, 0, []

    def blame(self, how, name, text=""):
        setattr(self, how, getattr(self, how) + 1)
        self.bad.append(f"{self.name}: {name}: {how} {' '.join(str(text).split())[:200]}")

    def attempt(self, name, command, cwd, accepts=(0, 1, 2), reference=False):
        """Runs it, and counts how it ended. Returns its exit code."""
        self.tried += 1
        begin = time.monotonic()
        try:
            done = subprocess.run(command, cwd=cwd, capture_output=True, timeout=PATIENCE, stdin=subprocess.DEVNULL, preexec_fn=limit)
        except subprocess.TimeoutExpired:
            self.blame("hung", name, f"after {time.monotonic() - begin:.0f} s")
            return -1
        said = done.stderr.decode(errors="replace")
        if done.returncode == -signal.SIGXCPU:
            self.blame("hung", name, f"after {LONGEST} s of processor time")
        elif done.returncode not in accepts or "internal error" in said:
            self.blame("crashed", name, f"exit {done.returncode} {said}")
        elif reference and done.returncode != 0:  # all of these are to run, and to agree
            self.blame("wrong", name, said)
        elif done.returncode == 0:
            self.ran += 1
        elif said.strip():
            self.answered += 1
        else:
            self.blame("wrong", name, f"exit {done.returncode} without a word")
        return done.returncode

    def take(self, name, tried, crashed=0, hung=0, answered=0, text=""):
        self.tried += tried
        self.answered += answered
        self.ran += tried - crashed - hung - answered
        self.crashed += crashed
        self.hung += hung
        if crashed + hung:
            self.bad.append(f"{self.name}: {name}: {text}")


class Faults:
    def __init__(self, options, work):
        self.build, self.work, self.many, self.folder = options.build.resolve(), work, options.many, options.folder
        self.drc, self.drun, self.tests = self.build / "bin/drc", self.build / "bin/drun", self.build / "bin/tests"
        self.rows = []

    def row(self, name):
        self.rows.append(Row(name))
        print(f"{name} ...", file=sys.stderr, flush=True)
        return self.rows[-1]

    def room(self, name):
        path = self.work / name
        path.mkdir()
        return path

    def given(self, end):
        return sorted(self.folder.rglob("*" + end)) if self.folder else []

    def sources(self):
        row, room = self.row("programs, `drc check`"), self.room("sources")
        all_sources = sources.large() | sources.deep() | sources.growing() | sources.damaged()
        for name, text in all_sources.items():
            path = room / "this.dr"
            path.write_bytes(text if isinstance(text, bytes) else text.encode())
            row.attempt(name, [self.drc, "check", path], room)
        for path in self.given(".dr"):
            row.attempt(path.name, [self.drc, "check", path], room)
        row = self.row("programs, `drc build`, cold")
        picked = sources.large() | sources.growing() if self.many else {k: v for k, v in sources.large().items() if "1000" not in k and "0,000" not in k}
        for name, text in picked.items():
            (room / "this.dr").write_text(text)
            row.attempt(name, [self.drc, "build", "this.dr", "--emit", "bundle", "-o", "out.drb", "--no-cache"], room)
        for path in self.given(".dr"):
            row.attempt(path.name, [self.drc, "build", path, "--emit", "bundle", "-o", "out.drb", "--no-cache"], room)

    def runs(self):
        row, room = self.row("programs run, against the evaluator"), self.room("runs")
        for name, (text, arguments) in sources.numbers().items():
            (room / "this.dr").write_text(text)
            for road in [[]] + ([["--pack", "naive"], ["--lower", "fragment"], ["--float", "native"]] if self.many else []):
                row.attempt(f"{name} {' '.join(road)}", [self.drun, "this.dr", *arguments, *road, "--check-against-reference"], room, reference=True)

    def bundles(self):
        row = self.row("crafted bundles, by four commands")
        script = subprocess.run(["bash", HERE.parent / "faults.sh", self.drc, self.drun, self.tests / "craft_bundles"], capture_output=True, text=True)
        line = re.compile(r"^(.*?) +(\d+) tried +(\d+) signals +(\d+) hangs +(\d+) files outside +(\d+) escapes +(\d+) answered", re.M)
        found = {m[1]: [int(x) for x in m.groups()[1:]] for m in line.finditer(script.stdout)}
        if not found:
            row.blame("crashed", "faults.sh", script.stdout + script.stderr)
        for name, (tried, signals, hangs, outside, escapes, answered) in found.items():
            if name == "hands, disks and memory":
                row = self.row("full disks, caches, little memory")
            row.take(name, tried, signals, hangs, answered, script.stdout)
            row.wrong += outside + escapes
        given = self.given(".drb")
        if not given:
            return
        row, room = self.row("bundles of the folder, by four commands"), self.room("bundles")
        (room / "t.csv").write_text("1,2,3,4,5,6,7,8\n")
        for path in given:
            for name, command in {"drun": [self.drun, path, "-b", "t=t.csv", "--out", "o"], "inspect": [self.drc, "inspect", path],
                                  "json": [self.drc, "inspect", "--json", path],
                                  "reference": [self.drun, path, "-b", "t=t.csv", "--device", "reference"]}.items():
                row.attempt(f"{path.name} {name}", command, room)

    def mutations(self):
        tables, words = (20000, 2000) if self.many else (200, 100)
        row = self.row("bundles loaded and run, tables or a word of SPIR-V changed")
        done = subprocess.run([self.tests / "bundle_mutations_test"], capture_output=True, text=True,
                              env=os.environ | {"DR_TABLE_MUTATIONS": str(tables), "DR_SPIRV_MUTATIONS": str(words)})
        line = re.compile(r"(\d+) mutants, (\d+) refused when loaded, (\d+) later, (\d+) ran, (\d+) did not end, (\d+) signals")
        for tried, refused, later, _, hung, signals in ([int(x) for x in m] for m in line.findall(done.stdout)):
            row.take("mutants", tried, signals, hung, refused + later, done.stdout)
        if row.tried == 0:
            row.blame("crashed", "bundle_mutations_test", done.stdout + done.stderr)

    def readers(self):
        row, room = self.row("files for readers, changed at random"), self.room("readers")
        fuzzers = self.build / "bin/tests"
        seeds = next((p for p in self.build.glob("bin/**/fuzz_reader_seeds")), None)
        if seeds is None:
            row.blame("wrong", "fuzzers", "are not built: ninja on_demand")
            return
        fuzzers = seeds.parent
        subprocess.run([seeds, room], check=True)
        for reader in ("gltf", "obj", "png", "jpeg", "hdr", "npy", "csv", "json"):
            count = 12000 if self.many else 500
            done = subprocess.run([fuzzers / f"fuzz_{reader}", "--runs", str(count), "--end=." + reader, "--end=." + {"gltf": "glb", "jpeg": "jpg"}.get(reader, reader),
                                   room], capture_output=True, text=True, cwd=room)
            said = done.stdout + done.stderr
            slow = "takes too long" in said
            row.take(reader, count, int(done.returncode != 0 and not slow), int(slow), text=said)

    def files(self):
        row, room = self.row("crafted pictures, meshes, arrays, links, pipes"), self.room("crafted")
        inside, commands = files.write(room)
        for name, arguments in commands.items():
            for device in [[]] + ([["--device", "reference"]] if self.many else []):
                row.attempt(f"{name} {' '.join(device)}", [self.drun, *arguments, *device], inside)

    def checkpoints(self):
        row, room = self.row("checkpoints changed, then `--resume`"), self.room("checkpoints")
        for name in runs.damage_checkpoints(room, lambda name, arguments: row.attempt(name, [self.drun, *arguments], room), 250 if self.many else 24):
            row.blame("wrong", name)

    def kills(self):
        row = self.row("fits killed at random, and resumed")
        kills = 130 if self.many else 6
        done = subprocess.run(["bash", HERE.parent / "killed_fit.sh", self.drun], capture_output=True, text=True, env=os.environ | {"DR_KILLS": str(kills)})
        row.take("kills", kills)
        if done.returncode != 0:
            row.blame("wrong", "killed_fit.sh", done.stdout + done.stderr)

    def hands(self):
        row = self.row("wrong data, names and devices")
        script = TESTS / "device/faults_test.sh"
        done = subprocess.run(["bash", script, self.drun], capture_output=True, text=True)
        count = sum(line.lstrip().startswith("expect ") for line in script.read_text().splitlines())
        row.take("faults_test.sh", count, answered=count)
        if done.returncode != 0:
            row.blame("wrong", "faults_test.sh", done.stdout + done.stderr)

    def meshes(self):
        row, room = self.row("degenerate meshes by every road"), self.room("meshes")
        (room / "mesh.dr").write_text(runs.MESHES)
        picked = runs.meshes() if self.many else {k: runs.meshes()[k] for k in ("no area", "1e38", "NaN")}
        for name, (positions, faces) in picked.items():
            values = struct.pack(f"<{3 * len(positions)}f", *(x for p in positions for x in p))
            (room / "position.npy").write_bytes(files.npy((len(positions), 3), values))
            data = ["-b", "position=position.npy", "-b", f"face=={faces}", "--unchecked"]
            first = None
            for road in runs.ROADS:
                shutil.rmtree(room / "o", ignore_errors=True)
                status = row.attempt(f"{name} {' '.join(road)}", [self.drun, "mesh.dr", *data, *road, "--out", "o"], room)
                if status != 0:
                    continue
                bits = {p.name: p.read_bytes() for p in (room / "o").glob("*.npy")}
                first = first or bits
                if bits != first:
                    row.blame("wrong", f"{name} {' '.join(road)}", f"other bits in {[f for f in bits if bits[f] != first.get(f)]}")

    def api(self):
        row = self.row("the C++ interface misused, checks")
        done = subprocess.run([self.tests / "api_faults_test"], capture_output=True, text=True)
        found = re.search(r"All tests passed \((\d+) assertions? in (\d+) test cases?\)", done.stdout)
        if found:
            row.take("calls", int(found[1]), answered=int(found[1]))
        else:
            row.blame("crashed", "api_faults_test", done.stdout + done.stderr)

    def install(self):
        row = self.row("installed, moved, used by a project elsewhere")
        done = subprocess.run(["bash", TESTS / "consumer/install_test.sh", "cmake", self.build, "c++"], capture_output=True, text=True)
        row.tried += 1
        if done.returncode == 0:
            row.ran += 1
        else:
            row.blame("wrong", "install_test.sh", done.stdout + done.stderr)


NAMES = ["sources", "runs", "bundles", "mutations", "readers", "files", "checkpoints", "kills", "hands", "meshes", "api", "install"]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("build", type=Path)
    parser.add_argument("--only", default=",".join(NAMES))
    parser.add_argument("--many", action="store_true")
    parser.add_argument("--folder", type=lambda text: Path(text).resolve())
    options = parser.parse_args()
    device = os.environ.get("DR_LAVAPIPE_ICD")
    if not device:
        print("DR_LAVAPIPE_ICD is not set: faults are left out")
        return 1 if os.environ.get("CI") else 77
    os.environ |= {"VK_ICD_FILENAMES": device, "VK_DRIVER_FILES": device}
    with tempfile.TemporaryDirectory() as work:
        faults = Faults(options, Path(work))
        for name in options.only.split(","):
            if name not in NAMES:
                parser.error(f"there is no '{name}'; there are {', '.join(NAMES)}")
            getattr(faults, name)()
    print("| category | inputs | crash | hang > 20 s | wrong or silent | answered | right |\n| --- | --- | --- | --- | --- | --- | --- |")
    for row in faults.rows:
        print(f"| {row.name} | {row.tried:,} | {row.crashed} | {row.hung} | {row.wrong} | {row.answered:,} | {row.ran:,} |")
    bad = [line for row in faults.rows for line in row.bad]
    print("\n".join(bad))
    return int(any(row.crashed + row.hung + row.wrong for row in faults.rows))


if __name__ == "__main__":
    sys.exit(main())
