// SPDX-License-Identifier: Apache-2.0
// Small programs, each about one thing that went wrong or might: every device and lowering against the evaluator.
#include <array>
#include <cmath>
#include <filesystem>
#include <fstream>

#include "runtime/jit/jit.h"
#include "runtime/jit/reference_program.h"
#include "runtime/runtime.h"
#include "tests/catch.h"
#include "tests/device/compile.h"
#include "tests/device/devices.h"

using namespace dr;
using io::Array;
using test::must;

namespace {

struct Case {
  const char* name;
  const char* text;                // after "edition 1;"
  std::vector<const char*> steps;  // run in order; outputs of all are compared at the end
  bool exact = false;              // bit for bit: integers, and floats that nothing rounds
};

const Case kCases[] = {
    {"names of the user hide none of ours",
     R"(
      input a : float[W, H];
      let out = a * 2.0; let scatter = a + 1.0; let index = coord(W, H).x;
      let gather_a = a.at(coord(W, H).xy + ivec2(1, 0)); let load_a = a.at(coord(W, H).xy - ivec2(0, 1)) * gather_a;
      let y = out * sin(out) + 1.0; let at = load_a + y; let pc = at * 0.5;
      let face = scatter_add(index, scatter, W);
      step go { output out, y, at, pc, face; })",
     {"go"}},
    {"integers over numbers that are powers of two, and others",
     R"(
      input a : float[W, H];
      let place = coord(W, H).x + 7 * coord(W, H).y;
      let i = [-2147483647 - 1, -2147483647, 2147483647, -9, -8, -7, -1, 0, 1, 7, 8, 9][place % 12];
      let u = uint(i);
      let v = ivec2(i, 3 - i);
      step go { output quotients = ivec4(i / 2, i / 8, i / 1073741824, i / 1), rests = ivec4(i % 2, i % 8, i % 1073741824, i % 1),
                       others = ivec4(i / 3, i % 3, i / -8, i % -8), by_largest = i / (-2147483647 - 1),
                       unsigned_quotients = uvec4(u / 2u, u / 8u, u / 2147483648u, u / 3u),
                       unsigned_rests = uvec4(u % 2u, u % 8u, u % 2147483648u, u % 3u),
                       vectors = v / 4, unlike = v / ivec2(4, 8), rest = v % 16, zero = v / 0; })",
     {"go"},
     true},
    {"extents whose parts take more than 32 bits",
     R"(
      input a : float[W, H];
      let n = W * H * 2000000000 / 2000000011;
      let wide = coord(n).x;
      step go { output n, f = float(n), trips = reduce(sum, i in 0..n) { 1 }, width = wide.width, last = max(wide),
                       linear = W * 2000000000 / 2000000011, chosen = a.width * 1999999999 / 2000000011; })",
     {"go"},
     true},
    {"a reduce of a range of more than 2^31 ends after its most trips",
     R"(
      input a : float[W, H];
      let low = int(-2e9 + 0.0 * min(a));
      step go { output far = reduce(sum, i in low..-low, max = 7) { 1 }, none = reduce(sum, i in -low..low, max = 7) { 1 },
                       few = reduce(sum, i in low..low + 5, max = 7) { i - low },
                       folded = fold(i in low..-low, s = 0, max = 7) { s + 1 }; })",
     {"go"},
     true},
    {"argmin of whole numbers that no float tells apart",
     R"(
      input a : float[W, H];
      let n = int(min(a)) + 16777217;
      step go { output k = reduce(argmin, i in 0..6) { n + 40 - i }, tie = reduce(argmin, i in 0..6) { n + i / 3 },
                       u = reduce(argmin, i in 0..6) { 4294967295u - uint(n - 16777217) - uint(i) },
                       most = reduce(argmin, i in 0..6) { 2147483647 },
                       capped = reduce(argmin, i in 0..n, max = 6) { n + 40 - i }; })",
     {"go"},
     true},
    {"layers of functions of pictures of one column",
     R"(
      input a : float[W, H];
      fn next(x: float[A, B]) -> float[A, B] {
        let p = coord(A, B).xy;
        if p.x < A - 1 { x.at(p + ivec2(1, 0)) } else { 1.0 }
      }
      let known = next(a.at(coord(1, 1, 3)));
      step go { output sum = sum(known), layers = known.layers; })",
     {"go"},
     true},
    {"tables of a mesh's topology",
     R"(
      input a : float[W, H]; input face : ivec3[F];
      let t = topology(face, 4);
      step go { output e = t.edge, beside = t.edge_face, sides = t.face_edge, start = t.vertex_start,
                       corner = t.vertex_corner, closed = t.closed, count = t.edge.width; })",
     {"go"}},
    {"a gradient of the program's own",
     R"(
      input a : float[W, H];
      fn square(x: float) -> float { x * x }
      @vjp(square) fn square_vjp(x: float, g: float) -> float { 2.0 * x * g + 0.5 * g }
      step go { output d = grad(sum(if a > 0.25 { square(a) } else { 0.0 }), a); })",
     {"go"}},
    {"a gradient through a loop in a branch that names its own element",
     R"(
      input a : float[W, H];
      let low = min(a) < -1e9;
      let y = if low { 0.0 } else { tanh(reduce(sum, i in 0..3) { a.at(coord(W, H, 2)) }) };
      step go { output d = grad(sum(y), a); })",
     {"go"}},
    {"branches alike but for a number that stands elsewhere in them too",
     R"(
      input a : float[W, H];
      fn f(x: float, y: float) -> float {
        var s = x - y;
        for i in 0..24 { s = 1.5 * sin(s) - 0.25; }
        s
      }
      let more = a - 0.25;
      let one = if more > 0.1 { f(0.25, a) } else { 0.0 };
      let two = if more < 0.41 { f(more, a) } else { 0.0 };
      step go { output sum = one + two, more; })",
     {"go"}},
    {"neighbours of a row or a column, read where it is stretched",
     R"(
      input a : float[W, H];
      let row = a.at(ivec2(coord(W, 1).x, 0)) * 2.0; let column = a.at(ivec2(0, coord(1, H).y)) * 3.0;
      step go { output y = a + shift(row, -1, 0) * shift(column, 0, 1), z = a + shift(row, 0, 1) + shift(column, 1, 0); })",
     {"go"}},
    {"unsigned minima and maxima",
     R"(
      input a : float[W, H];
      let u = uint(a * 1000.0) + 3000000000u;
      fn low(u: uint[A, B]) -> uint { reduce(min, i in 0..A) { u.at(ivec2(i, 0)) } }
      fn high(u: uint[A, B]) -> uint { reduce(max, i in 0..A) { u.at(ivec2(i, 1)) } }
      step go { output low = low(u) / 1000u, high = high(u) / 1000u; })",
     {"go"}},
    {"a quotient by zero is infinite",
     R"(
      input a : float[W, H];
      step go { output inf = a / 0.0, both = vec2(a, -a) / vec2(0.0, 2.0), part = vec2(a, -a) / vec2(0.0, 2.0 + a); })",
     {"go"}},
    {"an output stays what its step saw",
     R"(
      input a : float[W, H];
      state p : float[W] = 1.0; state q : float[W] = 5.0;
      step look { output seen = p, sum = sum(a); }
      step swap { p <- q; q <- p; output other = q; })",
     {"look", "swap"}},
    {"a non-finite contribution spoils its own element only",
     R"(
      input a : float[W, H];
      let x = select(lessThan(vec2(a), vec2(0.3)), vec2(a), vec2(1.0) / vec2(0.0));
      step go { output sums = scatter_add(coord(W, H).x, x, W), fine = scatter_add(coord(W, H).y, a, H); })",
     {"go"}},
    {"regions, nested, with their gradients",
     R"(
      param w : vec2[V] = vec2(0.5, -0.25);
      input a : float[W, H];
      fn walk(w: vec2[V], x: float) -> float {
        reduce(sum, i in 0..6) { if x > 0.1 * float(i) { dot(w.at(i % 4), vec2(x, x * x)) * exp(-x) } else { w.at(3).x } }
      }
      fn steepest(w: vec2[V], x: float) -> float { reduce(max, i in 0..4) { w.at(i).x * float(i) + x } }
      let y = walk(w, a) + steepest(w, a);
      let total = mean(y * y);
      step go { output total, gradient = grad(total, w), y; })",
     {"go"}},
    {"loops that carry, with their gradients: states stored, and computed again from checkpoints",
     R"(
      param w : vec2[V] = vec2(0.5, -0.25);
      input a : float[W, H];
      fn stored(w: vec2[V], x: float) -> vec2 {
        var s = vec2(x, 0.25);
        var n = 0;
        for k in 0..V + 20, max = 24 {
          s = vec2(sin(s.y + 0.3 * w.at((k + n) % 4).x), 0.7 * s.x + w.at(k).y);
          if s.x > 0.2 { n += 1; s.y *= 0.9; }
          break if s.y < -0.3;
        }
        s * float(n + 1)
      }
      fn long(w: vec2[V], x: float, n: int) -> float {
        fold(k in 3..n, s = vec3(x, 1.0, 0.0)) {
          let t = 0.95 * s + 0.05 * vec3(sin(s.y), cos(3.0 * s.x), w.at(k % 4).y * s.x);
          break if t.y < -0.5;
          t
        }.y
      }
      fn nested(w: vec2[V], x: float) -> float {
        reduce(sum, i in 0..4) {
          fold(k in 0..i, s = x) { s * 0.5 + if s > 0.2 { fold(j in 0..k, t = s) { t * w.at(j).x } } else { w.at(i).y } }
        }
      }
      let y = stored(w, a);
      let z = long(w, a, 40 + int(900.0 * abs(a)));
      let total = mean(dot(y, y)) + mean(z) + mean(nested(w, a));
      let g = grad(mean(dot(y, y)), w);
      step go { output total, gradient = grad(total, w), y, z, second = grad(sum(dot(g, g)), w); })",
     {"go"}},
    {"scans: a loop that breaks, one along the columns of a picture, and one of a number that takes many trips",
     R"(
      param w : vec2[V] = vec2(0.5, -0.25);
      input a : float[W, H];
      struct Spring { at: vec2; speed: float; }
      let (n, s) = scan(k in 2..V + 9, max = 40, n = 1, s = Spring(vec2(0.1, 0.2), 0.0)) {
        break if s.speed > 0.9;
        (n + k, Spring(s.at + 0.1 * s.speed, 0.95 * s.speed + w.at(k % V).x - 0.4 * s.at.x))
      };
      fn along(a: float[W, H]) { scan(k in 0..H, s = vec2(0.0), max = 8) { vec2(0.9 * s.x + a.at(ivec2(coord(W).x, k)), s.x * s.y - 1e-6) } }
      let c = along(a);
      let t = scan(k in 0..70000, s = 1e-20 + 0.0 * w.at(0).y) { 0.9375 * s + 1e-9 * w.at(k % V).y };
      let total = mean(dot(c, c)) + mean(dot(s.at, s.at)) + 1e7 * mean(t);
      let g = grad(mean(dot(c, c)), a);
      step go { output total, n, at = s.at, c, late = t.at(69999), early = t.at(0), of_w = grad(total, w), of_a = g,
                       second = grad(sum(g * g), a); })",
     {"go"}},
    {"many outputs, layers and shifts",
     R"(
      input a : float[W, H];
      let c = float(coord(1, 1, 3).z) + 1.0;
      let b = a * c;
      let s = shift(b, 1, -1) + shift(b, -2, 0);
      step go { output o0 = b, o1 = s, o2 = b + s, o3 = vec3(b, s, a), o4 = sum(b, over = layers), o5 = max(b, over = x), o6 = min(s, over = y),
                o7 = b > s, o8 = int(b * 9.0), o9 = sum(s), o10 = mean(vec2(b, s)); })",
     {"go"}},
    // The fragment lowering keeps these in images, whole; the others keep two components in a word.
    {"float16 between passes: all there are, what lies in the middle of two, the floats around that, and beyond",
     R"(
      input a : float[W, H];
      let i = uint(coord(256, 256).x + 256 * coord(256, 256).y);
      let normal = uintBitsToFloat(i * 4096u + 947912704u + uvec3(4294967295u, 0u, 1u));  // from 2^-14 on
      let small = float(int(i)) * 9.31322574615478515625e-10;
      let (three, two, four, one) = (half(normal), half(vec2(small, -small)), half(vec4(-normal, small)), half(small));
      let nan = half(uintBitsToFloat(uvec2(2143289344u, 4290772992u) + i % 7u));
      let x = vec2(a, 1e6 + a);
      step between { output beside = 2.0 * shift(three, 1, 0), below = 2.0 * shift(two, 0, 1), four = 2.0 * shift(four, -1, 0),
                            one = 2.0 * shift(one, 0, -1), nan = isnan(shift(nan, 1, 0)),
                            gradient = grad(sum(dot(shift(half(x), 1, 0), vec2(3.0, 5.0))), a); }
      step whole { output three, two, four, one, most = max(three.x), least = min(two.y); })",
     {"between", "whole"},
     true},
    {"functions of bits and mantissas",
     R"(
      input a : float[W, H];
      let u = uint(a * 16777215.0) * 257u; let i = int(u);
      let (high, low) = umulExtended(u, 4000000007u); let (signed_high, signed_low) = imulExtended(i, -1000003);
      let (total, carry) = uaddCarry(u, uvec2(u, 4000000000u)); let (rest, borrow) = usubBorrow(u, 2000000000u);
      let (significand, exponent) = frexp(vec2(a * 1e-3, -1.0 / a)); let (part, whole) = modf(a * 9.0 - 4.0);
      step go { output u, i, high, low, signed_high, signed_low, total, carry, rest, borrow, significand, exponent, part, whole,
                counts = ivec3(bitCount(u), findLSB(i), findMSB(-i)), reversed = bitfieldReverse(u),
                extracted = ivec2(bitfieldExtract(i, 3, 7), bitfieldExtract(i, 25, 9)), inserted = bitfieldInsert(u, low, 7, int(u >> 27)),
                powers = ldexp(vec2(a), ivec2(coord(W, H).xy * 7 - 20)), bits = floatBitsToInt(vec2(a, -a)),
                floats = uintBitsToFloat((u >> 9) | 1065353216u), packed = packSnorm4x8(vec4(a, -a, 0.5, -3.0)),
                unpacked = unpackUnorm2x16(u); })",
     {"go"}},
    {"what is no number is known by its bits",
     R"(
      input a : float[W, H];
      let zero = a - a; let inf = a / zero; let nan = zero / zero;
      step go { output nans = vec4(isnan(vec4(a, inf, nan, -nan))), infs = vec4(isinf(vec4(a, inf, -inf, nan))),
                few = isnan(acosh(a)), atanhs = atanh(a * 0.9), asinhs = asinh(vec2(a, -1e6 * a)), acoshs = acosh(1.5 + a); })",
     {"go"}},
    {"a constant that is zero loses no NaN and no Inf",
     R"(
      input a : float[W, H];
      let zero = a - a; let inf = 1.0 / zero; let nan = inf - inf;
      let heavy = if a > 0.5 { exp(a) + pow(a, 2.5) + sin(3.0 * a) * cos(a) + atan(a, 2.0) + tanh(a) } else { 0.0 };
      step go { output product = inf * 0.0, other = vec2(0.0, 1.0) * nan, quotient = 0.0 / zero, along = dot(vec3(inf, nan, a), vec3(0.0, 0.0, 1.0)),
                larger = max(inf * 0.0, -1.0), sum = 0.0 * inf + 2.0, branch = nan * heavy, both = inf * heavy + a,
                at = scatter_add(coord(W, H).x, inf * heavy, W); })",
     {"go"}},
    {"places of floats that no integer holds",
     R"(
      input a : float[W, H];
      let f = if a > 0.5 { 1e30 } else { 3.0 * a };
      let i = min(max(int(f), 0) + 1, 6); let j = max(int(min(-f, 7.0)) - 1, 0); let k = clamp(int(f), 0, 5) + 1;
      step go { output i, j, k, one = a.at(ivec2(i, 0)), two = a.at(ivec2(j, 1)), three = a.at(ivec2(k, 2)); })",
     {"go"}},
    {"pictures halved, and by thirds, whose size data says",
     R"(
      input a : float[W, H];
      let last = ivec2(W, H) - 1;
      let p = coord((W + 1) / 2, (H + 1) / 2).xy;
      let half = a.at(min(2 * p + 1, last)); let third = a.at(min(3 * p + 1, last)); let beside = a.at(min(min(2 * p, last) + 1, last));
      step go { output half, third, back = grad(sum(half * half), a), thirds = grad(sum(third * third), a), other = grad(sum(beside * beside), a); })",
     {"go"}},
    {"refraction and other functions of vectors",
     R"(
      input a : float[W, H];
      param n : vec3 = vec3(0.0, 1.0, 0.0);
      let ray = normalize(vec3(a, -0.4, 0.2));
      let bent = refract(ray, n, 1.4);
      step go { output bent, gradient = grad(sum(bent.x), n), facing = faceforward(ray, n, ray), fused = fma(a, a, 1.0),
                product = matrixCompMult(mat2(vec2(a), vec2(1.0, a)), mat2(vec2(a, 2.0), vec2(3.0))); })",
     {"go"}},
    {"textures under every filter and wrap, with gradients",
     R"(
      input a : float[W, H];
      param w : vec2[V] = vec2(0.5, -0.25);
      let uv = vec2(detach(a), 1.0 - detach(a)) * 4.0 - 1.5 + 0.01 * w.at(1);
      let deep = a + float(coord(1, 1, 2).z);
      let lost = sample(a, uv / (a - a));
      let y = sample(a, uv) + 2.0 * sample(a, uv, wrap = repeat) + 3.0 * sample(a, uv, wrap = mirror) + 4.0 * sample(a, uv, wrap = zero);
      let z = sample(a, uv, filter = nearest) + 2.0 * sample(a, uv, filter = nearest, wrap = repeat)
            + 3.0 * sample(a, uv, filter = nearest, wrap = mirror) + 4.0 * sample(a, uv, filter = nearest, wrap = zero);
      fn walk(a: float[A, B], x: float) -> float { reduce(sum, i in 0..5) { if x > 0.3 { sample(a, vec2(0.25 * float(i), x)) } else { x } } }
      step go { output y, z, lost, layers = sample(deep, uv), layer = sample(deep, uv, layer = 1), walked = walk(a, a),
                to_texels = grad(y, a), to_places = grad(y * y, w); })",
     {"go"}},
    {"reductions of matrices, the largest of what lands",
     R"(
      input a : float[W, H];
      let m = mat2(vec2(a, 1.0), vec2(-a, a * a)) ;
      let c = coord(W, H);
      step go { output sums = sum(m), means = mean(m, over = x), least = min(m, over = y), largest = max(m),
                landed = scatter_max(c.x % 3, int(a * 100.0) - 50, 5), pairs = scatter_max(c.yx, ivec2(c.x, -c.y), H, W); })",
     {"go"}},
    {"random numbers are the same everywhere",
     R"(
      import std.random;
      input a : float[W, H];
      let p = coord(W, H, 3);
      step go { output bits = random.bits(p, 9), uniform = random.uniform4(p, 2), one = random.uniform(p, 0), die = random.integer(p, 1, 6),
                sobol = random.sobol(uint(p.x * 77), 3), scrambled = random.scrambled_sobol(uint(p.y * 1001), 1, 12345u), seed; })",
     {"go", "go"},
     true},
    {"normal numbers",
     R"(
      import std.random;
      input a : float[W, H];
      step go { output one = random.normal(coord(W, H), 0), all = random.normal4(coord(W, H), 1); })",
     {"go"}},
    {"leaves that are overwritten in place, and leaves that must not be",
     R"(
      input a : float[W, H];
      state p : float[W] = 1.0; state q : float[W] = 2.0; state r : float[W] = 3.0; state s : vec3[W, H] = vec3(1.0, 2.0, 3.0);
      let total = sum(a);
      step go {
        p <- p * 0.5 + total;
        q <- q.at(coord(W, 1).x + 1) + p;
        r <- r + q * total;
        s <- s * 0.5 + shift(s, 1, 0) * a;
        output sum_r = sum(r), old_q = q; }
      step look { output p1 = p, q1 = q, r1 = r, s1 = s; })",
     {"go", "go", "go", "look"}},
    {"counters",
     R"(
      input a : float[W, H];
      state n : int = 0;
      step go { n <- n + step_index; output n, index = step_index, sum = sum(a); })",
     {"go", "go", "go", "go"}},
    {"counters named first in a branch, in a loop and in a reduction",
     R"(
      input a : float[W, H];
      let branch = if a > 0.5 { float(step_index) * sin(a) } else { a };
      fn looped(x: float) -> float {
        var s = x;
        for k in 0..3 { s = 0.5 * s + float(step_index + k); }
        s
      }
      let loop = looped(a);
      step branches { output branch; }
      step loops { output loop; }
      step sums { output all = sum(if a > 0.25 { a * float(step_index) } else { 1.0 }); })",
     {"branches", "branches", "branches", "loops", "loops", "sums", "sums", "sums"}},
    {"library functions of what is very small or large, in units of about their answers",
     R"(
      import std.environment; import std.image; import std.light; import std.loss; import std.nn; import std.rig; import std.skin;
      import std.solve; import std.strands; import std.texture; import std.tone;
      input a : float[W, H];
      fn each(f: fn) { vec4(f(1e-20), f(1e-12), f(1e12), f(1e20)) }
      // Systems, and their gradients.
      param b : float[4] = [1.0, -2.0, 3.0, 0.5][coord(4).x];
      fn solved(s: float) -> float[1] {
        let x = solve.conjugate_gradients(fn(v) { s * float(coord(4).x + 1) * v }, s * b, 0.0 * b, 4);
        sum(x) + 2.0 * sum(grad(sum(x), b))
      }
      // Footprints, and what is read there.
      param dx : vec2 = vec2(1e20, 2e19);
      let levels = texture.pyramid(float(coord(16, 8).x + coord(16, 8).y), 4);
      let (along, wide) = texture.footprint(dx, vec2(0.0, 1.0));
      let (small, thin) = texture.footprint(vec2(1e-20, 1e-21), vec2(0.0, 1e-20));
      let read = texture.anisotropic(levels, vec2(0.3), dx, vec2(0.0, 1.0));
      // Lamps that end, pictures, colours, normals, mirrors.
      param range : float = 1e-20;
      let near = light.fade(vec3(0.0), vec3(0.0, 0.0, 0.5e-20), range);
      let p = float(1 + coord(4).x);
      param m : mat4[1] = mat4(vec4(1e-20, 1e-21, 0.0, 0.0), vec4(2e-21, 2e-20, 0.0, 0.0), vec4(0.0, 0.0, 3e-20, 0.0), vec4(0.0));
      let turned = rig.skinned_normal(vec3(0.3, -0.5, 0.81), ivec4(0), vec4(1.0, 0.0, 0.0, 0.0), m);
      // Skies for small alpha: slopes go to zero with it.
      param alpha : float = 1e-6;
      let q = vec2(coord(64, 32).xy);
      let sky = environment.prefilter_map(vec3(1.0 + sin(0.2 * q.x) * sin(0.1 * (q.y + 0.5))), alpha, 4, 2);
      // A ribbon far from the picture's corner, of a ten-thousandth of a pixel.
      param width : float = 1e-4;
      let clip = if coord(2).x == 0 { vec4(1100.3 / 1024.0 - 1.0, -0.4, 0.5, 1.0) } else { vec4(1900.1 / 1024.0 - 1.0, 0.3, 0.5, 1.0) };
      let hits = strands.rasterize(clip, strands.segments(1, 2), strands.strand_of(1, 2), width + 0.0 * float(coord(2).x), 2048, 8, nearest = 1);
      let ribbon = sum(strands.silhouette(hits));
      step go { output solved = each(solved), along = 1e-20 * along, wide, small = 1e20 * small, thin = 1e20 * thin, read,
                stretch = grad(along.x, dx), near, fading = 1e-20 * grad(near, range), far = light.fade(vec3(0.0), vec3(1e20), 2e20),
                gain = each(fn(s) { loss.gain(s * p, 2.0 * s * p).x }), variation = 1e-20 * image.total_variation(1e20 * p),
                tone = 1e-20 * tone.neutral(vec3(-1e20, 0.0, 0.0)), turned, turning = 1e-20 * grad(turned.x, m)[0],
                bands = nn.positional(0.0 * p.at(0) + 100.25, 22),
                mirrored = skin.highlights(vec3(0.0, 0.0, 1.0), light.directional(vec3(0.6, 0.0, 0.8)), vec3(0.0, 0.6, 0.8), vec2(0.3, 0.6), ior = 1e20),
                sky, slope = 1e4 * grad(sum(sky).x, alpha), ribbon, widening = 1e-2 * grad(ribbon, width), sum = sum(a); })",
     {"go"}},
    {"geometry with a far corner, far away, tiny, huge and all but degenerate",
     R"(
      import std.camera; import std.coverage; import std.mesh; import std.raster; import std.splat;
      input a : float[W, H];
      // A face that reaches far behind the picture, whichever corner stands first.
      let view = camera.perspective(60.0, aspect = 1.0, near = 0.05, far = 5000.0);
      let k = coord(3).x;
      let ground = camera.project(view, vec3([900.0, -0.1, 0.4][k], [-1350.0, -0.05, -0.2][k], [-3000.0, -0.2, -1.0][k]));
      fn seen(clip: vec4[3], first: ivec3, near: float[1]) -> float[1] {
        sum(if raster.rasterize(clip, first + 0 * coord(1), 16, 16, near = near, both_sides = true).face >= 0 { 1.0 } else { 0.0 })
      }
      let plain = vec4([-0.75, 0.75, 0.0][k], [-0.67, -0.67, 0.67][k], 0.5, 1.0);
      // A ball far from the origin.
      let ball = mesh.icosphere_position(1) + vec3(16.0, 8.0, -16.0);
      // A point beside a needle, and above triangles of any size.
      let p = vec3(-0.4034748673439026, -0.9766222238540649, 0.6601250767707825);
      let needle = vec3([-1.5775264501571655, -0.39386510848999023, -0.15240220725536346][k],
                        [1.0375118255615234, -0.9931095242500305, -1.4073508977890015][k],
                        [1.85595703125, 0.6503342986106873, 0.4043911099433899][k]);
      param above : vec3 = vec3(0.25, 0.25, 0.1);
      fn square(s: float) -> float[1] {
        mesh.triangle_distance_squared(s * above, vec3(0.0), vec3(s, 0.0, 0.0), vec3(0.0, s, 0.0)) / s / s
      }
      param q : vec2 = vec2(-0.67287095, -0.54615317);
      let bent = camera.undistort(q, vec3(0.0), vec2(0.0), vec3(-0.4717206, 0.32280002, 0.38420743));
      param point : vec3[3] = vec3(1.0);
      let one_face = ivec3(0, 1, 2) + 0 * coord(1);
      step go { output far = seen(ground, ivec3(0, 1, 2), 0.001), rolled = seen(ground, ivec3(1, 2, 0), 0.001),
                area = sum(coverage.silhouette(ground, one_face, mesh.neighbours_of(one_face), 16, 16)),
                tiny = seen(1e-16 * plain, ivec3(0, 1, 2), 1e-19), huge = seen(1e16 * plain, ivec3(0, 1, 2), 1e13),
                volume = mesh.volume(ball, mesh.icosphere_face(1)), needle = 10.0 * mesh.distance_to(p, needle, one_face),
                squares = vec4(square(1e-8), square(1e-12), square(1e7), square(1e10)), slope = grad(square(1e-10), above),
                bent, bending = grad(bent.x, q), even = mesh.edge_variation(point, one_face), evening = grad(mesh.edge_variation(point, one_face), point),
                even_huge = mesh.edge_variation(1e19 * plain.xyz, one_face), looks = camera.look_at(vec3(1.0, 2.0, 3.0), vec3(0.0), 1e20 * vec3(1.0, 0.3, 0.0)),
                flat = 1e-7 * splat.precision(vec3(1e-7, 0.0, 2e-7), least = 0.0), sum = sum(a); })",
     {"go"}},
    {"orders of faces, in place and elsewhere, of several ranks and layers",
     R"(input a : float[W, H];
      // The last one begins where the others do, and the third is seen nowhere.
      fn order(const ranks: int) {
        raster(5, W, H, 2, nearest = ranks) {
          setup(f) -> vec4 { vec4([0.0, 1.0, 2.0, 0.0, -1.0][f], [0.0, 1.0, 9.0, 0.0, 2.0][f], [0.25, 0.5, 0.0, 0.25, 2.0][f], 0.0) }
          corner(s, c) -> vec2 { [s.xy, s.xy + vec2(12.0, 0.0), s.xy + vec2(0.0, 12.0)][c] }
          depth(s, p) -> float { s.z - 0.0625 * floor(p.x) }
          keep(s, p) -> bool { s.y < 5.0 && p.x > s.x && p.y > s.y && (s.z < 2.0 || p.x < 3.0) && p.x < 6.0 }
          tag(s, p) -> int { int(p.y) }
        }
      }
      let one = order(1)[0];
      let three = order(3);
      let beside = one.order.at(coord(W, H, 2) + ivec3(1, -1, 0));
      let depth = (float(one.order) + 0.5) / 16777215.0;
      step go { output orders = array(3, fn(k) { three[k].order }), faces = three[2].face, tags = three[1].tag, nearest = one.order,
                       apart = one.order - three[0].order; }
      step read { output beside, near = if three[1].order < 8000000 { three[1].order } else { -three[2].order }, sum = sum(one.order % 1000); }
      step rounded { output far = depth > 0.99, same = abs(depth - 0.25 + 0.0625 * float(coord(W, H).x)) < 1e-6; })",
     {"go", "read", "rounded"},
     true},
    {"large faces that a step moves, as they were before",
     R"(input a : float[W, H];
      param shift : vec2[50] = 2.0;
      struct T { at: vec2; size: float; }
      let seen = raster(50, 64, 32, 1) {
        setup(f) -> T { T(vec2(8.0, 0.0) + shift, 14.25) }
        corner(s, c) -> vec2 { [s.at, s.at + vec2(s.size, 0.25), s.at + vec2(0.25, s.size)][c] }
        depth(s, p) -> float { 0.5 }
      }[0];
      step go { shift <- shift + 1.5; output s = sum(if seen.face >= 0 { 1 } else { 0 }), o = seen.order, b = sum(a * 0.0); })",
     {"go", "go", "go"},
     true},
    {"gradients of matrices in a branch, one with Inf",
     R"(input a : float[W, H];
      param few : mat3[5] = mat3(1.0);
      param many : mat4[1500] = mat4(1.0);
      let p = coord(W, H).xy;
      let w = if p.x == 3 && p.y == 2 { 1.0 / (a - a) } else { 1.0 };
      let y = if a > 0.25 {
        w * few.at(p.x % 5)[0].x + few.at(p.x % 5)[2].z + w * many.at(p.x)[0].x + many.at(p.x)[3].w
      } else { 0.0 };
      step go { output to_few = grad(sum(y), few), to_many = grad(sum(y), many); })",
     {"go"}},
};

