# SPDX-License-Identifier: Apache-2.0
"""Faults in drun and drc: each Vulkan call, allocation and file call of a few commands fails once.

  commands.py DRUN DRC SHIM LAYERS [--places N|all] [--kind KIND]... [--without COMMAND]... [--only COMMAND]... [--leaks LSAN]

A command then does what it was asked for, in the bits of a run without faults, or says in words why not and exits with
1 or 2; it dies of no signal, leaves no Vulkan object, and no file that is neither the old nor the new one. Run again
without faults, where it stands, it gives the right files. --places says how many places of each command and kind are
tried, evenly spread. Under AddressSanitizer leaks count too, and with --leaks "$(gcc -print-file-name=liblsan.so)" those
of any build: not those of a driver, whose library is gone when they are told.
"""
import argparse
import json
import math
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile

KINDS = ["vulkan", "new", "file", "short"]
FIT = """edition 1;
import std.optim;
param p : vec3[W, H] = 0.0;
state s : float[W, H] = 0.0;
input t : vec3[W, H];
let off = p - t;
let e = mean(dot(off, off)) + 0.001 * mean(s);
step fit { minimize e over p with optim.adam(rate = 0.01); s <- s * 0.9 + sin(p.x); output error = e, img = p; }
"""
MESH = """edition 1;
import std.raster;
input position : vec3[V];
input face : ivec3[F];
let hit = raster.rasterize(vec4(position, 1.0), face, 16, 16);
step look { output seen = if hit.face >= 0 { 1.0 } else { 0.0 }; }
"""
OBJ = "v -0.5 -0.5 0.5\nv 0.5 -0.5 0.5\nv 0 0.5 0.5\nf 1 2 3\n"
DATA = ["--bind", "t==[[[1, 2, 3], [4, 5, 6]], [[7, 8, 9], [1, 0, 1]]]"]


def commands(drun, drc):
    """By name: what was run before, and what is tried."""
    fit = [drun, "fit.dr", *DATA, "--step", "fit=20", "--checkpoint-every", "10", "--out", "o"]
    mesh = ["--bind", "position=a.obj:position", "--bind", "face=a.obj:indices"]
    return {
        "drun, a fit": ([], fit),
        "drun, a fit resumed": ([[w.replace("fit=20", "fit=10") for w in fit]], [*fit, "--resume"]),
        "drun, a bundle over old results": ([fit, [drc, "build", "fit.dr", "--emit", "bundle", "-o", "fit.drb"]],
                                            [drun, "fit.drb", *DATA, "--step", "fit=5", "--out", "o"]),
        "drun, a mesh": ([], [drun, "mesh.dr", *mesh, "--out", "o", "--dump-raster", "o/rasters"]),
        "drun, the reference": ([], [drun, "mesh.dr", *mesh, "--out", "o", "--device", "reference"]),
        "drun profile": ([], [drun, "profile", "-o", "profile.json"]),
        "drc check": ([], [drc, "check", "fit.dr"]),
        "drc build": ([], [drc, "build", "fit.dr", "--emit", "bundle", "-o", "fit.drb"]),
        "drc eval": ([], [drc, "eval", "mesh.dr", *mesh, "--step", "look", "--out", "o"]),
    }


