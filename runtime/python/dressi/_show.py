# SPDX-License-Identifier: Apache-2.0
"""What notebooks show: pictures, and tables of what ran."""
from __future__ import annotations

import html
import struct
import zlib
from typing import TYPE_CHECKING, Any, Iterable, Sequence

from . import _library as c

if TYPE_CHECKING:
    import numpy as np


def table(heads: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """A table of HTML."""

    def line(tag: str, words: Sequence[Any]) -> str:
        return "<tr>" + "".join(f"<{tag}>{html.escape(str(word))}</{tag}>" for word in words) + "</tr>"

    return f"<table>{line('th', heads)}{''.join(line('td', row) for row in rows)}</table>"


class Counters(dict):  # type: ignore[type-arg]
    """What the runs of a step did, and what they left out, by name; each is an attribute, too."""

    def __getattr__(self, name: str) -> int:
        try:
            return self[name]
        except KeyError:
            raise AttributeError(f"no counter '{name}'; there are {', '.join(self)}") from None

    def _repr_html_(self) -> str:
        kinds = ("commands", "ops", "bytes")
        rows = [(kind, self[kind], self[f"skipped_{kind}"]) for kind in kinds]
        return f"<p>{self['runs']} runs</p>" + table(("", "done", "left out"), rows)


class Timing(list):  # type: ignore[type-arg]
    """How long each command of a step took on the device."""

    @property
    def milliseconds(self) -> float:
        """Of all commands together. Waiting for each takes time: it is more than a run takes."""
        return sum(entry["nanoseconds"] for entry in self) / 1e6

    def _rows(self) -> list[tuple[str, str, str]]:
        longest = sorted(self, key=lambda entry: -entry["nanoseconds"])
        return [(f"{e['nanoseconds'] / 1e6:.3f} ms", e["label"], ", ".join(e["lines"])) for e in longest]

    def __str__(self) -> str:
        return "\n".join(f"{took:>12}  {label}  {lines}" for took, label, lines in self._rows())

    def _repr_html_(self) -> str:
        return table(("time", "command", "lines"), self._rows())


class NotFinite:
    """The first NaN or Inf that a run stored."""

    def __init__(self, found: dict[str, Any]) -> None:
        self.value: str = found["value"]
        self.command: str = found["label"]
        self.element = (found["layer"], found["y"], found["x"])
        self.lines: list[str] = found["lines"]
        self._place: str = found["place"]

    def __str__(self) -> str:
        lines = f" ({', '.join(self.lines)})" if self.lines else ""
        return f"'{self.value}' has {self._place}, written by '{self.command}'{lines}"

    __repr__ = __str__


class GradientExplanation:
    """Why a gradient is what it is. True where it flows; as text it is what `drc explain-grad` prints."""

    def __init__(self, found: dict[str, Any]) -> None:
        self.flows: bool = found["flows"]
        self.summary: str = found["summary"]
        # Of the few shortest ways: names of values, loss first, their places in the program, and the ops between.
        self.paths: list[list[dict[str, str]]] = found["paths"]
        self.more_paths: int = found["more_paths"]
        # {"place", "reason"} each: where it is zero outside of limits, and ways that carry nothing.
        self.clamps: list[dict[str, str]] = found["clamps"]
        self.cuts: list[dict[str, str]] = found["cuts"]
        self._text: str = found["text"]

    def __bool__(self) -> bool:
        return self.flows

    def __str__(self) -> str:
        return self._text.rstrip()

    def __repr__(self) -> str:
        return f"<dressi.GradientExplanation: {self.summary}>"

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(str(self))}</pre>"


