# SPDX-License-Identifier: Apache-2.0
"""Programs that somebody writes to break the compiler: name -> text. What is long is made here, not kept."""

HEAD = "edition 1;\n"


def chain(op, length, gradient=True):
    lets = "".join(f"let x{k} = {op.format(f'x{k - 1}')} * 0.5;\n" for k in range(1, length + 1))
    update = f"x0 <- x0 - grad(x{length}, x0); " if gradient else ""
    return HEAD + f"param x0 : float = 1.0;\n{lets}step s {{ {update}output e = x{length}; }}\n"


def wrapped(before, inner, after, depth):
    return HEAD + f"param x : float = 0.5;\nlet y = {before * depth}{inner}{after * depth};\nstep s {{ output y; }}\n"


def step(body, lets=""):
    return HEAD + f"param x : float[W] = 0.5;\n{lets}\nstep s {{ {body} }}\n"


def loops(kind, counts):
    body = "x"
    for k, count in enumerate(counts):
        body = f"reduce({kind}, i{k} in 0..{count}) {{ {body} }}"
    return step(f"output y = sum({body});")


def large():
    """What is well meant, and large: all of it compiles, or is answered."""
    out = {}
    for op in ("sin({})", "exp({})", "sqrt(abs({}))", "({} + 1.0)", "tanh({})", "atan({})", "abs({})", "pow(abs({}), 1.5)"):
        for length in (100, 1000):
            out[f"chain {op} {length}"] = chain(op, length)
    out["chain of 10,000"] = chain("sin({})", 10000)
    out["chain of 10,000 without a gradient"] = chain("cos({})", 10000, gradient=False)
    for trips in (128, 1024, 4096):
        out[f"march {trips}"] = step("x <- x - 0.1 * grad(e, x); output e;",
            f"let q = {{ var a = x; for i in 0..{trips} {{ a = sin(a) * 0.9 + 0.1 * cos(a); }} a }};\nlet e = sum(q * q);")
    out["wide 5,000"] = HEAD + "param x : float = 1.0;\n" + "".join(
        f"let a{k} = sin(x * {k}.0);\n" for k in range(5000)) + "step s { output e = " + " + ".join(
        f"a{k}" for k in range(5000)) + "; }\n"
    out["a sum of 20,000 terms"] = step("output e = sum(" + " + ".join(["x"] * 20000) + ");")
    out["1,000 steps"] = HEAD + "param x : float = 1.0;\n" + "".join(
        f"step s{k} {{ output y = x + {k}.0; }}\n" for k in range(1000))
    out["100,000 steps"] = HEAD + "param x : float = 1.0;\n" + "".join(
        f"step s{k} {{ output y = x; }}\n" for k in range(100000))
    out["2,000 params"] = HEAD + "".join(f"param p{k} : float = 1.0;\n" for k in range(2000)) + (
        "let e = " + " + ".join(f"p{k} * p{k}" for k in range(2000)) + ";\nstep s { " + " ".join(
        f"p{k} <- p{k} - grad(e, p{k});" for k in range(2000)) + " output e; }\n")
    out["1,000 outputs"] = step(" ".join(f"output y{k} = x * {k}.0;" for k in range(1000)))
    out["a name of 100,000 letters"] = HEAD + f"param {'a' * 100000} : float = 1.0;\nstep s {{ output y = {'a' * 100000}; }}\n"
    out["a comment of 10 MB"] = HEAD + "//" + "x" * 10_000_000 + "\nparam x : float = 1.0;\nstep s { output x; }\n"
    out["200,000 lines"] = HEAD + "\n" * 200000 + "param x : float = 1.0;\nstep s { output x; }\n"
    for k in (1, 8, 64):
        out[f"nearest = {k}"] = HEAD + f"""import std.hardsoftras;
import std.camera;
param position : vec3[V];
input face : ivec3[F];
let view = camera.perspective(40.0) * camera.look_at(camera.orbit(90.0, 20.0, 4.0));
let soft = hardsoftras.rasterize(camera.project(view, position), face, 16, 16, radius = 2.0, nearest = {k}, everywhere = true);
let e = mean(hardsoftras.silhouette(soft));
step s {{ position <- position - grad(e, position); output e; }}
"""
    return out


