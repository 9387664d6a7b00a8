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
