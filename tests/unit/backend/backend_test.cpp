// SPDX-License-Identifier: Apache-2.0
// The compiler's second half without a device: schedules are sound on every profile and packing, SPIR-V is strict.
#include <algorithm>
#include <set>

#include "compiler/backend/compile.h"
#include "compiler/backend/glsl/text.h"
#include "compiler/backend/skips.h"
#include "compiler/backend/spirv/spirv.h"
#include "compiler/ir/parse.h"
#include "tests/catch.h"

using namespace dr;
using namespace dr::backend;

namespace {

// Reductions, scatter, an indexed read in an If, a stretched operand, two updates of which one reads the other's leaf.
const char* const kGraph = R"(leaf a : vec2[V] param
leaf b : float[V] param
leaf i : int[W, H] input
%0 : vec2[V] = leaf text "a"
%1 : float[V] = leaf text "b"
%2 : int[W, H] = leaf text "i"
%3 : int = const floats [0]
%4 : bool[W, H] = le %3, %2
%5 : float[W, H] = if %4 dims [W, H, 1] yields [element] {
  %6 : vec2[W, H] = gather %0, %2
  %7 : float[W, H] = dot %6, %6
  yield %7
} {
  %8 : float = const floats [0]
  yield %8
}
%9 : float[W, H] = exp %5
%10 : float = reduce_sum %9 ints [1, 1, 1]
%11 : float[V] = mul %1, %10
%12 : float[V] = scatter_add %2, %9 dims [V, 1, 1]
%13 : float[V] = add %11, %12
%14 : vec2[V] = splat %1 ints [2]
step go {
  output total %10
  output old %1
  update a %14
  update b %13
}
)";

ir::Graph graph() {
  auto parsed = ir::parse(kGraph);
  if (auto* error = std::get_if<ir::ParseError>(&parsed)) FAIL("line " << error->line << ": " << error->message);
  return std::move(std::get<ir::Graph>(parsed));
}

target::Profile profile(const std::string& name) { return std::get<target::Profile>(target::load_profile(name)); }

}  // namespace

TEST_CASE("every lowering of a graph has a sound schedule, a sound bundle and the same bytes twice") {
  const ir::Graph g = graph();
  for (const std::string& name : target::builtin_profiles())
    for (const bool fused : {false, true})
      for (const Lower lower : {Lower::Fragment, Lower::Compute}) {
        CompileOptions options;
        options.fused = fused;
        options.lower = lower;
        auto once = compile(g, profile(name), options);
        INFO(name << (fused ? " fused" : " naive") << (lower == Lower::Fragment ? " fragment" : " compute"));
        REQUIRE(std::holds_alternative<Compiled>(once));
        const Compiled& c = std::get<Compiled>(once);
        CHECK(check_schedule(g, c.schedule, profile(name)).empty());
        CHECK(bundle::check(c.bundle).empty());
        const auto bytes = bundle::write(c.bundle);
        auto twice = compile(g, profile(name), options);
        CHECK(bytes == bundle::write(std::get<Compiled>(twice).bundle));
      }
}

TEST_CASE("fusing never takes more passes than one an op") {
  const ir::Graph g = graph();
  PackOptions naive, fused;
  naive.fused = false;
  const auto n = pack(g, profile("lavapipe"), naive), f = pack(g, profile("lavapipe"), fused);
  CHECK(f.steps[0].passes.size() < n.steps[0].passes.size());
}

TEST_CASE("a limit of the profile splits a pass or is told") {
  const ir::Graph g = graph();
  target::Profile tight = profile("lavapipe");
  tight.lanes_in_turn = false;  // else what is only read is no storage buffer
  tight.max_color_attachments = 1;
  tight.max_per_stage_descriptor_storage_buffers = 4;
  PackOptions options;
  options.fragment = true;
  const Schedule s = pack(g, tight, options);
  CHECK(check_schedule(g, s, tight).empty());
  tight.max_per_stage_descriptor_storage_buffers = 1;
  const auto result = compile(g, tight, {});
  REQUIRE(std::holds_alternative<Limit>(result));
  CHECK(std::get<Limit>(result).text.find("device allows 1") != std::string::npos);
}

