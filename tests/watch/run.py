# SPDX-License-Identifier: Apache-2.0
"""A run that is watched, and a client of its page."""
import http.client
import json
import re
import shutil
import subprocess
import sys
import tempfile
import time
import unittest
from pathlib import Path

PROGRAM = """edition 1;
param x : float[32, 24, 2] = 0.0;
let error = mean((x - 1.0) * (x - 1.0));
let color = vec3(x, 0.5 * x, 1.0 - x);

step fit {
  x <- x - 0.01 * grad(error, x);
  output error, color, wide = 10.0 * x - 3.0, pair = vec2(error, 1.0), list = coord(7, 1).x;
}
"""
DRUN = "drun"


class Run:
    def __init__(self, *arguments, steps=100_000_000, program=PROGRAM, port=None, device="reference"):
        self.folder = Path(tempfile.mkdtemp(prefix="watch"))
        (self.folder / "fit.dr").write_text(program)
        watch = ["--watch"] + ([str(port)] if port is not None else [])
        self.process = subprocess.Popen(
            [DRUN, *watch, "fit.dr", "--device", device, "--step", f"fit={steps}", "--out", "out", *arguments],
            cwd=self.folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        line = self.process.stderr.readline()
        found = re.fullmatch(r"watch: (http://127\.0\.0\.1:(\d+)/\?token=([0-9a-f]{32}))\n", line)
        self.first_line = line
        if found:
            self.url, self.port, self.token = found.group(1), int(found.group(2)), found.group(3)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()
        self.process.stderr.close()
        shutil.rmtree(self.folder)

    def ask(self, path, method="GET", headers=None, token=True):
        """Status, body and headers of an answer."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=20)
        try:
            connection.request(method, path, headers={**({"X-Token": self.token} if token else {}), **(headers or {})})
            answer = connection.getresponse()
            return answer.status, answer.read(), dict(answer.getheaders())
        finally:
            connection.close()

    def state(self):
        status, body, _ = self.ask("/state")
        assert status == 200, body
        return json.loads(body)

    def press(self, button):
        status, body, _ = self.ask("/" + button, "POST")
        assert status == 200, body

    def wait(self, wanted, seconds=30):
        """The first state that `wanted` accepts."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            state = self.state()
            if wanted(state):
                return state
            time.sleep(0.02)
        raise AssertionError(f"not in {seconds} seconds: {state}")

    def finish(self):
        out, err = self.process.communicate(timeout=60)
        return self.process.returncode, out, err


def main():
    global DRUN
    DRUN = str(Path(sys.argv[1]).resolve())
    sys.modules["run"].DRUN = DRUN
    del sys.argv[1]
    unittest.main(module="__main__")
