# SPDX-License-Identifier: Apache-2.0
"""Every fuzz target in turn for as long as one likes, with corpora that are kept, and a line each of what it reached.

  run.py BUILD [--seconds N] [--seed N] [--keep FOLDER] [--drc DRC] [TARGET...]

A folder that is not there yet begins with what earlier runs kept, `corpus/kept.tar.xz`; `tar --sort=name -C FOLDER -cJf`
makes it anew. BUILD is a folder of the preset `fuzz`, where inputs that reach something new are kept, or of `asan`, where mistakes with
memory show. Seeds of bundles are made by the drc that is named, of a usual build. Exit code 1: a target died, and left
the input where this was called.
"""
import argparse
import json
import pathlib
import subprocess
import sys
import tarfile


def targets(build):
    """The tests' commands, without their seconds."""
    told = subprocess.run(["ctest", "--test-dir", str(build), "--show-only=json-v1"], capture_output=True, text=True, check=True)
    for test in json.loads(told.stdout)["tests"]:
        name, command = test["name"], test.get("command", [])
        if name.startswith("fuzz/") and "--seconds" in command:
            at = command.index("--seconds")
            yield name[len("fuzz/") :], command[:at] + command[at + 2 :]


def make_seeds(build, drc):
    tests = pathlib.Path(__file__).parent
    subprocess.run([build / "bin/tests/fuzz_reader_seeds", build / "fuzz_reader_seeds"], check=True)
    if drc:
        root = tests.parent.parent
        subprocess.run(["bash", tests / "bundle_seeds.sh", drc, root, build / "fuzz_bundle_seeds"], check=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("build", type=lambda path: pathlib.Path(path).resolve())
    parser.add_argument("--seconds", default="60")
    parser.add_argument("--seed", default="1")
    parser.add_argument("--keep", default="fuzz-corpora", type=pathlib.Path)
    parser.add_argument("--drc")
    parser.add_argument("target", nargs="*")
    options = parser.parse_intermixed_args()
    make_seeds(options.build, options.drc)
    if not options.keep.exists():
        with tarfile.open(pathlib.Path(__file__).parent / "corpus/kept.tar.xz") as kept:
            kept.extractall(options.keep)
    failed = 0
    for name, command in targets(options.build):
        if (options.target and name not in options.target) or (name.startswith("bundle_") and not options.drc):
            continue
        kept = options.keep / name
        kept.mkdir(parents=True, exist_ok=True)
        done = subprocess.run([*command, "--seconds", options.seconds, "--seed", options.seed, "--keep", str(kept)],
                              stdout=subprocess.PIPE, text=True)
        last = done.stdout.strip().splitlines()[-1] if done.stdout.strip() else "no word"
        print(f"{name:16} {last}" + (f", exit code {done.returncode}" if done.returncode else ""), flush=True)
        failed += done.returncode != 0
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
