# SPDX-License-Identifier: Apache-2.0
"""What `drc lsp` answers: messages, hover, definitions, completion and layout."""
import re
import subprocess
import tempfile
import unittest
from pathlib import Path
from urllib.parse import unquote, urlparse

import client as editor
from client import Client, main, place_of

PROGRAM = """edition 1;
import std.camera;
import std.optim as opt;

/// How bright the lamp is.
param power : vec3[W, H];
input photo : vec3[W, H];
const K = 4;

/// A ray of light.
struct Ray {
  origin: vec3;
  along: vec3;
  fn end(self, t: float) -> vec3 { self.origin + self.along * t }
}

/// Twice what it is given.
fn twice(x) -> vec3 {
  let half = x * 0.5;
  half + half + x
}

fn nobody(ray: Ray, c: vec3) -> vec3 { ray.along }

// 🙂
let bright = twice(power) - photo;
let ray = Ray(origin = vec3(0.0), along = vec3(1.0));
let error = mean(dot(bright, bright));

step fit {
  minimize error over power with opt.adam(rate = 0.1);
  output error;
}
"""
URI = "file:///program.dr"


class Answers(unittest.TestCase):
    def setUp(self):
        self.client = self.enterContext(Client()) if hasattr(self, "enterContext") else Client()
        if not hasattr(self, "enterContext"):
            self.addCleanup(self.client.__exit__)
        self.client.open(URI, PROGRAM)

    def hover(self, marked, nth=0, inside=0):
        line, character = place_of(PROGRAM, marked, nth)
        return self.client.hover(URI, (line, character + inside))

    def edited(self, marked, replacement):
        """The program with another text in a place; the place behind it."""
        uri = "file:///edited.dr"
        text = PROGRAM.replace(marked, replacement + "@", 1)
        place = place_of(text, "@")
        self.client.open(uri, text.replace("@", "", 1))
        return uri, place

    # ---- messages ----

    def test_messages_come_and_go(self):
        self.assertEqual(self.client.diagnostics(URI, 1), [])
        line, character = place_of(PROGRAM, "photo;", 0)
        self.client.change(URI, [{"range": {"start": {"line": line, "character": character},
                                            "end": {"line": line, "character": character + 5}}, "text": "phot"}], 2)
        found = self.client.diagnostics(URI, 2)
        self.assertEqual([one["code"] for one in found], ["E0201"])
        self.assertIn("did you mean 'photo'?", found[0]["message"])
        self.assertEqual(found[0]["range"], {"start": {"line": line, "character": character},
                                             "end": {"line": line, "character": character + 4}})
        # The smiley has two UTF-16 units and four bytes.
        self.client.open("file:///smiley.dr", 'edition 1;\nlet a = "🙂" ?;\n')
        start = self.client.diagnostics("file:///smiley.dr")[0]["range"]["start"]
        self.assertEqual(start, {"line": 1, "character": 13})
        self.client.change(URI, [{"text": PROGRAM}], 3)
        self.assertEqual(self.client.diagnostics(URI, 3), [])
        self.client.change(URI, [{"text": "edition 1;\nlet a = ;\nlet b = missing;\n"}], 4)
        self.assertEqual([one["code"] for one in self.client.diagnostics(URI, 4)], ["E0102"])

    def test_messages_of_calls_lead_into_the_program(self):
        self.client.open("file:///call.dr", "edition 1;\nimport std.image;\nparam p : float[W, H];\n"
                         "let q = image.blur(p, p);\nstep s { output q; }\n")
        found = self.client.diagnostics("file:///call.dr")
        text = subprocess.run([editor.DRC, "check", "-"], input="edition 1;\nimport std.image;\nparam p : float[W, H];\n"
                              "let q = image.blur(p, p);\nstep s { output q; }\n", capture_output=True, text=True).stderr
        self.assertEqual([one["code"] for one in found], re.findall(r"error\[(E\d+)\]", text))
        self.assertEqual(found[0]["range"]["start"]["line"], 3)

    def test_a_module_that_is_open_counts_as_it_is_written(self):
        with tempfile.TemporaryDirectory() as folder:
            module, program = Path(folder, "lamp.dr"), Path(folder, "main.dr")
            module.write_text("edition 1;\nfn shine(x) { x }\n")
            text = "edition 1;\nimport lamp;\nparam p : float;\nstep s { output q = lamp.shine(p); }\n"
            program.write_text(text)
            self.client.open(program.as_uri(), text)
            self.assertEqual(self.client.diagnostics(program.as_uri()), [])
            self.client.open(module.as_uri(), "edition 1;\nfn glow(x) { x }\n")
            self.assertEqual([one["code"] for one in self.client.diagnostics(program.as_uri())], ["E0205"])
            self.client.notify("textDocument/didClose", {"textDocument": {"uri": module.as_uri()}})
            self.assertEqual(self.client.diagnostics(module.as_uri()), [])
            self.assertEqual(self.client.diagnostics(program.as_uri()), [])

    # ---- hover ----

    def test_hover_says_type_extent_and_documentation(self):
        self.assertIn("bright: vec3[W, H]", self.hover("bright ="))
        self.assertIn("param power : vec3[W, H]", self.hover("power", 2))
        self.assertIn("How bright the lamp is.", self.hover("power", 2))
        self.assertIn("error: float", self.hover("error;"))
        self.assertIn("const K = 4", self.hover("K"))
        self.assertIn("K: int = 4", self.hover("K"))
        twice = self.hover("twice(power)")
        self.assertIn("fn twice(x) -> vec3", twice)
        self.assertIn("Twice what it is given.", twice)
        # In a function: what the call came to; at the end of a name too.
        self.assertIn("half: vec3[W, H]", self.hover("half +"))
        self.assertIn("half: vec3[W, H]", self.hover("half +", 0, 4))
        self.assertIn("along: vec3", self.hover("along }"))
        self.assertIn("x: vec3[W, H]", self.hover("x * 0.5"))

    def test_hover_over_the_library_and_the_language(self):
        adam = self.hover("adam")
        self.assertIn("optimizer adam(", adam)
        module = editor.ROOT / "stdlib/std/optim.dr"
        doc = re.search(r"((?:///.*\n)+)optimizer adam", module.read_text()).group(1).split("\n")[0].strip("/ ")
        self.assertIn(doc, adam)
        self.assertIn("The sum of the products", self.hover("dot(bright"))
        self.assertIn("minimize loss over param with optimizer;", self.hover("minimize"))
        self.assertIn("std/camera.dr", self.hover("camera"))
        self.assertEqual(self.hover("= mean"), "")

    def test_every_word_of_the_language_is_explained(self):
        builtins = editor.builtins()
        self.assertGreater(len(builtins), 100)
        lexer = (editor.ROOT / "dsl/syntax/lexer.cpp").read_text()
        keywords = [word.lower() for word in re.findall(r"TokenKind::(\w+)", lexer.split("kKeywords[] = {")[1].split("}")[0])]
        self.assertEqual(len(keywords), 13)
        for word in builtins + keywords + ["param", "input", "state", "step", "struct", "optimizer", "private", "import"]:
            with self.subTest(word=word):
                uri = f"file:///{word}.dr"
                behind = "x." if word in ("at", "layer") else ""
                self.client.open(uri, f"edition 1;\n{behind}{word}")
                self.assertIn(word, self.client.hover(uri, (1, len(behind) + 1)))
                if word not in ("at", "layer"):
                    items = self.client.at("completion", uri, (1, 1))["items"]
                    item = next(item for item in items if item["label"] == word)
                    self.assertTrue(item["documentation"]["value"])

    # ---- definitions ----

    def definition(self, marked, nth=0):
        place = self.client.at("definition", URI, place_of(PROGRAM, marked, nth))
        if place is None:
            return None
        start = place["range"]["start"]
        path = Path(unquote(urlparse(place["uri"]).path))
        text = PROGRAM if place["uri"] == URI else path.read_text()
        return path, text.split("\n")[start["line"]][start["character"]:]

    def test_definitions_in_the_program(self):
        self.assertTrue(self.definition("power", 2)[1].startswith("power : vec3[W, H]"))
        self.assertTrue(self.definition("half + half")[1].startswith("half = x"))
        self.assertTrue(self.definition("twice(power)")[1].startswith("twice(x)"))
        self.assertTrue(self.definition("Ray(origin")[1].startswith("Ray {"))
        self.assertTrue(self.definition("along }")[1].startswith("along: vec3;"))
        self.assertTrue(self.definition("error over")[1].startswith("error = mean"))
        self.assertTrue(self.definition("ray.along")[1].startswith("ray: Ray, c"))
        self.assertIsNone(self.definition("mean"))
        self.assertIsNone(self.definition("edition"))

    def test_definitions_in_the_library_are_files(self):
        path, line = self.definition("adam")
        self.assertTrue(line.startswith("adam("))
        self.assertEqual(path.read_text(), (editor.ROOT / "stdlib/std/optim.dr").read_text())
        self.assertFalse(path.stat().st_mode & 0o222)
        self.assertEqual(self.definition("opt.")[0].name, "optim.dr")
        # What the editor then opens has names to follow too, and no messages of its own.
        uri = path.as_uri()
        self.client.open(uri, path.read_text())
        self.assertEqual(self.client.diagnostics(uri), [])
        row, column = place_of(path.read_text(), "optimizer adam(")
        again = self.client.at("definition", uri, (row, column + len("optimizer ")))
        self.assertEqual(again["uri"], uri)

    # ---- completion ----

    def test_names_in_scope(self):
        labels = self.client.labels(URI, place_of(PROGRAM, "half + half"))
        for name in ("half", "x", "twice", "power", "K", "Ray", "opt", "camera", "smoothstep", "let", "vec3", "output"):
            self.assertIn(name, labels)
        self.assertEqual(labels.count("half"), 1)
        self.assertNotIn("half", self.client.labels(URI, (0, 0)) if "half" not in labels[-200:] else [])
        at_end = [item for item in self.client.at("completion", URI, place_of(PROGRAM, "output error"))["items"]]
        by_name = {item["label"]: item for item in at_end}
        self.assertEqual(by_name["bright"]["detail"], "vec3[W, H]")
        self.assertNotIn("x", by_name)
        self.assertNotIn("origin", by_name)
        self.assertNotIn("fit", by_name)

    def test_members(self):
        for written, expected in (("let q = ray.", {"origin", "along", "end"}), ("let q = ray.al", {"origin", "along", "end"}),
                                  ("let q = power.", {"x", "y", "z", "width", "height", "layers", "at", "layer"}),
                                  ("let q = opt.", {"adam", "sgd"}), ("let q = ray.along.", {"x", "width"})):
            for end in ("\nlet error", ";\nlet error", ".x + 1.0;\nlet error" if written.endswith("al") else ";\nlet error"):
                with self.subTest(written=written, end=end):
                    uri, place = self.edited("let error", written)
                    labels = self.client.labels(uri, place)
                    self.assertLessEqual(expected, set(labels))
                    self.assertNotIn("let", labels)
        # In a function that nobody calls, what is written tells.
        uri, place = self.edited("{ ray.along }", "{ ray.")
        self.assertEqual(set(self.client.labels(uri, place)), {"origin", "along", "end"})

    def test_modules(self):
        uri, place = self.edited("import std.camera;", "import std.")
        labels = self.client.labels(uri, place)
        self.assertEqual(set(labels), {path.stem for path in (editor.ROOT / "stdlib/std").glob("*.dr")})
        uri, place = self.edited("import std.camera;", "import ")
        self.assertIn("std", self.client.labels(uri, place))

    def test_nothing_in_prose(self):
        for marked in ("A ray of", "🙂"):
            self.assertEqual(self.client.labels(URI, place_of(PROGRAM, marked)), [])

    # ---- layout ----

    def test_layout_is_that_of_fmt(self):
        text = "edition 1;\nparam  x:float;\n\n\n\n// 🙂\nstep s{output   y=x+1.0;}"
        self.client.open("file:///ugly.dr", text)
        where = {"textDocument": {"uri": "file:///ugly.dr"}, "options": {"tabSize": 2, "insertSpaces": True}}
        edits = self.client.request("textDocument/formatting", where)
        wanted = subprocess.run([editor.DRC, "fmt", "-"], input=text.encode(), capture_output=True, check=True).stdout.decode()
        self.assertNotEqual(wanted, text)
        self.assertEqual([edit["newText"] for edit in edits], [wanted])
        self.assertEqual(edits[0]["range"]["end"], {"line": 6, "character": 25})
        self.client.change("file:///ugly.dr", [{"text": wanted}])
        self.assertEqual(self.client.request("textDocument/formatting", where), [])
        self.client.change("file:///ugly.dr", [{"text": "let let let"}])
        self.assertEqual(self.client.request("textDocument/formatting", where), [])


if __name__ == "__main__":
    main()
