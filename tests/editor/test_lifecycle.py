# SPDX-License-Identifier: Apache-2.0
"""How a conversation with `drc lsp` begins and ends, and that it says so when a request is none of its own."""
import unittest

from client import Client, main


class Lifecycle(unittest.TestCase):
    def test_ends_as_asked(self):
        with Client() as client:
            self.assertIsNone(client.request("shutdown", None))
            self.assertEqual(client.error("textDocument/hover", {}), -32600)
            client.notify("exit", None)
            self.assertEqual(client.process.wait(20), 0)
            self.assertEqual(client.process.stderr.read(), b"")

    def test_ends_with_an_error_unasked(self):
        for end in (lambda client: client.notify("exit", None), lambda client: client.process.stdin.close()):
            with Client() as client:
                end(client)
                self.assertEqual(client.process.wait(20), 1)

    def test_exit_before_initialize(self):
        with Client(initialize=False) as client:
            client.notify("exit", None)
            self.assertEqual(client.process.wait(20), 1)

    def test_requests_before_initialize(self):
        with Client(initialize=False) as client:
            self.assertEqual(client.error("textDocument/hover", {}), -32002)
            client.open("file:///a.dr", "let")  # of no effect
            capabilities = client.request("initialize", {"capabilities": {}})["capabilities"]
            self.assertEqual(capabilities["textDocumentSync"]["change"], 2)
            self.assertEqual(client.error("initialize", {}), -32600)
            self.assertEqual(client.error("textDocument/formatting", {"textDocument": {"uri": "file:///a.dr"}}), -32602)

    def test_unknown_methods(self):
        with Client() as client:
            self.assertEqual(client.error("textDocument/rename", {}), -32601)
            self.assertEqual(client.error("$/whatever", {}), -32601)
            client.notify("$/setTrace", {"value": "off"})
            client.notify("workspace/didChangeConfiguration", {"settings": None})
            self.assertEqual(client.error("textDocument/hover", {"textDocument": {"uri": "file:///none.dr"},
                                                                 "position": {"line": 0, "character": 0}}), -32602)

    def test_cancelled(self):
        with Client() as client:
            uri = "file:///slow.dr"
            client.open(uri, "edition 1;\nstep s { var x = 0.0; for i in 0..4096 { for j in 0..4096 { x = x + 1.0; } } output x = x; }\n")
            where = {"textDocument": {"uri": uri}, "position": {"line": 1, "character": 5}}
            first = client.start("textDocument/hover", where)
            second = client.start("textDocument/hover", where)
            client.notify("$/cancelRequest", {"id": second})
            client.notify("$/cancelRequest", {"id": 999})
            client.notify("$/cancelRequest", None)
            self.assertIn("result", client.answer(first))
            self.assertIn(client.answer(second).get("error", {}).get("code"), (-32800,))
            self.assertIn("result", client.answer(client.start("textDocument/hover", where)))


if __name__ == "__main__":
    main()
