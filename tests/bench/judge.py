# SPDX-License-Identifier: Apache-2.0
"""The float64 evaluator against mpmath: judge.py POINTS OUT.json

POINTS has lines `op direction operand... result`, numbers in hexadecimal. Functions and derivatives are written out here
once more, from their definitions in docs/reference/ops.md, and computed with 50 digits. Errors are relative, in units of 2^-53;
results that are no normal float64 numbers must agree in kind (0 or subnormal, infinite, no number). Operands that are not
finite are left out, and derivatives where the function is no number.
"""
import json
import math
import multiprocessing
import sys

import mpmath
from mpmath import mp, mpf

mp.dps = 50
INF, NAN = mpf("inf"), mpf("nan")
ZERO, ONE, HALF = mpf(0), mpf(1), mpf("0.5")
TINY, HUGE = mpf(2) ** -1022, mpf(2) ** 1024


def clamped(x):
    return max(-ONE, min(ONE, x))


def power(x, y):
    """x^y; a negative x has whole powers only."""
    if x == 1 or y == 0:
        return ONE
    if x == 0:
        return ZERO if y > 0 else INF
    if mpmath.isinf(x) or mpmath.isinf(y):
        size = abs(x)
        if size == 1:
            return ONE
        return INF if (size > 1) == (y > 0) else ZERO
    if x < 0 and y != mpmath.floor(y):
        return NAN
    # Exponents beyond float64's range a hundred times over need no digits.
    exponent = y * mpmath.log(abs(x))
    if abs(exponent) > 1e5:
        size = INF if exponent > 0 else ZERO
    else:
        size = mpmath.exp(exponent)
    odd = x < 0 and mpmath.fmod(abs(y), 2) == 1
    return -size if odd else size


def exp(x):
    return ZERO if x < -1e5 else INF if x > 1e5 else mpmath.exp(x)


def sigmoid(x):
    return 1 / (1 + exp(-x)) if x > -1e5 else ZERO


def sign(x):
    return ZERO if x == 0 else ONE if x > 0 else -ONE


def inside(x, derivative):
    return derivative() if -1 < x < 1 else ZERO


def half(x):
    """The nearest number of 11 digits, no finer than 2^-24, at most 65504."""
    size = min(abs(x), mpf(65504))
    unit = max(mpf(2) ** -24, mpf(2) ** (mpmath.frexp(size)[1] - 11)) if size > 0 else ONE
    return mpmath.nint(size / unit) * unit * (-1 if x < 0 else 1)


def above(x, low, derivative):
    return derivative() if x > low else ZERO


def floor_mod(x, y):
    if y == 0:
        return ZERO
    if mpmath.isinf(x):
        return NAN
    return x - y * mpmath.floor(x / y)


def angle(y, x):
    return ZERO if x == 0 and y == 0 else mpmath.atan2(y, x)


def share(x, y, wins):
    return HALF if x == y else ONE if wins else ZERO


def tan(x):
    return mpmath.tan(x)


def clamp(x, low, high):
    return min(max(x, low), high)


def clamp_parts(x, low, high):
    """Which operand has the derivative: x inside, else the bound; the upper one where they are crossed."""
    if low > high:
        return 2
    return 0 if low <= x <= high else 1 if x < low else 2


def with_extra(digits, function):
    """For sums that cancel, or arguments that are huge."""
    before = mp.dps
    mp.dps = before + digits
    try:
        return function()
    finally:
        mp.dps = before


