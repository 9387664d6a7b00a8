#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# What golden files cannot show of `drc eval` and `drc explain-grad`: messages, files in and out, replayed decisions,
# threads. usage: eval_test.sh DRC
set -euo pipefail
drc=$(readlink -f "$1")
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
failed=0

# same NAME EXPECTED FOUND
same() {
  if [[ $2 != "$3" ]]; then
    printf '%s:\n  expected: %s\n  found:    %s\n' "$1" "$2" "$3"
    failed=1
  fi
}
# refuses NAME EXPECTED COMMAND...: exit code 1 and exactly this on stderr.
refuses() {
  local name=$1 expected=$2 code=0
  shift 2
  "$@" > out.txt 2> err.txt || code=$?
  same "$name, exit code" 1 "$code"
  same "$name" "$expected" "$(cat err.txt)"
}
equal_folders() { diff -r "$2" "$3" > /dev/null || { echo "$1: $2 and $3 differ"; failed=1; }; }

# ---- Steps, bindings, files -----------------------------------------------------------------------------------------

cat > steps.dr << 'END'
edition 1;
param a : float[W];
param b : float[N] = 2.0;
input only_b : float[N];
step first { a <- a + 1.0; output total = sum(a); }
step second { b <- b * only_b; output total = sum(b), both = vec2(b, only_b); }
END
printf 'time, x\n' > table.csv
printf '1\n2.5\n# a comment\n-3e0\n' > column.csv
same 'a step needs only its own leaves' $'first.total = 0.5\nfirst.total = 3.5' \
  "$("$drc" eval steps.dr --bind a=column.csv --step first=2)"
same 'steps in order with counts' $'first.total = 0.5\nsecond.total = 4\nsecond.total = 12\nfirst.total = 3.5' \
  "$("$drc" eval steps.dr --bind a=column.csv --bind 'only_b=[3, 3]' --step first --step second=2 --step first=1)"
refuses 'all that is missing is named' \
  "error: param 'a' : float[W], input 'only_b' : float[N] have no data; bind them before the first step" \
  "$drc" eval steps.dr
refuses 'a wrong count' "error: expected a number of runs after 'first=', found 'x'" \
  "$drc" eval steps.dr --step first=x
"$drc" eval steps.dr --bind a=column.csv --bind 'only_b=[3, 4]' --save first.total=total.npy --save both=both.csv \
  --save a=a.csv --save b=b.png > /dev/null
same 'a list as .csv' $'2,3\n2,4' "$(cat both.csv)"
same 'a leaf as .csv' $'2\n3.5\n-2' "$(cat a.csv)"
same 'reads back' 'first.total = 3.5' "$("$drc" eval steps.dr --bind a=a.csv --step first)"
[[ -s total.npy && -s b.png ]] || { echo "--save wrote no file"; failed=1; }
refuses 'an output of two steps' "error: --save total=t.npy: several steps have an output 'total': write first.total or second.total" \
  "$drc" eval steps.dr --bind a=column.csv --bind 'only_b=[3, 4]' --save total=t.npy
refuses 'a name that is not there' "error: --save bots=t.npy: there is no leaf 'bots', and no such output of the steps that run (did you mean 'both'?)" \
  "$drc" eval steps.dr --bind a=column.csv --bind 'only_b=[3, 4]' --save bots=t.npy
refuses 'a table of words' "error: cannot read 'table.csv': there are no numbers in it" \
  "$drc" eval steps.dr --bind a=table.csv --step first

# ---- NaN and Inf ----------------------------------------------------------------------------------------------------

cat > finite.dr << 'END'
edition 1;
input x : float[W];
state n : int = 0;
let root = sqrt(x - float(n));
fn inner(x: float) -> float { if x > 2.0 { log(x - 3.0) } else { 0.0 } }
step go { n <- n + 1; output shielded = sum(if x - float(n) >= 0.0 { root } else { 0.0 }); }
step region { output r = sum(min(inner(x), 0.0)); }
END
refuses 'the first NaN' "finite.dr:4:12: error: 'sqrt' makes a NaN or Inf of finite operands: 'root' at element (0, 0, 0)
4 | let root = sqrt(x - float(n));
  |            ^^^^^^^^^^^^^^^^^^
  operand %OPERAND is -1
  in run 3 of step 'go'" bash -c "'$drc' eval finite.dr --bind 'x=[1, 5]' --step go=4 --check-finite 2> e || { sed 's/%[0-9]*/%OPERAND/' e >&2; exit 1; }"
