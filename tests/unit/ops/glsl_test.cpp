// SPDX-License-Identifier: Apache-2.0
// Every element-wise op, in every form that it takes, prints GLSL that glslang accepts for Vulkan 1.1, with variables
// as operands and with literals, and of which it makes straight code.
#include <unistd.h>

#include <array>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <set>

#include "compiler/ops/native.h"
#include "tests/catch.h"
#include "tests/unit/ops/support.h"

using namespace dr;
using namespace dr::ops_test;

namespace {

bool have_glslang() { return std::system("glslangValidator --version > /dev/null 2>&1") == 0; }

std::string literal(Type type) {
  const char* number = type.is_float() ? "-1.5" : type.is_bool() ? "true" : type.scalar == Scalar::Int ? "-2" : "3u";
  return type.is_scalar() ? number : type.str() + "(" + number + ")";
}

// One shader with a block for each form. All it computes is written out, so nothing is dropped.
std::string shader(OpKind kind, bool native) {
  const ops::OpInfo& info = ops::info(kind);
  std::string functions, body;
  std::set<std::string_view> printed;
  for (const Form& form : forms(kind)) {
    std::vector<std::string> names, literals;
    std::string block = "  {\n";
    for (size_t k = 0; k < form.operands.size(); ++k) {
      const Type type = form.operands[k];
      names.push_back("v" + std::to_string(k));
      literals.push_back(literal(type));
      block += "    " + type.str() + " " + names[k] + " = " + type.str() + "(";
      for (int c = 0; c < type.components(); ++c) block += (c > 0 ? ", " : "") + ("word[" + std::to_string(c) + "]");
      block += ");\n";
    }
    const auto store = [&](const std::vector<std::string>& operands, const std::string& result) {
      const ops::GlslInput input{
          .operands = operands, .operand_types = form.operands, .attrs = form.attrs, .result_type = form.result};
      for (const std::string_view strict : ops::prelude(info, input)) {
        const std::string_view text = native ? ops::native_prelude(strict) : strict;
        if (printed.insert(text).second) functions += text;
      }
      const auto own = native ? ops::native_glsl(kind, input) : std::nullopt;
      block += "    " + form.result.str() + " " + result + " = " + (own ? *own : info.glsl(input)) + ";\n";
      for (int c = 0; c < form.result.components(); ++c) {
        const std::string part = form.result.is_scalar()   ? ""
                                 : form.result.is_vector() ? std::string(".") + "xyzw"[c]
                                                           : "[" + std::to_string(c / form.result.rows) + "][" +
                                                                 std::to_string(c % form.result.rows) + "]";
        block += "    total += float(" + result + part + ");\n";
      }
    };
    store(names, "result");
    store(literals, "of_literals");
    body += block + "  }\n";
  }
  return "#version 440\n#extension GL_EXT_shader_integer_mix : require\nlayout(local_size_x = 1) in;\nlayout(std430, "
         "set = 0, binding = 0) buffer Data { float "
         "word[16]; float total_out; };\n" +
         functions + "void main() {\n  float total = 0.0;\n" + body + "  total_out = total;\n}\n";
}

// What the tool says about the shader; "" when it accepts it.
std::string complaints(const std::string& text, const std::filesystem::path& folder) {
  const std::string source = (folder / "op.comp").string(), log = (folder / "log").string();
  std::ofstream(source) << text;
  const std::string command = "glslangValidator -V --target-env vulkan1.1 -o '" + (folder / "op.spv").string() + "' '" +
                              source + "' > '" + log + "' 2>&1";
  if (std::system(command.c_str()) == 0) return "";
  std::ifstream stream(log);
  return {std::istreambuf_iterator<char>(stream), {}};
}

// What the module that glslang made last has of control flow.
struct Flow {
  size_t branches = 0, functions = 0, returns = 0;
};
Flow flow(const std::filesystem::path& folder) {
  constexpr uint32_t kOpFunction = 54, kOpBranchConditional = 250, kOpReturn = 253, kOpReturnValue = 254, kHeader = 5;
  std::ifstream stream(folder / "op.spv", std::ios::binary);
  const std::string bytes{std::istreambuf_iterator<char>(stream), {}};
  std::vector<uint32_t> words(bytes.size() / 4);
  std::memcpy(words.data(), bytes.data(), words.size() * 4);
  REQUIRE(words.size() > kHeader);
  Flow out;
  for (size_t at = kHeader; at < words.size(); at += words[at] >> 16) {
    const uint32_t op = words[at] & 0xffffu;
    if (op == kOpBranchConditional) ++out.branches;
    if (op == kOpFunction) ++out.functions;
    if (op == kOpReturn || op == kOpReturnValue) ++out.returns;
  }
  return out;
}

// Two costly sides of which one is enough; and SPIR-V's select does not take matrices.
const std::set<OpKind> kBranching = {OpKind::Expm1, OpKind::Tanh, OpKind::Sinh,
                                     OpKind::Erf,   OpKind::Pow,  OpKind::Select};

}  // namespace

TEST_CASE("glslang accepts every op in every form, of both float profiles; functions return once, few branch") {
  if (!have_glslang()) {
    WARN("glslangValidator is not installed: the GLSL of the ops is not checked");
    return;
  }
  std::string pattern = (std::filesystem::temp_directory_path() / "dr-ops-XXXXXX").string();
  REQUIRE(mkdtemp(pattern.data()) != nullptr);
  const std::filesystem::path folder = pattern;
  for (const OpKind kind : elementwise_kinds()) {
    INFO(ir::op_name(kind));
    std::vector<std::string> texts{shader(kind, false), shader(kind, true)};
    if (texts[0] == texts[1]) texts.pop_back();
    for (const std::string& text : texts) {
      const std::string wrong = complaints(text, folder);
      if (!wrong.empty()) {
        FAIL_CHECK(wrong << "\n" << text);
        continue;
      }
      const Flow found = flow(folder);
      CHECK(found.returns == found.functions);
      if (&text == &texts[0]) CHECK((found.branches != 0) == kBranching.contains(kind));
    }
  }
  std::filesystem::remove_all(folder);
}

TEST_CASE("scalars need no overloads, integers no float functions") {
  const std::vector<std::string> names{"a", "b"};
  const auto texts = [&](OpKind kind, Type type) {
    const std::vector<Type> types(ops::info(kind).infer == nullptr ? 0 : 2, type);
    std::string all;
    for (const std::string_view text :
         ops::prelude(ops::info(kind), {.operands = names, .operand_types = types, .attrs = {}, .result_type = type}))
      all += text;
    return all;
  };
  CHECK(texts(OpKind::Exp, ir::kFloat).find("vec2") == std::string::npos);
  CHECK(texts(OpKind::Exp, ir::vec(3)).find("vec3 dr_exp(vec3") != std::string::npos);
  CHECK(texts(OpKind::Add, ir::kFloat).empty());
  CHECK(texts(OpKind::Div, ir::kFloat).find("vec2") == std::string::npos);
  CHECK(texts(OpKind::Min, ir::kInt).empty());
  CHECK(texts(OpKind::Mod, ir::kInt).find("float") == std::string::npos);
  CHECK(texts(OpKind::Mod, ir::kUint).find("int dr_mod(int") == std::string::npos);
}
