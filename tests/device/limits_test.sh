#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The limits suite: programs below, at and beyond each limit of drivers and of the interface against the evaluator, on
# lavapipe and SwiftShader, or with DR_TEST_DEVICE=NAME on that device alone. Beyond a limit a run is right or an error.
# docs/results/limits.md has the table. Nothing here keeps a device busy for longer than a second, but on processors.
# usage: limits_test.sh DRUN; with DR_LARGE_LIMITS=1 also those that take long, or gigabytes.
set -eu
drun=$(readlink -f "$1")
profiles=$(readlink -f "$(dirname "${BASH_SOURCE[0]}")/../../compiler/target/profiles")
device=()
if [[ -n ${DR_TEST_DEVICE-} ]]; then
  device=(--device "$DR_TEST_DEVICE") drivers=('')
  source "$(dirname "${BASH_SOURCE[0]}")/in_folder.sh"
else
  source "$(dirname "${BASH_SOURCE[0]}")/on_lavapipe.sh" "limits on lavapipe"
  drivers=("$DR_LAVAPIPE_ICD" ${DR_SWIFTSHADER_ICD:-})
fi
runs=0
# ends STATUS TEXT ARGUMENTS...: drun on each device ends so and says so.
ends() {
  local want=$1 text=$2 driver
  shift 2
  for driver in "${drivers[@]}"; do
    local status=0
    runs=$((runs + 1))
    if [[ -n $driver ]]; then
      VK_ICD_FILENAMES=$driver VK_DRIVER_FILES=$driver "$drun" "$@" > said 2>&1 || status=$?
    else
      "$drun" "$@" "${device[@]}" > said 2>&1 || status=$?
    fi
    if [[ $status != "$want" ]] || ! grep -qE -- "$text" said; then
      echo "${driver:-$DR_TEST_DEVICE}: drun $*: exit $status, expected $want and: $text"
      tail -n 3 said
      failed=1
    fi
  done
}
agrees() { ends 0 'agrees with the reference' "$@" --check-against-reference; }
# on NAME COMMAND...: on that CPU device alone, if the suite runs on it.
on() {
  local only=$1 all=("${drivers[@]}")
  shift
  case $only in
    lavapipe) drivers=(${DR_LAVAPIPE_ICD-}) ;;
    swiftshader) drivers=(${DR_SWIFTSHADER_ICD-}) ;;
  esac
  [[ -n ${DR_TEST_DEVICE-} || ${#drivers[@]} == 0 ]] || "$@"
  drivers=("${all[@]}")
}
# joined FORMAT SEPARATOR COUNT: the format with 0 to COUNT - 1 for %d.
joined() { seq 0 $(($3 - 1)) | awk -v format="$1" -v between="$2" '{ text = format; gsub(/%d/, $1, text); printf "%s%s", (NR > 1 ? between : ""), text }'; }

# ---- Trips of a loop, alone and nested: lavapipe's 65,535 ----
cat > trips.dr << 'DR'
edition 1;
param a : float[N] = 0.5;
step go { output total = reduce(sum, i in 0..N) { a.at(i) * float(i % 7) }; }
DR
cat > nested.dr << 'DR'
edition 1;
param a : float[N] = 0.5;
step go { output total = reduce(sum, i in 0..N) { reduce(max, j in 0..257) { a.at(i) * float((i + j) % 7) } }; }
DR
for count in 65533 65534 65535 65536 131072; do agrees trips.dr -s N=$count; done
for count in 253 254 255 256; do agrees nested.dr -s N=$count; done

# A bundle for devices without a limit: what loops is refused where there is one.
printf 'edition 1;\nparam a : float[N] = 0.5;\nstep go { output y = a.at(0) * 2.0; }\n' > plain.dr
for program in trips plain; do "$(dirname "$drun")/drc" build $program.dr --profile=swiftshader -o $program.drb; done
on lavapipe ends 1 "built for profile 'swiftshader', whose devices let loops run on" trips.drb -s N=100000
on lavapipe ends 0 'y = 1' plain.drb -s N=3
on swiftshader ends 0 'total' trips.drb -s N=100000

# ---- Faces that words of a list name beside a tag: 2^27 - 1 ----
cat > listed.dr << 'DR'
edition 1;
const F = 134217728;
const L = 1;
let list = raster(F, 8, 8, L, listed = 2) {
  setup(f) -> vec2 { vec2(float(f % 3)) }
  corner(s, c) -> vec2 { s + vec2(float(c), float(c % 2)) }
  keep(s, p) -> bool { true }
};
step go { output n = list.at(ivec3(1, 1, 0)) + 0; }
DR
on lavapipe ends 1 "134217728 faces, too many for a 'raster' with 'listed'" listed.dr --step go
ends 0 'go.n = 16' listed.dr --step go -D F=40
ends 0 'go.n = 16' listed.dr --step go -D F=40 -D L=20

# ---- Dispatches: 65,535 workgroups of 64 fill a row, and more go on in the next one; as many rows and layers ----
cat > elements.dr << 'DR'
edition 1;
param a : float[N] = 0.5;
let y = a * float(coord(N, 1, 1).x % 1000);
step go { output last = y.at(N - 1) + 0.0, total = sum(y); }
DR
cat > shape.dr << 'DR'
edition 1;
param a : float[W, H, L] = 0.5;
let p = coord(W, H, L);
let y = a * float((p.x + 3 * p.y + 7 * p.z) % 1000);
step go { output last = y.at(ivec3(W - 1, H - 1, L - 1)) + 0.0, total = sum(y), rows = sum(sum(y, over = x)); }
DR
for count in 4194239 4194240 4194241; do agrees elements.dr -s N=$count; done
for count in 65535 65536 65537; do
  agrees shape.dr -s W=2 -s H=$count -s L=1
  agrees shape.dr -s W=1 -s H=2 -s L=$count
done

# ---- Pictures as images: 8,192 a side on SwiftShader, 16,384 on lavapipe, 32,768 on NVIDIA; views of one render pass: 6 ----
cat > picture.dr << 'DR'
edition 1;
param a : float[W, H, L] = 0.5;
let p = coord(W, H, L);
let y = sin(a * float(p.x % 1000)) + float(p.y + p.z);
let beside = y.at(ivec3(max(p.x - 1, 0), p.y, p.z)) * 2.0;
step go { output last = beside.at(ivec3(W - 1, H - 1, L - 1)) + 0.0, total = sum(beside); }
DR
side() { # MOST
  agrees picture.dr --lower fragment -s W=$(($1 - 1)) -s H=2 -s L=1
  agrees picture.dr --lower fragment -s W=$1 -s H=2 -s L=1
  ends 1 "'y' is an image of $(($1 + 1)) x 2 x 1, the device allows $1 |draws $(($1 + 1)) x 2 pixels, the device allows $1 " \
    picture.dr --lower fragment -s W=$(($1 + 1)) -s H=2 -s L=1
  agrees picture.dr --lower compute -s W=$(($1 + 1)) -s H=2 -s L=1
}
on lavapipe side 16384
on swiftshader side 8192
[[ ${DR_TEST_DEVICE-} != *NVIDIA* ]] || side 32768
for layers in 6 7 33; do agrees picture.dr --lower fragment -s W=5 -s H=4 -s L=$layers; done
cat > layers.dr << 'DR'
edition 1;
const L = 1;
param size : float = 0.6;
let seen = raster(1, 16, 16, L) {
  setup(f) -> vec3 { vec3(size, 0.5, 1.0) }
  corner(s, c) -> vec2 { [vec2(2.0, 2.0), vec2(14.0, 3.0), vec2(7.0, 14.0)][c] }
  keep(s, p) -> bool { distance(p, vec2(7.6, 6.2)) < 4.0 * s.x }
  depth(s, p) -> float { 0.5 }
};
step go { output found = float(seen[0].face), total = sum(if seen[0].face >= 0 { 1.0 } else { 0.0 }); }
DR
for raster in hardware compute; do
  for layers in 1 6 7 65; do agrees layers.dr --raster $raster -D L=$layers; done
done

# ---- What a shader binds: 30 buffers on SwiftShader, 32 on lavapipe ----
for count in 24 29 30 31 32 33 64 200; do
  {
    echo 'edition 1;'
    joined 'param a%d : float[N] = 0.5;' $'\n' $count
    echo
    echo "let y = $(joined 'a%d * float(coord(N).x + %d)' ' + ' $count);"
    echo "step go { output y, slope = grad(sum(y * y), a0), last = grad(sum(y * y), a$((count - 1))); }"
  } > buffers.dr
  agrees buffers.dr -s N=70
done
# What it writes: colour attachments (8), and buffers.
for count in 7 8 9 33; do
  {
    echo 'edition 1;'
    echo 'param a : float[N] = 0.5;'
    echo "step go { output $(joined 'y%d = sin(a * float(coord(N).x + %d))' ', ' $count); }"
  } > outputs.dr
  agrees outputs.dr -s N=70
  agrees outputs.dr -s N=70 --lower fragment
done
# Symbols are constants of pipelines.
for count in 15 16 17 65; do
  {
    echo 'edition 1;'
    joined 'param a%d : float[N%d] = 0.5;' $'\n' $count
    echo
    echo "step go { output y = $(joined 'a%d.at(N%d - 1) * float(N%d)' ' + ' $count); }"
  } > symbols.dr
  agrees symbols.dr $(joined '-s N%d=1%d' ' ' $count)
done

# ---- Lengths of shaders: a chain of sines, in one pass of up to 6,144 instructions' size, then in several ----
chain() { # LENGTH: each number from the one before
  echo 'edition 1;'
  echo 'param x0 : float[N] = 0.3;'
  awk -v n="$1" 'BEGIN { for (k = 1; k <= n; ++k) printf "let x%d = x%d + 0.001 * sin(x%d * %d.0);\n", k, k - 1, k - 1, k % 7 + 1 }'
  echo "step go { output y = x$1, slope = grad(sum(x$1), x0); }"
}
for count in 100 500 ${DR_LARGE_LIMITS:+1500 6000}; do
  chain $count > chain.dr
  agrees chain.dr -s N=3
done

# ---- Registers: so many numbers at once in a shader, each made of the one before; NVIDIA's have 255, then scratch ----
registers() { # COUNT
  echo 'edition 1;'
  echo 'param x0 : float[N] = 0.3;'
  awk -v n="$1" 'BEGIN {
    for (k = 1; k < n; ++k) printf "let x%d = x%d + 0.001 * sin(x%d * %d.0);\n", k, k - 1, k - 1, k % 7 + 1
    printf "let y = "
    for (k = 0; k < n; ++k) printf "%sx%d * x%d", (k > 0 ? " + " : ""), k, n - 1 - k
    print ";"
  }'
  echo 'step go { output y, slope = grad(sum(y), x0); }'
}
for count in 64 ${DR_LARGE_LIMITS:+128 255 256 257 600}; do
  registers $count > registers.dr
  agrees registers.dr -s N=70
done
# Scratch: a gradient keeps a loop's states in an array, up to 512 words an element, and a matrix more.
cat > scratch.dr << 'DR'
edition 1;
const N = 1;
param g : float[V] = 0.4;
let (m, v, x) = fold(k in 0..N, m = mat4(1.0), v = vec4(0.1), x = 0.2) {
  (0.999 * m + 0.001 * mat4(v, v, v, v), 0.99 * v + 0.01 * (m * vec4(sin(x + g))), x + 0.01 * cos(x * g))
};
let e = sum(dot(m * v, v)) + sum(x);
step go { output e, slope = grad(e, g); }
DR
for count in 1 16 17 600; do agrees scratch.dr -s V=70 -D N=$count; done
# Shared memory: a group's part of a sum, of the largest type.
cat > shared.dr << 'DR'
edition 1;
param a : mat4[N] = 0.5;
let wide = a * float(coord(N).x % 100);
let total = sum(wide);
let lowest = min(float(coord(N).x) - 3.0);
step go { output total, lowest; }
DR
for count in 255 256 257 65537; do agrees shared.dr -s N=$count; done

# ---- Floats as counts: beyond 2^24 neighbours are one float; beyond int they are clamped or refused alike ----
cat > counts.dr << 'DR'
edition 1;
input x : float[V];
step go { output whole = int(x), shares = reduce(sum, i in 0..int(min(x, 100.0))) { 1.0 }; }
DR
agrees counts.dr --bind 'x=[0, -0.5, 0.999, 16777215, 16777216, 2147483520, -2147483648]'

# ---- `if`s one behind another in a loop: SwiftShader's compiler walks what is behind an `else` twice ----
{
  printf 'edition 1;\nparam a : float[W] = 0.5;\ninput m : int[W];\nlet e = reduce(sum, k in 0..40) {\n  let i = coord(W).x;\n  var s = float(k);\n'
  for ((j = 0; j < 40; ++j)); do
    echo "s = s + (if s > $j.5 { a.at(i + k + m.at(i + $j)) * sin(s) } else { a.at(i - k - m.at(i - $j)) * cos(s) });"
  done
  printf '  s\n};\nstep go { output e; }\n'
} > ifs.dr
agrees ifs.dr -b 'm==[1,2,3,0,1,1,0,2]'

# ---- A dispatch may take long: watchdogs ----
# A device that ends what runs too long has a profile with so many trips a dispatch: the same bits.
cat > long.dr << 'DR'
edition 1;
param a : float[N] = 0.5;
param b : float[T] = 1.0;
let y = reduce(sum, i in 0..T) { b.at(i) * sin(a * float(i % 97 + coord(N).x)) };
step go { output y; }
DR
profile=$(sed "s/\"loop_trips\": [0-9]*/\"loop_trips\": 1000/; s/\"name\": \"[^\"]*\"/\"name\": \"ends_loops\"/" \
  "$profiles/swiftshader.json")
echo "$profile" > ends_loops.json
agrees long.dr -s N=200 -s T=999 --profile ends_loops.json
agrees long.dr -s N=200 -s T=20000 --profile ends_loops.json
# On processors nothing ends a dispatch of some ten seconds.
if [[ -n ${DR_LARGE_LIMITS-} && -z ${DR_TEST_DEVICE-} ]]; then
  printf 'edition 1;\nparam a : float[N] = 1.0;\nstep go { output least = min(reduce(sum, i in 0..60000) { a.at((i * 7919) %% N) }); }\n' > busy.dr
  ends 0 'least = 60000' busy.dr -s N=200000
fi

# ---- A value: bound in parts beyond 128 MiB on lavapipe, 1 GiB on SwiftShader, 4 GiB on NVIDIA; in several buffers beyond
# ---- what an allocation has, 2 GiB and 1 GiB on the first two; 2^31 elements for all ----
cat > buffer.dr << 'DR'
edition 1;
input a : float;
param p : float[N] = 0.25;
step go { p <- p + a; output last = p.at(N - 1) + 0.0; }
DR
ends 1 'not between 1 and 2\^31|more than 2\^31|error' buffer.dr --bind a=0.5 -s N=2147483648
for count in 8191 8192 8193 100001; do agrees buffer.dr --bind a=0.5 -s N=$count --buffers 32K; done
ends 1 'a shader binds [0-9]+ storage buffers, .* are bound in parts: bind less data, or allow larger buffers' buffer.dr --bind a=0.5 -s N=1000000 --buffers 32K
if [[ -n ${DR_LARGE_LIMITS-} ]]; then
  for count in 33554431 33554432 33554433; do ends 0 'last = 0.25' buffer.dr --bind a=0.5 -s N=$count; done
  on lavapipe ends 0 'last = 0.25' buffer.dr --bind a=0.5 -s N=300000000
  # More than an allocation.
  on lavapipe ends 0 'last = 0.25' buffer.dr --bind a=0.5 -s N=600000000
  on swiftshader ends 0 'last = 0.25' buffer.dr --bind a=0.5 -s N=300000000
  if [[ ${DR_TEST_DEVICE-} == *NVIDIA* ]]; then
    for count in 268435455 268435456 1073741823 1073741824 1500000000; do ends 0 'last = 0.25' buffer.dr --bind a=0.5 -s N=$count; done
  fi
fi
echo "$runs runs"
exit $failed
