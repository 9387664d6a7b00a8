#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Rasters and rows whose own loops would take more trips than lavapipe gives a shader: they are spread over more
# invocations and right; where a function of a raster alone takes too many, the run is an error.
# usage: long_rasters_test.sh DRUN
set -eu
drun=$(readlink -f "$1")
source "$(dirname "${BASH_SOURCE[0]}")/on_lavapipe.sh" "long rasters on lavapipe"
cat > large.dr << 'END'
edition 1;
// The boxes of all faces are the picture; the last face alone covers its pixels.
input edge : float[F];
let seen = raster(F, 1024, 1024) {
  setup(f) -> float { float(f) }
  corner(s, c) -> vec2 { [vec2(0.0, 0.0), vec2(1024.0, 0.0), vec2(0.0, 1024.0)][c] }
  depth(s, p) -> float { 0.5 }
  keep(s, p) -> bool { p.x + p.y < edge.at(0) && s > float(F) - 1.5 }
}[0];
step look { output covered = sum(if seen.face == F - 1 { 1.0 } else { 0.0 }); }
END
# raster FILE FIELD BOUND: 500 faces of 3,600 pixels, and `keep` loops to BOUND for each.
raster() {
  cat > "$1" << END
edition 1;
input depth_of : float[F];
input w : float[N];
input $2 : int;
let seen = raster(F, 64, 64) {
  setup(f) -> float { depth_of.at(f) }
  corner(s, c) -> vec2 { [vec2(0.0, 0.0), vec2(60.0, 0.0), vec2(0.0, 60.0)][c] }
  depth(s, p) -> float { 1.0 - s }
  keep(s, p) -> bool { p.x + p.y + reduce(max, i in 0..$3) { w.at(i % N) } < 60.0 }
}[0];
step look { output covered = sum(if seen.face == F - 1 { 1.0 } else { 0.0 }); }
END
}
raster known.dr n N
raster data.dr n n
cat > rows.dr << 'END'
edition 1;
input row : int[N];
param x : float[N] = 0.5;
step look { output total = sum(scatter_add(row, x, 2)); }
END
seq 500 | awk '{ print ($1 - 0.5) / 500 }' > 500.csv
yes 1024 | head -n 300 > edge.csv || true
for count in 10 600 70000; do yes 1 | head -n $count > w$count.csv || true; done
yes 1 | head -n 9000000 > rows.csv || true
expect 0 'covered = 523776' large.dr --bind edge=edge.csv
expect 0 'covered = 1711' known.dr --bind depth_of=500.csv --bind w=w600.csv --bind n=1
expect 1 'may take 70019 trips' known.dr --bind depth_of=500.csv --bind w=w70000.csv --bind n=1
expect 0 'covered = 1711' data.dr --bind depth_of=500.csv --bind w=w10.csv --bind n=10
expect 1 'data.dr:9' data.dr --bind depth_of=500.csv --bind w=w10.csv --bind n=100000
expect 0 'total = 4500000' rows.dr --bind row=rows.csv --scatter rows
exit $failed
