// SPDX-License-Identifier: Apache-2.0
// Modules for buffers in parts: valid, with a variable for each part and no access past them; what cannot be split is
// told. That results have the same bits is tested on devices (tests/device/parts_test.cpp).
#include "compiler/backend/bundle/split_buffers.h"

#include <map>
#include <spirv-tools/libspirv.hpp>

#include "compiler/backend/spirv/module.h"
#include "compiler/backend/spirv/spirv.h"
#include "tests/catch.h"

using namespace dr;
using namespace dr::backend;

namespace {

std::vector<uint32_t> words_of(const std::string& main) {
  const std::string source =
      "#version 440\n#extension GL_ARB_gpu_shader_int64 : require\n#extension GL_EXT_shader_atomic_int64 : require\n"
      "#extension GL_EXT_samplerless_texture_functions : require\nlayout(local_size_x = 64) in;\n"
      "layout(set = 0, binding = 0, std430) buffer A { float d[]; } a;\n"
      "layout(set = 0, binding = 1, std430) buffer B { uint64_t d[]; } b;\n"
      "layout(set = 0, binding = 2, std430) buffer C { uvec2 d[]; } c;\n"
      "layout(set = 0, binding = 3) uniform utextureBuffer t;\n"
      "layout(set = 0, binding = 4, std430) buffer E { uint d[]; } e;\n"
      "void main() {\n  int i = int(gl_GlobalInvocationID.x);\n  uint u = gl_GlobalInvocationID.x;\n" +
      main + "}\n";
  auto result = assemble({{"test"}, bundle::Stage::Compute, source, false}, ShaderCache({}));
  INFO(source);
  if (const auto* problem = std::get_if<std::string>(&result)) FAIL(*problem);
  return std::get<std::vector<uint32_t>>(result);
}

const std::vector<bundle::Split> kSplits{{0, 5, 3, 10}, {1, 7, 2, 12}, {2, 8, 2, 12}, {3, 9, 4, 9}, {4, 12, 2, 8}};

std::vector<uint32_t> split(const std::string& main) {
  auto result = bundle::split_buffers(words_of(main), kSplits);
  INFO(main);
  if (const auto* problem = std::get_if<std::string>(&result)) FAIL(*problem);
  auto& words = std::get<std::vector<uint32_t>>(result);
  spvtools::SpirvTools tools(SPV_ENV_VULKAN_1_1);
  std::string said;
  tools.SetMessageConsumer([&](spv_message_level_t, const char*, const spv_position_t&, const char* m) { said = m; });
  INFO(said);
  const bool valid = tools.Validate(words);
  INFO(said);
  REQUIRE(valid);
  return words;
}

std::map<uint16_t, size_t> counts(const std::vector<uint32_t>& words) {
  std::map<uint16_t, size_t> out;
  for (size_t at = 5; at < words.size(); at += words[at] >> 16) ++out[static_cast<uint16_t>(words[at] & 0xffff)];
  return out;
}

}  // namespace

TEST_CASE("accesses become calls, one function for those that are alike") {
  const auto n = counts(split("  a.d[i] = a.d[i + 1] + a.d[u + 2u] + a.d[i + 7];\n"));
  CHECK(n.at(spirv::kFunction) == 4);  // main; load by int and by uint; store
  CHECK(n.at(spirv::kFunctionCall) == 4);
  CHECK(n.at(spirv::kSwitch) == 3);
}

TEST_CASE("every kind of access gives a sound module") {
  split("  a.d[i] = float(c.d[i].y) + float(c.d[u].x);\n  c.d[i + 1] = uvec2(u, 3u);\n");
  split("  uint64_t old = atomicAdd(b.d[i], uint64_t(7));\n  b.d[i + 1] = old;\n  atomicMin(b.d[u], old);\n");
  split(
      "  if (atomicCompSwap(e.d[u], 3u, 4u) == atomicExchange(e.d[i], u)) atomicOr(e.d[i + 2], atomicMax(e.d[u], "
      "1u));\n");
  split("  a.d[i] = float(texelFetch(t, i).x) + float(texelFetch(t, i + 1).y);\n");
  split("  for (int k = 0; k < i; ++k) { if (a.d[k] > 0.5) e.d[k] = texelFetch(t, k).x; else break; }\n");
}

TEST_CASE("what lies in the first part for certain is read and written as before") {
  const auto n = counts(split("  atomicAdd(e.d[0], 1u);\n  a.d[3] = float(e.d[1]);\n"));
  CHECK(n.at(spirv::kFunction) == 1);
  CHECK(n.count(spirv::kFunctionCall) == 0);
}

TEST_CASE("what needs a buffer as a whole is told") {
  const auto refused = bundle::split_buffers(words_of("  e.d[i] = uint(a.d.length());\n"), kSplits);
  REQUIRE(std::holds_alternative<std::string>(refused));
  CHECK(std::get<std::string>(refused) == "uses a buffer as a whole");
}
