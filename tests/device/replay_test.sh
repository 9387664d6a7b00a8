#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# What a device decides is written by drun and replayed by drc eval: the same faces, the same pinned values, and so
# nearly the same losses. Also: steps that do not run need no data. usage: replay_test.sh DRC DRUN
set -euo pipefail
drc=$(readlink -f "$1") drun=$(readlink -f "$2")
source "$(dirname "${BASH_SOURCE[0]}")/on_lavapipe.sh" "replaying decisions of lavapipe"
cat > fit.dr << 'END'
edition 1;
import std.mesh;
import std.camera;
import std.hardsoftras;
import std.loss;
param moved : vec3[50] = 0.0;
param later : float[W, Q];
input photo : float[W, H];
let position = pin(0.8 * mesh.globe_position(6, 8) + moved);
let clip = camera.project(camera.perspective(40.0) * camera.look_at(vec3(0.5, 1.0, 3.0)), position);
let soft = hardsoftras.rasterize(clip, mesh.globe_face(6, 8), 40, 40);
let alpha = hardsoftras.silhouette(soft);
let disk = if distance(vec2(coord(40, 40).xy), vec2(18.0, 21.0)) < 9.0 { 1.0 } else { 0.0 };
let error = loss.l2(alpha, disk);
let seen = raster(3, 8, 8, 1, listed = 2) {
  setup(f) -> vec2 { vec2(float(f)) }
  corner(s, c) -> vec2 { s + vec2(float(3 * c), float(c % 2 * 4)) }
  keep(s, p) -> bool { true }
};
step fit { moved <- moved - 2.0 * grad(error, moved); output error, alpha, listed = seen + 0; }
step tone { later <- later * 0.5; output mean = mean(photo) + mean(later); }
END

for lower in fragment compute; do
  raster=hardware
  [[ $lower == fragment ]] || raster=compute
  rm -rf device again out
  "$drun" fit.dr --device llvmpipe --lower $lower --raster $raster --step fit=3 --dump-raster device --out out > /dev/null
  "$drc" eval fit.dr --step fit=3 --freeze device --dump-raster again --out reference > reference.txt
  for run in 0 1 2; do
    for file in again/fit/$run/raster*; do
      cmp "$file" "device/fit/$run/$(basename "$file")" || failed=1
    done
    [[ -s device/fit/$run/pin.position.npy ]] || { echo "the device wrote no pinned value"; failed=1; }
  done
  # The pinned value ties both to the same shape in every run, so rounding does not add up.
  paste <(sed -n 's/.*"error": \([^,}]*\).*/\1/p' out/log.jsonl) <(sed 's/.* //' reference.txt) |
    awk '{ d = $1 - $2; if (d < 0) d = -d; if (d > 1e-5 * $2) { print "losses differ: " $0; bad = 1 } }
         END { if (NR != 3) { print "expected 3 losses, found " NR; bad = 1 } exit bad }' || failed=1
done

"$drun" fit.dr --device llvmpipe --step tone > /dev/null 2> err.txt && { echo "a step runs without its data"; failed=1; }
grep -q "step 'tone' needs data for leaves 'later' \[W, Q, 1\], 'photo' \[W, H, 1\], which are not bound" err.txt ||
  { echo "wrong message: $(cat err.txt)"; failed=1; }
# What another step writes is told of.
cat > order.dr << 'END'
edition 1;
param w : float[H];
input x : float[H];
step make { w <- 2.0 * x; }
step use { output y = sum(w * w); }
END
"$drun" order.dr --device llvmpipe --bind 'x=[1, 2]' --step use > /dev/null 2> err.txt && { echo "a step runs before its data is there"; failed=1; }
grep -q "needs data for leaf 'w' \[H, 1, 1\], which is not bound; step 'make' writes 'w': run it before" err.txt ||
  { echo "wrong message: $(cat err.txt)"; failed=1; }
# The other step's memory is made when it runs, with extents that the first one does not know.
"$drun" fit.dr --device llvmpipe --bind 'later=[[1, 2, 3], [4, 5, 6]]' --bind 'photo=[[1, 1, 1]]' --step tone=2 --step fit=2 \
  --step tone > tone.txt 2>&1 || { cat tone.txt; failed=1; }
grep -q "tone.mean = 1.875" tone.txt || { echo "a step after another: $(cat tone.txt)"; failed=1; }
exit $failed