class Suite:
    def __init__(self, options, root):
        self.options, self.root = options, root
        self.problems = []

    def complain(self, text):
        self.problems.append(text)
        print(text, flush=True)

    def environment(self, room, fault):
        env = dict(os.environ, LD_PRELOAD=self.options.shim, VK_LAYER_PATH=self.options.layers,
                   VK_INSTANCE_LAYERS="VK_LAYER_DRESSI_faults",
                   NODEVICE_SELECT="1",  # Mesa's layer reads what a call that failed did not write
                   DRC_CACHE_DIR=str(room / "cache"),
                   DR_FAULT_REPORT=str(self.root / "report"))
        asan = subprocess.run(["ldd", self.options.drun], capture_output=True, text=True).stdout
        for line in asan.splitlines():
            if "libasan" in line:
                env["LD_PRELOAD"] = line.split()[2] + " " + self.options.shim
        if self.options.leaks:
            env["LD_PRELOAD"] += " " + self.options.leaks
            env["LSAN_OPTIONS"] = "exitcode=0:" + os.environ.get("LSAN_OPTIONS", "")
        if fault:
            env["DR_FAULT"] = fault
        return env

    def room(self, before):
        """A folder as it was before the command, made once for each."""
        room = self.root / "room"
        shutil.rmtree(room, ignore_errors=True)
        room.mkdir()
        for name, text in (("fit.dr", FIT), ("mesh.dr", MESH), ("a.obj", OBJ)):
            (room / name).write_text(text)
        for command in before:
            done = subprocess.run(command, cwd=room, env=dict(os.environ, DRC_CACHE_DIR=str(room / "cache")),
                                  capture_output=True, text=True)
            assert done.returncode == 0, done.stderr
        return room

    def run(self, room, command, fault=None):
        try:
            done = subprocess.run(command, cwd=room, env=self.environment(room, fault), capture_output=True, text=True,
                                  errors="replace", timeout=60)
        except subprocess.TimeoutExpired:
            return 124, "", {}
        report = {}
        if (self.root / "report").exists():
            for line in (self.root / "report").read_text().splitlines():
                word, _, rest = line.partition(" ")
                report[word] = rest
            (self.root / "report").unlink()
        return done.returncode, done.stderr, report

    @staticmethod
    def leaks(words):
        """What LeakSanitizer tells of, where any of it is ours: a driver is gone by then, and its frames have no name or
        that of what was mapped there since."""
        told = re.findall(r"^((?:Direct|Indirect) leak of .*?)(?:\n\n|\Z)", words, re.M | re.S)
        return [leak for leak in told if re.search(r"\(\S*(?:/drun|/drc|libdr_faults|libstdc\+\+|libstb|libtinygltf)", leak)]

    @staticmethod
    def files(room):
        """By name, of all that a command is asked for; the cache and the state of locks are its own."""
        found = {}
        for path in sorted(room.rglob("*")):
            name = str(path.relative_to(room))
            if path.is_file() and not name.startswith("cache") and not path.name.startswith("log"):
                found[name] = path.read_bytes()
                if path.name == "profile.json":  # each measurement has numbers of its own
                    found[name] = " ".join(sorted(json.loads(found[name]))).encode()
        return found

    @staticmethod
    def same(one, other):
        """Folders of checkpoints have numbers that count up."""
        plain = lambda files: {n: b for n, b in files.items() if "checkpoint" not in n}
        return plain(one) == plain(other)

    @staticmethod
    def is_whole(name, data):
        if name.endswith(".png"):
            return data.startswith(b"\x89PNG") and data[-8:-4] == b"IEND"
        found = re.match(rb"\x93NUMPY\x01\x00..\{'descr': '..(\d)', 'fortran_order': False, 'shape': \(([\d, ]*)\).*?\n", data, re.S)
        if not name.endswith(".npy") or not found:
            return False
        return len(data) == found.end() + math.prod(int(n) for n in found[2].split(b",") if n.strip()) * int(found[1])

    def attempt(self, what, start, old, new, command, kind, at):
        room = self.root / "room"
        shutil.rmtree(room)
        shutil.copytree(start, room, symlinks=True)
        code, words, report = self.run(room, command, f"{kind}:{at}")
        here = f"{what}, {kind} {at} ({report.get('failed', '?')})"
        complain = lambda text: self.complain(f"{here}: {text}\n    {words.strip()[:600]}")
        if code not in (0, 1, 2):
            complain(f"ends with {code}")
        elif code != 0 and len(words) < 10:
            complain(f"ends with {code} without a word")
        if self.options.leaks:
            for leak in self.leaks(words):
                complain("leaks: " + leak)
            words = words.partition("\n=====")[0]
        if "AddressSanitizer" in words or "LeakSanitizer" in words or "runtime error" in words:
            complain("a sanitizer speaks")
        if report.get("alive"):
            complain(f"leaves {report['alive']}")
        files = self.files(room)
        for name, data in files.items():
            known = [old.get(name), new.get(name)]
            if pathlib.PurePath(name).name == "results.txt":  # the list of what a run may have written
                lines = lambda text: set((text or b"").splitlines())
                if lines(data) - lines(known[0]) - lines(known[1]):
                    complain(f"'{name}' lists what nobody writes")
            elif code == 1 and files.get("o/checkpoint.json") != old.get("o/checkpoint.json") and self.is_whole(name, data):
                pass  # a run that stops in words leaves what it has so far, with its checkpoint
            elif data not in known and "checkpoint" not in name and not name.endswith(".tmp"):
                complain(f"'{name}' is neither the old nor the new one")
            if name.endswith((".tmp", ".partial")) and code in (0, 1, 2):
                complain(f"'{name}' is left")
        if code == 0 and not self.same(files, new):
            complain("says that all is well, and the files are others")
        code, words, _ = self.run(room, command)
        if code != 0 or not self.same(self.files(room), new):
            complain(f"run again it ends with {code}, or with other files")
        return report.get("failed") != ""

    def try_command(self, what, before, command):
        room = self.room(before)
        old = self.files(room)
        start = self.root / "start"
        shutil.rmtree(start, ignore_errors=True)
        shutil.copytree(room, start, symlinks=True)
        code, words, report = self.run(room, command)
        assert code == 0, f"{what}: {words}"
        for leak in self.leaks(words) if self.options.leaks else []:
            self.complain(f"{what}, without a fault, leaks: {leak}")
        new = self.files(room)
        for kind in self.options.kind or KINDS:
            places = int(report[kind])
            tried = places if self.options.places == "all" else min(int(self.options.places), places)
            reached = 0
            for k in range(tried):
                reached += self.attempt(what, start, old, new, command, kind, 1 + k * places // tried)
            print(f"{what:34} {kind:7} {reached:5} of {places:6} places failed, {len(self.problems)} problems so far", flush=True)

    def go(self):
        for what, (before, command) in commands(self.options.drun, self.options.drc).items():
            if what in (self.options.without or []) or what not in (self.options.only or [what]):
                continue
            self.try_command(what, before, command)
        return 1 if self.problems else 0


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("drun", "drc", "shim", "layers"):
        parser.add_argument(name, type=lambda path: str(pathlib.Path(path).resolve()))
    parser.add_argument("--places", default="2")
    parser.add_argument("--kind", action="append", choices=KINDS)
    parser.add_argument("--without", action="append", metavar="COMMAND")
    parser.add_argument("--only", action="append", metavar="COMMAND")
    parser.add_argument("--leaks", metavar="LSAN", help="LeakSanitizer's library")
    options = parser.parse_args()
    icd = os.environ.get("DR_LAVAPIPE_ICD")
    if icd is None:
        print("DR_LAVAPIPE_ICD is not set: faults of commands are left out")
        return 1 if "CI" in os.environ else 77
    os.environ["VK_ICD_FILENAMES"] = os.environ["VK_DRIVER_FILES"] = icd
    with tempfile.TemporaryDirectory() as folder:
        return Suite(options, pathlib.Path(folder)).go()


if __name__ == "__main__":
    sys.exit(main())
