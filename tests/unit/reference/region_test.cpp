// SPDX-License-Identifier: Apache-2.0
// If and Reduce, alone and in each other, and what they scatter.
#include <cmath>

#include "tests/catch.h"
#include "tests/unit/reference/support.h"

namespace dr::reference_test {
namespace {

TEST_CASE("if takes each element's branch, captures stretch") {
  const Images out =
      run(R"(
    leaf x : float[W, H] input
    leaf y : vec2[W] input
    %0 : float[W, H] = leaf text "x"
    %1 : vec2[W] = leaf text "y"
    %2 : float = const floats [0]
    %3 : bool[W, H] = lt %2, %0
    %4 : float[W, H], %5 : vec2[W, H] = if %3 dims [W, H, 1] yields [element, element] {
      %6 : float[W, H] = log2 %0
      yield %6, %1
    } {
      %7 : vec2[W, H] = splat %0 ints [2]
      yield %2, %7
    }
    step s {
      output a %4
      output b %5
    })",
          {{"x", image("float", 2, 2, 1, {8, -1, -2, 2})}, {"y", image("vec2", 2, 1, 1, {10, 20, 30, 40})}});
  CHECK(out.at("a").data == Numbers{3, 0, 0, 1});
  CHECK(out.at("b").data == Numbers{10, -1, -2, 20, 30, -1, -2, 40});
}

TEST_CASE("if with the same condition everywhere") {
  const std::string_view text = R"(
    leaf c : bool input
    leaf x : float[W] input
    %0 : bool = leaf text "c"
    %1 : float[W] = leaf text "x"
    %2 : float = const floats [7]
    %3 : float[W] = if %0 dims [W, 1, 1] yields [element] {
      yield %1
    } {
      yield %2
    }
    step s {
      output r %3
    })";
  CHECK(result(text, {{"c", row("bool", {1})}, {"x", row("float", {1, 2, 3})}}).data == Numbers{1, 2, 3});
  CHECK(result(text, {{"c", row("bool", {0})}, {"x", row("float", {1, 2, 3})}}).data == Numbers{7, 7, 7});
}

TEST_CASE("reduce folds over ranges that differ from element to element") {
  const std::string_view text = R"(
    leaf begin : int[N] input
    leaf end : int[N] input
    leaf x : float[V] input
    %0 : int[N] = leaf text "begin"
    %1 : int[N] = leaf text "end"
    %2 : float[V] = leaf text "x"
    %3 : float[N], %4 : float[N], %5 : float[N], %6 : int[N] = reduce %0, %1 ints [-1] dims [N, 1, 1] yields [sum, min, max, argmin] (%7 : int[N]) {
      %8 : float[N] = gather %2, %7
      yield %8, %8, %8, %8
    }
    step s {
      output sum %3
      output min %4
      output max %5
      output argmin %6
    })";
  const Images out = run(text, {{"begin", row("int", {0, 3, 1, 5, -2})},
                                {"end", row("int", {6, 3, 4, 6, 1})},
                                {"x", row("float", {4, 2, 8, 2, 1, 9})}});
  CHECK(out.at("sum").data == Numbers{26, 0, 12, 9, 4});
  CHECK(out.at("min").data == Numbers{1, kInfinity, 2, 9, 0});
  CHECK(out.at("max").data == Numbers{9, -kInfinity, 8, 9, 4});
  // Ties go to the first; an empty range gives begin - 1.
  CHECK(out.at("argmin").data == Numbers{4, 2, 1, 5, -2});
}

TEST_CASE("minima skip NaN, and argmin finds an infinity") {
  const std::string_view text = R"(
    leaf x : float[V] input
    %0 : float[V] = leaf text "x"
    %1 : int = const floats [0]
    %2 : int = dim dims [V]
    %3 : float, %4 : int = reduce %1, %2 ints [-1] dims [1, 1, 1] yields [min, argmin] (%5 : int) {
      %6 : float = gather %0, %5
      yield %6, %6
    }
    step s {
      output min %3
      output argmin %4
    })";
  Images out = run(text, {{"x", row("float", {kNaN, 3, kNaN, 2})}});
  CHECK(out.at("min").data == Numbers{2});
  CHECK(out.at("argmin").data == Numbers{3});
  out = run(text, {{"x", row("float", {kNaN, kInfinity, kInfinity})}});
  CHECK(out.at("min").data == Numbers{kInfinity});
  CHECK(out.at("argmin").data == Numbers{1});
  out = run(text, {{"x", row("float", {kNaN, kNaN})}});
  CHECK(out.at("argmin").data == Numbers{-1});
}

