#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# skip.sh BUILD_FOLDER [--device NAME] [--quick]: what HardSoftRas leaves out where nothing soft shows (skip.dr), for a sphere of 5,120 faces and a crowd of
# small ones whose outlines lie in front of others: the part of the picture that is blended, candidate pixels of compute loops, those
# of draws by boxes and by the smaller of box and triangle, and times in us, medians of seven (--quick: of two, for the sphere alone): `hard` of the
# same frame without soft layers (step `plain`: the first layer, its silhouette and the loss), `soft` of what the frame takes beyond
# that, both a run while several are under way. `others`, with a wait after each, are the commands that do not draw the first layer, the loss over all pixels among them: what `soft` was before.
# skip_scenes.sh comes after it.
set -euo pipefail
source "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/suite.bash"
suite skip "$@"
no_more
meshes=(sphere crowd) rounds=7
if [[ -n $quick ]]; then meshes=(sphere) rounds=2; fi
awk -v levels=4 -f "$here/icosphere.awk" > "$out/sphere.obj"
# Sixty spheres of 320 faces on a large one.
{
  cat "$out/sphere.obj"
  awk -v levels=2 -f "$here/icosphere.awk" | awk '
    $1 == "v" { x[++n] = $2; y[n] = $3; z[n] = $4 }
    $1 == "f" { a[++m] = $2; b[m] = $3; c[m] = $4 }
    END {
      for (s = 0; s < 60; ++s) {
        h = 1 - (2 * s + 1) / 60; r = sqrt(1 - h * h); t = 2.39996 * s
        for (i = 1; i <= n; ++i) print "v", 0.95 * r * cos(t) + 0.06 * x[i], 0.95 * h + 0.06 * y[i], 0.95 * r * sin(t) + 0.06 * z[i]
      }
      for (s = 0; s < 60; ++s)
        for (i = 1; i <= m; ++i) { o = 2562 + s * n; print "f", o + a[i], o + b[i], o + c[i] }
    }'
} > "$out/crowd.obj"
run() { "$bin/drun" "$here/cases/skip.dr" -D outlines="$outlines" -D skip="$skip" --device "$device" --bind "position=$out/$mesh.obj:position" \
  --bind "face=$out/$mesh.obj:indices" "$@"; }
printf '%7s %9s %5s  %6s %9s %9s %9s %9s %9s  %8s %8s %8s\n' mesh edges skip band all proposed measured boxes smaller hard soft others
for mesh in "${meshes[@]}"; do
  for outlines in 0 1; do
    skip=1
    run --step count --out "$out/count" > /dev/null
    for skip in 0 1; do
      for ((k = 0; k < rounds; ++k)); do run --step plain=15 --step draw=15 --timing --ablate=cache; done > "$out/timing.txt"
      /usr/bin/python3 - "$out" $mesh $outlines $skip << 'END'
import json, re, statistics, sys
out, mesh, outlines, skip = sys.argv[1:]
counts = json.loads(open(out + "/count/log.jsonl").readlines()[-1])
runs, now = {"plain": [], "draw": []}, []
for line in open(out + "/timing.txt"):
    step = re.match(r"(plain|draw): \d+ commands", line)
    if step:
        now = runs[step[1]]
        now.append({"run": 0.0, "others": 0.0})
    run = re.match(r"(?:plain|draw): ([\d.]+) us a run while", line)
    if run: now[-1]["run"] = float(run[1])
    row = re.match(r"\s*([\d.]+)\s+[\d.]+%\s+\d+\s+\d+\s+\d+\s+[\d.]+  (.*)", line)
    if row:
        if not re.match(r"(clear )?(covering|hard|raster)", row[2]): now[-1]["others"] += float(row[1])
hard, soft = (statistics.median(values) for values in (
    [r["run"] for r in runs["plain"]], [d["run"] - p["run"] for d, p in zip(runs["draw"], runs["plain"])]))
others = statistics.median(r["others"] for r in runs["draw"])
proposed, measured = (counts["proposed"], counts["measured"]) if skip == "1" else (counts["all"], counts["all"])
print(f"{mesh:>7} {['all', 'outlines'][int(outlines)]:>9} {['no', 'yes'][int(skip)]:>5}  {counts['band']:6.3f} {counts['all']:9.0f} {proposed:9.0f} {measured:9.0f}"
      f" {counts['drawn_boxes']:9.0f} {counts['drawn_smaller']:9.0f}"
      f"  {hard:8.0f} {soft:8.0f} {others:8.0f}")
with open(out + "/skip.jsonl", "a") as log:
    json.dump({"mesh": mesh, "outlines": int(outlines), "skip": int(skip), **counts, "hard_us": hard, "soft_us": soft, "others_us": others}, log)
    log.write("\n")
END
    done
  done
done
bash "$here/skip_scenes.sh" "$@"
