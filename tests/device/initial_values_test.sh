#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Initial values that are computed are filled in on the device as in the evaluator: before a step reads them, where the
# host asks for a leaf that nothing has read, not where it is bound, and not again on --resume.
# usage: initial_values_test.sh DRC DRUN
set -euo pipefail
drc=$(readlink -f "$1") drun=$(readlink -f "$2")
source "$(dirname "${BASH_SOURCE[0]}")/on_lavapipe.sh" "initial values on lavapipe"
cat > begin.dr << 'END'
edition 1;
import std.random;
param weight : vec3[W, H] = random.uniform3(coord(W, H), 5u) - scale;
param even : int[W] = 2 * coord(W).x;
state count : float = 3.0 * scale;
input scale : float = 0.5;
step fit { weight <- 0.5 * weight; count <- count + 1.0; output corner = weight.at(ivec2(5, 4)), count; }
step look { output weight, even = even.at(6); }
END
check() {  # the arguments of both
  "$drc" eval begin.dr "$@" > expected.txt
  "$drun" begin.dr --device llvmpipe "$@" > found.txt
  [[ -s found.txt ]] || { echo "nothing was printed: $*"; exit 1; }
  python3 - "$*" << 'END'
import re, sys
def numbers(name): return [float(x) for x in re.findall(r"(?<== |.[(]|, )-?[0-9][0-9.e-]*", open(name).read())]
found, expected = numbers("found.txt"), numbers("expected.txt")
expected = expected[-len(found):]  # the evaluator prints every run, drun the last
same = len(found) == len(expected) > 3 and all(abs(a - b) <= 2e-7 * max(abs(b), 1) for a, b in zip(found, expected))
sys.exit(0 if same else f"{sys.argv[1]}: found {found}, expected {expected}")
END
}
size=(--symbol W=7 --symbol H=5)
check "${size[@]}" --step fit
check "${size[@]}" --step fit=3 --step look --bind seed=9
check "${size[@]}" --step look --step fit --bind scale=2 --bind count=1

cat > npy.py << 'END'
# Of a .npy file.
import array, ast, struct
def numbers(name):
    data = open(name, "rb").read()
    length = struct.unpack("<H", data[8:10])[0]
    head = ast.literal_eval(data[10:10 + length].decode())
    return head["shape"], array.array({"f4": "f", "f8": "d", "i4": "i"}[head["descr"][1:]], data[10 + length:]).tolist()
END
# Bit by bit: uniform numbers are multiples of 2^-24, and so are these.
"$drc" eval begin.dr "${size[@]}" --step look --save look.weight=expected.npy > /dev/null
"$drun" begin.dr --device llvmpipe "${size[@]}" --step look --save look.weight=found.npy > /dev/null
python3 - << 'END'
import sys
sys.path.insert(0, ".")
from npy import numbers
a, b = numbers("found.npy"), numbers("expected.npy")
assert a == b and len(set(a[1])) > 100, (a, b)
END

# A leaf that no step has read, and a bundle that was built before.
"$drc" build begin.dr -o begin.drb
"$drun" begin.drb --device llvmpipe "${size[@]}" --step fit --save even=even.npy > /dev/null
python3 - << 'END'
import sys
sys.path.insert(0, ".")
from npy import numbers
assert numbers("even.npy")[1] == [2 * x for x in range(7)], numbers("even.npy")
END

"$drun" begin.dr --device llvmpipe "${size[@]}" --step fit=4 > whole.txt
"$drun" begin.dr --device llvmpipe "${size[@]}" --step fit=2 --out out > /dev/null
"$drun" begin.dr --device llvmpipe "${size[@]}" --step fit=4 --out out --resume > resumed.txt
diff whole.txt resumed.txt
