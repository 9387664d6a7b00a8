# SPDX-License-Identifier: Apache-2.0
"""That `drc lsp` goes on whatever it is sent: broken texts, long texts, broken messages."""
import json
import random
import tempfile
import time
import unittest
from pathlib import Path

import client as editor
from client import Client, main

REQUESTS = ("hover", "definition", "completion")


class Robust(unittest.TestCase):
    def alive(self, client):
        """The client's next request is answered."""
        client.open("file:///alive.dr", "edition 1;\nparam p : float;\n")
        self.assertIn("param p", client.hover("file:///alive.dr", (1, 6)))

    def test_broken_messages(self):
        with Client() as client:
            for bad in (b"Content-Length: 3\r\n\r\n{]}", b"Content-Length: 2\r\n\r\n[]", b"Content-Length: 4\r\n\r\nnull",
                        b"nonsense\r\n\r\nContent-Length: -5\r\n\r\n", b"\r\n\r\n\r\n", b"content-length:2\r\nX: y\r\n\r\n{}",
                        b"Content-Length: 99999999999999999999\r\n\r\n", b"a" * 100000 + b"\r\n",
                        b"Content-Length: 200000\r\n\r\n" + b"[" * 200000, b"Content-Length: 2\r\n\r\n\xff\xfe"):
                client.send_bytes(bad)
            # Brackets that are closed, too: a tree that deep would take a stack of any size.
            deep = b'{"jsonrpc": "2.0", "id": 3, "method": "x", "params": ' + b"[" * 60000 + b"]" * 60000 + b"}"
            client.kept.clear()
            client.send_bytes(b"Content-Length: %d\r\n\r\n" % len(deep) + deep)
            self.alive(client)
            self.assertIn(-32700, [message.get("error", {}).get("code") for message in client.kept])
            self.alive(client)
            for message in ({"id": None, "method": "x"}, {"id": {"a": [1]}, "method": "shutdown"}, {"id": "seven"}, {"id": 1.5, "method": 3},
                            {"method": "textDocument/didOpen"}, {"method": "textDocument/didOpen", "params": [1]},
                            {"method": "textDocument/didChange", "params": {"textDocument": {"uri": "file:///alive.dr"}, "contentChanges": 3}},
                            {"method": "textDocument/didChange", "params": {"textDocument": {"uri": "file:///alive.dr"},
                             "contentChanges": [{"range": {"start": {"line": -4, "character": 1e30}}, "text": ""}]}},
                            {"jsonrpc": "2.0", "id": 3, "result": None}):
                client.send(message)
            for params in (None, [], {}, {"textDocument": 3}, {"textDocument": {"uri": "file:///alive.dr"}, "position": {"line": "x"}}):
                for method in REQUESTS:
                    self.assertEqual(client.error("textDocument/" + method, params), -32602)
            self.alive(client)

    def test_statements_where_none_may_stand(self):
        """A tree with errors is elaborated as far as it goes: whatever a block holds that it may not."""
        blocks = ("step s { %s }", "param p : float;\nstep s { output p; %s }", "step s { for k in 0..3 { %s } }",
                  "step s { for k in 0..3, max = 2 { %s } }", "step s { if true { %s } }", "param p : float;\nstep s { if p > 0.0 { %s } }",
                  "let a = { %s };", "let a = if true { %s } else { 2.0 };", "let a = reduce(sum, k in 0..3) { %s };",
                  "let a = fold(k in 0..3, c = 1.0) { %s };", "let f = fn(x) { %s 1.0 };\nlet a = f(1.0);",
                  "fn f(x) { const if true { %s } x }\nlet a = f(1.0);",
                  "optimizer o(rate) { update(x, g) { %s x } }\nparam p : float;\nstep s { minimize p over p with o(0.1); }")
        statements = ("return 1.0;", "return;", "return", "return fn(x) { x };", "break;", "output a = 1.0;", "let (a, b) = ;", "x <- ;",
                      "minimize 1.0 over;", "{ return 1.0; }", "if true { return 1.0; } else { 2.0 }", "step q { }", "for k in 0.. { }")
        with Client() as client, tempfile.TemporaryDirectory() as folder:
            for block in blocks:
                for statement in statements:
                    with self.subTest(block=block, statement=statement):
                        client.open("file:///broken.dr", "edition 1;\n" + block % statement + "\n")
                        client.hover("file:///broken.dr", (1, 5))
            client.open("file:///return.dr", "edition 1;\nstep s { return 1.0; }\n")
            self.assertEqual([one["code"] for one in client.diagnostics("file:///return.dr")], ["E0121"])
            # In a module, where an instance of it runs the step.
            Path(folder, "rig.dr").write_text("edition 1;\nparam q : float = 1.0;\nstep s { return 1.0; }\n")
            uri = Path(folder, "main.dr").as_uri()
            client.open(uri, "edition 1;\nimport rig;\nlet left = rig();\n")
            self.assertEqual([one["code"] for one in client.diagnostics(uri)], ["E0121"])
            self.alive(client)

    def test_lines_end_by_carriage_returns_alone(self):
        with Client() as client:
            client.open("file:///cr.dr", "edition 1;\rlet a = 1.0;\r\nstep go { output y = b; }\r")
            self.assertEqual([d["range"]["start"]["line"] for d in client.diagnostics("file:///cr.dr")], [2])

    def test_places_outside_of_the_text(self):
        with Client() as client:
            uri = "file:///small.dr"
            for text in ("", "\n", "\r\n\r\n", "\ufeffedition 1;", "🙂", "é", "a\u0000b", "let x = \"", "/*", "///", "x.", ".", "..", "2."):
                client.open(uri, text)
                for place in ((0, 0), (0, 1), (0, 4000000000), (1, 0), (4000000000, 7)):
                    for method in REQUESTS:
                        client.at(method, uri, place)
                client.diagnostics(uri)

    def test_changes_at_any_place(self):
        """Incremental changes give the text that the client has: its layout is that of the same text sent whole."""
        random.seed(3)
        with Client() as client:
            uri = "file:///changed.dr"
            units = "edition 1;\r\n// 🙂é\nparam x : float;\n".encode("utf-16-le")
            client.open(uri, units.decode("utf-16-le"))
            for version in range(2, 60):
                lines = units.decode("utf-16-le").split("\n")
                line = random.randrange(len(lines))
                text = lines[line].rstrip("\r") if line + 1 < len(lines) else lines[line]
                column = random.choice([len(text[:k].encode("utf-16-le")) // 2 for k in range(len(text) + 1)])
                written = random.choice(["é", "🙂", " ", "\n", "// a\n", ""])
                at = len("".join(one + "\n" for one in lines[:line]).encode("utf-16-le")) + 2 * column
                if units[at:at + 2] == b"\n\0":
                    continue
                units = units[:at] + written.encode("utf-16-le") + units[at:]
                place = {"line": line, "character": column}
                client.change(uri, [{"range": {"start": place, "end": place}, "text": written}], version)
            client.open("file:///whole.dr", units.decode("utf-16-le"))
            messages = [client.wait(lambda message, one=one: message.get("params", {}).get("uri") == one
                                    and message["params"].get("version") in (59, 58, 57, 1)) for one in (uri, "file:///whole.dr")]
            self.assertEqual(*(message["params"]["diagnostics"] for message in messages))

    def test_half_characters(self):
        """Half of a character beyond the Basic Multilingual Plane is an edit like others; what follows lands where it should."""
        uri = "file:///half.dr"
        with Client() as client:
            client.open(uri, "edition 1;\nlet a = 1.0;\nstep s { output a; }\n")
            start = {"line": 1, "character": 0}
            client.change(uri, [{"range": {"start": start, "end": start}, "text": '// \ud83d "\\\\ud83d"\n'}], 2)
            name = {"start": {"line": 3, "character": 16}, "end": {"line": 3, "character": 17}}
            client.change(uri, [{"range": name, "text": "nope"}], 3)
            message = client.wait(lambda message: message.get("params", {}).get("version") == 3)
            self.assertEqual([found["range"]["start"] for found in message["params"]["diagnostics"]], [name["start"]])

    def test_texts_that_are_cut_off(self):
        """Every example, cut at places all over it, while somebody types there."""
        random.seed(1)
        with Client() as client:
            for path in sorted((editor.ROOT / "docs/examples").glob("*.dr")):
                whole = path.read_text()
                for end in random.sample(range(len(whole)), 12):
                    text = whole[:end]
                    client.open(path.as_uri(), text)
                    line, column = text.count("\n"), len(text) - text.rfind("\n") - 1
                    for method in REQUESTS:
                        client.at(method, path.as_uri(), (line, column))
            self.alive(client)

    def test_texts_with_a_word_missing_or_too_much(self):
        random.seed(2)
        with Client() as client:
            for path in sorted((editor.ROOT / "docs/examples").glob("*.dr")) + sorted((editor.ROOT / "stdlib/std").glob("r*.dr")):
                words = path.read_text().split(" ")
                for _ in range(6):
                    place = random.randrange(len(words))
                    changed = words[:place] + random.choice([[], [words[place]] * 2, [random.choice(words)]]) + words[place + 1:]
                    client.open(path.as_uri(), " ".join(changed))
                    for method in REQUESTS:
                        client.at(method, path.as_uri(), (random.randrange(30), random.randrange(40)))
            self.alive(client)

    def test_a_long_text(self):
        """Says what answers take in a text of 1,000 lines, and that one of 20,000 is answered."""
        with Client() as client:
            for lines in (1000, 20000):
                uri = f"file:///long{lines}.dr"
                text = "edition 1;\nimport std.camera;\nparam x0 : vec3[W, H];\n" + "".join(
                    f"let x{i + 1} = mix(x{i}, vec3(0.5), 0.5) * {i}.0; // one more\n" for i in range(lines)) + "step s { output y = x1; }\n"
                client.open(uri, text)
                took = {}
                for name, method in (("first hover", "hover"), *((method, method) for method in REQUESTS)):
                    start = time.monotonic()
                    client.at(method, uri, (lines - 3, 14))
                    took[name] = f"{1000 * (time.monotonic() - start):.0f} ms"
                start = time.monotonic()
                client.request("textDocument/formatting", {"textDocument": {"uri": uri}})
                took["formatting"] = f"{1000 * (time.monotonic() - start):.0f} ms"
                print(lines, "lines:", json.dumps(took))
            self.alive(client)


if __name__ == "__main__":
    main()