F = {
    "add": [lambda x, y: x + y, lambda x, y: ONE, lambda x, y: ONE],
    "sub": [lambda x, y: x - y, lambda x, y: ONE, lambda x, y: -ONE],
    "mul": [lambda x, y: x * y, lambda x, y: y, lambda x, y: x],
    "smul": [lambda x, y: ZERO if x == 0 else x * y, lambda x, y: y, lambda x, y: x],
    "div": [lambda x, y: x / y if y != 0 else NAN if x == 0 else sign(x) * INF,
            lambda x, y: 1 / y if y != 0 else ZERO,
            lambda x, y: -x / (y * y) if y != 0 else ZERO],
    "mod": [floor_mod, lambda x, y: ONE, lambda x, y: -mpmath.floor(x / y) if y != 0 else ZERO],
    "half": [half, lambda x: ONE if abs(half(x)) < 65504 else ZERO],
    "neg": [lambda x: -x, lambda x: -ONE],
    "abs": [abs, sign],
    "sign": [sign],
    "min": [min, lambda x, y: share(x, y, x < y), lambda x, y: share(x, y, y < x)],
    "max": [max, lambda x, y: share(x, y, x > y), lambda x, y: share(x, y, y > x)],
    "clamp": [clamp] + [lambda x, l, h, k=k: ONE if clamp_parts(x, l, h) == k else ZERO for k in range(3)],
    "floor": [mpmath.floor],
    "ceil": [mpmath.ceil],
    "round": [mpmath.nint],
    "trunc": [lambda x: mpmath.floor(x) if x > 0 else mpmath.ceil(x)],
    "fract": [lambda x: x - mpmath.floor(x), lambda x: ONE],
    "sqrt": [lambda x: mpmath.sqrt(x) if x >= 0 else NAN, lambda x: above(x, 0, lambda: HALF / mpmath.sqrt(x))],
    "inversesqrt": [lambda x: 1 / mpmath.sqrt(x) if x > 0 else INF if x == 0 else NAN,
                    lambda x: above(x, 0, lambda: -HALF / (x * mpmath.sqrt(x)))],
    "exp": [exp, exp],
    "exp2": [lambda x: exp(x * mp.ln2), lambda x: exp(x * mp.ln2) * mp.ln2],
    "expm1": [lambda x: mpmath.expm1(x) if abs(x) < 1e5 else exp(x) - 1, exp],
    "log": [lambda x: mpmath.log(x) if x > 0 else -INF if x == 0 else NAN, lambda x: above(x, 0, lambda: 1 / x)],
    "log2": [lambda x: mpmath.log(x) / mp.ln2 if x > 0 else -INF if x == 0 else NAN,
             lambda x: above(x, 0, lambda: 1 / (x * mp.ln2))],
    "log1p": [lambda x: mpmath.log1p(x) if x > -1 else -INF if x == -1 else NAN,
              lambda x: above(x, -1, lambda: 1 / (1 + x))],
    "pow": [power,
            lambda x, y: ZERO if x == 0 and y < 1 else ZERO if y == 0 else y * power(x, y - 1),
            lambda x, y: power(x, y) * mpmath.log(x) if x > 0 else ZERO],
    "sin": [mpmath.sin, mpmath.cos],
    "cos": [mpmath.cos, lambda x: -mpmath.sin(x)],
    "tan": [tan, lambda x: 1 + tan(x) ** 2],
    "asin": [lambda x: mpmath.asin(clamped(x)), lambda x: inside(x, lambda: 1 / mpmath.sqrt((1 - x) * (1 + x)))],
    "acos": [lambda x: mpmath.acos(clamped(x)), lambda x: inside(x, lambda: -1 / mpmath.sqrt((1 - x) * (1 + x)))],
    "atan": [mpmath.atan, lambda x: 1 / (1 + x * x)],
    "atan2": [angle,
              lambda y, x: ZERO if x == 0 and y == 0 else x / (x * x + y * y),
              lambda y, x: ZERO if x == 0 and y == 0 else -y / (x * x + y * y)],
    "sinh": [lambda x: mpmath.sinh(x) if abs(x) < 1e5 else sign(x) * INF,
             lambda x: mpmath.cosh(x) if abs(x) < 1e5 else INF],
    "cosh": [lambda x: mpmath.cosh(x) if abs(x) < 1e5 else INF,
             lambda x: mpmath.sinh(x) if abs(x) < 1e5 else sign(x) * INF],
    "tanh": [lambda x: mpmath.tanh(x) if abs(x) < 1e5 else sign(x),
             lambda x: mpmath.sech(x) ** 2 if abs(x) < 1e5 else ZERO],
    "asinh": [mpmath.asinh, lambda x: 1 / mpmath.sqrt(1 + x * x)],
    "acosh": [lambda x: mpmath.acosh(x) if x >= 1 else NAN,
              lambda x: above(x, 1, lambda: 1 / mpmath.sqrt((x - 1) * (x + 1)))],
    "atanh": [lambda x: NAN if abs(x) > 1 else sign(x) * INF if abs(x) == 1 else mpmath.atanh(x),
              lambda x: inside(x, lambda: 1 / ((1 - x) * (1 + x)))],
    "sigmoid": [sigmoid, lambda x: sigmoid(x) * sigmoid(-x)],
    "softplus": [lambda x: max(x, ZERO) + mpmath.log1p(exp(-abs(x))), sigmoid],
    "cbrt": [lambda x: sign(x) * mpmath.cbrt(abs(x)), lambda x: 1 / (3 * mpmath.cbrt(abs(x)) ** 2) if x != 0 else ZERO],
    "logaddexp": [lambda x, y: max(x, y) + mpmath.log1p(exp(-abs(x - y))), lambda x, y: sigmoid(x - y),
                  lambda x, y: sigmoid(y - x)],
    "erf": [mpmath.erf, lambda x: 2 / mpmath.sqrt(mp.pi) * exp(-x * x)],
}
# Their arguments span the range: what is 1 + 1e-38, or x - floor(x) of a huge x, needs as many digits.
WIDE = {"atan", "atan2", "asinh", "mod", "add", "sub", "fract", "sigmoid", "softplus", "tanh", "sin", "cos", "tan", "log1p"}


