// SPDX-License-Identifier: Apache-2.0
// Bundles: round trip, and refusal of whatever is cut, flipped or makes no sense.
#include "compiler/backend/bundle/bundle.h"

#include <cstdlib>
#include <random>

#include "tests/unit/backend/bundle_sample.h"

using namespace dr::bundle;

TEST_CASE("a bundle reads back as it was written, and its bytes do not change") {
  const auto bytes = write(sample());
  CHECK(bytes == write(sample()));
  const auto back = read(bytes);
  REQUIRE(std::holds_alternative<BundleT>(back));
  CHECK(write(std::get<BundleT>(back)) == bytes);
}

TEST_CASE("a bundle that is cut off anywhere is refused") {
  const auto bytes = write(sample());
  for (size_t n = 0; n < bytes.size(); ++n) {
    const auto result = read(std::span(bytes).first(n));
    INFO("after " << n << " bytes");
    CHECK(std::holds_alternative<std::string>(result));
  }
}

TEST_CASE("damaged bundles are refused or sound, never worse") {
  const auto bytes = write(sample());
  std::mt19937_64 random(7);
  // DR_MUTATIONS=1000000 for a long run.
  const char* wanted = std::getenv("DR_MUTATIONS");
  const int count = wanted ? std::atoi(wanted) : 20000;
  for (int k = 0; k < count; ++k) {
    auto damaged = bytes;
    for (uint64_t n = random() % 4 + 1; n > 0; --n) damaged[random() % damaged.size()] = static_cast<uint8_t>(random());
    const auto result = read(damaged);
    if (const auto* b = std::get_if<BundleT>(&result)) CHECK(check(*b).empty());
  }
}

TEST_CASE("one bit that is not what it was is noticed, wherever it is") {
  const auto bytes = write(sample());
  for (size_t k = 0; k < bytes.size() * 8; ++k) {
    auto damaged = bytes;
    damaged[k / 8] = static_cast<uint8_t>(damaged[k / 8] ^ 1u << k % 8);
    INFO("bit " << k);
    CHECK(std::holds_alternative<std::string>(read(damaged)));
  }
}

TEST_CASE("another version is named") {
  BundleT b = sample();
  b.version = 99;
  const auto result = read(write(b));
  REQUIRE(std::holds_alternative<std::string>(result));
  CHECK(std::get<std::string>(result).find("version 99") != std::string::npos);
}

TEST_CASE("what FlatBuffers cannot know is checked") {
  expect(sample, {
                     {[](auto& b) { b.resources[0]->extent->w = "Q"; }, "unknown symbol 'Q'"},
                     {[](auto& b) { b.resources[0]->extent->w = "V +"; }, "no expression"},
                     {[](auto& b) { b.resources[0]->extent->w = "V / (V - 8)"; }, "no expression"},
                     {[](auto& b) { command(b).compute = 3; }, "shader 3"},
                     {[](auto& b) { command(b).bindings[0]->resource = 5; }, "names resource 5"},
                     {[](auto& b) { command(b).lines = {Line(0, 3)}; }, "line 3 of file 0"},
                     {[](auto& b) {
                        command(b).push = {1, 2, 3, 4};
                      },
                      "more than three constants"},
                     {[](auto& b) {
                        command(b).leaves = {0, 0};
                      },
                      "leafs out of order"},
                     {[](auto& b) { command(b).leaves = {1}; }, "a leaf that is not there"},
                     {[](auto& b) { command(b).bindings[0]->texel = 5; }, "binds as texels"},
                     {[](auto& b) { command(b).indirect = 0; }, "as large as a value says"},
                     {[](auto& b) { b.shaders[0]->spirv[0] = 1; }, "not SPIR-V"},
                     {[](auto& b) {
                        b.leaves[0]->initial = {1, 2};
                      },
                      "initial value"},
                     {[](auto& b) { b.leaves[0]->type->cols = 2; }, "a matrix of what is no float"},
                     {[](auto& b) { b.resources[0]->role = Role::Value; }, "a resource of another type"},
                     {[](auto& b) { b.op_lines = {Line(0, 1)}; }, "a file that there is not"},
                     {[](auto& b) { b.float_profile = static_cast<FloatProfile>(2); }, "float profile"},
                     {[](auto& b) { b.packing = static_cast<Packing>(2); }, "the lowering is unknown"},
                     {[](auto& b) { b.lowering = static_cast<Lowering>(9); }, "the lowering is unknown"},
                     {[](auto& b) { b.raster = static_cast<RasterLowering>(255); }, "the lowering is unknown"},
                     {[](auto& b) { b.features = {static_cast<Feature>(200)}; }, "needs feature 200, which is unknown"},
                     {[](auto& b) {
                        b.features = {Feature::Multiview, Feature::ShaderInt64};
                      },
                      "out of order"},
                     {[](auto& b) { b.resources[0]->list = static_cast<ListKind>(3); }, "an unknown list"},
                     {[](auto& b) { b.resources[0]->list = ListKind::Active; }, "and yet no scratch buffer"},
                     {[](auto& b) { b.steps[0]->outputs[0]->resource = 1; }, "output 'y'"},
                     {[](auto& b) { b.steps[0]->symbols = {"Q"}; }, "needs the unknown symbol 'Q'"},
                     {[](auto& b) { b.steps[0]->leaves.clear(); }, "which its step does not name"},
                     {[](auto& b) {
                        b.steps[0]->changes = {0, 1};
                      },
                      "a leaf that is not there"},
                     {[](auto& b) { b.steps[0]->step_index = 0; }, "no counter"},
                     {[](auto& b) { b.steps[0]->step_index = -2; }, "counts in no resource"},
                     {[](auto& b) { command(b).bindings[0]->access = Access::Write; }, "changes leaf 'x'"},
                 });
}

