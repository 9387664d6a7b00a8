#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""A page about what a run left with `drun --out FOLDER`: how its numbers went from run to run, where they ended, and its pictures.

usage: report.py FOLDER [TITLE]     writes FOLDER/report.html
"""
import base64
import html
import io
import json
import sys
from pathlib import Path

try:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
except ImportError:
    sys.exit("report.py: it needs matplotlib (Debian: python3-matplotlib, else: pip install matplotlib)")

out = Path(sys.argv[1])
title = sys.argv[2] if len(sys.argv) > 2 else out.name

PAGE = """<!DOCTYPE html>
<html lang="en"><meta charset="utf-8"><title>{title}</title>
<style>
body {{ font: 16px/1.5 sans-serif; max-width: 60em; margin: 2em auto; padding: 0 1em }}
figure {{ display: inline-block; margin: 0.5em }}  figcaption {{ color: #555 }}
img.pixels {{ image-rendering: pixelated; min-width: 192px; max-width: 100% }}
td {{ padding: 0.1em 1em 0.1em 0; font-variant-numeric: tabular-nums }}
</style>
<h1>{title}</h1>
{curves}
<h2>Where it ended</h2><table>{numbers}</table>
<h2>Pictures</h2>
{pictures}
</html>
"""


def series():
    """By step, its runs and what each of its numbers was; the components of a vector one by one."""
    steps = {}
    log = out / "log.jsonl"
    for line in log.read_text().splitlines() if log.exists() else []:
        entry = json.loads(line)
        runs, values = steps.setdefault(entry.pop("step"), ([], {}))
        runs.append(entry.pop("run"))
        for name, value in entry.items():
            for k, x in enumerate(value if isinstance(value, list) else [value]):
                values.setdefault(f"{name}[{k}]" if isinstance(value, list) else name, []).append(float("nan") if x is None else x)
    return steps


def figure(data, caption, kind=""):
    return (f'<figure><img class="{kind}" src="data:image/png;base64,{base64.b64encode(data).decode()}" alt="{html.escape(caption)}">'
            f"<figcaption>{html.escape(caption)}</figcaption></figure>")


def curve(name, runs, values):
    plot, axes = plt.subplots(figsize=(4.5, 3), dpi=96)
    axes.plot(runs, values)
    if min(values) > 0 and max(values) > 20 * min(values):
        axes.set_yscale("log")
    axes.set_xlabel("run")
    plot.tight_layout()
    memory = io.BytesIO()
    plot.savefig(memory, format="png")
    plt.close(plot)
    return figure(memory.getvalue(), name)


steps = series()
named = [(f"{step}.{name}", runs, values) for step, (runs, all_of) in steps.items() for name, values in all_of.items() if len(values) == len(runs)]
(out / "report.html").write_text(PAGE.format(
    title=html.escape(title),
    curves="".join(curve(name, runs, values) for name, runs, values in named if len(runs) > 1),
    numbers="".join(f"<tr><td>{html.escape(name)}</td><td>{values[-1]:.6g}</td></tr>" for name, _, values in named),
    pictures="".join(figure(path.read_bytes(), path.stem, "pixels") for path in sorted(out.glob("*.png")))))