class Schedule(list):  # type: ignore[type-arg]
    """The commands of a step in order, each a dict of kind, label, ops, lines, reads, writes, joins and steady."""

    def __init__(self, step: str, commands: Iterable[dict[str, Any]]) -> None:
        super().__init__(commands)
        self.step = step

    def flows(self) -> list[tuple[int, int, list[str]]]:
        """(from, to, names): what a command reads of the one that wrote it last before."""
        writer: dict[str, int] = {}
        found: dict[tuple[int, int], list[str]] = {}
        for at, command in enumerate(self):
            for name in command["reads"]:
                if name in writer:
                    found.setdefault((writer[name], at), []).append(name)
            writer.update({name: at for name in command["writes"]})
        return [(*ends, names) for ends, names in found.items()]

    def __str__(self) -> str:
        return "\n".join(f"{c['kind']:<8} {c['label']}  {', '.join(c['lines'])}" for c in self)

    def _repr_svg_(self) -> str:
        """A row for each command; arcs on the left lead from what writes to what reads."""
        row, box = 26, 300
        flows = self.flows()
        reach = max((to - start for start, to, _ in flows), default=0)
        left = 24 + min(220, 14 * reach)  # room for the widest arc
        colors = {"dispatch": "#cfe3f7", "draw": "#d8efcf", "fill": "#eeeeee", "copy": "#eeeeee", "reduce": "#f7e3c3"}

        def middle(at: int) -> float:
            return row * at + row / 2 + 4

        def text(x: float, y: float, words: str) -> str:
            return f'<text x="{x:g}" y="{y + 4:g}">{html.escape(words)}</text>'

        parts = []
        for start, to, names in flows:
            bow = left - 8 - min(left - 10, 14 * (to - start))
            a, b = middle(start) + 3, middle(to) - 3
            parts.append(
                f'<path d="M{left} {a:g} C{bow:g} {a:g} {bow:g} {b:g} {left} {b:g}" fill="none" stroke="#888">'
                f"<title>{html.escape(', '.join(names))}</title></path>"
            )
        for at, command in enumerate(self):
            y = middle(at)
            tip = f"reads {', '.join(command['reads']) or 'nothing'}\nwrites {', '.join(command['writes']) or 'nothing'}"
            parts.append(
                f'<g><title>{html.escape(tip)}</title><rect x="{left}" y="{y - 10:g}" width="{box}" height="20" rx="3" '
                f'fill="{colors[command["kind"]]}" stroke="#888"/>{text(left + 6, y, command["label"][:42])}</g>'
            )
            words = [command["kind"], f"{command['ops']} ops"] if command["ops"] else [command["kind"]]
            lines = [line.rsplit("/", 1)[-1] for line in command["lines"]]
            words += lines[:2] + ([f"and {len(lines) - 2} more"] if len(lines) > 2 else [])
            parts.append(text(left + box + 10, y, ", ".join(words)))
        width, height = left + box + 360, row * len(self) + 8
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}" '
            f'font-family="sans-serif" font-size="12"><title>{html.escape(self.step)}</title>{"".join(parts)}</svg>'
        )


class Picture:
    """An array as a picture that notebooks show: (H, W), or (H, W, C) with 1 to 4 channels. Values from 0 to 1; colours are linear."""

    def __init__(self, array: Any) -> None:
        import numpy as np

        array = np.asarray(array, np.float32)
        if array.ndim == 2:
            array = array[..., None]
        if array.ndim != 3 or not 1 <= array.shape[2] <= 4 or 0 in array.shape:
            raise c.Error(f"expected an array of shape (H, W) or (H, W, 1 to 4) for a picture, found {array.shape}")
        self.array: np.ndarray = array

    def png(self) -> bytes:
        """The picture as a file."""
        import numpy as np

        values = np.clip(np.nan_to_num(self.array, nan=0.0), 0, 1)
        height, width, channels = values.shape
        if channels == 2:
            values = np.concatenate([values, np.zeros_like(values[..., :1])], 2)
            channels = 3
        if channels >= 3:  # the sRGB curve; grey is data and alpha is linear
            color = values[..., :3]
            values = values.copy()
            values[..., :3] = np.where(color <= 0.0031308, 12.92 * color, 1.055 * color ** (1 / 2.4) - 0.055)
        rows = np.round(values * 255).astype(np.uint8).reshape(height, -1)
        packed = zlib.compress(np.concatenate([np.zeros((height, 1), np.uint8), rows], 1).tobytes())
        kind = {1: 0, 3: 2, 4: 6}[channels]

        def chunk(name: bytes, data: bytes) -> bytes:
            return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

        head = struct.pack(">IIBBBBB", width, height, 8, kind, 0, 0, 0)
        return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", packed) + chunk(b"IEND", b"")

    def _repr_png_(self) -> bytes:
        return self.png()
