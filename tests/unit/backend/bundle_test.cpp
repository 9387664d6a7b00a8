// SPDX-License-Identifier: Apache-2.0
// Bundles: round trip, and refusal of whatever is cut, flipped or makes no sense.
#include "compiler/backend/bundle/bundle.h"

#include <cstdlib>
#include <random>

#include "tests/catch.h"
#include "tests/unit/backend/bundle_samples.h"

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
  CHECK(std::get<std::string>(result) == "the bundle is of version 99, this build reads version " +
                                             std::to_string(kVersion) + ": compile the program again");
}

// A table whose fields beside the version are of other types than this version's.
std::vector<uint8_t> bundle_of_other_tables(uint32_t version) {
  flatbuffers::FlatBufferBuilder builder;
  const auto name = builder.CreateString("a profile");
  const auto start = builder.StartTable();
  builder.AddElement<uint32_t>(Bundle::VT_VERSION, version, 0);
  builder.AddElement<uint64_t>(Bundle::VT_PROFILE, 0xfffffff0fffffff0, 0);
  builder.AddOffset(Bundle::VT_LEAVES, name);
  builder.FinishSizePrefixed(flatbuffers::Offset<Bundle>(builder.EndTable(start)), BundleIdentifier());
  std::vector<uint8_t> bytes(builder.GetBufferPointer(), builder.GetBufferPointer() + builder.GetSize());
  const uint64_t sum = checksum(bytes.data(), bytes.size());
  bytes.resize(bytes.size() + sizeof sum);
  flatbuffers::WriteScalar(bytes.data() + bytes.size() - sizeof sum, sum);
  return bytes;
}

std::string problem_of(std::span<const uint8_t> bytes) {
  const auto result = read(bytes);
  REQUIRE(std::holds_alternative<std::string>(result));
  return std::get<std::string>(result);
}

TEST_CASE("another version is named whatever its tables are, and damage is told from it") {
  const auto bytes = bundle_of_other_tables(kVersion - 1);
  const std::string named = "the bundle is of version " + std::to_string(kVersion - 1);
  CHECK(problem_of(bytes).starts_with(named));
  CHECK(problem_of(bundle_of_other_tables(kVersion)) == "the bundle is damaged or cut off");
  auto damaged = bytes;
  damaged[bytes.size() / 2] ^= 1;
  CHECK(problem_of(damaged) == "the bundle is damaged or cut off");
  // Early versions end where the tables do.
  CHECK(problem_of(std::span(bytes).first(bytes.size() - sizeof(uint64_t))).starts_with(named));
  CHECK(problem_of(std::span(bytes).first(bytes.size() / 2)) == "the bundle is cut off: it has " +
                                                                    std::to_string(bytes.size() / 2) + " of " +
                                                                    std::to_string(bytes.size()) + " bytes");
}

