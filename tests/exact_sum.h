// SPDX-License-Identifier: Apache-2.0
// Sums of floats by whole numbers as long as they need, rounded once to the nearest float, of two the even one; and
// terms that are hard to add.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <random>
#include <span>
#include <vector>

namespace dr::test {

// A sum of floats as a magnitude and a sign, in whole numbers of 2^-149: bit by bit, slow and plain. Inf and NaN are no
// part of it: flags tell of them.
class ExactSum {
 public:
  void add(float x) {
    if (x == 0 || !std::isfinite(x)) return;
    int exponent = 0;
    auto mantissa = static_cast<uint32_t>(std::ldexp(std::frexp(std::fabs(x), &exponent), 24));
    int place = exponent - 24 + 149;
    for (; place < 0; ++place) mantissa >>= 1;  // a subnormal's lowest bits are 0
    Bits term{};
    for (int k = 0; k < 24; ++k) term[static_cast<size_t>(place + k)] = ((mantissa >> k) & 1u) != 0;
    if ((x < 0) == negative_) {
      bits_ = added(bits_, term);
    } else if (less(bits_, term)) {
      bits_ = subtracted(term, bits_);
      negative_ = !negative_;
    } else {
      bits_ = subtracted(bits_, term);
    }
  }

  uint32_t rounded() const {
    int top = kBits - 1;
    while (top >= 0 && !bits_[static_cast<size_t>(top)]) --top;
    if (top < 0) return 0;
    const int drop = std::max(top - 23, 0);
    uint32_t mantissa = 0;
    for (int k = top; k >= drop; --k) mantissa = 2 * mantissa + (bits_[static_cast<size_t>(k)] ? 1 : 0);
    bool rest = false;
    for (int k = 0; k < drop - 1; ++k) rest = rest || bits_[static_cast<size_t>(k)];
    if (drop > 0 && bits_[static_cast<size_t>(drop - 1)] && (rest || mantissa % 2 == 1)) ++mantissa;
    const double value = std::ldexp(static_cast<double>(mantissa), drop - 149);
    const float most = 0x1.fffffep127F;
    const float nearest = value > most ? INFINITY : static_cast<float>(value);
    return std::bit_cast<uint32_t>(negative_ ? -nearest : nearest);
  }

 private:
  static constexpr int kBits = 320;
  using Bits = std::array<bool, kBits>;

  static Bits added(const Bits& a, const Bits& b) {
    Bits out{};
    int carry = 0;
    for (size_t k = 0; k < kBits; ++k) {
      const int sum = int{a[k]} + int{b[k]} + carry;
      out[k] = sum % 2 == 1;
      carry = sum / 2;
    }
    return out;
  }
  static Bits subtracted(const Bits& a, const Bits& b) {
    Bits out{};
    int borrow = 0;
    for (size_t k = 0; k < kBits; ++k) {
      const int difference = int{a[k]} - int{b[k]} - borrow;
      out[k] = difference % 2 != 0;
      borrow = difference < 0 ? 1 : 0;
    }
    return out;
  }
  static bool less(const Bits& a, const Bits& b) {
    return std::lexicographical_compare(a.rbegin(), a.rend(), b.rbegin(), b.rend());
  }

  Bits bits_{};
  bool negative_ = false;
};

inline uint32_t rounded_sum(std::span<const float> terms) {
  ExactSum sum;
  for (const float x : terms) sum.add(x);
  return sum.rounded();
}

// Up to 24 terms: of all exponents, or of neighbouring ones, subnormal or the largest; many sums cancel all but the
// lowest bits, lie half way between two floats, or just beside that, or beyond the largest float.
inline std::vector<float> wild_terms(std::mt19937& random) {
  const auto bits = [&] { return static_cast<uint32_t>(random()); };
  const auto below = [&](uint32_t n) { return static_cast<int>(bits() % n); };
  const int way = below(6);
  const int centre = way == 0 ? 1 : way == 1 ? 254 : way == 2 ? 1 + below(30) : 1 + below(254);
  const int spread = way == 5 ? 254 : 1 + below(way < 3 ? 4 : 60);
  std::vector<float> out(static_cast<size_t>(1 + below(24)));
  for (float& x : out) {
    const int exponent = std::clamp(centre + below(static_cast<uint32_t>(2 * spread)) - spread, 0, 254);
    // Few bits, so that sums lie half way.
    const uint32_t mantissa = below(3) == 0 ? bits() & 0x700000u : bits() & 0x7fffffu;
    x = std::bit_cast<float>((static_cast<uint32_t>(exponent) << 23) | mantissa | (bits() & 0x80000000u));
  }
  if (below(3) == 0) {  // what cancels
    const size_t n = out.size();
    for (size_t k = 0; k < n; ++k) out.push_back(-out[k]);
    for (int k = below(4); k > 0; --k) out.push_back(out[static_cast<size_t>(below(static_cast<uint32_t>(n)))]);
  }
  if (below(3) == 0) {  // half a unit of the sum's last place, and perhaps a little more or less
    const auto sum = std::bit_cast<float>(rounded_sum(out));
    if (std::isfinite(sum)) {
      const float half = std::ldexp(std::nextafter(std::fabs(sum), INFINITY) - std::fabs(sum), -1);
      if (std::isfinite(half)) out.push_back(below(2) == 0 ? half : -half);
      if (below(2) == 0) out.push_back(below(2) == 0 ? 0x1p-149F : -0x1p-149F);
    }
  }
  std::ranges::shuffle(out, random);
  return out;
}

}  // namespace dr::test
