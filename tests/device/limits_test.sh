#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The limits suite: programs below, at and beyond each limit of drivers and of the interface, on lavapipe and SwiftShader
# against the evaluator. Beyond a limit a run is right or an error. docs/results/limits.md has the table.
# usage: limits_test.sh DRUN; with DR_LARGE_LIMITS=1 also those that take long.
set -eu
drun=$(readlink -f "$1")
source "$(dirname "${BASH_SOURCE[0]}")/on_lavapipe.sh" "limits on lavapipe"
# ends STATUS TEXT ARGUMENTS...: drun on each device ends so and says so.
ends() {
  local want=$1 text=$2 driver
  shift 2
  for driver in "$DR_LAVAPIPE_ICD" ${DR_SWIFTSHADER_ICD:-}; do
    local status=0
    VK_ICD_FILENAMES=$driver VK_DRIVER_FILES=$driver "$drun" "$@" > said 2>&1 || status=$?
    if [[ $status != "$want" ]] || ! grep -qE -- "$text" said; then
      echo "$driver: drun $*: exit $status, expected $want and: $text"
      tail -n 3 said
      failed=1
    fi
  done
}
agrees() { ends 0 'agrees with the reference' "$@" --check-against-reference; }

# Trips of a loop, alone and nested: lavapipe's 65,535.
cat > trips.dr << 'END'
edition 1;
param a : float[N] = 0.5;
step go { output total = reduce(sum, i in 0..N) { a.at(i) * float(i % 7) }; }
END
cat > nested.dr << 'END'
edition 1;
param a : float[N] = 0.5;
step go { output total = reduce(sum, i in 0..N) { reduce(max, j in 0..257) { a.at(i) * float((i + j) % 7) } }; }
END
for count in 65533 65534 65535 65536 131072; do agrees trips.dr -s N=$count; done
for count in 253 254 255 256; do agrees nested.dr -s N=$count; done

# A bundle for devices without a limit: what loops is refused where there is one.
for program in trips plain; do
  [[ $program == trips ]] || printf 'edition 1;\nparam a : float[N] = 0.5;\nstep go { output y = a.at(0) * 2.0; }\n' > plain.dr
  "$(dirname "$drun")/drc" build $program.dr --profile=swiftshader -o $program.drb
done
DR_SWIFTSHADER_ICD= ends 1 "built for profile 'swiftshader', whose devices let loops run on" trips.drb -s N=100000
DR_SWIFTSHADER_ICD= ends 0 'y = 1' plain.drb -s N=3
[[ -z ${DR_SWIFTSHADER_ICD-} ]] || DR_LAVAPIPE_ICD=$DR_SWIFTSHADER_ICD DR_SWIFTSHADER_ICD= ends 0 'total' trips.drb -s N=100000

# Elements of a dispatch: 65,535 workgroups of 64 fill a row; more go on in the next one.
cat > elements.dr << 'END'
edition 1;
param a : float[N] = 0.5;
let y = a * float(coord(N, 1, 1).x % 1000);
step go { output last = y.at(N - 1) + 0.0, total = sum(y); }
END
for count in 4194239 4194240 4194241; do agrees elements.dr -s N=$count; done

# Floats as counts: beyond 2^24 neighbours are one float; beyond int they are clamped or refused alike.
cat > counts.dr << 'END'
edition 1;
input x : float[V];
step go { output whole = int(x), shares = reduce(sum, i in 0..int(min(x, 100.0))) { 1.0 }; }
END
agrees counts.dr --bind 'x=[0, -0.5, 0.999, 16777215, 16777216, 2147483520, -2147483648]'

# A buffer: 128 MiB on lavapipe; 2^31 elements for all.
cat > buffer.dr << 'END'
edition 1;
input a : float;
param p : float[N] = 0.25;
step go { p <- p + a; output last = p.at(N - 1) + 0.0; }
END
ends 1 'not between 1 and 2\^31|more than 2\^31|error' buffer.dr --bind a=0.5 -s N=2147483648
ends 1 'error: .*(2\^31|memory|holds|bytes|MiB|GiB)' buffer.dr --bind a=0.5 -s N=2147483647
if [[ -n ${DR_LARGE_LIMITS-} ]]; then
  ends 0 'last = 0.25' buffer.dr --bind a=0.5 -s N=33554432
  ends 0 'last = 0.25' buffer.dr --bind a=0.5 -s N=33554431
  DR_SWIFTSHADER_ICD= ends 1 "'p' takes 134217732 bytes, the device allows 134217728" buffer.dr --bind a=0.5 -s N=33554433
fi
exit $failed
