# SPDX-License-Identifier: Apache-2.0
"""The page of `drun --watch` in a browser without a screen: pictures change, buttons do what they say, nothing else is asked."""
import base64
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
import unittest

from run import Run, main

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


class Browser:
    """A page, by the browser's own protocol over two pipes."""

    def __init__(self, url):
        self.folder = tempfile.mkdtemp(prefix="browser")
        to_browser, self.out = os.pipe()
        self.input, from_browser = os.pipe()

        def pipes():  # the browser reads from 3 and writes to 4
            os.dup2(to_browser, 103), os.dup2(from_browser, 104)
            os.dup2(103, 3), os.dup2(104, 4)

        self.process = subprocess.Popen(
            [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run", "--disable-extensions",
             "--disable-background-networking", "--remote-debugging-pipe", f"--user-data-dir={self.folder}", "about:blank"],
            close_fds=False, preexec_fn=pipes, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
            env={**os.environ, "HOME": self.folder})
        os.close(to_browser), os.close(from_browser)
        self.buffer, self.next_id, self.session, self.asked, self.errors = b"", 0, None, [], []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self.session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Network", "Runtime", "Page", "Log"):
            self.call(domain + ".enable")
        self.call("Page.navigate", url=url)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        try:
            self.session = None
            self.call("Browser.close")
            self.process.wait(20)
        except (subprocess.TimeoutExpired, EOFError, OSError):
            self.process.kill()
            self.process.wait()
        os.close(self.out), os.close(self.input)
        shutil.rmtree(self.folder, ignore_errors=True)

    def call(self, method, **params):
        self.next_id += 1
        message = {"id": self.next_id, "method": method, "params": params, **({"sessionId": self.session} if self.session else {})}
        os.write(self.out, json.dumps(message).encode() + b"\0")
        while True:
            while b"\0" not in self.buffer:
                part = os.read(self.input, 1 << 16)
                if not part:
                    raise EOFError("the browser has ended")
                self.buffer += part
            line, self.buffer = self.buffer.split(b"\0", 1)
            answer = json.loads(line)
            if answer.get("method") == "Network.requestWillBeSent":
                self.asked.append(answer["params"]["request"]["url"])
            if answer.get("method") in ("Runtime.exceptionThrown", "Log.entryAdded"):
                self.errors.append(answer["params"])
            if answer.get("id") == self.next_id:
                if "error" in answer:
                    raise AssertionError(answer["error"])
                return answer["result"]

    def js(self, text):
        result = self.call("Runtime.evaluate", expression=text, returnByValue=True)
        if "exceptionDetails" in result:
            raise AssertionError(result["exceptionDetails"])
        return result["result"].get("value")

    def wait(self, text, seconds=40):
        end = time.monotonic() + seconds
        while not (value := self.js(text)):
            if time.monotonic() > end:
                raise AssertionError(f"not in {seconds} seconds: {text}; {self.errors}")
            time.sleep(0.05)
        return value


class PageInABrowser(unittest.TestCase):
    def test_page(self):
        pixels = "document.querySelector('canvas[data-name=\"fit.color\"]')?.toDataURL()"
        number = "+document.querySelector('canvas[data-name=\"fit.color\"]')?.dataset.number"
        at = "byId('at').textContent"
        with Run() as run, Browser(run.url) as page:
            page.wait(number + " > 0")
            first = page.js(pixels)
            self.assertGreater(len(base64.b64decode(first.split(",")[1])), 100)
            page.wait(f"{pixels} !== {json.dumps(first)}")
            page.wait("document.querySelector('canvas[data-name=\"fit.error\"]') !== null")
            self.assertRegex(page.js(at), r"^fit: \d+ runs, ")
            page.js("byId('pause').click()")
            page.wait("byId('status').textContent === 'paused'")
            time.sleep(1.2)
            held = page.js(at).split(",")[0], page.js(pixels)
            time.sleep(1.5)
            self.assertEqual((page.js(at).split(",")[0], page.js(pixels)), held)
            page.js("byId('step').click()")
            page.wait(f"{at}.split(',')[0] !== {json.dumps(held[0])}")
            self.assertEqual(int(page.js(at).split()[1]), int(held[0].split()[1]) + 1)
            page.js("byId('resume').click()")
            page.wait("byId('status').textContent === 'running'")
            page.js("byId('stop').click()")
            self.assertEqual(run.finish()[0], 0)
            page.wait("byId('status').textContent === 'ended'")
            self.assertEqual({url.split("/")[2] for url in page.asked if not url.startswith(("about:", "data:"))}, {f"127.0.0.1:{run.port}"})
            self.assertEqual([one for one in page.errors if "favicon" not in json.dumps(one) and "ERR_CONNECTION" not in json.dumps(one)
                              and "ERR_EMPTY" not in json.dumps(one)], [])


if __name__ == "__main__":
    if BROWSER is None:
        print("no browser: the page is not looked at in one")
        sys.exit(77)
    main()