constexpr int kWidth = 7, kHeight = 5;

Array input() {
  std::vector<float> values;
  for (int k = 0; k < kWidth * kHeight; ++k) values.push_back(0.5f + 0.5f * std::sin(static_cast<float>(k * k)));
  return Array::from_floats(values, 1, kWidth, kHeight, 1);
}

template <class P>
void run(P& program, const Case& c, bool has_v) {
  must(program.bind("a", input()));
  if (std::string_view(c.text).find("ivec3[F]") != std::string_view::npos)
    must(program.bind("face", Array::from_ints(std::array<int32_t, 6>{0, 1, 2, 2, 1, 3}, 3)));
  if (has_v) must(program.bind_symbol("V", 4));
  for (const char* step : c.steps) must(program.run(step));
}

}  // namespace

TEST_CASE("small programs give the evaluator's answer on every device and lowering") {
  const auto all = test::devices();
  const std::string path = (std::filesystem::path(DR_BUILD_DIR) / "small_program.dr").string();
  for (const Case& c : kCases) {
    std::ofstream(path) << "edition 1;\n" << c.text;
    const bool has_v = std::string(c.text).find("[V]") != std::string::npos;
    INFO(c.name);
    jit::Options options;
    options.profile = "lavapipe";
    auto reference = must(jit::ReferenceProgram::load(test::compile(path, options)));
    run(reference, c, has_v);
    for (const auto& [name, device] : all)
      for (const char* lower : {"fragment", "compute"})
        for (const char* pack : {"fused", "naive", "subpasses"}) {
          // Subpasses are the fragment lowering's; one op a pass is the same in both.
          if (std::string(lower) == "fragment" ? std::string(pack) == "naive" : std::string(pack) == "subpasses")
            continue;
          INFO(name << " " << lower << " " << pack);
          options.lower = lower;
          options.raster = std::string(lower) == "fragment" ? "hardware" : "compute";
          const bool subpasses = std::string(pack) == "subpasses";
          options.profile = subpasses ? test::profile_of_subpasses(name) : name;
          options.pack = subpasses ? "fused" : pack;
          options.ablate = subpasses ? std::vector<std::string>{"substages", "remat"} : std::vector<std::string>{};
          auto program = must(runtime::Program::load(device, test::compile(path, options)));
          run(program, c, has_v);
          for (const std::string& step : program.steps())
            for (const std::string& output : program.outputs(step)) {
              INFO(step << "." << output);
              const auto found = must(program.output(step, output)).to_doubles(),
                         expected = must(reference.output(step, output)).to_doubles();
              REQUIRE(found.size() == expected.size());
              for (size_t k = 0; k < found.size(); ++k) {
                const bool same_special = (std::isnan(found[k]) && std::isnan(expected[k])) || found[k] == expected[k];
                if (c.exact && found[k] != expected[k])
                  CHECK(found[k] == expected[k]);  // a check costs, and some are millions
                if (!same_special)
                  CHECK(std::fabs(found[k] - expected[k]) <= 1e-5 * std::max(1.0, std::fabs(expected[k])));
              }
            }
          for (const std::string& message : device.validation_messages()) FAIL("validation: " << message);
        }
  }
}

TEST_CASE("what is divided by Inf is zero to tests of it, by the driver's divisions too") {
  const char* const text = R"(edition 1;
    param x : float = 1e20;
    fn steep(y: float) -> float { y }
    @vjp(steep) fn steep_vjp(y: float, g: float) -> float { if g != 0.0 { g * exp2(y) } else { 0.0 } }
    let w = 1.0 / (1.0 + x * x);
    step go { output w, is_zero = w == 0.0, slope = grad(atan(exp2(x)), x), own = grad(atan(steep(x)), x); })";
  for (auto& [name, device] : test::devices()) {
    INFO(name);
    jit::Options options;
    options.profile = name;
    options.float_profile = "native";
    const std::string path = (std::filesystem::path(DR_BUILD_DIR) / "native_zero.dr").string();
    std::ofstream(path) << text;
    auto program = must(runtime::Program::load(device, test::compile(path, options)));
    must(program.run("go"));
    for (const auto& [output, value] : {std::pair{"w", 0}, {"is_zero", 1}, {"slope", 0}, {"own", 0}}) {
      INFO(output);
      CHECK(must(program.output("go", output)).to_doubles()[0] == value);
    }
  }
}
