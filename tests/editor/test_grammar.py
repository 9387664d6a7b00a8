# SPDX-License-Identifier: Apache-2.0
"""The grammar for colours knows every word of the language, by the compiler's own tables, and colours programs as they are meant.

Editors use Oniguruma's regular expressions; the grammar keeps to what Python's have too.
"""
import json
import re
import unittest

import client as editor
from client import Client, main


def load(name):
    return json.loads((editor.ROOT / "dsl/editors" / name).read_text(encoding="utf-8"))


class Colours:
    """As much of a TextMate tokenizer as the grammar uses: patterns of one line, the leftmost match, of those the first."""

    def __init__(self, grammar):
        self.patterns = []
        for include in grammar["patterns"]:
            for pattern in grammar["repository"][include["include"][1:]]["patterns"]:
                assert set(pattern) <= {"name", "match", "captures", "begin", "end", "patterns"}, pattern
                text = pattern.get("match")
                if text is None:  # a string
                    text = f"{pattern['begin']}(?:\\\\.|[^\"\\\\])*(?:{pattern['end']})"
                self.patterns.append((re.compile(text), pattern))

    def line(self, text):
        """Pairs of text and scope."""
        found, at = [], 0
        while at < len(text):
            matches = [(match.start(), k, match) for k, (regex, _) in enumerate(self.patterns) if (match := regex.search(text, at))]
            if not matches:
                break
            _, k, match = min(matches, key=lambda one: one[:2])
            pattern = self.patterns[k][1]
            if "captures" in pattern:
                found += [(match.group(int(group)), scope["name"]) for group, scope in pattern["captures"].items()]
            else:
                found.append((match.group(), pattern["name"]))
            assert match.end() > at, (text, pattern)
            at = match.end()
        return [(part, scope.removesuffix(".dressi")) for part, scope in found]


class Grammar(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.colours = Colours(load("dressi.tmLanguage.json"))

    def scope(self, text, word):
        return dict(self.colours.line(text)).get(word)

    def test_knows_every_word_of_the_compiler(self):
        with Client() as client:
            client.open("file:///empty.dr", "")
            items = client.at("completion", "file:///empty.dr", (0, 0))["items"]
        kinds = {}
        for item in items:
            kinds.setdefault(item["kind"], set()).add(item["label"])
        functions, keywords, types = kinds[3], kinds[14], kinds[22]
        builtins = set(editor.builtins())
        self.assertEqual(functions, builtins - {"at", "layer"})
        for word in builtins:
            with self.subTest(word=word):
                used = f"y.{word}(x)" if word in ("at", "layer") else f"let y = {word}(x);"
                self.assertEqual(self.scope(used, word), "support.type" if word in ("array", "topology") else "support.function")
        for word in keywords:
            with self.subTest(word=word):
                self.assertRegex(self.scope(f"@{word}(f)" if word == "vjp" else f"{word} ", word) or "",
                                 r"^(keyword\.control|storage\.(type|modifier)|constant\.language|variable\.language)$")
        self.assertGreater(len(types), 15)
        for word in types:
            with self.subTest(word=word):
                self.assertEqual(self.scope(f"param x : {word};", word), "support.type")

    def test_no_word_is_made_up(self):
        source = json.dumps(load("dressi.tmLanguage.json"))
        words = re.findall(r"\(\?:([a-z0-9_|A-Z]{40,})\)", source)
        with Client() as client:
            client.open("file:///empty.dr", "")
            known = set(client.labels("file:///empty.dr", (0, 0)))
        for word in "|".join(words).split("|"):
            self.assertIn(word, known | {"at", "layer"})

    def test_colours_programs_as_they_are_meant(self):
        expected = (
            ("/// A lamp. let", {"/// A lamp. let": "comment.line.documentation"}),
            ("let x = 2.px; // fn", {"let": "storage.type", "2": "constant.numeric.integer", "// fn": "comment.line.double-slash"}),
            ("for k in 0..12u {", {"for": "keyword.control", "in": "keyword.control", "0": "constant.numeric.integer",
                                   "..": "keyword.operator", "12u": "constant.numeric.integer"}),
            ("x <- x - 1.5e-3 * pair.0.1;", {"<-": "keyword.operator", "1.5e-3": "constant.numeric.float"}),
            ("step fit { minimize e over x with adam(rate = 0.1); }", {
                "step": "storage.type", "fit": "entity.name.function", "minimize": "keyword.control", "over": "keyword.control",
                "with": "keyword.control", "adam": "entity.name.function.call"}),
            ("let k = step_index of fit;", {"step_index": "variable.language", "of": "keyword.control"}),
            ("mean(x, over = layers)", {"mean": "support.function", "over": None}),
            ("fn project(p: vec3) -> vec2 {", {"fn": "storage.type", "project": "entity.name.function", "vec3": "support.type"}),
            ("step(0.5, ray.input)", {"step": "support.function", "input": None}),
            ('import std.camera as cam; "a\\" // b" x', {"import": "keyword.control", "std.camera": "entity.name.namespace",
                                                        '"a\\" // b"': "string.quoted.double"}),
        )
        for text, scopes in expected:
            for word, scope in scopes.items():
                with self.subTest(text=text, word=word):
                    self.assertEqual(self.scope(text, word), scope)

    def test_goes_over_every_program(self):
        for path in (*editor.ROOT.glob("docs/examples/**/*.dr"), *editor.ROOT.glob("stdlib/std/*.dr")):
            for line in path.read_text(encoding="utf-8").split("\n"):
                for part, scope in self.colours.line(line):
                    self.assertIn(part, line)
                    if scope.startswith("comment"):
                        self.assertTrue(line.endswith(part))

    def test_the_extension_is_whole(self):
        package = load("package.json")
        for file in (package["main"], package["contributes"]["grammars"][0]["path"],
                     package["contributes"]["languages"][0]["configuration"]):
            self.assertTrue((editor.ROOT / "dsl/editors" / file).is_file(), file)
        # The client of the server needs as new an editor: its releases of number 9 say 1.82.
        self.assertEqual(package["dependencies"]["vscode-languageclient"], "^9.0.0")
        self.assertEqual(package["engines"]["vscode"], "^1.82.0")
        extension = (editor.ROOT / "dsl/editors/extension.js").read_text()
        self.assertEqual(re.findall(r"scheme: '(\w+)', language: 'dressi'", extension), ["file", "untitled"])
        self.assertEqual(package["contributes"]["grammars"][0]["scopeName"], load("dressi.tmLanguage.json")["scopeName"])
        self.assertEqual(load("language-configuration.json")["comments"], {"lineComment": "//"})
        settings = set(package["contributes"]["configuration"]["properties"])
        read = re.findall(r"settings.get\('(\w+)'\)", (editor.ROOT / "dsl/editors/extension.js").read_text())
        self.assertEqual({"dressi." + name for name in read}, settings)


if __name__ == "__main__":
    main()
