# SPDX-License-Identifier: Apache-2.0
"""What `drc lsp` takes a name for: variables of branches and loops, names of arguments, outputs and steps, instances, words that a
place gives a meaning, and names in documents that are no files."""
import tempfile
import unittest
from pathlib import Path

from client import Client, main, place_of

VARIABLES = """edition 1;
input x : vec3[W, H];
fn g(p: float) -> float {
  var light = 1.0;
  for k in 0..4 { if p > 0.0 { light *= 0.5; } light += 1.0; }
  if p > 1.0 { light += 2.0; }
  for k in 0..x.width { light += 1.0; }
  for k in 0..4, max = 3 { light += 1.0; break if light > 9.0; }
  light
}
let a = g(x.x);
let f = fold(k in 0..x.width, c = 1.0) { c * 2.0 };
param p : vec3;
step fit { minimize dot(p, p) over p with rate(); p <- saturate(p); output a, f; }
optimizer rate() { update(x, g) { x - g } }
"""

NAMES = """edition 1;
import std.optim;
/// The global rate.
param rate : vec3 = 1.0;
param gain : float[W];
input x : vec3[W, H];
let nearest = 3.0;
fn scale(gain: vec3, by: float) -> vec3 { gain * by }
fn nobody(v: vec3) { scale(by = v.x, gain = v) }
struct Pair {
  /// How much.
  gain: vec3;
  rate: float = 1.0;
  fn all(self) { self.gain * self.rate }
}
let p = Pair(gain = rate, rate = 2.0);
let s = scale(gain = rate, by = 2.0);
let off = dot(s, s) + p.rate + p.gain.x;
let m = sum(x, over = x) + mean(x, over = (x, y));
let t = sample(x, vec2(0.5), filter = nearest, wrap = clamp);
let r = reduce(sum, i in 0..4, max = 4) { float(i) };
let n = step_index of go;
step go {
  minimize off over rate with optim.adam(rate = 0.1, beta1 = 0.5);
  output off = mean(rate), gain = if true { sum(rate) } else { rate }, x = r, m, t, n, p;
}
"""


