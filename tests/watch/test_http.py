# SPDX-License-Identifier: Apache-2.0
"""What the page of `drun --watch` shows, whom it shows it to, and what its buttons do."""
import os
import re
import socket
import subprocess
import time
import unittest

import run as watched
from run import Run, main


class Page(unittest.TestCase):
    def test_shows_the_run(self):
        with Run() as run:
            status, page, headers = run.ask("/?token=" + run.token, token=False)
            self.assertEqual(status, 200)
            self.assertIn("default-src 'none'", headers["Content-Security-Policy"])
            self.assertEqual(re.findall(rb"https?://|//[a-z]+\.|@import|src=|<link", page), [])
            first = run.wait(lambda state: len(state["pictures"]) == 2 and state["runs_per_second"] > 0)
            self.assertEqual([one["name"] for one in first["pictures"]], ["fit.color", "fit.wide"])
            self.assertEqual([(one["width"], one["height"], one["layers"]) for one in first["pictures"]], [(32, 24, 2)] * 2)
            self.assertEqual(set(first["curves"]), {"fit.error", "fit.pair.0", "fit.pair.1"})
            self.assertEqual(first["status"], "running")

            def pixels(name):
                status, body, _ = run.ask("/picture?name=" + name)
                self.assertEqual((status, len(body)), (200, 4 * 32 * 24))
                return body

            early = pixels("fit.color")
            later = run.wait(lambda state: state["done"] > first["done"] and state["pictures"][0]["number"] > first["pictures"][0]["number"])
            self.assertNotEqual(early, pixels("fit.color"))
            self.assertEqual(pixels("fit.color")[3::4], b"\xff" * 32 * 24)
            curve = later["curves"]["fit.error"]
            self.assertEqual([run for run, _ in curve], sorted({run for run, _ in curve}))
            self.assertLess(curve[-1][1], curve[0][1])
            self.assertRegex(later["pictures"][1]["note"], r"^black -\d.*, white \d")
            # The layer that is asked for.
            self.assertEqual(run.ask("/layer?number=9", "POST")[0], 200)
            run.wait(lambda state: all(one["layer"] == 1 for one in state["pictures"]))

    def test_buttons(self):
        with Run() as run:
            run.wait(lambda state: state["done"] > 0)
            run.press("pause")
            time.sleep(0.5)  # the runs under way end
            paused = run.wait(lambda state: state["status"] == "paused" and state["curves"]["fit.error"][-1][0] == state["done"])
            time.sleep(0.5)
            self.assertEqual(run.state()["done"], paused["done"])
            for more in (1, 2, 3):
                run.press("step")
                after = run.wait(lambda state: state["done"] > paused["done"] + more - 1 and state["status"] == "paused")
                self.assertEqual(after["done"], paused["done"] + more)
            self.assertEqual(after["curves"]["fit.error"][-1][0], after["done"])
            for _ in range(10):  # each press is a run, however fast they come
                run.press("step")
            run.wait(lambda state: state["done"] == after["done"] + 10 and state["status"] == "paused")
            time.sleep(0.3)
            self.assertEqual(run.state()["done"], after["done"] + 10)
            run.press("resume")
            run.wait(lambda state: state["done"] > after["done"] + 10)
            run.press("stop")
            code, out, err = run.finish()
            self.assertEqual(code, 0, err)
            self.assertIn("stopped on its page: writing what there is", err)
            self.assertRegex(out, r"fit\.error = ")
            self.assertLessEqual({"x.npy", "log.jsonl"}, set(os.listdir(run.folder / "out")))
            self.assertTrue(any("color" in name for name in os.listdir(run.folder / "out")))

    def test_a_page_counts_the_runs_that_its_curves_show(self):
        with Run() as run:
            time.sleep(1.5)  # numbers for the log are there before anybody looks
            for k in range(200):
                state = run.state()
                points = [curve[-1][0] for curve in state["curves"].values() if curve]
                if points:
                    self.assertEqual((state["step"], state["done"]), ("fit", max(points)), f"answer {k}")
                time.sleep(0.005)
            self.assertTrue(points)

    def test_stop_while_paused_and_before_the_first_run(self):
        with Run() as run:
            run.press("pause")
            run.wait(lambda state: state["status"] == "paused")
            run.press("stop")
            try:
                run.press("resume")  # stays stopped
            except ConnectionError:  # and may have ended meanwhile
                pass
            self.assertEqual(run.finish()[0], 0)

    def test_a_run_that_ends(self):
        with Run(steps=3000) as run:
            state = run.state()
            while state["status"] != "ended":
                state = run.state()
                time.sleep(0.05)
            self.assertEqual(state["done"], 3000)
            self.assertEqual(state["curves"]["fit.error"][-1][0], 3000)
            self.assertEqual(run.finish()[0], 0)
            self.assertRaises(ConnectionRefusedError, run.state)

    def test_results_have_the_same_bits(self):
        with Run(steps=2000) as run:
            while run.process.poll() is None:
                try:
                    run.state()
                except OSError:
                    break
            self.assertEqual(run.finish()[0], 0)
            subprocess.run([watched.DRUN, "fit.dr", "--device", "reference", "--step", "fit=2000", "--out", "alone"], cwd=run.folder, check=True,
                           stdout=subprocess.DEVNULL)
            for file in ("x.npy", "log.jsonl"):
                self.assertEqual((run.folder / "out" / file).read_bytes(), (run.folder / "alone" / file).read_bytes())