TEST_CASE("integers reduce within 32 bits") {
  const Images out = run(R"(
    leaf x : int[V] input
    %0 : int[V] = leaf text "x"
    %1 : int = const floats [0]
    %2 : int = dim dims [V]
    %3 : int, %4 : int, %5 : int = reduce %1, %2 ints [-1] dims [1, 1, 1] yields [sum, min, max] (%6 : int) {
      %7 : int = gather %0, %6
      yield %7, %7, %7
    }
    %8 : int, %9 : int = reduce %1, %1 ints [-1] dims [1, 1, 1] yields [min, max] (%10 : int) {
      yield %10, %10
    }
    step s {
      output sum %3
      output min %4
      output max %5
      output none_min %8
      output none_max %9
    })",
                         {{"x", row("int", {2147483647, 2, -9})}});
  CHECK(out.at("sum").data == Numbers{-2147483656.0 + 4294967296.0});
  CHECK(out.at("min").data == Numbers{-9});
  CHECK(out.at("max").data == Numbers{2147483647});
  CHECK(out.at("none_min").data == Numbers{2147483647});
  CHECK(out.at("none_max").data == Numbers{-2147483648.0});
}

TEST_CASE("a reduce over an image larger than a batch") {
  // A box filter: every element has the same range, and the trip number is one for all.
  constexpr int64_t kSize = 64;
  Image x = reference::zeros(ir::kFloat, kSize, kSize, 2);
  for (size_t i = 0; i < x.data.size(); ++i) x.data[i] = static_cast<double>(i % 17);
  const Image r = result(R"(
    leaf x : float[W, H, L] input
    %0 : float[W, H, L] = leaf text "x"
    %1 : int = const floats [-1]
    %2 : int = const floats [2]
    %3 : int[W, H, L] = coord ints [0] dims [W, H, L]
    %4 : int[W, H, L] = coord ints [1] dims [W, H, L]
    %5 : float[W, H, L] = reduce %1, %2 ints [3] dims [W, H, L] yields [sum] (%6 : int) {
      %7 : float[W, H, L] = reduce %1, %2 ints [3] dims [W, H, L] yields [sum] (%8 : int) {
        %9 : int[W, H, L] = add %3, %8
        %10 : int[W, H, L] = add %4, %6
        %11 : ivec2[W, H, L] = compose %9, %10 ints [2, 1]
        %12 : float[W, H, L] = gather %0, %11
        yield %12
      }
      yield %7
    }
    step s {
      output r %5
    })",
                         {{"x", x}});
  bool right = true;
  for (int64_t l = 0; l < 2; ++l) {
    for (int64_t y = 0; y < kSize; ++y) {
      for (int64_t px = 0; px < kSize; ++px) {
        double sum = 0;
        for (int64_t dy = -1; dy < 2; ++dy) {
          for (int64_t dx = -1; dx < 2; ++dx) {
            const int64_t u = px + dx, v = y + dy;
            if (u >= 0 && u < kSize && v >= 0 && v < kSize) sum += x.at(u, v, l, 0);
          }
        }
        right &= r.at(px, y, l, 0) == sum;
      }
    }
  }
  CHECK(right);
}

TEST_CASE("regions nest") {
  // For each n: the sum over i < n of (i even ? the smallest of i*j, j in 1..4 : -i)
  const Image r = result(R"(
    leaf n : int[N] input
    %0 : int[N] = leaf text "n"
    %1 : int = const floats [0]
    %2 : int = const floats [2]
    %3 : int = const floats [1]
    %4 : int = const floats [4]
    %5 : int[N] = reduce %1, %0 ints [-1] dims [N, 1, 1] yields [sum] (%6 : int) {
      %7 : int = mod %6, %2
      %8 : bool = eq %7, %1
      %9 : int[N] = if %8 dims [N, 1, 1] yields [element] {
        %10 : int[N] = reduce %3, %4 ints [-1] dims [N, 1, 1] yields [min] (%11 : int) {
          %12 : int = mul %6, %11
          yield %12
        }
        yield %10
      } {
        %13 : int = neg %6
        yield %13
      }
      yield %9
    }
    step s {
      output r %5
    })",
                         {{"n", row("int", {0, 1, 2, 3, 4, 5, 900})}});
  Numbers expected;
  for (double n : {0, 1, 2, 3, 4, 5, 900}) {
    double sum = 0;
    for (int i = 0; i < n; ++i) sum += i % 2 == 0 ? i : -i;
    expected.push_back(sum);
  }
  CHECK(r.data == expected);
}

TEST_CASE("region results that nothing needs, and yields that are captured") {
  const Images out = run(R"(
    leaf x : float[W] input
    %0 : float[W] = leaf text "x"
    %1 : int = const floats [0]
    %2 : int = const floats [3]
    %3 : float[W], %4 : int[W] = reduce %1, %2 ints [-1] dims [W, 1, 1] yields [sum, sum] (%5 : int) {
      %6 : float[W] = sqrt %0
      yield %0, %5
    }
    step s {
      output a %3
      output b %4
    })",
                         {{"x", row("float", {1, 2})}});
  CHECK(out.at("a").data == Numbers{3, 6});
  CHECK(out.at("b").data == Numbers{3, 3});
}

