# SPDX-License-Identifier: Apache-2.0
"""The page of `Run.watch`, by a client of HTTP in another thread. What the page itself does is tests/watch's."""
import http.client
import json
import threading
import time
import urllib.parse

import numpy as np
import pytest

import dressi

PROGRAM = """edition 1;
param x : float[32, 24] = 0.0;
let error = mean((x - 1.0) * (x - 1.0));
step fit { x <- x - 0.01 * grad(error, x); output error, picture = vec3(x, 0.5, 1.0 - x); }
"""


def ask(watch, path, method="GET"):
    place = urllib.parse.urlparse(watch.url)
    connection = http.client.HTTPConnection("127.0.0.1", place.port, timeout=20)
    try:
        connection.request(method, path, headers={"X-Token": urllib.parse.parse_qs(place.query)["token"][0]})
        answer = connection.getresponse()
        return answer.status, answer.read()
    finally:
        connection.close()


def state(watch):
    return json.loads(ask(watch, "/state")[1])


def until(condition, seconds=60):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


class Fit(threading.Thread):
    """Steps until it is stopped."""

    def __init__(self, run):
        super().__init__()
        self.run_, self.error = run, None
        self.start()

    def run(self):
        try:
            self.run_.step("fit", times=10**9)
        except dressi.Error as error:
            self.error = error


def test_a_page_shows_pauses_steps_and_stops(device):
    run = dressi.compile(PROGRAM, device=device).bind()
    watch = run.watch()
    assert watch.url.startswith("http://127.0.0.1:") and watch.url in watch._repr_html_()
    fit = Fit(run)
    until(lambda: state(watch)["curves"].get("fit.error") and state(watch)["pictures"])
    assert ask(watch, "/picture?name=fit.picture")[0] == 200
    assert ask(watch, "/pause", "POST")[0] == 200
    until(lambda: state(watch)["status"] == "paused")
    time.sleep(0.3)
    held = run["x"].copy()
    time.sleep(0.3)
    np.testing.assert_array_equal(run["x"], held)  # other threads use the run meanwhile
    before = state(watch)["done"]
    ask(watch, "/step", "POST")
    until(lambda: state(watch)["done"] == before + 1)
    ask(watch, "/resume", "POST")
    until(lambda: state(watch)["done"] > before + 1)
    if device != "reference":
        assert {left["what"] for left in state(watch)["left_out"]} == {"commands", "ops", "bytes"}
    ask(watch, "/stop", "POST")
    fit.join(60)
    assert isinstance(fit.error, dressi.Stopped)
    with pytest.raises(OSError):
        state(watch)  # the page is no more
    assert run.step("fit")["error"] >= 0  # and the run goes on without it


def test_a_watched_run_has_the_same_bits_and_ends_with_it(device):
    program = dressi.compile(PROGRAM, device=device)
    alone, run = program.bind(), program.bind()
    with run.watch() as watch:
        for _ in range(5):
            run.step("fit", times=3)
        run.step("fit")
        state(watch)
        run.step("fit")
        with pytest.raises(dressi.Error, match="port"):
            program.bind().watch(urllib.parse.urlparse(watch.url).port)  # taken
    alone.step("fit", times=17)
    np.testing.assert_array_equal(alone["x"], run["x"])
    with pytest.raises(OSError):
        state(watch)
    watch.close()  # again: nothing
    with pytest.raises(dressi.Error, match="expected a port from 1 to 65535, or 0 for any, found 70000"):
        run.watch(70000)
    lost = program.bind().watch()  # its run is gone
    with pytest.raises(OSError):
        state(lost)
    lost.close()


def test_nobody_who_looks_costs_nothing(device):
    run = dressi.compile(PROGRAM, device=device).bind()
    run.step("fit", times=10)
    with run.watch():
        before = threading.active_count(), time.process_time()
        time.sleep(0.5)
        assert threading.active_count() == before[0]
        assert time.process_time() - before[1] < 0.1  # its thread sleeps
