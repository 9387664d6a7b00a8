// SPDX-License-Identifier: Apache-2.0
// Sources, element-wise ops and whole-image ops of the root, against images computed by hand.
#include <cmath>

#include "tests/catch.h"
#include "tests/unit/reference/support.h"

namespace dr::reference_test {
namespace {

// 1 2 3      11 12 13
// 4 5 6      14 15 16
Image two_layers() { return image("float", 3, 2, 2, {1, 2, 3, 4, 5, 6, 11, 12, 13, 14, 15, 16}); }

TEST_CASE("element-wise ops stretch axes of extent 1") {
  const Image r = result(R"(
    leaf a : float[W, H, L] input
    leaf b : float[W] input
    leaf c : float[1, 1, L] input
    leaf d : float input
    %0 : float[W, H, L] = leaf text "a"
    %1 : float[W] = leaf text "b"
    %2 : float[1, 1, L] = leaf text "c"
    %3 : float = leaf text "d"
    %4 : float[W, H, L] = add %0, %1
    %5 : float[W, 1, L] = mul %1, %2
    %6 : float[W, H, L] = add %4, %5
    %7 : float[W, H, L] = add %6, %3
    step s {
      output r %7
    })",
                         {{"a", two_layers()},
                          {"b", row("float", {100, 200, 300})},
                          {"c", image("float", 1, 1, 2, {0, 1})},
                          {"d", row("float", {0.5})}});
  CHECK(r.width == 3);
  CHECK(r.height == 2);
  CHECK(r.layers == 2);
  CHECK(r.data == Numbers{101.5, 202.5, 303.5, 104.5, 205.5, 306.5, 211.5, 412.5, 613.5, 214.5, 415.5, 616.5});
}

TEST_CASE("element-wise ops on vectors keep their planes apart") {
  // Wider than a batch, so that the planes have to be cut.
  constexpr int64_t kWidth = 70000;
  Image a = reference::zeros(ir::vec(3), kWidth, 1, 1);
  for (int64_t x = 0; x < kWidth; ++x) {
    for (int c = 0; c < 3; ++c) a.at(x, 0, 0, c) = static_cast<double>(x) + 0.25 * c;
  }
  const Images out = run(R"(
    leaf a : vec3[V] input
    leaf b : vec3 input
    %0 : vec3[V] = leaf text "a"
    %1 : vec3 = leaf text "b"
    %2 : vec3[V] = mul %0, %1
    %3 : float[V] = dot %2, %1
    %4 : float[V] = extract %2 ints [2]
    step s {
      output mul %2
      output dot %3
      output z %4
    })",
                         {{"a", a}, {"b", image("vec3", 1, 1, 1, {1, 2, 3})}});
  bool right = true;
  for (int64_t x = 0; x < kWidth; ++x) {
    for (int c = 0; c < 3; ++c) right &= out.at("mul").at(x, 0, 0, c) == a.at(x, 0, 0, c) * (c + 1);
    right &= out.at("dot").at(x, 0, 0, 0) == a.at(x, 0, 0, 0) + 4 * a.at(x, 0, 0, 1) + 9 * a.at(x, 0, 0, 2);
    right &= out.at("z").at(x, 0, 0, 0) == 3 * a.at(x, 0, 0, 2);
  }
  CHECK(right);
}

TEST_CASE("sources") {
  const Images out = run(R"(
    leaf a : float[W, H, L] input
    %0 : int[W, H, L] = coord ints [0] dims [W, H, L]
    %1 : int[W, H, L] = coord ints [1] dims [W, H, L]
    %2 : int[W, H, L] = coord ints [2] dims [W, H, L]
    %3 : int = dim dims [W * H - 7]
    %4 : vec2 = const floats [0.5, -2]
    step s {
      output x %0
      output y %1
      output l %2
      output dim %3
      output const %4
    })",
                         {{"a", two_layers()}});
  CHECK(out.at("x").data == Numbers{0, 1, 2, 0, 1, 2, 0, 1, 2, 0, 1, 2});
  CHECK(out.at("y").data == Numbers{0, 0, 0, 1, 1, 1, 0, 0, 0, 1, 1, 1});
  CHECK(out.at("l").data == Numbers{0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1});
  CHECK(out.at("dim").data == Numbers{-1});
  CHECK(out.at("const").data == Numbers{0.5, -2});
  CHECK(out.at("const").count() == 1);
}

TEST_CASE("gather with one number reads a row") {
  CHECK(result(R"(
    leaf x : float[V] input
    leaf i : int[N] input
    %0 : float[V] = leaf text "x"
    %1 : int[N] = leaf text "i"
    %2 : float[N] = gather %0, %1
    step s {
      output r %2
    })",
               {{"x", row("float", {10, 20, 30})}, {"i", row("int", {2, 0, -1, 3, 2147483647})}})
            .data == Numbers{30, 10, 0, 0, 0});
}

