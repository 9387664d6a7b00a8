# SPDX-License-Identifier: Apache-2.0
"""The page of results, docs/results/README.md, from docs/results/figures.jsonl; see results.sh. With --check it only says whether the
page is what the figures make."""
import json
import sys
from pathlib import Path

results = Path(__file__).resolve().parents[2] / "docs/results"
figures_file, page_file = results / "figures.jsonl", results / "README.md"

# Figures by section: name, what it is, unit, digits. A name is BENCH/KEY.
SECTIONS = [
    ("Speed: the pear, a step of each fit", "642 vertices, a texture of 256², six pictures of 256², three of which a step of the shape sees by exact coverage (2026-11-22: all six, by outlines); `./dr bench table3`. A GPU times all 150 steps of the shape's fit, a processor its first ones; up to eb5583f8 GPUs timed steps behind its end, which take about half as long", [
        ("table3/fit_shape full", "shape", "ms", 3),
        ("table3/fit_texture full", "texture", "ms", 3),
        ("table3/fit_shape naive", "shape, an op a pass, no cache", "ms", 3),
        ("table3/fit_texture naive", "texture, an op a pass, no cache", "ms", 3)]),
    ("Exactness: what fits find", "`./dr bench pear`, `./dr bench spot`", [
        ("pear/mean distance after 150 steps, % of the radius", "pear: mean distance from the true surface, of its radius", "%", 3),
        ("pear/mean distance of 2,562 vertices after 600 steps, %", "the same of 2,562 vertices after 600 steps", "%", 2),
        ("pear/least overlap with 12 other views", "least overlap with 12 other views", "", 3),
        ("pear/PSNR of 12 other views, dB", "PSNR of 12 other views", "dB", 1),
        ("spot/overlap, mean of the 8 views", "Spot: overlap with the eight views that were fitted", "", 3),
        ("spot/overlap, mean of 4 other views", "overlap with four other views", "", 3),
        ("spot/mean distance of the fit's vertices from the mesh, % of its radius", "mean distance from the mesh, of its radius", "%", 2)]),
]
TAKEN = {name for _, _, rows in SECTIONS for name, _, _, _ in rows}


def short(device):
    """A device's name for a column, of what drun calls it."""
    for part, name in (("llvmpipe", "lavapipe"), ("swiftshader", "SwiftShader"), ("H200", "H200"), ("H100", "H100")):
        if part.lower() in device.lower():
            return name
    return device.split(" (")[0]


def left(out):
    """(name, value) of what a benchmark left."""
    if (out / "figures.json").exists():
        for key, value in json.loads((out / "figures.json").read_text()).items():
            yield f"{out.name}/{key}", value
    beside = out.with_suffix(".json")
    if beside.exists():
        for row in json.loads(beside.read_text()).get("rows", []):
            yield f"{out.name}/{row['step']} {row['way']}", row["median_ms"]


def take(figures):
    count = 0
    for run in sorted(Path("bench-out").glob("*/run.json")):
        about = json.loads(run.read_text())
        if about["quick"] or "changes" in about["commit"]:
            print(f"{run.parent.name}: not taken ({'--quick' if about['quick'] else 'a tree with changes'})")
            continue
        for name, value in left(run.parent):
            if name in TAKEN:
                figures[name, short(about["device"])] = {
                    "name": name, "device": short(about["device"]), "value": value, "commit": about["commit"],
                    "date": about["date"][:10], "full_device": about["device"]}
                count += 1
    print(f"{count} figures taken")


def plot(rows, figures, devices):
    """Bars on a logarithmic scale, as SVG."""
    lines, y = [], 18
    values = [figures[name, device]["value"] for name, *_ in rows for device in devices if (name, device) in figures]
    least, most = min(values) / 2, max(values)
    import math
    width = lambda value: 360 * math.log(value / least) / math.log(most / least)
    for name, title, unit, digits in rows:
        lines.append(f'<text x="4" y="{y}" font-weight="bold">{title}</text>')
        for device in devices:
            if (name, device) in figures:
                y += 17
                value = figures[name, device]["value"]
                lines.append(f'<text x="84" y="{y}" text-anchor="end">{device}</text>'
                             f'<rect x="90" y="{y - 10}" width="{width(value):.1f}" height="12" fill="#5b8c3e"/>'
                             f'<text x="{95 + width(value):.1f}" y="{y}">{value:.{digits}g} {unit}</text>')
        y += 26
    return (f'<svg xmlns="http://www.w3.org/2000/svg" width="560" height="{y}" font-family="sans-serif" font-size="12">'
            f'<rect width="560" height="{y}" fill="#fff"/>' + "".join(lines) + "</svg>\n")


