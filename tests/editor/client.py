# SPDX-License-Identifier: Apache-2.0
"""A client of the Language Server Protocol, as an editor is one."""
import json
import os
import queue
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import unittest
from pathlib import Path

DRC, ROOT = Path("drc"), Path(".")


def builtins():
    """The functions of the language: those of the table, and those that entries of ops offer by the op's name."""
    names = re.findall(r'^        \{"(\w+)", \d', (ROOT / "compiler/lower/builtins/builtins.cpp").read_text(), re.M)
    op_names = dict(re.findall(r'^DR_(?:OP|ELEMENTWISE)\((\w+), "(\w+)"\)', (ROOT / "compiler/ir/op_kinds.def").read_text(), re.M))
    for family in sorted((ROOT / "compiler/ops").glob("*.cpp")):
        for entry in family.read_text().split("{.kind = OpKind::")[1:]:
            if ".is_function = true" in entry:
                names.append(op_names[re.match(r"\w+", entry).group()])
    return names


class Gone(Exception):
    """The server has ended."""


class Client:
    """A server under test. Messages that nobody waits for are kept."""

    def __init__(self, *arguments, initialize=True, options=None):
        self.cache = tempfile.mkdtemp(prefix="editor")
        self.process = subprocess.Popen(
            [DRC, "lsp", *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            env={**os.environ, "DRC_CACHE_DIR": self.cache})
        self.messages = queue.Queue()
        self.kept = []
        self.next_id = 1
        self.reader = threading.Thread(target=self._read, daemon=True)
        self.reader.start()
        if initialize:
            self.server = self.request("initialize", {"processId": None, "rootUri": None, "capabilities": {},
                                                      **({"initializationOptions": options} if options else {})})
            self.notify("initialized", {})

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()
        self.reader.join()
        for stream in (self.process.stdin, self.process.stdout, self.process.stderr):
            stream.close()
        shutil.rmtree(self.cache, ignore_errors=True)

    def _read(self):
        out = self.process.stdout
        while True:
            length = None
            while (line := out.readline()).strip():
                name, value = line.decode().split(":")
                assert name == "Content-Length", line
                length = int(value)
            if length is None:
                break
            self.messages.put(json.loads(out.read(length)))
        self.messages.put(None)

    def send_bytes(self, data):
        try:
            self.process.stdin.write(data)
            self.process.stdin.flush()
        except BrokenPipeError as error:
            raise Gone() from error

    def send(self, message):
        body = json.dumps(message).encode()
        self.send_bytes(b"Content-Length: %d\r\n\r\n" % len(body) + body)

    def notify(self, method, params):
        self.send({"jsonrpc": "2.0", "method": method, "params": params})

    def start(self, method, params):
        identity = self.next_id
        self.next_id += 1
        self.send({"jsonrpc": "2.0", "id": identity, "method": method, "params": params})
        return identity

    def wait(self, wanted, timeout=200):
        """The first message that `wanted` accepts."""
        for place, message in enumerate(self.kept):
            if wanted(message):
                return self.kept.pop(place)
        while True:
            message = self.messages.get(timeout=timeout)
            if message is None:
                raise Gone(self.process.stderr.read().decode())
            if wanted(message):
                return message
            self.kept.append(message)

    def answer(self, identity):
        return self.wait(lambda message: message.get("id") == identity and "method" not in message)

    def request(self, method, params):
        answer = self.answer(self.start(method, params))
        if "error" in answer:
            raise AssertionError(answer["error"])
        return answer["result"]

    def error(self, method, params):
        return self.answer(self.start(method, params))["error"]["code"]

    def open(self, uri, text):
        self.notify("textDocument/didOpen", {"textDocument": {"uri": uri, "languageId": "dressi", "version": 1, "text": text}})

    def change(self, uri, changes, version=2):
        self.notify("textDocument/didChange", {"textDocument": {"uri": uri, "version": version}, "contentChanges": changes})

    def diagnostics(self, uri, version=None):
        def wanted(message):
            params = message.get("params", {})
            return (message.get("method") == "textDocument/publishDiagnostics" and params["uri"] == uri
                    and (version is None or params.get("version") == version))
        return self.wait(wanted)["params"]["diagnostics"]

    def at(self, method, uri, place):
        line, character = place
        return self.request("textDocument/" + method, {"textDocument": {"uri": uri},
                                                       "position": {"line": line, "character": character}})

    def hover(self, uri, place):
        result = self.at("hover", uri, place)
        return result["contents"]["value"] if result else ""

    def labels(self, uri, place):
        return [item["label"] for item in self.at("completion", uri, place)["items"]]


def place_of(text, marked, nth=0):
    """Line and UTF-16 column of the nth occurrence of a text."""
    at = -1
    for _ in range(nth + 1):
        at = text.index(marked, at + 1)
    before = text[:at]
    column = before[before.rfind("\n") + 1:]
    return before.count("\n"), len(column.encode("utf-16-le")) // 2


def main():
    global DRC, ROOT
    DRC, ROOT = Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve()
    del sys.argv[1:3]
    sys.modules["client"].DRC, sys.modules["client"].ROOT = DRC, ROOT
    unittest.main(module="__main__")
