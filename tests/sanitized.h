// SPDX-License-Identifier: Apache-2.0
// Whether this is built with AddressSanitizer, under which a test takes some ten times as long. What the numbers are is
// tested without it, so random tests repeat less often here.
#pragma once

namespace dr {

#if defined(__SANITIZE_ADDRESS__)
inline constexpr bool kSanitized = true;
#elif defined(__has_feature)
#if __has_feature(address_sanitizer)
inline constexpr bool kSanitized = true;
#else
inline constexpr bool kSanitized = false;
#endif
#else
inline constexpr bool kSanitized = false;
#endif

// So many times, or a quarter of that.
constexpr int repeats(int plain) { return kSanitized ? plain / 4 : plain; }

}  // namespace dr
