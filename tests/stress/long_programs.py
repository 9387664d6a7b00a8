# SPDX-License-Identifier: Apache-2.0
"""Random programs whose loops take about as many trips as lavapipe lets an invocation have, and several times as many: alone,
nested, stopped, behind each other, in branches, in folds with gradients, in what is scattered and in functions of a raster.
All numbers are small and whole, so that each way through the compiler gives the evaluator's bits, or refuses in words.

usage: long_programs.py DRUN [--seconds N] [--seed N] [--ways N] [--keep FOLDER]
Exit code 1: a program gave something else. It is left in FOLDER with the command that shows it.
"""
import argparse
import os
import pathlib
import random
import re
import subprocess
import sys
import tempfile
import time

import numpy as np

REFUSED = ("trips", "the device allows", "in the profile", "--scatter exact")
TRIPS = (40, 100, 127, 128, 250, 1000, 16000, 32700, 32768, 65533, 65534, 65535, 65536, 66000, 100000, 131072)
MOST = 4_000_000  # trips of a program in the evaluator


class Program:
    def __init__(self, seed):
        self.random = random.Random(seed)
        pick = self.random.choice
        self.most = pick(TRIPS)
        self.elements = max(1, min(pick((1, 3, 9, 33, 300, 511, 600)), MOST // self.most))
        self.fixed = pick((True, False))
        self.names = 0
        self.lines = []
        self.outputs = []

    def name(self, what):
        self.names += 1
        return f"{what}{self.names}"

    def count(self, trips):
        """The end of a range: a number, a symbol's value, or data, with what bounds it."""
        data = f"n / {self.most // trips}" if self.most // trips > 1 else "n"
        return self.random.choice(((str(trips), ""), (data, ""), (data, f", max = {trips}"), (data, f", max = {trips * 3}")))

    def loop(self, trips, depth=0, x="x", named=True):
        """An expression of small whole numbers, a float, that takes about so many trips."""
        pick = self.random.choice
        if depth < 2 and trips >= 100 and self.random.random() < 0.4:
            inner = pick([t for t in (1, 5, 40, 300) if t < trips])
            body = self.loop(inner, depth + 1, x)
            trips = max(1, trips // (inner + 1))
        else:
            body = f"float(({{k}} * {pick((1, 3, 5))} + int({x})) % 5)"
        k = self.name("k")
        body = body.replace("{k}", k)
        end, bound = self.count(trips)
        kind = pick(("sum", "sum", "max", "argmin", "fold", "stop"))
        if kind in ("sum", "max"):
            loop = f"reduce({kind}, {k} in 0..{end}{bound}) {{ {body} }}"
        elif kind == "argmin":
            loop = f"float(reduce(argmin, {k} in 0..{end}{bound}) {{ {body} + float({k} % 7) }})"
        elif kind == "fold":
            loop = f"fold({k} in 0..{end}, s = {x}{bound}) {{ let y = s + {body}; if y > 99.0 {{ y - 100.0 }} else {{ y }} }}"
        else:
            at = self.random.randint(trips // 2, trips + 10)
            loop = f"fold({k} in 0..{end}, s = {x}{bound}) {{ if {k} == {at} {{ break; }} let y = s + {body}; if y > 99.0 {{ y - 100.0 }} else {{ y }} }}"
        return f"float(int({loop}) % 64)" if named else loop

    def statement(self):
        pick, let = self.random.choice, self.name("v")
        trips = pick((self.most, self.most, max(1, self.most // 2), 7))
        kind = pick(("map", "behind", "branch", "scatter", "gradient", "scattering_branch", "both", "index", "carried", "scan", "raster"))
        if kind == "map":
            text = self.loop(trips)
        elif kind == "behind":
            self.lines.append(f"let {let}_a = {self.loop(trips)};")
            text = self.loop(trips, x=f"{let}_a") + f" + {let}_a"
        elif kind == "branch":
            text = f"if x > 1.0 {{ {self.loop(trips)} }} else {{ {self.loop(pick((3, trips)))} }}"
        elif kind == "scatter":
            text = f"scatter_add(i, {self.loop(trips)}, 4)"
        elif kind == "gradient":
            self.lines.append(f"let {let}_a = a.at(i) * {self.loop(trips)};")
            text = f"grad(sum({let}_a), a)"
        elif kind == "scattering_branch":
            behind = pick(("", f" + a.at(i) * {self.loop(pick((5, 50)))}"))
            self.lines.append(f"let {let}_a = if x > 0.5 {{ a.at(i) * {self.loop(trips)}{behind} }} else {{ 0.0 }};")
            text = f"grad(sum({let}_a), a)"
        elif kind == "both":
            self.lines.append(f"let {let}_a = {self.loop(trips)};")
            self.lines.append(f"let {let}_b = if {let}_a > 20.0 {{ a.at(i) * {self.loop(trips)} }} else {{ {let}_a * a.at(0) }};")
            text = f"grad(sum({let}_b), a)"
        elif kind == "index":
            text = f"scatter_add(int({self.loop(trips)}) % 4, float(int(x) + 1), 4)"
        elif kind == "carried":
            k, (end, bound) = self.name("k"), self.count(trips)
            self.lines.append(f"let {let}_a = fold({k} in 0..{end}, s = 0.0{bound}) {{ s + a.at({k} % 4) * float({k} % 3) * x }};")
            text = f"grad(sum({let}_a), {pick(('a', 'x'))})"
        elif kind == "scan":
            k = self.name("k")
            end, bound = pick(((str(trips), ""), (f"n / {self.most // trips}", f", max = {trips}")))
            self.lines.append(f"let {let}_a = scan({k} in 0..{end}, s = x{bound}) {{ let y = s + float({k} % 3); if y > 99.0 {{ y - 100.0 }} else {{ y }} }};")
            text = f"sum(float(int({let}_a) % 3))"
        else:
            # The function's loops count for each pixel, so they are few.
            few = pick((5, 40, 300))
            k, more = self.name("k"), re.sub(r"\bn\b", "n.at(0)", self.loop(few, depth=1, x="s"))
            self.lines.append(
                f"let {let}_a = raster({pick((2, 60, 400))}, 48, 40) {{ setup(f) -> float {{ float((f * 7) % 50) }} "
                "corner(s, c) -> vec2 { [vec2(0.0, 0.0), vec2(47.0, 0.0), vec2(0.0, 39.0)][c] } depth(s, p) -> float { 1.0 - s / 64.0 } "
                f"keep(s, p) -> bool {{ reduce(sum, {k} in 0..{few}) {{ a.at({k} % 4) }} + {pick(('s', more))} < {few}.0 + {pick((30, 49, 55))}.0 && p.x + p.y < 38.0 }} }}[0];")
            text = f"sum(float({let}_a.face) * if {let}_a.face >= 0 {{ 1.0 }} else {{ 0.0 }})"
        self.lines.append(f"let {let} = {text};")
        self.outputs.append(let)

    def text(self):
        for _ in range(self.random.choice((1, 2, 3))):
            self.statement()
        n = str(self.elements) if self.fixed else "N"
        head = f"edition 1;\ninput n : int[{n}];\ninput i : int[{n}];\nparam x : float[{n}] = 1.0;\nparam a : float[4] = 1.0;\n"
        return head + "\n".join(self.lines) + f"\nstep look {{ output {', '.join(self.outputs)}; }}\n"

    def data(self, folder):
        ints = {"n": [self.most if self.random.random() < 0.8 else self.random.randint(0, self.most) for _ in range(self.elements)]}
        ints["i"] = [self.random.randint(-1, 4) if self.random.random() < 0.3 else 1 for _ in range(self.elements)]
        ints["x"] = [self.random.randint(0, 3) for _ in range(self.elements)]
        for name, numbers in ints.items():
            (folder / f"{name}.csv").write_text("\n".join(map(str, numbers)) + "\n")
        return [word for name in ints for word in ("--bind", f"{name}={name}.csv")]


def ways(chance, some):
    for _ in range(some):
        yield [
            *chance.choice(([], ["--lower", "fragment"], ["--lower", "compute"])),
            *chance.choice(([], ["--scatter", "rows"], ["--scatter", "rows"], ["--scatter", "exact"], ["--scatter", "atomic"])),
            *chance.choice(([], [], ["--pack", "naive"])),
            *chance.choice(([], [], ["--raster", "hardware"])),
            *chance.choice(([], [], ["--no-skip", "active"], ["--no-skip", "branches"], ["--no-skip", "cache"])),
        ]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("drun", type=lambda path: pathlib.Path(path).resolve())
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--ways", type=int, default=4)
    parser.add_argument("--keep", type=pathlib.Path, default=pathlib.Path("."))
    options = parser.parse_args()
    icd = os.environ.get("DR_LAVAPIPE_ICD")
    if not icd:
        print("long_programs.py is left out: DR_LAVAPIPE_ICD is not set")
        return 1 if os.environ.get("CI") else 77
    programs = ran = refused = wrong = 0
    begin, seed = time.monotonic(), options.seed
    while time.monotonic() - begin < options.seconds:
        folder = pathlib.Path(tempfile.mkdtemp())
        program = Program(seed)
        (folder / "p.dr").write_text(program.text())
        bind = program.data(folder)

        def look(*arguments):
            try:
                done = subprocess.run([options.drun, "p.dr", *bind, "--step", "look", *arguments], cwd=folder, timeout=200, text=True,
                                      capture_output=True, env={**os.environ, "VK_ICD_FILENAMES": icd, "VK_DRIVER_FILES": icd})
                return done.returncode, done.stderr
            except subprocess.TimeoutExpired:
                return 124, "more than 200 s"

        status, said = look("--device", "reference", "--out", "expected")
        found = [] if status == 0 else [f"the evaluator: {said}"]
        programs += 1
        if status == 0:
            expected = {file.name: np.load(file) for file in (folder / "expected").glob("look.*.npy")}
            for k, way in enumerate([[], *ways(program.random, options.ways)]):
                status, said = look("--device", "llvmpipe", *way, "--out", f"o{k}")
                ran += 1
                if status == 1 and any(word in said for word in REFUSED):
                    refused += 1
                elif status != 0:
                    found.append(f"{' '.join(way)}: exit {status}: {said[:300]}")
                else:
                    bad = [name for name, numbers in expected.items() if not np.array_equal(numbers, np.load(folder / f"o{k}" / name))]
                    if bad:
                        found.append(f"{' '.join(way)}: {', '.join(bad)} differ")
        if found:
            wrong += 1
            options.keep.mkdir(parents=True, exist_ok=True)
            kept = options.keep / f"long-{seed}"
            print(f"seed {seed}, in {kept}: " + "\n  ".join(found), flush=True)
            subprocess.run(["cp", "-r", folder, kept], check=True)
        subprocess.run(["rm", "-rf", folder], check=True)
        seed += 1
    print(f"{programs} programs in {time.monotonic() - begin:.0f} s, {ran} ways ran, {refused} of them refused in words; {wrong} wrong")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
