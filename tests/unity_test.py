#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Every target compiles as one file, too, which is how fresh machines and continuous integration build it: names in unnamed
namespaces of a target must differ, and a file must not count on macros or `using` of its own staying its own.

A build of one object a file asks that here, so that what works locally works there. Syntax alone is checked, and only of
targets whose files or headers changed since they last passed.

usage: unity_test.py BUILD_FOLDER [TARGET...]
"""
import collections
import concurrent.futures
import hashlib
import json
import os
import pathlib
import shlex
import subprocess
import sys

build = pathlib.Path(sys.argv[1]).resolve()
only = set(sys.argv[2:])
kept = build / "unity"
kept.mkdir(exist_ok=True)

targets = collections.defaultdict(list)  # folder of objects -> (source, command without source and object)
for entry in json.loads((build / "compile_commands.json").read_text()):
    words = shlex.split(entry["command"])
    if os.path.basename(words[0]) == "ccache":
        words = words[1:]
    output = words[words.index("-o") + 1]
    if ".dir/" not in output:
        continue
    words = words[: words.index("-o")]
    targets[output[: output.index(".dir/")]].append((entry["file"], tuple(words)))


def check(name, sources, words):
    """The messages of the compiler, or nothing."""
    unit = kept / (name.replace("/", "_").replace("CMakeFiles_", "") + ".cpp")
    depends = unit.with_suffix(".d")
    text = "".join(f'#include "{source}"\n' for source in sources)
    stamp = unit.with_suffix(".passed")

    def state():
        files = [str(unit)]
        if depends.exists():
            files = sorted(set(depends.read_text().replace("\\\n", " ").split(":", 1)[1].split()))
        digest = hashlib.sha256(repr((words, text)).encode())
        for file in files:
            # The system's headers change with the compiler, whose version is part of the flags' fate.
            if file.startswith("/usr/"):
                continue
            try:
                digest.update(file.encode() + hashlib.sha256(pathlib.Path(file).read_bytes()).digest())
            except OSError:
                return ""
        return digest.hexdigest()

    if not unit.exists() or unit.read_text() != text:
        unit.write_text(text)
    elif stamp.exists() and stamp.read_text() == state():
        return ""
    run = subprocess.run([*words, "-w", "-fsyntax-only", "-MD", "-MF", str(depends), str(unit)],
                         cwd=build, capture_output=True, text=True)
    if run.returncode != 0:
        stamp.unlink(missing_ok=True)
        return run.stderr or "the compiler failed without a word\n"
    stamp.write_text(state())
    return ""


jobs = []
for name, entries in sorted(targets.items()):
    # As CMake does it: a source with flags of its own stays on its own.
    usual = collections.Counter(words for _, words in entries).most_common(1)[0][0]
    sources = [source for source, words in entries if words == usual]
    if len(sources) > 1 and (not only or name.rsplit("/", 1)[-1] in only):
        jobs.append((name, sources, usual))

failed = 0
with concurrent.futures.ThreadPoolExecutor(max_workers=2) as pool:
    for (name, sources, _), message in zip(jobs, pool.map(lambda job: check(*job), jobs)):
        if message:
            failed = 1
            print(f"{name.rsplit('/', 1)[-1]}: its {len(sources)} files do not compile as one:")
            print("\n".join(message.splitlines()[:30]))
print(f"{len(jobs)} targets checked")
sys.exit(failed or not jobs)
