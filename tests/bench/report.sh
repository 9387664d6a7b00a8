#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# report.sh BUILD_FOLDER: one page, bench-out/report.html, of all that benchmarks left in bench-out/: their records as tables, their
# plots, and with which device and commit suites ran; the machine, its Vulkan devices and the commit now. Nothing beside the page
# is needed to read it.
set -euo pipefail
[[ -d ${1-} ]] || { echo "usage: report.sh BUILD_FOLDER" >&2; exit 2; }
PYTHONDONTWRITEBYTECODE=1 PYTHONPATH=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")") exec /usr/bin/python3 - "$@" << 'END'
import base64, datetime, html, json, os, platform, subprocess, sys
from pathlib import Path
from suite import commit

build, out = Path(sys.argv[1]).resolve(), Path("bench-out").resolve()
escape = lambda value: html.escape(str(value))


def records(path):
    """The records of a file of JSON or JSON lines; what is nested in one object comes out flat."""
    content = path.read_text()
    try:
        found = json.loads(content)
    except json.JSONDecodeError:
        found = [json.loads(line) for line in content.splitlines() if line.strip()]
    found = found if isinstance(found, list) else [found]
    return [flat(r) for r in found if isinstance(r, dict)]


def flat(record, prefix=""):
    result = {}
    for key, value in record.items():
        result.update(flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value})
    return result


def number(value):
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return escape("" if value is None else value)
    return f"{value:,}" if isinstance(value, int) else f"{value:.4g}"


def tables(rows):
    """A table for each set of fields that records have, in the order in which they come."""
    kinds = {}
    for row in rows:
        row.pop("bench", None)
        kinds.setdefault(tuple(row), []).append(row)
    for fields, mine in kinds.items():
        if len(fields) > 12 and len(mine) == 1:  # a list of figures rather than a row
            yield "<table>" + "".join(f"<tr><th>{escape(k)}<td>{number(v)}" for k, v in mine[0].items()) + "</table>"
            continue
        shown = mine[:400]
        yield "<table><tr>" + "".join(f"<th>{escape(f)}" for f in fields)
        yield "".join("<tr>" + "".join(f"<td>{number(row[f])}" for f in fields) for row in shown) + "</table>"
        if len(mine) > len(shown):
            yield f"<p>… and {len(mine) - len(shown):,} more.</p>"


def picture(path):
    svg = path.with_suffix(".svg")
    if svg.exists() and svg.stat().st_size < 400_000:
        path = svg
    kind = "svg+xml" if path.suffix == ".svg" else "png"
    return f'<img alt="{escape(path.stem)}" src="data:image/{kind};base64,{base64.b64encode(path.read_bytes()).decode()}">'


def suites():
    """(name, files of records, plots, what is known of the run) of each benchmark."""
    found = {}
    for path in sorted([*out.glob("*.json"), *out.glob("*.jsonl"), *out.glob("*/figures.json"), *out.glob("*/figures.jsonl"), *out.glob("*/*.jsonl")]):
        if path.stat().st_size and path.name != "log.jsonl":
            found.setdefault(path.stem if path.parent == out else path.parent.name, {})[path] = None
    for name, files in sorted(found.items()):
        run = out / name / "run.json"
        yield name, list(files), sorted((out / name).glob("plot*.png")), json.loads(run.read_text()) if run.exists() else {}


model = next((line.partition(":")[2].strip() for line in open("/proc/cpuinfo") if line.startswith("model name")), platform.machine())
devices = subprocess.run([build / "bin/drun", "devices"], capture_output=True, text=True).stdout.strip()
body, names = [], []
for name, files, plots, run in suites():
    names.append(name)
    body.append(f'<h2 id="{escape(name)}">{escape(name)}</h2>')
    if run:
        body.append(f"<p>{escape(run['device'])}; commit {escape(run['commit'])}; {escape(run['date'])}{'; --quick' if run['quick'] else ''}</p>")
    body += map(picture, plots)
    for path in files:
        body.append(f"<details {'open' if len(files) == 1 else ''}><summary>{escape(path.relative_to(out))}</summary>")
        body += tables(records(path))
        body.append("</details>")
if not names:
    sys.exit("report: bench-out/ holds no figures; run ./dr bench NAME first")
page = f"""<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>Dressi: benchmarks</title>
<style>body {{ font: 14px/1.45 system-ui, sans-serif; margin: 2em auto; max-width: 75em; padding: 0 1em }} img {{ max-width: 100% }}
table {{ border-collapse: collapse; margin: .6em 0; display: block; overflow-x: auto }} th, td {{ padding: .1em .7em .1em 0; text-align: right; white-space: nowrap }}
th {{ border-bottom: 1px solid #888; font-weight: 600 }} details {{ margin: .5em 0 }}</style>
<h1>Dressi: benchmarks</h1>
<p>Commit {escape(commit())}; {datetime.datetime.now(datetime.timezone.utc):%Y-%m-%d %H:%M} UTC. {escape(model)}, {escape(os.cpu_count())} processors,
{escape(platform.system())} {escape(platform.release())}.</p><pre>{escape(devices)}</pre>
<p>{' · '.join(f'<a href="#{escape(n)}">{escape(n)}</a>' for n in names)}</p>
{"".join(body)}</html>
"""
(out / "report.html").write_text(page)
print(f"bench-out/report.html: {len(names)} benchmarks, {len(page) / 1e6:.1f} MB")
END