class Door(unittest.TestCase):
    def test_only_with_the_token(self):
        with Run() as run:
            for path in ("/", "/state", "/picture?name=fit.color"):
                self.assertEqual(run.ask(path, token=False)[0], 403)
                self.assertEqual(run.ask(path, token=False, headers={"X-Token": "0" * 32})[0], 403)
                self.assertEqual(run.ask(path + ("&" if "?" in path else "?") + "token=" + run.token[:-1], token=False)[0], 403)
            for button in ("pause", "resume", "step", "stop", "layer?number=1"):
                self.assertEqual(run.ask("/" + button, "POST", token=False)[0], 403)
                # A form of another page can send an address, but no header.
                self.assertEqual(run.ask(f"/{button.split('?')[0]}?token={run.token}", "POST", token=False)[0], 403)
                self.assertEqual(run.ask("/" + button)[0], 404)
            self.assertEqual(run.state()["status"], "running")

    def test_only_as_this_machine(self):
        with Run() as run:
            for host in ("evil.example", f"evil.example:{run.port}", "127.0.0.1", f"127.0.0.1:{run.port + 1}", f"127.0.0.1:{run.port}.evil.example", ""):
                self.assertEqual(run.ask("/state", headers={"Host": host})[0], 403, host)
            self.assertEqual(run.ask("/state", headers={"Host": f"localhost:{run.port}"})[0], 200)
            for origin in ("http://evil.example", "null", f"https://127.0.0.1:{run.port}", "http://127.0.0.1:1"):
                self.assertEqual(run.ask("/pause", "POST", headers={"Origin": origin})[0], 403, origin)
            self.assertEqual(run.ask("/pause", "POST", headers={"Origin": f"http://127.0.0.1:{run.port}"})[0], 200)
            for method in ("OPTIONS", "PUT", "DELETE", "HEAD", "TRACE"):
                self.assertEqual(run.ask("/state", method)[0], 405, method)
            addresses = {one[4][0] for one in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)}
            for address in addresses - {"127.0.0.1"}:
                if not address.startswith("127."):
                    with self.assertRaises(OSError):
                        socket.create_connection((address, run.port), timeout=2)

    def test_a_port_that_is_taken(self):
        with Run() as run, Run(port=run.port) as second:
            self.assertIn(f"port {run.port} of 127.0.0.1 is taken", second.first_line)
            self.assertEqual(second.finish()[0], 1)
            self.assertEqual(run.state()["status"], "running")
        for bad in ("70000", "99999999999", "-1", "8765.5", "abc", "80port"):
            ended = subprocess.run([watched.DRUN, "--watch", bad, "fit.dr"], capture_output=True, text=True)
            self.assertEqual(ended.returncode, 2)
            self.assertIn(f"expected a port from 1 to 65535, or 0 for any, found '{bad}'", ended.stderr)
        # A program's file is one, whatever it is called.
        with Run() as run:
            (run.folder / "8000").write_text("edition 1;\n")
            for file in ("fit.dr", "8000", "none.dr"):
                ended = subprocess.run([watched.DRUN, "--watch", file, "--step", "none"], cwd=run.folder, capture_output=True, text=True)
                self.assertNotIn("expected a port", ended.stderr)
                self.assertEqual(ended.returncode, 1, ended.stderr)

    def test_strange_clients(self):
        with Run() as run:
            run.wait(lambda state: state["done"] > 0)
            files = len(os.listdir(f"/proc/{run.process.pid}/fd"))
            for bad in (b"", b"\r\n\r\n", b"GET\r\n\r\n", b"GET / HTTP/9\r\n\r\n", b"\x00" * 9000, b"GET / HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n",
                        b"POST /stop HTTP/1.1\r\nContent-Length: 99999999\r\n\r\n", b"GET /" + b"a" * 20000, b"GET /%%%2 HTTP/1.1\r\n\r\n"):
                with socket.create_connection(("127.0.0.1", run.port)) as client:
                    client.sendall(bad)
                    client.settimeout(0.2)
                    try:
                        answer = client.recv(100)
                        self.assertRegex(answer, rb"^(HTTP/1.1 4\d\d |$)")
                    except (TimeoutError, socket.timeout, ConnectionResetError):
                        pass  # it waits for more, or did not read all
            # Some begin and never go on, some ask and never read, some leave at once.
            slow = [socket.create_connection(("127.0.0.1", run.port)) for _ in range(20)]
            for client in slow[:10]:
                client.sendall(b"GET /state HT")
            for client in slow[10:]:
                client.sendall(f"GET /state HTTP/1.1\r\nHost: 127.0.0.1:{run.port}\r\nX-Token: {run.token}\r\n\r\n".encode())
            for _ in range(100):
                socket.create_connection(("127.0.0.1", run.port)).close()
            for _ in range(1000):
                self.assertEqual(run.ask("/state")[0], 200)
            for client in slow:
                client.close()
            run.wait(lambda state: len(os.listdir(f"/proc/{run.process.pid}/fd")) <= files + 1)
            run.press("stop")
            self.assertEqual(run.finish()[0], 0)


if __name__ == "__main__":
    main()