TEST_CASE("gather stays in its layer, or in the only one") {
  const std::string_view text = R"(
    leaf x : float[W, H, L] input
    leaf one : vec2[W, H] input
    leaf i : ivec2[N, 1, L] input
    %0 : float[W, H, L] = leaf text "x"
    %1 : vec2[W, H] = leaf text "one"
    %2 : ivec2[N, 1, L] = leaf text "i"
    %3 : float[N, 1, L] = gather %0, %2
    %4 : vec2[N, 1, L] = gather %1, %2
    step s {
      output own %3
      output only %4
    })";
  const Images out = run(text, {{"x", two_layers()},
                                {"one", image("vec2", 3, 2, 1, {1, 2, 3, 4, 5, 6, -1, -2, -3, -4, -5, -6})},
                                {"i", image("ivec2", 2, 1, 2, {2, 0, 1, 0, 1, 0, 1, 2})}});
  // (2, 1) and (0, 0) in layer 0, (1, 1) and (0, 2) in layer 1.
  CHECK(out.at("own").data == Numbers{6, 1, 15, 0});
  CHECK(out.at("only").data == Numbers{6, 1, 5, 0, -6, -1, -5, 0});
}

TEST_CASE("gather with three numbers names the layer") {
  CHECK(result(R"(
    leaf x : float[W, H, L] input
    leaf i : ivec3[N] input
    %0 : float[W, H, L] = leaf text "x"
    %1 : ivec3[N] = leaf text "i"
    %2 : float[N] = gather %0, %1
    step s {
      output r %2
    })",
               {{"x", two_layers()}, {"i", image("ivec3", 4, 1, 1, {0, 2, 1, 1, 0, 1, 0, 0, 0, 1, 2, -1})}})
            .data == Numbers{1, 16, 0, 0});
}

TEST_CASE("scatter_add sums, drops what is outside, and stays in its layer") {
  const Images out = run(R"(
    leaf i : int[N] input
    leaf v : vec2[N] input
    leaf j : ivec2[N, 1, L] input
    leaf k : ivec3[N] input
    leaf n : int input
    %0 : int[N] = leaf text "i"
    %1 : vec2[N] = leaf text "v"
    %2 : ivec2[N, 1, L] = leaf text "j"
    %3 : ivec3[N] = leaf text "k"
    %4 : int = leaf text "n"
    %5 : vec2[3] = scatter_add %0, %1 dims [3, 1, 1]
    %6 : float = const floats [1]
    %7 : float[2, 2, L] = scatter_add %2, %6 dims [2, 2, L]
    %8 : float[2, 2] = scatter_add %2, %6 dims [2, 2, 1]
    %9 : float[2, 1, 2] = scatter_add %3, %6 dims [2, 1, 2]
    %10 : int[2] = scatter_add %0, %4 dims [2, 1, 1]
    step s {
      output sums %5
      output layers %7
      output flat %8
      output named %9
      output wrapped %10
    })",
                         {{"i", row("int", {0, 2, 0, 3})},
                          {"v", image("vec2", 4, 1, 1, {1, 2, 4, 8, 10, 20, 40, 80})},
                          {"j", image("ivec2", 4, 1, 2, {0, 1, 1, -1, 0, 0, 0, 0, 0, 0, 1, 0, 1, 1, 1, 2})},
                          {"k", image("ivec3", 4, 1, 1, {0, 1, 1, 0, 0, 0, 0, 0, 0, 1, 1, 2})},
                          {"n", row("int", {2000000000})}});
  CHECK(out.at("sums").data == Numbers{5, 0, 2, 50, 0, 20});
  CHECK(out.at("layers").data == Numbers{1, 1, 0, 1, 0, 0, 3, 0});
  CHECK(out.at("flat").data == Numbers{1, 1, 3, 1});
  CHECK(out.at("named").data == Numbers{1, 0, 0, 2});
  CHECK(out.at("wrapped").data == Numbers{4000000000.0 - 4294967296.0, 0});
}

TEST_CASE("scatter_max is 0 only where nothing lands") {
  CHECK(result(R"(
    leaf i : int[N] input
    leaf v : int[N] input
    %0 : int[N] = leaf text "i"
    %1 : int[N] = leaf text "v"
    %2 : int[4] = scatter_max %0, %1 dims [4, 1, 1]
    step s {
      output r %2
    })",
               {{"i", row("int", {0, 0, 1, 1, 9, 3})}, {"v", row("int", {3, 7, -5, -2, 100, 0})}})
            .data == Numbers{7, -2, 0, 0});
}

