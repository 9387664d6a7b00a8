// SPDX-License-Identifier: Apache-2.0
// GLSL of sums that do not depend on order: 64-bit fixed point numbers in two 32-bit words, low and high. What is done
// for each term has no branches (see compiler/ops/prelude.h).
#pragma once

namespace dr::backend::glsl {

// 64-bit integers and their two words, low and high.
inline constexpr const char* kWide = R"(
uint64_t wide_of(uvec2 words) { return uint64_t(words.x) | uint64_t(words.y) << 32; }
uvec2 words_of(uint64_t wide) { return uvec2(uint(wide), uint(wide >> 32)); }
)";

// A sum of at most 2^bits floats of magnitude `largest` and below cannot overflow when each is scaled by 2^shift.
inline constexpr const char* kFixedShift = R"(
int fixed_shift(uint largest, int bits) { return 62 - bits - (int(largest >> 23) - 126); }

// Bits of the magnitude of a finite float, which order as the magnitudes do; 0 for others.
uint finite_magnitude(float value) {
  uint magnitude = floatBitsToUint(value) & 0x7fffffffu;
  return magnitude < 0x7f800000u ? magnitude : 0u;
}
)";

inline constexpr const char* kFixedFromFloat = R"(
// A float times 2^shift, rounded; 0 for one that is not finite.
uvec2 fixed_from_float(float value, int shift) {
  uint bits = floatBitsToUint(value);
  uint magnitude = finite_magnitude(value);
  uint mantissa = (magnitude & 0x7fffffu) | (magnitude >= 0x800000u ? 0x800000u : 0u);
  int by = max(int(magnitude >> 23), 1) - 150 + shift;
  uint left = uint(max(by, 0)), right = uint(clamp(-by, 1, 25));
  uint moved = mantissa << (left & 31u), carried = (mantissa >> 1) >> (31u - (left & 31u));
  uint rounded = (mantissa + (1u << (right - 1u))) >> right;
  uint low = by < 0 ? rounded : moved;
  low = by >= 32 ? 0u : low;
  uint high = by >= 32 ? moved : carried;
  uint minus = 0u - (bits >> 31);
  low = (low ^ minus) - minus;
  high = (high ^ minus) + (minus & uint(low == 0u));
  return uvec2(low, high);
}

// 1 for +Inf, 2 for -Inf, 3 for NaN, which is also what both together make; 0 for a finite float.
uint special_flag(float value) {
  uint bits = floatBitsToUint(value), magnitude = bits & 0x7fffffffu;
  uint infinite = 1u + (bits >> 31);
  uint flag = magnitude > 0x7f800000u ? 3u : infinite;
  return magnitude < 0x7f800000u ? 0u : flag;
}
)";

inline constexpr const char* kFixedAdd = R"(
uvec2 fixed_add(uvec2 a, uvec2 b) {
  uint low = a.x + b.x;
  return uvec2(low, a.y + b.y + (low < a.x ? 1u : 0u));
}

// Divided by 2^by and rounded; `by` >= 0.
uvec2 fixed_halved(uvec2 a, int by) {
  int cut = clamp(by, 1, 63), within = cut & 31;
  uint bit = 1u << ((cut - 1) & 31);
  uvec2 b = fixed_add(a, uvec2(cut > 32 ? 0u : bit, cut > 32 ? bit : 0u));
  uint high = uint(int(b.y) >> within), low = (b.x >> within) | ((b.y << 1) << (31 - within));
  uint fill = uint(int(b.y) >> 31);
  b = uvec2(cut >= 32 ? high : low, cut >= 32 ? fill : high);
  b = by > 63 ? uvec2(0u) : b;
  return by == 0 ? a : b;
}
)";

// Two limbs, of which a few contributions can be added apart without a carry: `low` has `bits` bits and a sign.
inline constexpr const char* kFixedLimbs = R"(
// A finite float times 2^shift, rounded as fixed_from_float() does; less than 2^(2 * bits).
ivec2 limbs_from_float(float value, int shift, uint bits) {
  uint word = floatBitsToUint(value), exponent = (word >> 23) & 255u;
  uint mantissa = (word & 0x7fffffu) | (exponent != 0u ? 0x800000u : 0u);
  int by = max(int(exponent), 1) - 150 + shift;
  uint left = uint(max(by, 0)), right = uint(clamp(-by, 0, 25));
  uint rounded = (mantissa + ((1u << right) >> 1)) >> right;
  ivec2 limbs = ivec2((rounded << left) & ((1u << bits) - 1u), rounded >> (bits - left));
  return (word >> 31) != 0u ? -limbs : limbs;
}

// The magnitude's bits from which on a float times 2^shift has no limbs; Inf and NaN have none.
uint least_without_limbs(int shift, uint bits) { return uint(clamp(127 + 2 * int(bits) - shift, 0, 255)) << 23; }

uvec2 fixed_of_limbs(ivec2 limbs, uint bits) {
  uint low = uint(limbs.x), high = uint(limbs.y) << bits;
  uint sum = low + high;
  return uvec2(sum, uint(limbs.x >> 31) + uint(limbs.y >> (32u - bits)) + uint(sum < low));
}
)";

inline constexpr const char* kFixedMinus = R"(
uvec2 fixed_minus(uvec2 a, uvec2 b) { return uvec2(a.x - b.x, a.y - b.y - uint(a.x < b.x)); }
)";

inline constexpr const char* kFixedSubgroup = R"(
// The sum over the lanes that are here, 128 at most: three parts that cannot overflow 32 bits, but for the last, whose
// overflow is that of the whole.
uvec2 fixed_subgroup_add(uvec2 a) {
  uint low = subgroupAdd(a.x & 0xffffffu);
  uint middle = subgroupAdd((a.x >> 24) | ((a.y & 0xffffu) << 8));
  uint high = subgroupAdd(a.y >> 16);
  middle += low >> 24;
  return uvec2((low & 0xffffffu) | (middle << 24), (middle >> 8) + (high << 16));
}
)";

inline constexpr const char* kFixedToFloat = R"(
// 2^e for any e that a float can hold, without a rounding step of its own.
float power_of_two(int e) { return uintBitsToFloat(uint(clamp(e, -126, 127) + 127) << 23); }

// The nearest float of a fixed point number: its top 24 bits, the rest rounded half up. `flags` of what was not finite.
float fixed_to_float(uvec2 number, int shift, uint flags) {
  float value = flags == 0u ? 0.0 : uintBitsToFloat(flags == 1u ? 0x7f800000u : flags == 2u ? 0xff800000u : 0x7fc00000u);
  if (flags == 0u && (number.x | number.y) != 0u) {
    uint low = number.x, high = number.y;
    bool negative = (high >> 31) != 0u;
    if (negative) { low = ~low + 1u; high = ~high + (low == 0u ? 1u : 0u); }
    int top = high != 0u ? findMSB(high) + 32 : findMSB(low);
    int drop = max(top - 23, 0);
    uint mantissa;
    if (drop == 0) mantissa = low;
    else {
      int cut = drop - 1;
      uint kept = cut >= 32 ? high >> (cut - 32) : cut == 0 ? low : (low >> cut) | (high << (32 - cut));
      mantissa = (kept + 1u) >> 1;
    }
    int e = drop - shift;
    int half_e = e / 2;
    value = float(mantissa) * power_of_two(half_e) * power_of_two(e - half_e);
    if (negative) value = -value;
  }
  return value;
}
)";

}  // namespace dr::backend::glsl
