#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# What a loop at run time costs does not grow with its trips: the graph, the passes, the shaders, and what its reverse keeps an element.
# usage: trips_test.sh DRC
set -euo pipefail
drc=$(realpath "$1")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
export DRC_CACHE_DIR=$work/cache
failures=0
complain() { printf 'FAILED: %s\n' "$*"; failures=$((failures + 1)); }
cat > march.dr << 'END'
edition 1;
const G = 10;
param x : float[N];
param w : float[M];
fn march(a: float, w: float[M]) -> float {
  var s = vec3(a, 1.0, 0.5);
  for k in 0..G, max = G {
    let t = 0.95 * s + 0.05 * vec3(sin(s.y), cos(3.0 * s.x), w.at(k % w.width) * s.z);
    break if t.y > 30.0;
    s = t;
  }
  s.x + s.y
}
let y = march(x, w);
let sums = scan(k in 0..G, s = vec2(0.0)) { 0.5 * s + vec2(w.at(k % w.width), 1.0) };
let e = mean(y * y) + mean(dot(sums, sums));
step fit { x <- x - 0.1 * grad(e, x); w <- w - 0.1 * grad(e, w); output e; }
END
for profile in lavapipe swiftshader nvidia-h200; do
  for trips in 10 10000 1000000; do
    "$drc" build march.dr -D G=$trips --profile=$profile -o $trips.drb
    "$drc" inspect $trips.drb > $trips.txt
    grep -cE '^  [0-9]+ (dispatch|draw|fill|copy)' $trips.txt > $trips.passes
    sed -n '/^shaders/,$p' $trips.txt | grep -oE '[0-9]+ bytes' | awk '{ sum += $1 } END { print sum }' > $trips.bytes
    # 512 words of states, what they are for, and the trip.
    sed -nE 's/.*uint\[([0-9]+) \* N\].*/\1/p' $trips.txt | awk '$1 > 540 { exit 1 }' ||
      complain "$profile, $trips trips: the reverse keeps more than 540 words an element"
  done
  for trips in 10000 1000000; do
    cmp -s 10.passes $trips.passes || complain "$profile, $trips trips: $(cat $trips.passes) passes, $(cat 10.passes) for 10"
    # Checkpoints, and on devices that end loops what goes on in a later dispatch.
    (($(cat $trips.bytes) <= 2 * $(cat 10.bytes))) || complain "$profile, $trips trips: shaders of $(cat $trips.bytes) bytes, $(cat 10.bytes) for 10"
  done
done
for trips in 10 1000000; do
  "$drc" build march.dr -D G=$trips --emit=ir | sed -E 's/[0-9]+(\.[0-9]+)?(e[-+][0-9]+)?//g' > $trips.ir
done
cmp -s 10.ir 1000000.ir || complain "the graph depends on the trips by more than a number"
[[ $failures == 0 ]] && echo "trips: all as expected"
