// SPDX-License-Identifier: Apache-2.0
// Reading and writing bundles. A bundle from outside is verified, structure first and then meaning (indices in range,
// expressions that parse, sizes that agree), before any field is used. What its shaders do with its tables is looked at
// by check_shaders.h.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "bundle_generated.h"

namespace dr::bundle {

inline constexpr uint32_t kVersion = 21;

// Invocations of a workgroup of a dispatch whose workgroups a buffer counts.
inline constexpr int kIndirectGroup = 64;
// Words of a list (ListKind): 0 to 2 the workgroups of 64 that take one element each, then one more than there are,
// then the elements, or marks of blocks.
inline constexpr int kListEnd = 3, kListHead = 4;
// Elements of a block that is marked, and invocations of a workgroup that runs for one.
inline constexpr int kRestingBlock = 64;

// Where invocations may take several elements (Command.each), so many are started at least: they keep the threads of a
// large processor busy, in small workgroups.
inline constexpr int64_t kLeastInvocations = 512;
// Invocations of a Reduce with a `group` that share the inputs of one of others.
inline constexpr int64_t kReducingTeam = 8;
// Faces whose numbers an int holds beside a tag.
inline constexpr int64_t kMostListed = (int64_t{1} << 27) - 1;

// Runs of a raster for one clear of its EpochEntries.
inline constexpr int kEpochs = 14;

// Whether a resource is words of 32 bits that only shaders know the meaning of.
inline bool is_words(const ResourceT& r) { return r.role == Role::Scratch || r.role == Role::Zeros; }
// Whether it has a meaning to the host: a leaf, a counter or what a step computes.
inline bool is_value(const ResourceT& r) {
  return !is_words(r) && r.role != Role::Watch && r.role != Role::Guess && r.role != Role::EpochEntries;
}
// Whether a run of a step finds in it what an earlier one, or the host, left.
inline bool stays(const ResourceT& r) { return r.role != Role::Value && r.role != Role::Scratch; }

// Elements that lie behind those of its extent.
inline int64_t elements_behind(const ResourceT& r) { return r.role == Role::EpochEntries ? 2 : 0; }

// The word of an enumerator in commands, options and what is printed: "ShaderInt64" is "shader_int64".
std::string word(const char* enumerator);

// Deterministic bytes: the tables with their length before them, and a checksum of both behind them.
std::vector<uint8_t> write(const BundleT& bundle);

// Whether it begins as a bundle of any version does.
bool has_identifier(std::string_view bytes);

// The bundle, or one sentence on what is wrong with it.
std::variant<BundleT, std::string> read(std::span<const uint8_t> bytes);

// What read() checks beyond the FlatBuffers structure; empty when sound.
std::string check(const BundleT& bundle);

// A number that changes with any change within one word of 64 bits, and with nearly any other one: against accidents,
// not against people.
uint64_t checksum(const void* data, size_t bytes);

}  // namespace dr::bundle