same 'shielded is fine' 0 "$("$drc" eval finite.dr --bind 'x=[1, 5]' --step go=4 --check-finite=results > /dev/null; echo $?)"
refuses 'inside a region' "finite.dr:5:44: error: 'log' makes a NaN or Inf of finite operands: %N at element (1, 0, 0)
5 | fn inner(x: float) -> float { if x > 2.0 { log(x - 3.0) } else { 0.0 } }
  |                                            ^^^^^^^^^^^^
  operand %N is 0
  in run 1 of step 'region'" bash -c "'$drc' eval finite.dr --bind 'x=[1, 3]' --step region --check-finite 2> e || { sed 's/%[0-9]*/%N/' e >&2; exit 1; }"

cat > closure.dr << 'END'
edition 1;
input far : float[F];
let seen = raster(F, 4, 4) {
  setup(f) -> float { far.at(f) }
  corner(s, k) -> vec2 { [vec2(0.0), vec2(9.0, 0.0), vec2(0.0, 9.0)][k] }
  depth(s, p) -> float { 1.0 / (p.x - s) }
}[0];
step look { output faces = sum(seen.face); }
END
"$drc" eval closure.dr --bind 'far=[9.0, 2.5]' --check-finite > /dev/null 2> err.txt && { echo "a raster's Inf passes"; failed=1; }
same 'inside a raster' "closure.dr:6:26: error: 'div' makes a NaN or Inf of finite operands: % at element (2, 0, 0)" \
  "$(head -n 1 err.txt | sed 's/%[0-9]*/%/')"
grep -q "operand %[0-9]* is 0" err.txt || { echo "the operands of a raster's Inf are not told"; failed=1; }

printf '\x93NUMPY\x01\x00\x46\x00%-69s\n\x00\x00\x80\x3f\x00\x00\xc0\x7f' \
  "{'descr': '<f4', 'fortran_order': False, 'shape': (2,), }" > nan.npy
"$drc" eval finite.dr --bind x=nan.npy --step region --check-finite > /dev/null 2> err.txt && failed=1
same 'a NaN that is bound' "input 'x' holds a NaN or Inf at element (1, 0, 0)" \
  "$(head -n 1 err.txt | sed 's/.*error: //')"

cat > told.dr << 'END'
edition 1;
import std.optim;
input x : float[W];
param p : float = 1.0;
let error = p / sum(x);
step go { minimize error over p with optim.sgd(); output error, root = sqrt(x); }
step leave { p <- log(sum(x)); }
END
how='--check-finite stops at the op that makes the first one, with its line'
same 'an Inf is told of once' "warning: output 'go.error' is inf in run 1: $how
warning: 'p' has -Inf at element (0, 0, 0) after run 1 of step 'leave': $how" \
  "$("$drc" eval told.dr --bind 'x=[0, 0]' --step go=3 --step leave=2 2>&1 > /dev/null)"
same 'an image is looked at when a file gets it' "warning: 'go.root' has NaN at element (1, 0, 0): $how" \
  "$("$drc" eval told.dr --bind 'x=[4, -2]' --step go --out told 2>&1 > /dev/null)"
same 'finite numbers are not told of' '' "$("$drc" eval told.dr --bind 'x=[4, 2]' --step go=3 --out told 2>&1 > /dev/null)"

# ---- Steps that write what is missing -------------------------------------------------------------------------------

cat > order.dr << 'END'
edition 1;
param w : float[H];
input x : float[H];
step make { w <- 2.0 * x; }
step grow { w <- w + x; }
step use { output y = sum(w * w); }
END
refuses 'the step that writes it' "error: param 'w' : float[H] has no data; bind it before the first step; step 'make' writes 'w': run it before" \
  "$drc" eval order.dr --bind 'x=[1, 2]' --step use
same 'that step before' 'use.y = 20' "$("$drc" eval order.dr --bind 'x=[1, 2]' --step make --step use)"

# ---- A hull that is too small ---------------------------------------------------------------------------------------

cat > hull.dr << 'END'
edition 1;
const grow = 0.0;
let seen = raster(1, 8, 8) {
  setup(f) -> float { 0.0 }
  corner(s, k) -> vec2 { [vec2(2.0), vec2(6.0, 2.0), vec2(2.0, 6.0)][k] - grow }
  depth(s, p) -> float { 0.5 }
  keep(s, p) -> bool { p.x > 2.0 && p.y > 2.0 && p.x + p.y < 9.5 && p.x + 3.0 * p.y < 17.0 }
}[0];
step look { output faces = sum(seen.face); }
END
"$drc" eval hull.dr --step look=2 > /dev/null 2> err.txt
same 'a keep outside the hull' "hull.dr:7:24: warning: 'keep' holds outside the hull of the corners: for face 0 at pixel (6, 2, 0) and 1 more; a device may miss such pixels
7 |   keep(s, p) -> bool { p.x > 2.0 && p.y > 2.0 && p.x + p.y < 9.5 && p.x + 3.0 * p.y < 17.0 }
  |                        ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^" "$(cat err.txt)"
