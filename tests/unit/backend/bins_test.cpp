// SPDX-License-Identifier: Apache-2.0
// The GLSL of sums in bins, compiled as C++ beside a few names of GLSL, against whole numbers of 2^-149 of any size:
// 100,000 sums, each in two orders and split among ranks whose bins are added.
#include "compiler/backend/analysis/bins.h"

#include <algorithm>
#include <array>
#include <bit>
#include <random>
#include <vector>

#include "tests/catch.h"
#include "tests/exact_sum.h"
#include "tests/sanitized.h"

namespace dr::backend::glsl {

using uint = uint32_t;
struct uvec2 {
  uint x = 0, y = 0;
  uvec2(uint low, uint high) : x(low), y(high) {}
};
struct uvec3 {
  uint x = 0, y = 0, z = 0;
};
static uint floatBitsToUint(float x) { return std::bit_cast<uint>(x); }
static float uintBitsToFloat(uint x) { return std::bit_cast<float>(x); }
static int findMSB(uint x) { return 31 - std::countl_zero(x); }
static uint min(uint a, uint b) { return std::min(a, b); }
static uint max(uint a, uint b) { return std::max(a, b); }
static int max(int a, int b) { return std::max(a, b); }
// Of fixed_point.h, for finite ones.
static uint finite_magnitude(float x) { return floatBitsToUint(x) & 0x7fffffffu; }

}  // namespace dr::backend::glsl

#include "bins_as_code.h"

namespace {

namespace glsl = dr::backend::glsl;

using Bins = std::array<int64_t, dr::backend::kBins>;

glsl::uvec2 words_of(int64_t bin) {
  return {static_cast<uint32_t>(bin), static_cast<uint32_t>(static_cast<uint64_t>(bin) >> 32)};
}

// As emit/binned_sums.cpp does.
void add(Bins& bins, float x) {
  glsl::uvec2 part = glsl::in_bin(x);
  for (auto bin = static_cast<size_t>(glsl::bin_of(x));; ++bin) {
    const auto wide = static_cast<int64_t>(uint64_t{part.x} | uint64_t{part.y} << 32);
    if (!__builtin_add_overflow(bins.at(bin), wide, &bins.at(bin))) return;
    part = glsl::bin_overflow(part);
  }
}

// Of other ranks: bins add up, whatever their order.
void add(Bins& bins, const Bins& others) {
  for (size_t k = 0; k < bins.size(); ++k) {
    int64_t part = others[k];
    for (size_t bin = k; __builtin_add_overflow(bins.at(bin), part, &bins.at(bin)); ++bin)
      part = part < 0 ? -(int64_t{1} << 32) : int64_t{1} << 32;
  }
}

uint32_t rounded(const Bins& bins) {
  glsl::uvec3 sum{};
  for (const int64_t bin : bins) sum = glsl::bin_digit(sum, words_of(bin));
  sum = glsl::bin_digit(sum, {0, 0});
  glsl::BinDigits digits = glsl::bin_digits(static_cast<uint32_t>(static_cast<int32_t>(sum.y) >> 31));
  int place = 0;
  for (const int64_t bin : bins) digits = glsl::with_bin(digits, words_of(bin), place), place += 32;
  return std::bit_cast<uint32_t>(glsl::bins_to_float(glsl::with_bin(digits, {0, 0}, place), 0));
}

uint32_t sum_in_bins(std::span<const float> terms) {
  Bins bins{};
  for (const float x : terms) add(bins, x);
  return rounded(bins);
}

}  // namespace

TEST_CASE("sums in bins are rounded once, in any order and from any ranks") {
  std::mt19937 random(11);
  for (int k = 0; k < dr::repeats(100000); ++k) {
    std::vector<float> terms = dr::test::wild_terms(random);
    const uint32_t truth = dr::test::rounded_sum(terms);
    REQUIRE(sum_in_bins(terms) == truth);
    std::ranges::shuffle(terms, random);
    REQUIRE(sum_in_bins(terms) == truth);
    std::array<Bins, 5> ranks{};
    Bins all{};
    for (const float x : terms) add(ranks[random() % ranks.size()], x);
    for (const Bins& rank : ranks) add(all, rank);
    REQUIRE(rounded(all) == truth);
  }
}

TEST_CASE("bins that overflow carry") {
  std::mt19937 random(12);
  for (int k = 0; k < 20; ++k) {
    std::vector<float> terms;
    for (int i = 0; i < 5000; ++i)  // of the two highest bits of bin k % 8, most of one sign
      terms.push_back(std::ldexp(
          (i % 64 == 0 ? -1.0F : 1.0F) * (k < 10 ? 1.0F : -1.0F) * std::uniform_real_distribution<float>(1, 2)(random),
          32 * (k % 8) + 30 - 126 - i % 2));
    CHECK(sum_in_bins(terms) == dr::test::rounded_sum(terms));
  }
  Bins many{};
  for (int k = 0; k < 24; ++k) {  // 2^24 times that, by doubling
    Bins before = many;
    if (k == 0) add(many, 0x1.fffffep127F);
    add(many, before);
  }
  CHECK(rounded(many) == 0x7f800000U);
  for (const float x : {-0x1.fffffep127F, 0x1p-149F}) {
    Bins other{};
    for (int k = 0; k < 24; ++k) {
      Bins before = other;
      if (k == 0) add(other, x);
      add(other, before);
    }
    add(many, other);
  }
  CHECK(rounded(many) == std::bit_cast<uint32_t>(0x1p-126F));  // 2^23 of the least
}