def deep():
    out = {}
    for depth in (50, 1000, 10000, 100000):
        out[f"parentheses {depth}"] = wrapped("(", "x", ")", depth)
        out[f"minus {depth}"] = wrapped("-", "x", "", depth)
        out[f"not {depth}"] = wrapped("!", "true", "", depth)
        out[f"calls {depth}"] = wrapped("sin(", "x", ")", depth)
        out[f"blocks {depth}"] = wrapped("{ ", "x", " }", depth)
        out[f"ifs {depth}"] = wrapped("if x > 0.0 { ", "x", " } else { 0.0 }", depth)
        out[f"arrays {depth}"] = wrapped("[", "x", "]", depth)
        out[f"tuples {depth}"] = wrapped("(x, ", "x", ")", depth)
        out[f"lambdas {depth}"] = wrapped("array(1, fn(k) { ", "x", " })", depth)
        out[f"only opening {depth}"] = HEAD + "let y = " + "(" * depth
        out[f"only braces {depth}"] = HEAD + "step s {" + "{" * depth
        out[f"members {depth}"] = HEAD + "param x : float = 1.0;\nlet y = x" + ".x" * depth + ";\n"
        out[f"comments {depth}"] = HEAD + "/*" * depth
    return out


def growing():
    """Small texts that stand for much."""
    doubled = "".join(f"let t{k} = (t{k - 1}, t{k - 1});\n" for k in range(1, 41))
    out = {
        "tuples doubled 40 times": HEAD + "input x : float;\nlet t0 = (x, x);\n" + doubled + "step s { output x; }\n",
        "functions doubled 40 times": HEAD + "fn f0(x: float) -> float { x + 1.0 }\n" + "".join(
            f"fn f{k}(x: float) -> float {{ f{k - 1}(f{k - 1}(x)) }}\n" for k in range(1, 41)) +
            "param x : float = 1.0;\nstep s { output y = f40(x); }\n",
        "arrays of arrays": HEAD + "let a = array(4096, fn(k) { array(4096, fn(j) { array(4096, fn(i) { float(k) }) }) });\n"
            "step s { output b = a[0][0][0]; }\n",
        "structs doubled": HEAD + "struct S0 { a: float; b: float; }\n" + "".join(
            f"struct S{k} {{ a: S{k - 1}; b: S{k - 1}; }}\n" for k in range(1, 41)) + "param x : float = 1.0;\nstep s { output x; }\n",
        "loops of loops": step("output y = { var a = x; " + "for i in 0..4096 { for j in 0..4096 { for k in 0..4096 { a = a + 1.0; } } } a };"),
        "recursion": HEAD + "fn f(x: float) -> float { f(x) }\nparam x : float = 1.0;\nstep s { output y = f(x); }\n",
        "recursion of two": HEAD + "fn f(x: float) -> float { g(x) }\nfn g(x: float) -> float { f(x) }\nparam x : float = 1.0;\n"
            "step s { output y = f(x); }\n",
        "a struct of itself": HEAD + "struct S { a: S; }\nparam x : float = 1.0;\nstep s { output x; }\n",
        "a const of itself": HEAD + "const A = B;\nconst B = A;\nparam x : float[A] = 1.0;\nstep s { output x; }\n",
        "gradients of gradients": HEAD + "param x : float = 1.0;\nlet e0 = sin(x);\n" + "".join(
            f"let e{k} = sin(grad(e{k - 1}, x)) * x;\n" for k in range(1, 12)) + "step s { output y = e11; }\n",
    }
    for extent in ("2147483647", "2147483648", "4294967296", "9223372036854775807", "9223372036854775808", "99999999999999999999", "0", "-1"):
        out[f"extent {extent}"] = HEAD + f"param x : float[{extent}] = 0.0;\nstep s {{ output a = sum(x); }}\n"
        out[f"extents {extent}"] = HEAD + f"param x : float[{extent}, {extent}] = 0.0;\nstep s {{ output a = sum(x); }}\n"
        out[f"coord {extent}"] = HEAD + f"let x = float(coord({extent}, {extent}, {extent}).x);\nstep s {{ output a = sum(x); }}\n"
        out[f"trips {extent}"] = step(f"output a = sum(reduce(sum, i in 0..{extent}) {{ x }});")
    return out