sed -i 's/< 9.5/< 8.0/' hull.dr
same 'a keep inside the hull' '' "$("$drc" eval hull.dr 2>&1 > /dev/null)"

# ---- Replayed decisions, threads, float32 ---------------------------------------------------------------------------

cat > fit.dr << 'END'
edition 1;
import std.mesh;
import std.camera;
import std.hardsoftras;
import std.loss;
param moved : vec3[50] = 0.0;
let position = pin(0.8 * mesh.globe_position(6, 8) + moved);
let clip = camera.project(camera.perspective(40.0) * camera.look_at(vec3(0.5, 1.0, 3.0)), position);
let soft = hardsoftras.rasterize(clip, mesh.globe_face(6, 8), 40, 40);
let alpha = hardsoftras.silhouette(soft);
let disk = if distance(vec2(coord(40, 40).xy), vec2(18.0, 21.0)) < 9.0 { 1.0 } else { 0.0 };
let error = loss.l2(alpha, disk);
step fit { moved <- moved - 2.0 * grad(error, moved); output error, alpha; }
END
"$drc" eval fit.dr --steps 3 --threads 1 --dump-raster one --out out_one > one.txt
"$drc" eval fit.dr --steps 3 --threads 3 --dump-raster three --out out_three > three.txt
same 'threads change nothing' "$(cat one.txt)" "$(cat three.txt)"
equal_folders 'threads change nothing' one three
equal_folders 'threads change nothing' out_one out_three
same 'the faces that cover, three ranks, and the pinned value' 9 "$(find one/fit/2 -type f | wc -l)"
[[ -s one/fit/0/pin.position.npy ]] || { echo "there is no pinned value"; failed=1; }
"$drc" eval fit.dr --steps 3 --freeze one --dump-raster replayed --out out_replayed > replayed.txt
same 'a replay gives the same' "$(cat one.txt)" "$(cat replayed.txt)"
equal_folders 'a replay gives the same' one replayed
equal_folders 'a replay gives the same' out_one out_replayed
# Decisions of the first run for every run: the third differs from what it decides by itself.
mkdir -p first/fit
for run in 0 1 2; do cp -r one/fit/0 first/fit/$run; done
"$drc" eval fit.dr --steps 3 --raster-from first > first.txt
same 'the first run again' "$(head -n 1 one.txt) $(head -n 1 one.txt) $(head -n 1 one.txt)" "$(tr '\n' ' ' < first.txt | sed 's/ $//')"
refuses 'a run that was not dumped' \
  "error: there are no decisions for run 3 of step 'fit': no folder 'one/fit/3'" "$drc" eval fit.dr --steps 4 --freeze one
"$drc" eval fit.dr --steps 3 --float32 > float32.txt
if [[ $(cat float32.txt) == "$(cat one.txt)" ]]; then echo "--float32 rounds nothing"; failed=1; fi
paste <(sed 's/.* //' one.txt) <(sed 's/.* //' float32.txt) |
  awk '{ d = $1 - $2; if (d < 0) d = -d; if (d > 1e-5 * $1) { print "--float32 is off by " d; bad = 1 } } END { exit bad }' ||
  failed=1

# ---- normal maps ------------------------------------------------------------------------------------------------------

cat > bumps.dr << 'END'
edition 1;
import std.image;
let p = 0.1 * vec2(coord(64, 64).xy);
let bumps = normalize(vec3(sin(p.x), cos(p.y), 1.5));
step draw { output bumps = image.from_srgb(0.5 * bumps + 0.5), colours = image.from_srgb(vec3(0.5 + 0.5 * bumps.xy, 0.5)); }
END
"$drc" eval bumps.dr --out drawn > /dev/null
cat > lit.dr << 'END'
edition 1;
input texel : vec3[W, H];
step look { output up = mean(texel.z); }
END
same 'a normal map without :raw' \
  "warning: leaf 'texel': 'drawn/draw.bumps.png' looks like a normal map, whose texels were bent as colours are: bind 'drawn/draw.bumps.png:raw'" \
  "$("$drc" eval lit.dr --bind texel=drawn/draw.bumps.png 2>&1 > /dev/null)"
for fine in drawn/draw.bumps.png:raw drawn/draw.colours.png; do
  same "no doubt about $fine" '' "$("$drc" eval lit.dr --bind texel=$fine 2>&1 > /dev/null)"
done

# ---- explain-grad ---------------------------------------------------------------------------------------------------

refuses 'an unknown loss' "error: the program has no output or let 'eror', did you mean 'error'?" \
  "$drc" explain-grad fit.dr eror moved
refuses 'an unknown target' "error: the program has no leaf or let 'move', did you mean 'moved'?" \
  "$drc" explain-grad fit.dr error move

exit $failed
