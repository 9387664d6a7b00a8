// SPDX-License-Identifier: Apache-2.0
// GLSL of sums that are rounded once. A float is a whole number of 2^-149, of 277 bits; a sum has a signed 64-bit
// integer, a bin, for each 32 of them. A float adds its 24 bits to the bin of the lowest, less than 2^55. Where that
// overflows, once in 2^8 times at most, the next bin gets 2^32, and so on; the last one gets nothing else, and has room
// for 2^39 floats. What is done for each term has no branches (see compiler/ops/prelude.h).
// Behind kFixedShift of fixed_point.h.
#pragma once

namespace dr::backend::glsl {

inline constexpr const char* kBins = R"(
// The bin that a float adds to.
int bin_of(float value) { return int(max(finite_magnitude(value) >> 23, 1u) - 1u) >> 5; }

// What it adds there, as a 64-bit integer; 0 for one that is not finite.
uvec2 in_bin(float value) {
  uint magnitude = finite_magnitude(value);
  uint mantissa = (magnitude & 0x7fffffu) | (magnitude >= 0x800000u ? 0x800000u : 0u);
  uint left = (max(magnitude >> 23, 1u) - 1u) & 31u;
  uint low = mantissa << left, high = (mantissa >> 1) >> (31u - left);
  uint minus = 0u - (floatBitsToUint(value) >> 31);
  low = (low ^ minus) - minus;
  high = (high ^ minus) + (minus & uint(low == 0u));
  return uvec2(low, high);
}

// What the next bin gets where such an integer overflows one.
uvec2 bin_overflow(uvec2 part) { return uvec2(0u, 1u - 2u * (part.y >> 31)); }
)";

// A shader that reads bins takes the sum through them twice, from the lowest, and once beyond the last: for its sign,
// which is that of what is carried in the end, then for its digits.
inline constexpr const char* kBinsToFloat = R"(
// The digit of a sum, of 32 bits, where a bin begins, what it carries, and the bin's high word, which belongs to the
// next digit.
uvec3 bin_digit(uvec3 before, uvec2 bin) {
  uint sum = bin.x + before.z, digit = sum + before.y;
  uint carry = uint(sum < bin.x) + uint(digit < sum) - (before.z >> 31) - (before.y >> 31);
  return uvec3(digit, carry, bin.y);
}

// Where a sum is negative, `minus` is all ones. Of the digits of its magnitude, of 32 bits, so far: `top` is the
// highest that is not 0 and stands at bit `place`, `next` the one below, `rest` not 0 where those below are not;
// `last` is the last one, `under` not 0 where those before it are not, `one` what negation carries.
struct BinDigits {
  uvec3 sum;
  uint minus, one, top, next, rest, last, under;
  int place;
};

BinDigits bin_digits(uint minus) { return BinDigits(uvec3(0u, 0u, 0u), minus, minus & 1u, 0u, 0u, 0u, 0u, 0u, 0); }

BinDigits with_bin(BinDigits all, uvec2 bin, int place) {
  all.sum = bin_digit(all.sum, bin);
  uint digit = (all.sum.x ^ all.minus) + all.one;
  bool is_top = digit != 0u;
  all.one = is_top ? 0u : all.one;
  all.top = is_top ? digit : all.top;
  all.next = is_top ? all.last : all.next;
  all.rest = is_top ? all.under : all.rest;
  all.place = is_top ? place : all.place;
  all.under |= all.last;
  all.last = digit;
  return all;
}

// The nearest float, of two the even one. `flags` of what was not finite.
float bins_to_float(BinDigits all, uint flags) {
  int first = max(findMSB(all.top), 0);
  uint left = uint(31 - first);
  uint high = (all.top << left) | ((all.next >> 1) >> (31u - left));
  uint below = ((high & 0xffu) << 1) | uint(((all.next << left) | all.rest) != 0u);
  uint mantissa = high >> 8;
  mantissa += uint(below + (mantissa & 1u) > 0x100u);
  int spare = all.place + first - 23;
  uint bits = min((uint(max(spare, 0)) << 23) + mantissa, 0x7f800000u);
  bits = (spare < 0 ? all.top : bits) | (all.minus & 0x80000000u);
  bits = flags == 0u ? bits : flags == 1u ? 0x7f800000u : flags == 2u ? 0xff800000u : 0x7fc00000u;
  return uintBitsToFloat(bits);
}
)";

}  // namespace dr::backend::glsl