TEST_CASE("if scatters from the branches taken") {
  const Images out = run(R"(
    leaf i : int[N] input
    leaf v : float[N] input
    %0 : int[N] = leaf text "i"
    %1 : float[N] = leaf text "v"
    %2 : float = const floats [0]
    %3 : int = const floats [-1]
    %4 : bool[N] = lt %2, %1
    %5 : float[3], %6 : float[N] = if %4 dims [N, 1, 1, 3, 1, 1] yields [scatter, element] {
      yield %0, %1, %1
    } {
      yield %3, %2, %2
    }
    step s {
      output sums %5
      output element %6
    })",
                         {{"i", row("int", {0, 2, 0, 1, 7})}, {"v", row("float", {1, 2, 4, -8, 16})}});
  CHECK(out.at("sums").data == Numbers{5, 0, 2});
  CHECK(out.at("element").data == Numbers{1, 2, 4, 0, 16});
}

TEST_CASE("reduce scatters, and forwards what scatters inside it") {
  // Element e adds 1 at (i, own layer) for i < n[e], and 100 at (e, 0) of the inner image for odd i.
  const Images out = run(R"(
    leaf n : int[N, 1, 2] input
    %0 : int[N, 1, 2] = leaf text "n"
    %1 : int = const floats [0]
    %2 : int = const floats [2]
    %3 : float = const floats [1]
    %4 : float = const floats [100]
    %5 : int[N, 1, 2] = coord ints [0] dims [N, 1, 2]
    %6 : float[4, 1, 2], %7 : float[N], %8 : int[N, 1, 2] = reduce %1, %0 ints [-1] dims [N, 1, 2, 4, 1, 2, N, 1, 1] yields [scatter, scatter, sum] (%9 : int) {
      %10 : int = mod %9, %2
      %11 : bool = ne %10, %1
      %12 : accumulation float[N] = if %11 dims [N, 1, 2, N, 1, 1] yields [scatter] {
        %13 : accumulation float[N] = reduce %1, %2 ints [-1] dims [N, 1, 2, N, 1, 1] yields [scatter] (%14 : int) {
          yield %5, %4
        }
        yield %13
      } {
        yield %9, %3
      }
      yield %9, %3, %12, %10
    }
    step s {
      output layers %6
      output inner %7
      output odd %8
    })",
                         {{"n", image("int", 3, 1, 2, {3, 0, 1, 5, 2, 0})}});
  CHECK(out.at("layers").data == Numbers{2, 1, 1, 0, 2, 2, 1, 1});
  // Trips with even i add 1 at i: from layer 0 element 0: i = 0, 2; element 2: 0; layer 1: 0, 2, (4: outside) and 0.
  // Trips with odd i add 200 at e: layer 0 element 0: i = 1; layer 1 element 0: 1, 3; element 1: 1.
  CHECK(out.at("inner").data == Numbers{200 + 400 + 4, 200, 2});
  CHECK(out.at("odd").data == Numbers{1, 0, 0, 2, 1, 0});
}

TEST_CASE("scatters of many elements arrive once each") {
  // So many that tasks cannot log them all.
  constexpr int64_t kWidth = 5000;
  Image i = reference::zeros(ir::kInt, kWidth, 1, 1);
  for (int64_t x = 0; x < kWidth; ++x) i.at(x, 0, 0, 0) = static_cast<double>(x % 7);
  const Image r = result(R"(
    leaf i : int[N] input
    %0 : int[N] = leaf text "i"
    %1 : int = const floats [0]
    %2 : int = const floats [1500]
    %3 : vec2 = const floats [1, 0.5]
    %4 : vec2[7] = reduce %1, %2 ints [-1] dims [N, 1, 1, 7, 1, 1] yields [scatter] (%5 : int) {
      yield %0, %3
    }
    step s {
      output r %4
    })",
                         {{"i", i}});
  for (int c = 0; c < 2; ++c) {
    for (int64_t x = 0; x < 7; ++x) {
      CHECK(r.at(x, 0, 0, c) == static_cast<double>((kWidth - x + 6) / 7 * 1500) * (c == 0 ? 1 : 0.5));
    }
  }
}

TEST_CASE("sources inside regions") {
  const Images out = run(R"(
    leaf x : float[W, H] input
    %0 : float[W, H] = leaf text "x"
    %1 : float = const floats [0]
    %2 : bool[W, H] = lt %0, %1
    %3 : int[W, H], %4 : int[W, H], %5 : vec2[W, H] = if %2 dims [W, H, 1] yields [element, element, element] {
      %6 : int[W, H] = coord ints [1] dims [W, H, 1]
      %7 : int = dim dims [W + H]
      %8 : vec2 = const floats [1, 2]
      yield %6, %7, %8
    } {
      %9 : int[W] = coord ints [0] dims [W, 1, 1]
      %10 : int[W] = coord ints [1] dims [W, 1, 1]
      %11 : vec2 = const floats [3, 4]
      yield %9, %10, %11
    }
    step s {
      output a %3
      output b %4
      output c %5
    })",
                         {{"x", image("float", 2, 2, 1, {-1, 1, 1, -1})}});
  CHECK(out.at("a").data == Numbers{0, 1, 0, 1});
  CHECK(out.at("b").data == Numbers{4, 0, 0, 4});
  CHECK(out.at("c").data == Numbers{1, 3, 3, 1, 2, 4, 4, 2});
}

}  // namespace
}  // namespace dr::reference_test