namespace {

// Of a module: how many float instructions it has, and how many of them are decorated NoContraction.
std::pair<size_t, size_t> arithmetic_of(const std::vector<uint32_t>& code) {
  std::set<uint32_t> decorated;
  std::vector<uint32_t> arithmetic;
  for (size_t at = 5; at < code.size(); at += code[at] >> 16) {
    const uint32_t opcode = code[at] & 0xffff;
    if (opcode == 71 && code[at + 2] == 42) decorated.insert(code[at + 1]);
    if (opcode == 127 || opcode == 129 || opcode == 131 || opcode == 133 || opcode == 136 || opcode == 142 ||
        opcode == 148)
      arithmetic.push_back(code[at + 2]);
  }
  return {arithmetic.size(), std::ranges::count_if(arithmetic, [&](uint32_t id) { return decorated.contains(id); })};
}

size_t functions_of(const std::vector<uint32_t>& code) {
  size_t count = 0;
  for (size_t at = 5; at < code.size(); at += code[at] >> 16) count += (code[at] & 0xffff) == 54 ? 1 : 0;
  return count;
}

}  // namespace

TEST_CASE("the library is told what is switched off, and what it costs a device to look first") {
  const auto defines = [](const std::vector<std::string>& off, const char* profile) {
    return build_defines(off, std::get<target::Profile>(target::load_profile(profile)));
  };
  CHECK(defines({}, "lavapipe")[0] == std::pair<std::string, std::string>("std.build.skips", "true"));
  CHECK(defines({"dead", "soft"}, "lavapipe")[0].second == "false");
  // std.hardsoftras lets outlines look first below 1e7.
  const auto operations = [&](const char* profile) { return std::stod(defines({}, profile)[1].second); };
  CHECK(operations("lavapipe") < 1e7);
  CHECK(operations("arm-mali-g76") < 1e7);
  CHECK(operations("nvidia-h200") > 1e7);
}

TEST_CASE("every float instruction is decorated NoContraction") {
  const ir::Graph g = graph();
  auto result = compile(g, profile("swiftshader"), {});
  for (const auto& shader : std::get<Compiled>(result).bundle.shaders) {
    const auto [all, decorated] = arithmetic_of(shader->spirv);
    CHECK(decorated == all);
    CHECK(decorate_no_contraction(shader->spirv) == shader->spirv);
    CHECK(functions_of(shader->spirv) == 1);  // no function of ours leaves early
  }
}

TEST_CASE("in the profile native what the program says is the driver's to contract, and our functions are not") {
  auto g = ir::parse(R"(leaf a : float[V] input
%0 : float[V] = leaf text "a"
%1 : float[V] = mul %0, %0
%2 : float[V] = add %1, %0
%3 : float[V] = mod %2, %0
step go {
  output y %3
}
)");
  CompileOptions options;
  options.lower = Lower::Compute;
  const auto strict = compile(std::get<ir::Graph>(g), profile("swiftshader"), options);
  options.native_floats = true;
  const auto native = compile(std::get<ir::Graph>(g), profile("swiftshader"), options);
  CHECK(std::get<Compiled>(strict).bundle.float_profile == bundle::FloatProfile::Strict);
  CHECK(std::get<Compiled>(native).bundle.float_profile == bundle::FloatProfile::Native);
  const auto [all, decorated] = arithmetic_of(std::get<Compiled>(strict).bundle.shaders[0]->spirv);
  CHECK(all > 2);
  CHECK(decorated == all);
  const auto [same, fewer] = arithmetic_of(std::get<Compiled>(native).bundle.shaders[0]->spirv);
  CHECK(same == all);
  CHECK(fewer == all - 2);
}

TEST_CASE("shaders are compared without the names of what they read and write") {
  using backend::glsl::without_names;
  const std::string shader =
      "#extension GL_NV_some_1 : require\nbuffer r_mul_3_block { float d_1[]; } r_mul_3;\nfloat v_0 = 1.0e_1;\n";
  CHECK(without_names(shader) ==
        "#extension GL_NV_some_1 : require\nbuffer _0 { float _1[]; } _2;\nfloat _3 = 1.0e_1;\n");
  CHECK(without_names("a_1 = b_2 + b_2;") == without_names("c_7 = x_y_1 + x_y_1;"));
  // Another use of the same names is another shader; so are other members, functions and numbers.
  CHECK(without_names("a_1 = a_1 + b_2;") != without_names("a_1 = b_2 + b_2;"));
  CHECK(without_names("a_1.x_1 = 0;") != without_names("a_1.x_2 = 0;"));
  CHECK(without_names("a_1 = sin(b_2);") != without_names("a_1 = cos(b_2);"));
  CHECK(without_names("a_1 = 1;") != without_names("a_1 = 2;"));
  CHECK(without_names("").empty());
}