TEST_CASE("what FlatBuffers cannot know is checked") {
  expect(sample,
         {
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
             {[](auto& b) { b.resources[0]->list = static_cast<ListKind>(static_cast<int>(ListKind::MAX) + 1); },
              "an unknown list"},
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

namespace {

// Leaf "face" of whole numbers (0), and a table of it (1).
BundleT sample_with_table() {
  BundleT b = sample();
  b.leaves[0]->kind = LeafKind::Input;
  for (const auto& t : {b.leaves[0]->type.get(), b.resources[0]->type.get()}) {
    t->scalar = Scalar::Int;
    t->rows = 3;
  }
  b.resources.push_back(std::make_unique<ResourceT>(*b.resources[0]));
  b.resources[1]->name = "face.edge";
  b.resources[1]->slot = 1;
  b.leaves.push_back(std::make_unique<LeafT>(*b.leaves[0]));
  LeafT& table = *b.leaves[1];
  table.name = "face.edge";
  table.resource = 1;
  table.table = "edge";
  table.table_of = 0;
  return b;
}

// A raster of two ranks: entries (resource 1).
BundleT sample_with_raster() {
  BundleT b = sample();
  auto r = std::make_unique<ResourceT>(*b.resources[0]);
  r->name = "seen";
  r->role = Role::Value;
  r->type->scalar = Scalar::Uint;
  r->type->rows = 2;
  r->slot = 1;
  b.resources.push_back(std::move(r));
  auto written = std::make_unique<BindingT>();
  written->resource = 1;
  written->access = Access::Write;
  b.steps[0]->commands[0]->bindings.push_back(std::move(written));
  b.steps[0]->rasters.push_back(std::make_unique<RasterResultsT>());
  b.steps[0]->rasters[0]->resources = {1, 1, 1, 1};
  return b;
}

BundleT sample_with_reduce() {
  BundleT b = sample();
  for (const char* name : {"total", "scratch_a", "scratch_b"}) {
    b.resources.push_back(std::make_unique<ResourceT>(*b.resources[0]));
    b.resources.back()->name = name;
    b.resources.back()->role = b.resources.size() > 2 ? Role::Scratch : Role::Value;
    b.resources.back()->slot = static_cast<uint32_t>(b.resources.size());
  }
  CommandT& c = command(b);
  c.kind = CommandKind::Reduce;
  c.elements.clear();
  c.next = c.compute;
  c.outs = c.count = "V";
  c.target = 1;
  c.scratch_a = 2;
  c.scratch_b = 3;
  return b;
}

}  // namespace

TEST_CASE("tables are whole numbers of other leaves") {
  const std::string bad = "is a table, but not of whole numbers that are bound";
  expect(sample_with_table,
         {{[](auto& b) { b.leaves[1]->table_of = 7; }, "a table of a leaf that there is not"},
          {[](auto& b) { b.leaves[1]->table_of = 1; }, "is a table of itself"},
          {[](auto& b) { b.leaves[0]->table_of = 1, b.leaves[0]->table = "edge"; }, "is a table of itself"},
          {[](auto& b) { b.leaves[1]->table_of = -1; }, "is a table of nothing"},
          {[](auto& b) { b.leaves[1]->table_of = -2; }, "is a table of nothing"},
          {[](auto& b) { b.leaves[1]->kind = LeafKind::Param; }, bad},
          {[](auto& b) { b.leaves[0]->kind = LeafKind::State; }, bad},
          {[](auto& b) { b.leaves[0]->type->scalar = b.resources[0]->type->scalar = Scalar::Float; }, bad},
          {[](auto& b) { b.leaves[1]->resource = 0; }, "the resource of another leaf"},
          {[](auto& b) { b.resources[1]->slot = 0; }, "shares memory, but stays"}});
}

TEST_CASE("a raster is entries, or faces and tags") {
  const std::string neither = "holds neither faces nor entries";
  expect(sample_with_raster, {{[](auto& b) {
                                 b.steps[0]->rasters[0]->resources = {1, 1, 1};
                               },
                               "no tag for each face"},
                              {[](auto& b) { b.steps[0]->rasters[0]->resources.clear(); }, "no tag for each face"},
                              {[](auto& b) {
                                 b.steps[0]->rasters[0]->resources = {1, 0};
                               },
                               neither},
                              {[](auto& b) {
                                 b.steps[0]->rasters[0]->resources = {1, 9};
                               },
                               "names resource 9"},
                              {[](auto& b) { b.resources[1]->type->rows = 1; }, neither}});
}

TEST_CASE("a raster's bits are of a picture of some width") {
  const auto sample_with_bits = [] {
    BundleT b = sample_with_raster();
    b.resources[1]->type->rows = 1;
    b.steps[0]->rasters[0]->resources = {1, 1};
    b.steps[0]->rasters[0]->width = "32 * V - 1";
    return b;
  };
  const std::string other = "has a width, or bits without one";
  expect(sample_with_bits, {{[](auto& b) { b.steps[0]->rasters[0]->width.clear(); }, other},
                            {[](auto& b) { b.steps[0]->rasters[0]->width = "32 *"; }, "which is no expression"},
                            {[](auto& b) { b.steps[0]->rasters[0]->width = "Q"; }, "uses the unknown symbol 'Q'"},
                            {[](auto& b) { b.resources[1]->type->rows = 2; }, other},
                            {[](auto& b) {
                               b.steps[0]->rasters[0]->resources = {1, 0};
                             },
                             "holds neither faces nor entries"}});
}

TEST_CASE("entries with epochs are a raster's own, and shaders alone touch them") {
  const auto sample_with_epochs = [] {
    BundleT b = sample_with_raster();
    b.resources[1]->role = Role::EpochEntries;
    return b;
  };
  expect(+sample_with_epochs, {{[](auto& b) { b.resources[1]->type->rows = 1; }, "has epochs, and is no entries"},
                               {[](auto& b) { b.resources[1]->slot = 0; }, "shares memory, but stays"},
                               {[](auto& b) { b.steps[0]->outputs[0]->resource = 1; }, "names 'seen', no value"},
                               {[](auto& b) {
                                  auto fill = std::make_unique<CommandT>(*b.steps[0]->commands[0]);
                                  fill->kind = CommandKind::Fill;
                                  fill->compute = -1;
                                  fill->elements.clear();
                                  fill->bindings.clear();
                                  fill->target = 1;
                                  b.steps[0]->commands.insert(b.steps[0]->commands.begin(), std::move(fill));
                                },
                                "touches 'seen', whose epochs only shaders know"}});
}

TEST_CASE("a reduction keeps apart what it reads and what it writes") {
  expect(sample_with_reduce, {{[](auto& b) { command(b).scratch_b = 2; }, "where it writes others"},
                              {[](auto& b) { command(b).target = 3; }, "where it writes others"},
                              {[](auto& b) { command(b).target = 17; }, "names resource 17"},
                              {[](auto& b) { command(b).scratch_a = -1; }, "names resource -1"},
                              {[](auto& b) { b.resources[2]->role = Role::Value; }, "no scratch memory"},
                              {[](auto& b) { command(b).bindings[0]->resource = 1; }, "writes what it reads"},
                              {[](auto& b) { command(b).outs = ""; }, "no expression"},
                              {[](auto& b) { command(b).next = 1; }, "shader 1"}});
}

namespace {

// Two subpasses: the first writes the tile "t" (resource 1), the second reads it and writes the image "u" (2).
BundleT sample_with_tile() {
  BundleT b = sample();
  for (const auto& [name, storage] : {std::pair("t", Storage::Tile), std::pair("u", Storage::Image)}) {
    auto r = std::make_unique<ResourceT>(*b.resources[0]);
    r->name = name;
    r->storage = storage;
    r->role = Role::Value;
    r->slot = static_cast<uint32_t>(b.resources.size());
    b.resources.push_back(std::move(r));
  }
  for (const Stage stage : {Stage::Vertex, Stage::Fragment}) {
    b.shaders.push_back(std::make_unique<ShaderT>(*b.shaders[0]));
    b.shaders.back()->stage = stage;
  }
  for (const uint32_t color : {1u, 2u}) {
    auto c = std::make_unique<CommandT>();
    c->kind = CommandKind::Draw;
    c->label = "draw";
    c->vertex = 1;
    c->fragment = 2;
    c->elements = "3";
    c->extent = extent("V + 1");
    c->colors = {color};
    c->clear = {0};
    b.steps[0]->commands.push_back(std::move(c));
  }
  CommandT& last = *b.steps[0]->commands.back();
  last.joins = true;
  last.inputs = {1};
  last.bindings.push_back(std::make_unique<BindingT>());
  last.bindings[0]->resource = 1;
  return b;
}

}  // namespace

TEST_CASE("a tile is read by later subpasses of its render pass and by nothing else") {
  const std::string wanted = "'t', which lives in a render pass alone";
  const auto copy = [](BundleT& b) {
    auto c = std::make_unique<CommandT>();
    c->kind = CommandKind::Copy;
    c->label = "copy";
    c->source = 1;
    c->target = 0;
    b.steps[0]->changes = {0};
    b.steps[0]->commands.push_back(std::move(c));
  };
  expect(sample_with_tile,
         {{[](auto& b) { b.steps[0]->outputs[0]->resource = 1; }, "output 'y' names " + wanted},
          {[](auto& b) {
             b.steps[0]->pins.push_back(std::make_unique<OutputT>(*b.steps[0]->outputs[0]));
             b.steps[0]->pins[0]->resource = 1;
           },
           "pinned value 'y' names " + wanted},
          {[](auto& b) {
             b.steps[0]->rasters.push_back(std::make_unique<RasterResultsT>());
             b.steps[0]->rasters[0]->resources = {1, 1};
           },
           wanted},
          {[](auto& b) { command(b).bindings[0]->resource = 1; }, "command 'pass' names " + wanted},
          {[](auto& b) { command(b, 2).inputs.clear(); }, "command 'draw' names " + wanted},
          {[](auto& b) { command(b, 2).joins = false; }, "no subpass before it"},
          {[](auto& b) { command(b, 1).joins = true; }, "joins a render pass of another kind"},
          {[](auto& b) { std::swap(command(b, 1).colors, command(b, 2).colors); }, "that it writes"},
          {[](auto& b) {
             command(b, 2).inputs = {1, 1};
           },
           "input attachment that no subpass wrote"},
          {[](auto& b) { command(b, 2).colors = {1}; }, "that it writes"},
          {[](auto& b) {
             command(b, 1).colors = {1, 1}, command(b, 1).clear = {0, 0};
           },
           "a second time"},
          {[](auto& b) { command(b, 1).clear.clear(); }, "no clear value"},
          {[](auto& b) { command(b, 2).leaves = {0}; }, "other leaves than the render pass"},
          {copy, "command 'copy' names " + wanted},
          {[](auto& b) { b.resources[2]->slot = b.resources[1]->slot; }, "memory with one of another storage"}});
  BundleT b = sample_with_tile();
  copy(b);
  b.resources[1]->storage = Storage::Image;
  CHECK(check(b).empty());
}

TEST_CASE("an image is drawn before it is read") {
  expect(sample_with_tile, {{[](auto& b) {
                               b.resources[1]->storage = Storage::Image;
                               command(b).bindings[0]->resource = 1;
                             },
                             "reads 't', which no command before it writes"},
                            {[](auto& b) {
                               b.steps[0]->commands.resize(1);
                               b.steps[0]->outputs[0]->resource = 2;
                             },
                             "gives 'u', which none of its commands writes"}});
}
