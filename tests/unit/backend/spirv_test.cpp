// SPDX-License-Identifier: Apache-2.0
// What becomes of glslang's words: no call is left but of functions that leave early, variables go, and the work grows
// with the shader as its size does.
#include "compiler/backend/spirv/spirv.h"

#include <map>

#include "compiler/backend/spirv/module.h"
#include "tests/catch.h"

using namespace dr;
using namespace dr::backend;

namespace {

std::vector<uint32_t> words_of(const std::string& functions, const std::string& main, bool native = false) {
  const std::string source =
      "#version 440\nlayout(local_size_x = 64) in;\nlayout(set = 0, binding = 0, std430) buffer "
      "Data { float d[]; } data;\n" +
      functions + "void main() {\n  int index = int(gl_GlobalInvocationID.x);\n" + main + "}\n";
  auto result = assemble({{"test"}, bundle::Stage::Compute, source, native}, ShaderCache({}));
  INFO(source);
  if (const auto* problem = std::get_if<std::string>(&result)) FAIL(*problem);
  return std::get<std::vector<uint32_t>>(result);
}

// How often each opcode occurs.
std::map<uint16_t, size_t> counts(const std::vector<uint32_t>& words) {
  std::map<uint16_t, size_t> out;
  for (size_t at = 5; at < words.size(); at += words[at] >> 16) ++out[static_cast<uint16_t>(words[at] & 0xffff)];
  return out;
}

constexpr uint16_t kFMul = 133, kFAdd = 129;

}  // namespace

TEST_CASE("functions with one exit are gone, and so are the variables of what is straight") {
  const auto n = counts(words_of(
      "float square(float x) { float y = x * x; return y; }\nfloat fourth(float x) { return square(square(x)); }\n",
      "  float a = data.d[index];\n  float b = fourth(a) + square(a);\n  data.d[index] = b;\n"));
  CHECK(n.at(spirv::kFunction) == 1);
  CHECK(n.count(spirv::kFunctionCall) == 0);
  CHECK(n.at(kFMul) == 3);
  CHECK(n.at(kFAdd) == 1);
  // Two of the module: the buffer and the invocation's number.
  CHECK(n.at(spirv::kVariable) == 2);
}

TEST_CASE("branches, loops and choices inside of functions and around calls give sound modules") {
  const std::string functions =
      "float pick(float x) { float r; if (x < 0.0) { r = -x; } else { r = x * 2.0; } return r; }\n"
      "float sum(float x, int n) {\n  float t = 0.0;\n  for (int i = 0; i < n; ++i) t = t + pick(x + float(i));\n"
      "  return t;\n}\n"
      "bool both(float x, float y) { return sum(x, 2) > 0.0 && sum(y, 3) > 1.0; }\n"
      "void put(int place, float x) { if (place >= 0) data.d[place] = x; }\n"
      "void swap(inout float x, inout float y) { float t = x; x = y; y = t; }\n"
      "float never(float x) { return x; }\n";
  const auto n = counts(
      words_of(functions,
               "  if (index >= 7) return;\n  float x = data.d[index], y = 3.0;\n  swap(x, y);\n"
               "  for (int k = 0; k < 4; ++k) {\n    if (both(x, y) || pick(y) > sum(x, k)) { y = pick(x) + y; } else "
               "{ put(k, y); }\n"
               "    if (sum(y, k) > 100.0) break;\n    x = k > 2 ? sum(x, k) : x;\n  }\n  put(index, x + y);\n"));
  CHECK(n.at(spirv::kFunction) == 1);
  CHECK(n.count(spirv::kFunctionCall) == 0);
  CHECK(n.at(spirv::kLoopMerge) >= 5);
}

TEST_CASE("a function that leaves before its end stays, and so do the calls of it") {
  const auto n =
      counts(words_of("float early(float x) { if (x < 0.0) return 1.0; return x; }\n"
                      "float twice(float x) { return early(x) + early(x + 1.0); }\n",
                      "  data.d[index] = twice(data.d[index]);\n"));
  CHECK(n.at(spirv::kFunction) == 2);
  CHECK(n.at(spirv::kFunctionCall) == 2);
}

TEST_CASE("copies of what is exact are exact; what main of a native shader says is not") {
  const auto decorations = [](const std::vector<uint32_t>& words) {
    size_t count = 0;
    for (size_t at = 5; at < words.size(); at += words[at] >> 16)
      count += (words[at] & 0xffff) == spirv::kDecorate && words[at + 2] == spirv::kNoContraction ? 1 : 0;
    return count;
  };
  const std::string square = "float square(float x) { return x * x; }\n";
  const std::string main = "  data.d[index] = square(data.d[index]) + square(2.0) * data.d[index];\n";
  CHECK(decorations(words_of(square, main)) == 4);
  CHECK(decorations(words_of(square, main, true)) == 2);
}

TEST_CASE("what nothing needs is not there") {
  const auto n = counts(words_of("float none(float x) { return x * 3.0; }\n",
                                 "  float a = data.d[index] * 2.0;\n  float b = none(a);\n  float c = b + a;\n"
                                 "  a = 5.0;\n  data.d[index] = a;\n"));
  CHECK(n.count(kFMul) == 0);
  CHECK(n.count(kFAdd) == 0);
  CHECK(n.at(spirv::kStore) == 1);
}

TEST_CASE("a variable that branches change is kept, one that is set once and before is not") {
  const auto n = counts(words_of("",
                                 "  float once = data.d[index];\n  float r = 0.0;\n"
                                 "  if (once > 1.0) { r = once * 2.0; } else if (once < 0.0) { r = once; }\n"
                                 "  for (int i = 0; i < 3; ++i) { data.d[i] = once; }\n  data.d[index] = r;\n"));
  size_t locals = n.at(spirv::kVariable) - 2;
  CHECK(locals == 2);  // r and i
}