def kind(x):
    """What a result is: None where it is a normal number."""
    if mpmath.isnan(x):
        return "no number"
    if abs(x) >= HUGE:
        return "infinite"
    return "0" if abs(x) < TINY else None


def judge(line):
    """Op, direction, error in 2^-53, and the line where it is not 0."""
    words = line.rstrip("\n").split("\t")
    op, direction = words[0], words[1]
    operands = [float.fromhex(w) for w in words[2:-1]]
    found = float.fromhex(words[-1])
    if any(math.isnan(x) or math.isinf(x) for x in operands):
        return op, direction, None, None
    which = 0 if direction == "value" else int(direction[4:])
    points = [mpf(x) for x in operands]
    digits = 80 if op in WIDE else 10
    if which > 0 and mpmath.isnan(with_extra(digits, lambda: F[op][0](*points))):
        return op, direction, None, None
    exact = with_extra(digits, lambda: F[op][which](*points))
    a, b = kind(exact), kind(mpf(found))
    if a or b:
        # Either may be at the end of the range where the other is just inside it.
        near = abs(exact - mpf(found)) <= max(abs(exact), TINY) * mpf(2) ** -48 if not (a or b) or "0" in (a, b) else a == b
        error = 0.0 if a == b or near else math.inf
    else:
        error = float(abs(mpf(found) - exact) / abs(exact) * mpf(2) ** 53)
    return op, direction, error, line if error > 0 else None


def main():
    points, out = sys.argv[1:]
    errors, worst, skipped = {}, {}, 0
    with open(points) as lines, multiprocessing.Pool() as pool:
        for op, direction, error, line in pool.imap_unordered(judge, lines, chunksize=2000):
            if error is None:
                skipped += 1
                continue
            key = (op, direction)
            errors.setdefault(key, []).append(error)
            if error > worst.get(key, (-1.0, ""))[0]:
                worst[key] = (error, line or "")
    rows = []
    for (op, direction), all_of_it in errors.items():
        all_of_it.sort()
        rows.append({"op": op, "direction": direction, "n": len(all_of_it), "max": min(all_of_it[-1], 1e30),
                     "p999": min(all_of_it[(len(all_of_it) - 1) * 999 // 1000], 1e30),
                     "worst": worst[(op, direction)][1].strip()})
    order = list(F)
    rows.sort(key=lambda r: (order.index(r["op"]), r["direction"] != "value", r["direction"]))
    for row in rows:
        print(f'{row["op"]:12} {row["direction"]:6} {row["n"]:7} {row["max"]:10.3g} {row["p999"]:8.3g}  {row["worst"]}')
    total = sum(row["n"] for row in rows)
    print(f"{total} points, {skipped} left out; "
          f"the largest error is {max(row['max'] for row in rows):.3g} of 2^-53")
    with open(out, "w") as file:
        json.dump({"mpmath": mpmath.__version__, "points": total, "rows": rows}, file, indent=1)


if __name__ == "__main__":
    main()