def damaged():
    whole = HEAD + "param x : float[W] = 0.5;\nlet y = sin(x) * 2.0;\nstep s { x <- x - grad(sum(y), x); output y; }\n"
    out = {f"cut at {k}": whole[:k] for k in range(0, len(whole), 12)}
    out |= {
        "empty": "", "a NUL": whole.replace("sin", "s\0n"), "only NULs": "\0" * 4096, "bytes": bytes(range(256)) * 16,
        "half a letter": HEAD.encode() + b"let \xc3 = 1.0;\n", "a byte order mark": "\ufeff" + whole, "CRLF": whole.replace("\n", "\r\n"),
        "CR": whole.replace("\n", "\r"), "escapes": HEAD + "let \x1b[2J = 1.0;\n", "UTF-16": whole.encode("utf-16"),
        "right to left": HEAD + "let \u202ey = 1.0;\n", "edition 2": whole.replace("edition 1", "edition 2"),
        "edition 10^30": whole.replace("edition 1", "edition 1" + "0" * 30), "no edition": whole[len(HEAD):],
        "a number of 100,000 digits": HEAD + "let y = " + "9" * 100000 + ".0;\n",
        "exponents": HEAD + "let y = 1e999999999999;\nlet z = 1e-999999999999;\nparam x : float = 1.0;\nstep s { output x; }\n",
        "an import of itself": HEAD + "import this;\n", "an import above": HEAD + "import ..x;\n", "an import of a path": HEAD + 'import "/etc/passwd";\n',
    }
    return out


def numbers():
    """Small programs whose numbers were wrong where a loop ended early: name -> (text, arguments of drun)."""
    ones = ["-s", "W=3"]
    return {
        "70,000 trips": (loops("sum", (70000,)), ones),
        "65,535 trips": (loops("sum", (65535,)), ones),
        "65,536 trips": (loops("sum", (65536,)), ones),
        "1,000 x 1,000 trips": (loops("sum", (1000, 1000)), ones),
        "40 x 40 x 50 trips": (loops("max", (40, 40, 50)), ones),
        "three loops of 40,000": (step("output a = sum(reduce(sum, i in 0..40000) { x }), b = sum(reduce(max, i in 0..40000) "
            "{ x * float(i) }), c = sum(reduce(min, i in 0..40000) { x - float(i) });"), ones),
        "100,000 elements": (HEAD + "param a : float[V] = 1.0;\nparam x : float[4] = 1.0;\nstep s { output c = sum(reduce(sum, i in 0..V) "
            "{ x * a.at(i) }), d = sum(reduce(sum, i in 0..V) { a.at(V - 1 - i) }); }\n", ["-s", "V=100000"]),
        "its gradient": (HEAD + "param a : float[V] = 0.5;\nlet e = reduce(sum, i in 0..V) { a.at(i) * a.at((i * 7) % V) } / float(V);\n"
            "step s { a <- a - grad(e, a); output e, a; }\n", ["-s", "V=70000"]),
        "a fold of 70,000": (HEAD + "param a : float[V] = 0.5;\nstep s { output e = fold(i in 0..V, s = 0.0) { s * 0.5 + a.at(i) }; }\n",
            ["-s", "V=70000"]),
        "65,535 x 64 elements": (step("output e = mean(x * float(coord(W, 1, 1).x % 7));"), ["-s", "W=4194241"]),
        "chain of 400": (chain("sin({})", 400), []),
        "march of 128": (large()["march 128"], ones),
    }
