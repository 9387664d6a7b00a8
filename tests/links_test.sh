#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Links of the documentation lead somewhere: to a file of the tree, and to a heading where one is named. Links to other hosts
# are not followed. usage: links_test.sh SOURCE_ROOT
set -euo pipefail
cd "$1"
exec python3 - << 'END'
import pathlib, re, sys

def prose(path):  # without code, in which brackets mean something else
    text = re.sub(r"^```.*?^```$", "", path.read_text(encoding="utf-8"), flags=re.M | re.S)
    return re.sub(r"`[^`\n]*`", lambda code: code[0] if code[0].startswith("`](") else "", text)

def anchors(path):  # as hosts make them of headings: lower case, letters, digits and hyphens
    text = re.sub(r"^```.*?^```$", "", path.read_text(encoding="utf-8"), flags=re.M | re.S)
    found, seen = set(), {}
    for heading in re.findall(r"^#+ +(.*?) *$", text, re.M):
        name = re.sub(r"[^\w\- ]", "", re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower()).replace(" ", "-")
        count = seen[name] = seen.get(name, -1) + 1
        found.add(f"{name}-{count}" if count else name)
    return found | set(re.findall(r'<a (?:id|name)="([^"]+)"', text))

root, failed, count = pathlib.Path("."), 0, 0
files = [root / "README.md", *sorted(root.glob("docs/**/*.md"))]
for path in files:
    for target in re.findall(r"\]\(<?([^)\s>]+)", prose(path)) + re.findall(r'(?:src|href)="([^"]+)"', prose(path)):
        if re.match(r"[a-z]+:", target):
            continue
        count += 1
        name, _, anchor = target.partition("#")
        to = (path.parent / name) if name else path
        if not to.exists():
            print(f"{path}: {target} is not there")
            failed = 1
        elif anchor and to.suffix == ".md" and anchor not in anchors(to):
            print(f"{path}: {to} has no heading {anchor}")
            failed = 1

# A reader who begins at the index finds every page.
reached, queue = set(), [(root / "README.md").resolve(), (root / "docs/README.md").resolve()]
while queue:
    path = queue.pop()
    if path in reached or not path.exists():
        continue
    reached.add(path)
    for target in re.findall(r"\]\(<?([^)#\s>]+)", prose(path)):
        if target.endswith(".md") and not re.match(r"[a-z]+:", target):
            queue.append((path.parent / target).resolve())
for path in files:
    if path.resolve() not in reached:
        print(f"{path}: no page that the index leads to links to it")
        failed = 1
print(f"{count} links of {len(files)} pages checked")
sys.exit(failed or count == 0)
END
