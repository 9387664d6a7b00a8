#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Loops that carry values go on in later dispatches with what they carried, and so do their gradients: the same bits as on
# a device that lets loops run on, and close to the reference. usage: long_folds_test.sh DRUN
set -eu  # `yes` ends by a closed pipe
drun=$(readlink -f "$1")
written_out=$(readlink -f "$(dirname "${BASH_SOURCE[0]}")/../golden/programs/fold_written_out.dr")
profiles=$(readlink -f "$(dirname "${BASH_SOURCE[0]}")/../../compiler/target/profiles")
source "$(dirname "${BASH_SOURCE[0]}")/on_lavapipe.sh" "long folds on lavapipe"
cp "$written_out" written_out.dr
cat > data.dr << 'END'
edition 1;
input n : int[V];
let y = fold(k in 0..n, x = 0.0) { x + 1.0 };
step count { output total = sum(y); }
END
cat > extent.dr << 'END'
edition 1;
input a : float[W];
let y = fold(k in 0..W, x = 0.0) { x + a.at(k) };
step count { output y; }
END
for count in 60000 100000; do yes 1 | head -n $count > $count.csv; done
cat > promise.dr << 'END'
edition 1;
param g : float = 0.5;
input n : int[V];
let y = sum(fold(k in 0..n, x = 0.0, max = 20000) { x * 0.5 + g });
step fit { output y;  output slope = grad(y, g); }
END
cat > again.dr << 'END'
edition 1;
param g : float[V] = 0.5;
input n : int[V];
let y = sum(fold(k in 0..n, x = 0.0, max = 20000) { x + 0.0001 * g * cos(0.1 * x) });
step fit { output y;  output slope = grad(y, g); }
END
cat > kinds.dr << 'END'
edition 1;
param g : float[V] = 0.5;
param w : vec3[8] = 0.1;
input n : int[V];
fn newton(x: float, y: float) -> float { x - (x * x * x - y) / (3.0 * x * x + 0.1) }
// A stop, nested loops, a fold in a fold, one in an `if`, one in a reduce, several states, scatters by gradients.
let stop = fold(k in 0..n, x = 0.5, max = 250) { let next = newton(x, 2.0 + g); if abs(next - x) < 1e-6 { break; } next };
let inner = fold(k in 0..n, x = 0.1, v = vec2(0.0), max = 300) {
  let s = reduce(sum, j in 0..5) { sin(x * float(j)) * w.at((j + k) % 8).y };
  (x * 0.99 + 0.01 * s * g, v * 0.9 + vec2(x, s))
};
let nested = fold(k in 0..n, x = 0.2, max = 250) { fold(j in 0..7, y = x) { y + 0.01 * sin(y * g + float(j)) } };
let branch = if g > 0.3 { fold(k in 0..n, x = g, max = 500) { x + 0.001 * cos(x) } } else { g * 2.0 };
let around = reduce(sum, k in 0..9) { fold(j in 0..n / 2, x = g, max = 200) { x + 0.01 * w.at((j * k) % 8).x * x } };
let e = sum(stop) * 0.1 + sum(inner.0 + dot(inner.1, vec2(0.1, 0.2))) + sum(nested) + sum(branch) + sum(around);
step fit { g <- g - 0.001 * grad(e, g); w <- w - 0.001 * grad(e, w); output e, stop, nested, branch, around, gg = grad(e, g), gw = grad(e, w); }
END
# Gradients of gradients; several kinds of state.
cat > orders.dr << 'END'
edition 1;
param g : float[V] = 0.5;
input n : int[V];
let s = fold(k in 0..n, x = 0.3, m = vec3(1.0), b = true, max = 4000) {
  let y = x + 0.01 * sin(x + g) * m.y; if y > 1.4 { break; }
  (y, m * 0.999 + vec3(0.001) * y, !b)
};
let e = sum(s.0) + sum(s.1.y) + sum(select(s.2, 1.0, 2.0));
let q = sum(fold(k in 0..n, x = 0.3, max = 200) { x + 0.01 * sin(x * g) });
let d = grad(q, g);
let dd = grad(sum(d * d), g);
step fit { g <- g - 0.001 * grad(e, g) - 0.001 * dd; output e, q, dd, ge = grad(e, g); }
END
failed=0
# expect STATUS TEXT ARGUMENTS...: drun on lavapipe ends so and says so.
expect() {
  local want=$1 text=$2 status=0
  shift 2
  "$drun" "$@" --device llvmpipe > said 2>&1 || status=$?
  if [[ $status != "$want" ]] || ! grep -qF -- "$text" said; then
    echo "drun $*: exit $status, expected $want and: $text"
    cat said
    failed=1
  fi
}
expect 0 'total = 1005' data.dr --bind 'n=[5, 1000]'
expect 0 'total = 60005' data.dr --bind 'n=[5, 60000]'
expect 1 'data.dr:3' data.dr --bind 'n=[5, 200000]' # nothing says how many trips it takes at most
expect 0 'y = 60000' extent.dr --bind a=60000.csv
expect 0 'y = 1e+05' extent.dr --bind a=100000.csv
expect 0 'slope = 3.9375' promise.dr --bind 'n=[5, 1000]'
# What the backward sweep computes again counts too: it takes several times the trips of the forward one.
expect 0 'agrees with the reference' again.dr --bind 'n=[20000, 15000, 5000, 5]' --check-against-reference
# A large promise costs dispatches that find nothing to do.
sed 's/max = 20000/max = 1000000000/' again.dr > large.dr
expect 0 'agrees with the reference' large.dr --bind 'n=[200, 150, 50, 5]' --check-against-reference

# A loop gives the bits of the same loop written out.
for road in '' '--pack naive' '--lower fragment'; do
  # shellcheck disable=SC2086
  for wanted in 'loops_differ = 0' 'folds_differ = 0' 'loops_agree = 1' 'folds_agree = 1'; do
    expect 0 "$wanted" written_out.dr --step values --step gradients $road
  done
done

# The bits of loops cut anywhere, on each road, are those of loops that run on.
sed 's/"loop_trips": 65535/"loop_trips": 0/' "$profiles/lavapipe.json" > whole.json
counts='n=[200, 3, 0, 57, 199, 120, 64, 31, 5, 90]'
for program in kinds orders; do
  expect 0 'agrees with the reference' $program.dr --bind "$counts" --profile whole.json --out whole --check-against-reference
  for trips in 40 700; do
    sed "s/\"loop_trips\": 65535/\"loop_trips\": $trips/" "$profiles/lavapipe.json" > parts.json
    for road in '' '--pack naive' '--lower fragment'; do
      # shellcheck disable=SC2086
      expect 0 'fit.e = ' $program.dr --bind "$counts" --profile parts.json --out parts $road
      for file in whole/*.npy; do
        cmp "$file" "parts/${file##*/}" || { echo "$program.dr, parts of $trips trips, $road: other bits"; failed=1; }
      done
      rm -rf parts
    done
  done
  rm -rf whole
done
exit $failed
