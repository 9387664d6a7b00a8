// SPDX-License-Identifier: Apache-2.0
#include "tests/device/accuracy/verdicts.h"

// Code for wider vectors beside that for any processor; both compute the same bits.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__)
#define DR_VECTOR_CLONES __attribute__((target_clones("avx2", "default")))
#else
#define DR_VECTOR_CLONES
#endif

namespace dr::accuracy {

namespace {

// finite_float: what is smaller rounds to a finite number.
constexpr double kBeyond = 0x1.ffffffp127;

// In the order of the numbers, from 0 on.
int64_t bits_of(double x) { return std::bit_cast<int64_t>(x); }
uint64_t when(bool condition) { return static_cast<uint64_t>(condition); }
double at_most(double x, double most) { return x < most ? x : most; }
double at_least(double x, double least) { return x < least ? least : x; }
// ulp_of(size) and 1 / ulp_of(size), for sizes from 2^-126 on.
uint64_t exponent_of(double size) { return std::bit_cast<uint64_t>(size) & 0x7ff0000000000000u; }
double last_place(double size) { return std::bit_cast<double>(exponent_of(size)) * 0x1p-23; }
double places_in_one(double size) { return std::bit_cast<double>((uint64_t{2046 + 23} << 52) - exponent_of(size)); }

}  // namespace

// The loops are small, for the compiler to make vector code of each.
DR_VECTOR_CLONES void Verdicts::judge(const Asked& asked, const Elements& elements) {
  const float* const found = elements.found;
  const uint64_t* const inside = elements.inside;
  const double *const expected = elements.expected, *const value = elements.value, *const scale = elements.scale,
                      *const bound = elements.bound, *const except = elements.except;
  const double room = asked.derivative ? 0x1p7 : 1, least = room * 0x1p-126;
  const double widens = asked.promised ? 1 : 0;
  const uint64_t sums = when(asked.derivative || asked.has_scale), smooth = when(asked.derivative && !asked.exact);

  // error_of
  for (size_t i = 0; i < kBatch; ++i) {
    const double plain_f = static_cast<double>(found[i]), plain_e = expected[i], s = scale[i];
    const double f = at_most(at_least(plain_f, -0x1p128), 0x1p128), e = at_most(at_least(plain_e, -0x1p128), 0x1p128);
    const double off = std::abs(f - e), size = std::abs(e);
    const double terms = std::abs(s) <= DBL_MAX ? at_least(s, 0) : 0;
    const double places = off * places_in_one(at_most(at_least(at_least(size, terms), 0x1p-126), double{FLT_MAX}));
    const uint64_t nothing = (when(size < least) & when(std::abs(f) <= least)) | (when(s > 0) & when(off <= 0x1p-124));
    const uint64_t nan_f = when(plain_f != plain_f), nan_e = when(plain_e != plain_e);
    const double number = nothing != 0 ? 0.0 : places;
    error[i] = (nan_f | nan_e) == 0 ? number : (nan_f & nan_e) != 0 ? 0.0 : HUGE_VAL;
  }
  // judge_one
  uint64_t counts = 0, specials = 0, left = 0, bads = 0;
  for (size_t i = 0; i < kBatch; ++i) {
    const double size = std::abs(expected[i]), v = std::abs(value[i]);
    const double off = std::abs(bound[i]) <= DBL_MAX ? widens * (bound[i] * last_place(at_least(size, 0x1p-126))) : 0;
    const uint64_t finite = when(std::abs(static_cast<double>(found[i])) <= double{FLT_MAX});
    const uint64_t in_range =
        when(std::abs(room * (size + off)) < kBeyond) & when(std::abs(scale[i]) < kBeyond) & when(v < kBeyond);
    const uint64_t excepted = when(except[i] != 0) | (smooth & when(v != 0) & when(v < 0x1p-126));
    const uint64_t bad = (finite ^ 1) & in_range;
    const uint64_t is_special = (bad ^ 1) & ((inside[i] ^ 1) | excepted);
    const uint64_t is_left_out = (bad ^ 1) & (is_special ^ 1) & (in_range ^ 1) & sums;
    const uint64_t counts_here = (is_special | is_left_out) ^ 1;
    counted[i] = counts_here;
    error[i] = counts_here == 0 ? 0.0 : bad != 0 ? HUGE_VAL : error[i];
    bads += bad, specials += is_special, left += is_left_out, counts += counts_here;
  }
  count = counts, special = specials, left_out = left, not_finite = bads;
  int64_t most = 0, most_share = 0, most_at_share = 0;
  for (size_t i = 0; i < kBatch; ++i) most = std::max(most, bits_of(error[i]));
  worst = std::bit_cast<double>(most), worst_share = at_share = 0;
  share.fill(0);
  if (most == 0) return;
  for (size_t i = 0; i < kBatch; ++i) {
    const double quotient = error[i] == 0 ? 0.0 : error[i] / bound[i];
    share[i] = quotient < HUGE_VAL ? quotient : HUGE_VAL;  // Inf of Inf too
  }
  for (size_t i = 0; i < kBatch; ++i) most_share = std::max(most_share, bits_of(share[i]));
  for (size_t i = 0; i < kBatch; ++i)
    most_at_share = std::max(most_at_share, bits_of(share[i]) == most_share ? bits_of(error[i]) : 0);
  worst_share = std::bit_cast<double>(most_share), at_share = std::bit_cast<double>(most_at_share);
}

}  // namespace dr::accuracy
