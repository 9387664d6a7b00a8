// SPDX-License-Identifier: Apache-2.0
// Any bytes as a bundle: words that say what is wrong, or tables and shaders that a device may be given. DR_CHANGE says
// what is changed: 0 fields of the tables, 1 words of the shaders, 2 bytes of the file. Its checksum is made right.
#include "compiler/backend/bundle/bundle.h"

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <string>

#include "compiler/backend/bundle/check_shaders.h"
#include "tests/stress/mutate_bundle.h"

namespace {

using namespace dr;

constexpr size_t kMaxInput = size_t{1} << 17, kChecksum = sizeof(uint64_t);

#if DR_CHANGE < 2
// The tables as they are, sound or not; nothing where there are none.
std::optional<bundle::BundleT> tables_of(const uint8_t* data, size_t size) {
  std::vector<uint64_t> aligned((size + 7) / 8);
  std::memcpy(aligned.data(), data, size);
  const auto* bytes = reinterpret_cast<const uint8_t*>(aligned.data());
  flatbuffers::Verifier verifier(bytes, size, 64, 1'000'000);
  if (size < 16 || !bundle::VerifySizePrefixedBundleBuffer(verifier)) return std::nullopt;
  bundle::BundleT tables;
  bundle::GetSizePrefixedBundle(bytes)->UnPackTo(&tables);
  return tables;
}
#endif

std::vector<uint8_t> with_checksum(const uint8_t* data, size_t size) {
  std::vector<uint8_t> bytes(data, data + size);
  if (size <= kChecksum) return bytes;
  const uint64_t sum = bundle::checksum(data, size - kChecksum);
  std::memcpy(bytes.data() + size - kChecksum, &sum, kChecksum);
  return bytes;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  if (size > kMaxInput) return 0;
  const auto read = bundle::read(with_checksum(data, size));
  const auto* sound = std::get_if<bundle::BundleT>(&read);
  if (sound == nullptr) return 0;
  (void)bundle::check_shaders(*sound, {});
  // What is sound stays so when it is written and read.
  const auto again = bundle::read(bundle::write(*sound));
  if (std::holds_alternative<std::string>(again)) std::abort();
  return 0;
}

#if DR_CHANGE < 2
extern "C" size_t LLVMFuzzerCustomMutator(uint8_t* data, size_t size, size_t max, unsigned seed) {
  auto tables = tables_of(data, size);
  if (!tables || tables->shaders.empty()) return size;
  test::Random random(seed);
  if (DR_CHANGE == 0)
    test::mutate_tables(*tables, random);
  else if (std::ranges::none_of(tables->shaders, [](const auto& s) { return s->spirv.empty(); }))
    test::mutate_spirv(*tables, random);
  const std::vector<uint8_t> bytes = bundle::write(*tables);
  if (bytes.size() > max) return size;
  std::copy(bytes.begin(), bytes.end(), data);
  return bytes.size();
}
#endif