class Names(unittest.TestCase):
    def setUp(self):
        self.client = Client()
        self.addCleanup(self.client.__exit__)

    def open(self, text, uri="file:///names.dr"):
        self.uri, self.text = uri, text
        self.client.open(uri, text)
        self.assertEqual(self.client.diagnostics(uri), [])

    def hover(self, marked, inside=0, nth=0):
        line, character = place_of(self.text, marked, nth)
        return self.client.hover(self.uri, (line, character + inside))

    def definition(self, marked, inside=0, nth=0):
        """The line and the column of where it leads."""
        line, character = place_of(self.text, marked, nth)
        found = self.client.at("definition", self.uri, (line, character + inside))
        if not found:
            return None
        start = found["range"]["start"]
        return (Path(found["uri"]).name, start["line"], start["character"])

    def here(self, marked, inside=0, nth=0):
        line, character = place_of(self.text, marked, nth)
        return (Path(self.uri).name, line, character + inside)

    # ---- variables ----

    def test_variables_of_branches_and_loops(self):
        self.open(VARIABLES)
        declared = self.here("light")
        for nth in range(1, self.text.count("light")):
            with self.subTest(nth=nth):
                self.assertEqual(self.definition("light", 0, nth), declared)
                self.assertIn("var light\n```", self.hover("light", 0, nth))
                self.assertIn("light: float", self.hover("light", 0, nth))
        for marked, word in (("for k in 0..4 {", "for k in a..b"), ("if p > 0", "if condition"), ("if p > 1", "if condition"),
                             ("for k in 0..x", "for k in a..b"), ("for k in 0..4,", "for k in a..b"), ("fold", "fold(k in")):
            with self.subTest(marked=marked):
                self.assertIn(word, self.hover(marked))
                self.assertNotIn("float", self.hover(marked))
        # After `minimize`, the param is still what is declared.
        self.assertEqual(self.definition("saturate(p)", 9), self.here("param p", 6))

    # ---- names that are no references ----

    def test_names_of_arguments(self):
        self.open(NAMES)
        for use, declared in (("Pair(gain", "  gain: vec3;"), ("rate = 2.0", "  rate: float"), ("scale(gain = rate", "gain: vec3, by"),
                              ("by = 2.0", "by: float"), ("by = v.x", "by: float"), ("gain = v)", "gain: vec3, by")):
            with self.subTest(use=use):
                inside = use.index("(") + 1 if "(" in use else 0
                self.assertEqual(self.definition(use, inside), self.here(declared, len(declared) - len(declared.lstrip())))
        self.assertIn("rate: float", self.hover("rate = 2.0"))
        self.assertIn("How much.", self.hover("Pair(gain", 5))
        self.assertEqual(self.definition("adam(rate", 5)[0], "optim.dr")
        self.assertNotIn("global", self.hover("adam(rate", 5))
        self.assertEqual(self.definition("(gain = rate", 8), self.here("param rate", 6))

    def test_names_of_outputs(self):
        self.open(NAMES)
        for marked, inside in (("output off", 7), (", gain = if", 2), (", x = r", 2)):
            with self.subTest(marked=marked):
                self.assertIsNone(self.definition(marked, inside))
                self.assertEqual(self.hover(marked, inside), "")
        self.assertEqual(self.definition("= r,", 2), self.here("let r", 4))
        self.assertEqual(self.definition("m, t, n", 0), self.here("let m", 4))

    def test_words_of_a_place(self):
        self.open(NAMES)
        for marked, inside in (("over = x)", 7), ("(x, y)", 1), ("(x, y)", 4), ("filter = nearest", 9), ("wrap = clamp", 7)):
            with self.subTest(marked=marked):
                self.assertIsNone(self.definition(marked, inside))
                self.assertEqual(self.hover(marked, inside), "")
        self.assertIn("sum(x, over", self.hover("over = x)"))
        self.assertIn("sample(image", self.hover("wrap ="))
        self.assertIn("reduce(sum, k in", self.hover("reduce(sum", 7))
        self.assertIn("reduce(sum, k in", self.hover("max = 4"))
        self.assertIn("step NAME {", self.hover("step go"))
        self.assertIn("step_index of NAME", self.hover("of go"))
        self.assertIn("minimize loss over", self.hover("over rate"))
        self.open(VARIABLES)
        self.assertIn("for k in a..b", self.hover("max = 3"))

    def test_a_function_of_yours_takes_values(self):
        self.open("edition 1;\nparam x : float;\nfn sum(v, over) { v + over }\nlet a = sum(x, over = x);\nstep s { output a; }\n")
        self.assertEqual(self.definition("over = x", 0), self.here("over)"))
        self.assertEqual(self.definition("= x)", 2), self.here("param x", 6))

    # ---- instances and steps ----

    def test_names_of_an_instance(self):
        with tempfile.TemporaryDirectory() as folder:
            Path(folder, "rig.dr").write_text("edition 1;\nparameters (k: float = 1.0);\nparam q : vec3 = 0.0;\n"
                                              "let e = dot(q, q) * k;\nstep fit { q <- q * 0.5; output e; }\nstep look { output e; }\n")
            self.open("edition 1;\nimport rig;\nlet left = rig(k = 2.0);\nlet n = step_index of left.fit;\nlet l = step_index of own;\n"
                      "step s { left.q <- left.q * 2.0; output n, l; }\nstep own { minimize left.e over left.q with sg(rate = 0.1); }\n"
                      "optimizer sg(rate) { update(x, g) { x - rate * g } }\n", Path(folder, "main.dr").as_uri())
            for nth in range(3):
                self.assertEqual(self.definition("left.q", 5, nth), ("rig.dr", 2, 6))
                self.assertIn("param q : vec3", self.hover("left.q", 5, nth))
            self.assertEqual(self.definition("rig(k", 4), ("rig.dr", 1, 12))
            self.assertEqual(self.definition("left.fit", 5), ("rig.dr", 4, 5))
            self.assertIn("step fit", self.hover("left.fit", 5))
            self.assertEqual(self.definition("of own", 3), self.here("step own", 5))
            for written, expected in (("step_index of left.", {"fit", "look"}), ("step_index of ", {"own", "s", "left", "n", "l"})):
                text = self.text.replace("let n", f"let z = {written}@;\nlet n", 1)
                place = place_of(text, "@")
                self.client.open(self.uri, text.replace("@", ""))
                self.assertEqual(set(self.client.labels(self.uri, place)) - {"z"}, expected)

    # ---- completion ----

    def labels(self, text, uri="file:///written.dr"):
        place = place_of(text, "@")
        self.client.open(uri, text.replace("@", ""))
        return self.client.labels(uri, place)

    def test_completion(self):
        image = "edition 1;\ninput im : vec3[Wide, 2 * High];\n"
        self.assertLessEqual({"Wide", "High", "im"}, set(self.labels(image + "let q = @;\n")))
        inside = "edition 1;\nfn f(im: vec3[Wide]) { @ }\n"
        self.assertLessEqual({"Wide", "im"}, set(self.labels(inside)))
        self.assertNotIn("Wide", self.labels("edition 1;\nfn f(im: vec3[Wide]) { im }\nlet q = @;\n"))
        members = self.labels("edition 1;\nfn f(p: vec3) { p.@ }\n")
        self.assertEqual(members, ["x", "y", "z", "width", "height", "layers", "at", "layer"])
        self.assertEqual(self.labels("edition 1;\nlet a = 1.@;\n"), [])
        self.assertEqual(self.labels("edition 1;\nlet a = 1.@\n"), [])
        self.assertIn("x", self.labels("edition 1;\nlet t = (vec3(1.0), 2.0);\nlet a = t.0.@;\n"))

    def test_folders_behind_import(self):
        with tempfile.TemporaryDirectory() as folder:
            for name in ("parts", ".hidden", "no name"):
                Path(folder, name).mkdir()
            Path(folder, "parts", "lens.dr").write_text("edition 1;\n")
            uri = Path(folder, "main.dr").as_uri()
            labels = self.labels("edition 1;\nimport @\n", uri)
            self.assertEqual(set(labels), {"std", "parts"})
            self.assertEqual(self.labels("edition 1;\nimport parts.@\n", uri), ["lens"])

    # ---- -D ----

    def test_defines(self):
        text = "edition 1;\nconst N = 1;\nconst M = N + 1;\nconst on = false;\nstep s { output a = float(N + M), on; }\n"
        for arguments, defines in ((["-D", "N=7", "-D", "on=true"], None), ([], {"N": "7", "on": "true"}), ([], {"N": 7, "on": True})):
            with self.subTest(defines=defines), Client(*arguments, options=defines and {"defines": defines}) as client:
                client.open("file:///d.dr", text)
                self.assertEqual(client.diagnostics("file:///d.dr"), [])
                for marked, words in (("N =", "N: int = 7"), ("M =", "M: int = 8"), ("N + 1", "N: int = 7"), ("on =", "on: bool = true")):
                    self.assertIn(words, client.hover("file:///d.dr", place_of(text, marked)))

    # ---- documents ----

    def test_a_module_that_is_on_no_disk(self):
        with tempfile.TemporaryDirectory() as folder:
            program, module = Path(folder, "main.dr").as_uri(), Path(folder, "lamp.dr").as_uri()
            self.client.open(program, "edition 1;\nimport lamp;\nstep s { output a = lamp.one(); }\n")
            self.assertEqual([one["code"] for one in self.client.diagnostics(program)], ["E0203"])
            self.client.open(module, "edition 1;\nfn one() { 1.0 }\n")
            self.assertEqual(self.client.diagnostics(program), [])
            self.client.notify("textDocument/didClose", {"textDocument": {"uri": module}})
            self.assertEqual([one["code"] for one in self.client.diagnostics(program)], ["E0203"])

    def test_documents_that_are_no_files(self):
        text = "edition 1;\nlet a = 1.0;\nlet b = a;\n"
        for uri in ("untitled:Untitled-1", "git:/repository/a%20b.dr?ref", "vscode-notebook-cell:/notes/a.dr#3", "file://server/share/a.dr",
                    "file:///c%3A/a.dr"):
            with self.subTest(uri=uri):
                self.client.open(uri, text)
                self.assertEqual(self.client.diagnostics(uri), [])
                self.assertEqual(self.client.at("definition", uri, place_of(text, "a;"))["uri"], uri)
        # A document of another scheme stands for no file.
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "lamp.dr")
            self.client.open("git:" + str(path), "edition 1;\nfn one() { 1.0 }\n")
            program = Path(folder, "main.dr").as_uri()
            self.client.open(program, "edition 1;\nimport lamp;\n")
            self.assertEqual([one["code"] for one in self.client.diagnostics(program)], ["E0203"])


if __name__ == "__main__":
    main()