def page(figures):
    devices = [d for d in ("lavapipe", "SwiftShader", "H100", "H200") if any(device == d for _, device in figures)]
    devices += sorted({device for _, device in figures} - set(devices))
    text = ["<!-- Made by `./dr bench results` from figures.jsonl; see docs/howto/bench.md. -->", "# Results", "",
            "Each figure stands with the commit and the date that it was recorded at. Bars are on a logarithmic scale.", ""]
    plots = {}
    for k, (title, about, rows) in enumerate(SECTIONS):
        shown = [row for row in rows if any((row[0], device) in figures for device in devices)]
        if not shown:
            continue
        text += [f"## {title}", "", f"{about[0].upper()}{about[1:]}.", "",
                 "| | " + " | ".join(devices) + " |", "| --- |" + " --- |" * len(devices)]
        for name, what, unit, digits in shown:
            cells = []
            for device in devices:
                figure = figures.get((name, device))
                value = figure and (f"{figure['value']:.{digits}f}" if unit != "ms" else f"{figure['value']:.3g}")
                cells.append(f"{value}{'' if unit == '%' else ' '}{unit}".strip() + f" <sub>{figure['commit']}, {figure['date']}</sub>" if figure else "")
            text.append(f"| {what} | " + " | ".join(cells) + " |")
        text.append("")
        if all(unit == "ms" for _, _, unit, _ in rows):
            plots[f"plot_{k}.svg"] = plot(shown, figures, devices)
            text += [f"![the same as bars](plot_{k}.svg)", ""]
    text += ["## Devices", "", "| | |", "| --- | --- |"]
    full = {figure["device"]: figure["full_device"] for figure in figures.values() if figure.get("full_device")}
    text += [f"| {device} | {full.get(device, '')} |" for device in devices]
    text += ["", "## All of it", "",
             "- [The notebook](notebook.md): every benchmark, how it was measured, what was tried, and where we lose. Its figures are of the",
             "  builds that its history names, so some differ in the last digit from those above.",
             "- [Limits](limits.md): what devices and the interface allow, and what happens there.",
             "- [Faults](faults.md): damaged files, hostile bundles, kills and misuse, counted by how they end.",
             "- [Fuzzing](fuzzing.md): how much random input there was, what it reached, and what faults, steps and loads in numbers leave behind.",
             "- [Frames beside Mitsuba 3](frames.md): glTF assets under a lamp and under skies, a term each, and where differences come from.",
             "- [Accuracy](accuracy.md): the error of each op and each function of the library on each device.",
             "- Accuracy of what lights a frame: the same of materials, lamps, environments, shadows, textures and tone mapping, [by our own functions](accuracy_light.md) and",
             "  [by drivers' built-ins](accuracy_light_native.md).",
             "- `./dr bench` lists the benchmarks; `./dr bench results` takes what they left into this page.", ""]
    return "\n".join(text), plots


figures = {}
for line in figures_file.read_text().splitlines():
    figure = json.loads(line)
    figures[figure["name"], figure["device"]] = figure
check = "--check" in sys.argv
if not check and "--page" not in sys.argv:
    take(figures)
    figures_file.write_text("".join(json.dumps(figure) + "\n" for _, figure in sorted(figures.items())))
text, plots = page(figures)
stale = [name for name, content in [("README.md", text), *plots.items()]
         if not (results / name).exists() or (results / name).read_text() != content]
if check:
    for name in stale:
        print(f"docs/results/{name} is not what figures.jsonl makes; `./dr bench results --page` writes it anew")
    sys.exit(bool(stale))
page_file.write_text(text)
for name, content in plots.items():
    (results / name).write_text(content)
print(f"docs/results/README.md: {len(figures)} figures")
