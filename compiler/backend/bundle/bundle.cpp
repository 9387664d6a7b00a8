// SPDX-License-Identifier: Apache-2.0
// Bundles as bytes: length, tables, checksum.
#include "compiler/backend/bundle/bundle.h"

#include <algorithm>
#include <cctype>
#include <cstring>
#include <optional>

namespace dr::bundle {

namespace {

// Four bytes of length stand before the tables, so that a file cut within its padding is told too.
constexpr size_t kPrefix = sizeof(uint32_t), kChecksum = sizeof(uint64_t);
constexpr const char* kDamaged = "the bundle is damaged or cut off";

// What a bundle of any version begins with: a table whose first field is the version. The others may be other tables in
// another version, and may not verify as those of this one.
std::optional<uint32_t> version_of(const uint8_t* data, size_t size) {
  flatbuffers::Verifier verifier(data, size);
  const auto offset = verifier.VerifyOffset(kPrefix);
  if (offset == 0) return std::nullopt;
  const auto* root = reinterpret_cast<const flatbuffers::Table*>(data + kPrefix + offset);
  if (!root->VerifyTableStart(verifier) || !root->VerifyField<uint32_t>(verifier, Bundle::VT_VERSION, sizeof(uint32_t)))
    return std::nullopt;
  return reinterpret_cast<const Bundle*>(root)->version();
}

}  // namespace

std::string word(const char* enumerator) {
  std::string out;
  for (const char* c = enumerator; *c != 0; ++c) {
    const auto letter = static_cast<unsigned char>(*c);
    if (std::isupper(letter) && !out.empty()) out += '_';
    out += static_cast<char>(std::tolower(letter));
  }
  return out;
}

std::vector<uint8_t> write(const BundleT& bundle) {
  // Room for all that is large, so that it is not copied while the buffer grows.
  size_t large = bundle.graph.size() + (size_t{1} << 18);
  for (const auto& shader : bundle.shaders) large += shader->spirv.size() * sizeof(uint32_t);
  flatbuffers::FlatBufferBuilder builder(large);
  builder.FinishSizePrefixed(Bundle::Pack(builder, &bundle), BundleIdentifier());
  const uint8_t* const tables = builder.GetBufferPointer();
  const size_t size = builder.GetSize();
  std::vector<uint8_t> bytes(size + kChecksum);
  std::memcpy(bytes.data(), tables, size);
  flatbuffers::WriteScalar(bytes.data() + size, checksum(tables, size));
  return bytes;
}

uint64_t checksum(const void* data, size_t bytes) {
  // FNV-1a over words of 64 bits, the last one filled up with zeros. A product carries a word's bits upwards only, so
  // the upper half is folded back onto the lower one.
  const auto* p = static_cast<const unsigned char*>(data);
  uint64_t state = 0xcbf29ce484222325 ^ bytes;
  for (size_t k = 0; k < bytes; k += sizeof(uint64_t)) {
    uint64_t word = 0;
    std::memcpy(&word, p + k, std::min(sizeof word, bytes - k));
    state = (state ^ word) * 0x100000001b3;
    state ^= state >> 32;
  }
  return state;
}

bool has_identifier(std::string_view bytes) {
  constexpr size_t kSmallest = kPrefix + 8;
  return bytes.size() >= kSmallest && BundleBufferHasIdentifier(bytes.data() + kPrefix);
}

std::variant<BundleT, std::string> read(std::span<const uint8_t> bytes) {
  constexpr size_t kLargest = size_t{1} << 30;
  if (!has_identifier({reinterpret_cast<const char*>(bytes.data()), bytes.size()}))
    return "not a bundle: the file does not begin as one";
  if (bytes.size() > kLargest) return "the bundle is larger than 1 GiB";
  // The tables are read in place and want alignment, which a caller's bytes need not have.
  std::vector<uint64_t> aligned((bytes.size() + 7) / 8);
  std::memcpy(aligned.data(), bytes.data(), bytes.size());
  const auto* data = reinterpret_cast<const uint8_t*>(aligned.data());
  const size_t size = kPrefix + flatbuffers::ReadScalar<uint32_t>(data);
  if (size > bytes.size())
    return "the bundle is cut off: it has " + std::to_string(bytes.size()) + " of " + std::to_string(size + kChecksum) +
           " bytes";
  const bool is_whole =
      bytes.size() == size + kChecksum && flatbuffers::ReadScalar<uint64_t>(data + size) == checksum(data, size);
  const auto version = version_of(data, size);
  // Early versions have no checksum.
  if (version && *version != kVersion && (is_whole || bytes.size() == size))
    return "the bundle is of version " + std::to_string(*version) + ", this build reads version " +
           std::to_string(kVersion) + ": compile the program again";
  if (!version || !is_whole) return kDamaged;
  flatbuffers::Verifier verifier(data, size, 64, 1'000'000);
  if (!VerifySizePrefixedBundleBuffer(verifier)) return kDamaged;
  const Bundle* root = GetSizePrefixedBundle(data);
  // FlatBuffers checks the place of a vector's length, not that of elements that are wider.
  for (const Leaf* leaf : *root->leaves())
    if (leaf->initial() != nullptr && reinterpret_cast<uintptr_t>(leaf->initial()->data()) % alignof(double) != 0)
      return kDamaged;
  BundleT bundle;
  root->UnPackTo(&bundle);
  if (std::string problem = check(bundle); !problem.empty()) return "the bundle is not sound: " + problem;
  return bundle;
}

}  // namespace dr::bundle
