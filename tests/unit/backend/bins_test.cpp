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

namespace dr::backend::glsl {

using uint = uint32_t;
struct uvec2 {
  uint x = 0, y = 0;
  uvec2(uint low, uint high) : x(low), y(high) {}
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
  const glsl::uvec2 part = glsl::in_bins(x), words = glsl::bins_magnitude(part);
  const auto bin = static_cast<size_t>(glsl::bin_of(x));
  const int64_t sign = part.y >> 31 != 0 ? -1 : 1;
  if (words.x != 0) bins[bin] += sign * words.x;
  if (words.y != 0) bins.at(bin + 1) += sign * words.y;
}

uint32_t rounded(const Bins& bins) {
  glsl::uvec2 sum(0, 0);
  for (const int64_t bin : bins) sum = glsl::bin_carried(words_of(bin), sum);
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
  for (int k = 0; k < 100000; ++k) {
    std::vector<float> terms = dr::test::wild_terms(random);
    const uint32_t truth = dr::test::rounded_sum(terms);
    REQUIRE(sum_in_bins(terms) == truth);
    std::ranges::shuffle(terms, random);
    REQUIRE(sum_in_bins(terms) == truth);
    std::array<Bins, 5> ranks{};
    Bins all{};
    for (const float x : terms) add(ranks[random() % ranks.size()], x);
    for (const Bins& rank : ranks)
      for (size_t b = 0; b < all.size(); ++b) all[b] += rank[b];
    REQUIRE(rounded(all) == truth);
  }
}

TEST_CASE("bins hold 2^31 of the largest floats") {
  Bins bins{};
  constexpr int64_t kMany = int64_t{1} << 31;
  for (const float x : {0x1.fffffep127F, 0x1p-149F}) {
    Bins one{};
    add(one, x);
    for (size_t b = 0; b < bins.size(); ++b) bins[b] += kMany * one[b];
  }
  CHECK(rounded(bins) == 0x7f800000U);
  for (int64_t& bin : bins) bin = -bin;
  CHECK(rounded(bins) == 0xff800000U);
}