// Whoever walks over all fields of a command must find nothing there that nobody looked at.
TEST_CASE("a command has the fields of its kind alone") {
  const std::vector<std::pair<const char*, std::function<void(CommandT&)>>> fields = {
      {"next", [](auto& c) { c.next = 77777; }},
      {"vertex", [](auto& c) { c.vertex = 77777; }},
      {"fragment", [](auto& c) { c.fragment = -7; }},
      {"extent", [](auto& c) { c.extent = extent("1"); }},
      {"colors", [](auto& c) { c.colors = {99999}; }},
      {"clear", [](auto& c) { c.clear = {0}; }},
      {"joins", [](auto& c) { c.joins = true; }},
      {"inputs", [](auto& c) { c.inputs = {0}; }},
      {"depth", [](auto& c) { c.depth = 12345; }},
      {"value", [](auto& c) { c.value = 1; }},
      {"source", [](auto& c) { c.source = 2147483647; }},
      {"target", [](auto& c) { c.target = 0; }},
      {"outs", [](auto& c) { c.outs = "V"; }},
      {"scratch_a", [](auto& c) { c.scratch_a = 5000; }},
      {"scratch_b", [](auto& c) { c.scratch_b = -9; }}};
  for (const auto& [name, give] : fields)
    expect(sample, {{[&give = give](auto& b) { give(command(b)); },
                     "has '" + std::string(name) + "', which commands of its kind do not use"}});
  // A dispatch may say how many words it writes.
  expect(sample, {{[](auto& b) { command(b).count = "V +"; }, "no expression"},
                  {[](auto& b) { command(b).count = "unknown"; }, "uses the unknown symbol"},
                  {[](auto& b) {
                     const std::string label = command(b).label;
                     command(b) = {};
                     command(b).label = label;
                     command(b).kind = CommandKind::Copy;
                     command(b).count = "V";
                   },
                   "has 'count', which commands of its kind do not use"}});
  expect(sample, {{[](auto& b) { command(b).finite = -9; }, "is watched by no resource"},
                  {[](auto& b) { command(b).finite = 0; }, "is watched by what is no watch"},
                  {[](auto& b) { command(b).finite = 77777; }, "is watched by a resource that it does not bind"},
                  {[](auto& b) { command(b).left = 0; }, "does not say how it goes on"},
                  {[](auto& b) { command(b).part_trips = 9; }, "does not say how it goes on"}});
}

TEST_CASE("names are names, and there once") {
  const std::string not_a_name = "which is no name";
  for (const std::string bad :
       {"", "/absolute", "../above", "a/b", ".hidden", "a b", "\x1b[2J", "a\nb", "caf\xc3\xa9", "<b>"}) {
    INFO(bad);
    expect(sample, {{[&](auto& b) { b.leaves[0]->name = bad; }, not_a_name},
                    {[&](auto& b) { b.steps[0]->name = bad; }, not_a_name},
                    {[&](auto& b) { b.steps[0]->outputs[0]->name = bad; }, not_a_name},
                    {[&](auto& b) { b.symbols.push_back(bad); }, not_a_name},
                    {[&](auto& b) {
                       b.steps[0]->pins.push_back(std::make_unique<OutputT>(*b.steps[0]->outputs[0]));
                       b.steps[0]->pins[0]->name = bad;
                     },
                     not_a_name}});
  }
  const std::string odd = "which holds characters that no name has";
  for (const std::string bad : {"", "\x1b[2J", "a\nb", "caf\xc3\xa9", "<b>", "\"", "a&b"})
    expect(sample, {{[&](auto& b) { b.resources[0]->name = bad; }, odd},
                    {[&](auto& b) { b.shaders[0]->name = bad; }, odd},
                    {[&](auto& b) { command(b).label = bad; }, odd}});
  const std::string controls = "control characters";
  for (const std::string bad : {"\x1b[2J", "\x7f", "\xc2\x9b", "\a"})
    expect(sample, {{[&](auto& b) { b.files = {bad}; }, controls}, {[&](auto& b) { b.graph = bad; }, controls}});
  const std::string twice = "is there twice";
  expect(sample,
         {{[](auto& b) { b.symbols.push_back("V"); }, twice},
          {[](auto& b) { b.steps.push_back(std::make_unique<StepT>(*b.steps[0])); }, twice},
          {[](auto& b) {
             b.resources.push_back(std::make_unique<ResourceT>(*b.resources[0]));
             b.resources[1]->name = "other";
             b.leaves.push_back(std::make_unique<LeafT>(*b.leaves[0]));
             b.leaves[1]->resource = 1;
           },
           twice},
          {[](auto& b) { b.steps[0]->outputs.push_back(std::make_unique<OutputT>(*b.steps[0]->outputs[0])); }, twice}});
}
