#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Each module of the library begins with one worked example: a program, the command that runs it, and what that prints at its end,
# to four digits. usage: library_examples_test.sh DRC SOURCE_ROOT
set -euo pipefail
drc=$(realpath "$1")
cd "$2/docs/examples"
exec python3 - "$drc" ../../stdlib/std/*.dr << 'END_OF_PYTHON'
import pathlib, re, shlex, subprocess, sys, tempfile

NUMBER = r"-?\d+\.?\d*(?:e[-+]?\d+)?"
drc, modules = sys.argv[1], sys.argv[2:]


def head(path):
    """The comment that a module begins with."""
    lines = []
    for line in pathlib.Path(path).read_text(encoding="utf-8").splitlines():
        if not line.startswith("///"):
            break
        lines.append(line[4:])
    return "\n".join(lines)


def same(shown, printed):
    """Equal text, and numbers that agree to the digits shown."""
    if re.sub(NUMBER, "#", shown) != re.sub(NUMBER, "#", printed):
        return False
    pairs = zip(re.findall(NUMBER, shown), re.findall(NUMBER, printed))
    return all(abs(float(a) - float(b)) <= 1e-3 * abs(float(a)) + 1e-7 for a, b in pairs)


def fault_of(module, folder):
    text = head(module)
    programs = re.findall(r"^```dr\n(.*?)^```$", text, re.M | re.S)
    if len(programs) != 1:
        return f"expected one program in its first comment, found {len(programs)}"
    name = pathlib.Path(module).stem
    if not re.search(rf"^import std\.{name}\b", programs[0], re.M):
        return f"its example does not import std.{name}"
    ends = re.search(r"^`(drc eval (\S+).*)` ends with\n\n```text\n(.*?)^```", text, re.M | re.S)
    if not ends:
        return "its example says no command and what that ends with"
    program = pathlib.Path(folder) / ends[2]
    program.write_text(programs[0], encoding="utf-8")
    arguments = [str(program) if a == ends[2] else a for a in shlex.split(ends[1])[1:]]
    ran = subprocess.run([drc, *arguments], capture_output=True, text=True)
    if ran.returncode != 0 or ran.stderr:
        return f"its example ends with {ran.returncode}: {ran.stderr}"
    formatted = subprocess.run([drc, "fmt", "--check", str(program)], capture_output=True, text=True)
    if formatted.returncode != 0:
        return "its example is not as drc fmt has it"
    shown = ends[3].splitlines()
    printed = ran.stdout.splitlines()[-len(shown):]
    if len(shown) != len(printed) or not all(map(same, shown, printed)):
        return "its example prints\n  " + "\n  ".join(printed) + "\nand not\n  " + "\n  ".join(shown)
    return None


failed = not modules
with tempfile.TemporaryDirectory() as folder:
    for module in modules:
        fault = fault_of(module, folder)
        if fault:
            print(f"{module}: {fault}")
            failed = True
print(f"{len(modules)} modules")
sys.exit(failed)
END_OF_PYTHON