TEST_CASE("shift has a border of zeros") {
  const std::string_view text = R"(
    leaf x : float[W, H, L] input
    %0 : float[W, H, L] = leaf text "x"
    %1 : float[W, H, L] = shift %0 ints [1, 0]
    %2 : float[W, H, L] = shift %0 ints [-2, 1]
    %3 : float[W, H, L] = shift %0 ints [0, -5]
    %4 : float[W, H, L] = shift %0 ints [7, 0]
    step s {
      output right %1
      output left %2
      output far %3
      output wide %4
    })";
  const Images out = run(text, {{"x", two_layers()}});
  CHECK(out.at("right").data == Numbers{2, 3, 0, 5, 6, 0, 12, 13, 0, 15, 16, 0});
  CHECK(out.at("left").data == Numbers{0, 0, 4, 0, 0, 0, 0, 0, 14, 0, 0, 0});
  CHECK(out.at("far").data == Numbers(12, 0.0));
  CHECK(out.at("wide").data == Numbers(12, 0.0));
}

TEST_CASE("reductions take away the flagged axes") {
  const Images out = run(R"(
    leaf x : float[W, H, L] input
    %0 : float[W, H, L] = leaf text "x"
    %1 : float = reduce_sum %0 ints [1, 1, 1]
    %2 : float[1, H, L] = reduce_sum %0 ints [1, 0, 0]
    %3 : float[W, 1, L] = reduce_sum %0 ints [0, 1, 0]
    %4 : float[W, H] = reduce_sum %0 ints [0, 0, 1]
    %5 : float[1, H] = reduce_sum %0 ints [1, 0, 1]
    %6 : float[W] = reduce_min %0 ints [0, 1, 1]
    %7 : float[1, 1, L] = reduce_max %0 ints [1, 1, 0]
    step s {
      output all %1
      output x %2
      output y %3
      output l %4
      output xl %5
      output min %6
      output max %7
    })",
                         {{"x", two_layers()}});
  CHECK(out.at("all").data == Numbers{102});
  CHECK(out.at("x").data == Numbers{6, 15, 36, 45});
  CHECK(out.at("y").data == Numbers{5, 7, 9, 25, 27, 29});
  CHECK(out.at("l").data == Numbers{12, 14, 16, 18, 20, 22});
  CHECK(out.at("xl").data == Numbers{42, 60});
  CHECK(out.at("min").data == Numbers{1, 2, 3});
  CHECK(out.at("max").data == Numbers{6, 16});
}

TEST_CASE("a sum's rounding error grows with the logarithm of its length") {
  constexpr int64_t kWidth = 1 << 17, kHeight = 8;
  Image x = reference::zeros(ir::kFloat, kWidth, kHeight, 1);
  for (double& v : x.data) v = 0.1;
  const Image r = result(R"(
    leaf x : float[W, H] input
    %0 : float[W, H] = leaf text "x"
    %1 : float = reduce_sum %0 ints [1, 1, 1]
    step s {
      output r %1
    })",
                         {{"x", x}});
  CHECK(std::abs(r.data[0] / (0.1 * kWidth * kHeight) - 1) < 1e-15);
}

TEST_CASE("sums of integers wrap, extremes skip NaN") {
  const Images out = run(R"(
    leaf i : int[N] input
    leaf u : uint[N] input
    leaf x : vec2[N] input
    %0 : int[N] = leaf text "i"
    %1 : uint[N] = leaf text "u"
    %2 : vec2[N] = leaf text "x"
    %3 : int = reduce_sum %0 ints [1, 0, 0]
    %4 : uint = reduce_sum %1 ints [1, 0, 0]
    %5 : vec2 = reduce_min %2 ints [1, 0, 0]
    %6 : vec2 = reduce_max %2 ints [1, 0, 0]
    %7 : int = reduce_max %0 ints [1, 0, 0]
    step s {
      output int %3
      output uint %4
      output min %5
      output max %6
      output imax %7
    })",
                         {{"i", row("int", {2147483647, 1, 5})},
                          {"u", row("uint", {4294967295, 3, 0})},
                          {"x", image("vec2", 3, 1, 1, {kNaN, 2, 1, kNaN, kNaN, kNaN})}});
  CHECK(out.at("int").data == Numbers{-2147483643});
  CHECK(out.at("uint").data == Numbers{2});
  CHECK(out.at("min").data == Numbers{1, kInfinity});
  CHECK(out.at("max").data == Numbers{2, -kInfinity});
  CHECK(out.at("imax").data == Numbers{2147483647});
}

TEST_CASE("broadcast stretches") {
  CHECK(result(R"(
    leaf x : vec2[1, H] input
    %0 : vec2[1, H] = leaf text "x"
    %1 : vec2[2, H, 2] = broadcast %0 dims [2, H, 2]
    step s {
      output r %1
    })",
               {{"x", image("vec2", 1, 2, 1, {1, 2, 3, 4})}})
            .data == Numbers{1, 1, 2, 2, 1, 1, 2, 2, 3, 3, 4, 4, 3, 3, 4, 4});
}

}  // namespace
}  // namespace dr::reference_test
