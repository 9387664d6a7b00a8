# SPDX-License-Identifier: Apache-2.0
"""Files of data that somebody writes to break a reader: small ones that stand for much, links, pipes, other people's folders."""
import json
import os
import struct
import zlib


def png(width, height, depth, kind, rows=b"", name=b"IDAT"):
    def chunk(of, data):
        return struct.pack(">I", len(data)) + of + data + struct.pack(">I", zlib.crc32(of + data))
    head = struct.pack(">IIBBBBB", width, height, depth, kind, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(name, zlib.compress(rows)) + chunk(b"IEND", b"")


def npy(shape, data=b"", kind="<f4"):
    text = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}"
    text += " " * (64 - (len(text) + 11) % 64) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode() + data


def gltf(primitives=1, nodes=1, uri=None, count=3, sparse=None, view=36):
    buffer = {"byteLength": 36}
    if uri is None:
        uri = "data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"
    buffer["uri"] = uri
    accessor = {"componentType": 5126, "count": count, "type": "VEC3"}
    if sparse is None:
        accessor["bufferView"] = 0
    else:
        accessor["sparse"] = sparse
    return json.dumps({
        "asset": {"version": "2.0"}, "buffers": [buffer], "bufferViews": [{"buffer": 0, "byteLength": view}],
        "accessors": [accessor], "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}] * primitives}],
        "nodes": [{"mesh": 0}] * nodes, "scenes": [{"nodes": list(range(nodes))}], "scene": 0}).encode()


def hdr(width, height, data=b""):
    return b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n" + f"-Y {height} +X {width}\n".encode() + data


def all_files():
    """(file name, content, name of the leaf that takes it, how)"""
    sparse = {"count": 1, "indices": {"bufferView": 0, "componentType": 5125}, "values": {"bufferView": 0}}
    out = [
        ("short.png", png(16384, 16384, 16, 6), "c", ""), ("wide.png", png(2**31 - 1, 1, 8, 6), "c", ""),
        ("bomb.png", png(16384, 16384, 16, 6, bytes(16384 * 8 + 1) * 64), "c", ""), ("none.png", png(0, 0, 8, 6), "c", ""),
        ("deep.png", png(4, 4, 77, 6), "c", ""), ("noise.png", b"\x89PNG\r\n\x1a\n" + b"\xff" * 4000, "c", ""),
        ("flat.hdr", hdr(16384, 16384), "c", ""), ("wide.hdr", hdr(2**31 - 1, 2**31 - 1), "c", ""),
        ("runs.hdr", hdr(32767, 4, b"\x02\x02\x7f\xff" + b"\xff\x01" * 70000), "c", ""),
        ("huge.npy", npy("(2147483647, 2147483647)"), "i", ""), ("many.npy", npy("(" + "1, " * 10000 + ")"), "i", ""),
        ("minus.npy", npy("(-3, 4)"), "i", ""), ("objects.npy", npy("(3,)", b"cos\nsystem\n", "|O"), "i", ""),
        ("none.npy", npy("(0, 0)"), "i", ""), ("letters.npy", npy("('x', 4)"), "i", ""),
        ("wide.csv", b"1," * 1_000_000 + b"1\n", "i", ""), ("tall.csv", b"1\n" * 1_000_000, "i", ""), ("words.csv", b"one,two\n", "i", ""),
        ("ragged.csv", b"1,2\n3\n", "i", ""), ("exponent.csv", b"1e999999\n", "i", ""),
        ("deep.json", b"[" * 100000, "i", ""), ("ragged.json", b"[[1, 2], [3]]", "i", ""), ("word.json", b'["x"]', "i", ""),
        ("far.obj", b"v 0 0 0\nf 1 2 999999999999\n", "m", ":position"), ("minus.obj", b"v 0 0 0\nf -9 -9 -9\n", "m", ":position"),
        ("line.obj", b"v " + b"1" * 1_000_000 + b" 0 0\n", "m", ":position"), ("corners.obj", b"v 0 0 0\nf" + b" 1" * 100000 + b"\n", "m", ":position"),
        ("none.obj", b"", "m", ":position"), ("primitives.gltf", gltf(primitives=100000), "m", ":position"),
        ("nodes.gltf", gltf(nodes=1000000), "m", ":position"), ("sparse.gltf", gltf(count=70_000_000, sparse=sparse), "m", ":position"),
        ("beyond.gltf", gltf(count=2**31 - 1), "m", ":position"), ("view.gltf", gltf(view=2**40), "m", ":position"),
        ("short.glb", b"glTF\x02\0\0\0\xff\xff\xff\x7f" + b"\xff\xff\xff\x7fJSON{}", "m", ":position"),
    ]
    uris = ("../secret.bin", "%2e%2e/secret.bin", "/etc/passwd", "file:///etc/passwd", "http://localhost/x", "pipe", "link.bin",
            "..%2fsecret.bin", "a/../../secret.bin", "/proc/self/mem", "con\x00.bin", "x" * 10000)
    return out + [(f"uri{k}.gltf", gltf(uri=uri), "m", ":position") for k, uri in enumerate(uris)]


def write(folder):
    """Writes them, and what they point at. Returns arguments of drun by name."""
    program = "edition 1;\ninput m : vec3[V];\ninput i : float[W, H];\ninput c : vec4[W, H];\n"
    program += "step m { output s = sum(m.x); }\nstep i { output s = sum(i); }\nstep c { output s = sum(c.x); }\n"
    inside = folder / "files"
    inside.mkdir()
    (inside / "take.dr").write_text(program)
    (folder / "secret.bin").write_bytes(b"\0" * 36)
    os.mkfifo(inside / "pipe")
    os.mkfifo(inside / "pipe.npy")
    (inside / "link.bin").symlink_to(folder / "secret.bin")
    (inside / "loop.npy").symlink_to(inside / "loop.npy")
    (inside / "zero.npy").symlink_to("/dev/zero")
    out = {}
    for name, content, leaf, how in all_files():
        (inside / name).write_bytes(content)
        out[name] = ["take.dr", "--step", leaf, "-b", f"{leaf}={name}{how}"]
    for name in ("pipe.npy", "loop.npy", "zero.npy"):
        out[name] = ["take.dr", "--step", "i", "-b", f"i={name}"]
    return inside, out
