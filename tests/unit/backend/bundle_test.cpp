// SPDX-License-Identifier: Apache-2.0
// Bundles: round trip, and refusal of whatever is cut, flipped or makes no sense.
#include "compiler/backend/bundle/bundle.h"

#include <cstdlib>
#include <random>

#include "tests/catch.h"

using namespace dr::bundle;

namespace {

std::unique_ptr<ExtentT> extent(const char* w) {
  auto e = std::make_unique<ExtentT>();
  e->w = w;
  e->h = e->l = "1";
  return e;
}

BundleT sample() {
  BundleT b;
  b.version = kVersion;
  b.profile = "lavapipe";
  b.float_profile = "strict";
  b.lowering = "fused,compute,compute";
  b.symbols = {"V"};
  auto r = std::make_unique<ResourceT>();
  r->name = "x";
  r->role = Role::Leaf;
  r->type = std::make_unique<TypeT>();
  r->type->scalar = Scalar::Float;
  r->extent = extent("V + 1");
  b.resources.push_back(std::move(r));
  auto l = std::make_unique<LeafT>();
  l->name = "x";
  l->type = std::make_unique<TypeT>();
  l->type->scalar = Scalar::Float;
  l->extent = extent("V + 1");
  b.leaves.push_back(std::move(l));
  auto s = std::make_unique<ShaderT>();
  s->name = "main";
  s->stage = Stage::Compute;
  s->spirv = {0x07230203u, 0x10300u, 0, 8, 0, 1, 2, 3};
  b.shaders.push_back(std::move(s));
  auto step = std::make_unique<StepT>();
  step->name = "go";
  auto c = std::make_unique<CommandT>();
  c->kind = CommandKind::Dispatch;
  c->label = "pass";
  c->compute = 0;
  c->elements = "V";
  auto binding = std::make_unique<BindingT>();
  c->bindings.push_back(std::move(binding));
  step->commands.push_back(std::move(c));
  auto o = std::make_unique<OutputT>();
  o->name = "y";
  step->outputs.push_back(std::move(o));
  b.steps.push_back(std::move(step));
  return b;
}

std::string problem(const BundleT& b) { return check(b); }

}  // namespace

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

TEST_CASE("another version is named") {
  BundleT b = sample();
  b.version = 99;
  const auto result = read(write(b));
  REQUIRE(std::holds_alternative<std::string>(result));
  CHECK(std::get<std::string>(result).find("version 99") != std::string::npos);
}

TEST_CASE("what FlatBuffers cannot know is checked") {
  BundleT b = sample();
  CHECK(problem(b).empty());
  b.resources[0]->extent->w = "Q";
  CHECK(problem(b).find("unknown symbol 'Q'") != std::string::npos);
  b = sample();
  b.resources[0]->extent->w = "V +";
  CHECK(problem(b).find("no expression") != std::string::npos);
  b = sample();
  b.steps[0]->commands[0]->compute = 3;
  CHECK(problem(b).find("shader 3") != std::string::npos);
  b = sample();
  b.steps[0]->commands[0]->bindings[0]->resource = 5;
  CHECK_FALSE(problem(b).empty());
  b = sample();
  b.shaders[0]->spirv[0] = 1;
  CHECK(problem(b).find("not SPIR-V") != std::string::npos);
  b = sample();
  b.leaves[0]->initial = {1, 2};
  CHECK(problem(b).find("initial value") != std::string::npos);
  b = sample();
  b.op_lines = {Line(0, 0), Line(static_cast<uint32_t>(b.files.size()), 1)};
  CHECK(problem(b).find("a file that there is not") != std::string::npos);
  b = sample();
  b.steps[0]->commands[0]->joins = true;
  CHECK(problem(b).find("joins no render pass") != std::string::npos);
  b = sample();
  b.steps[0]->commands[0]->inputs = {0};
  CHECK(problem(b).find("no subpass before it") != std::string::npos);
  b = sample();
  b.steps[0]->commands.push_back(std::make_unique<CommandT>(*b.steps[0]->commands[0]));
  b.steps[0]->commands[1]->joins = true;
  CHECK(problem(b).find("joins a render pass of another kind") != std::string::npos);
  b = sample();
  b.steps[0]->commands[0]->lines = {Line(0, 3)};
  CHECK(problem(b).find("line 3 of file 0") != std::string::npos);
  b = sample();
  b.resources.push_back(std::make_unique<ResourceT>(*b.resources[0]));
  b.resources[1]->storage = Storage::Image;
  CHECK(problem(b).find("memory with one of another storage") != std::string::npos);
  b = sample();
  b.steps[0]->outputs[0]->resource = 1;
  CHECK(problem(b).find("output 'y'") != std::string::npos);
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
  BundleT b = sample_with_tile();
  CHECK(problem(b).empty());
  b.steps[0]->outputs[0]->resource = 1;
  CHECK(problem(b).find("output 'y' names " + wanted) != std::string::npos);
  b = sample_with_tile();
  b.steps[0]->pins.push_back(std::make_unique<OutputT>(*b.steps[0]->outputs[0]));
  b.steps[0]->pins[0]->resource = 1;
  CHECK(problem(b).find("pinned value 'y' names " + wanted) != std::string::npos);
  b = sample_with_tile();
  b.steps[0]->rasters.push_back(std::make_unique<RasterResultsT>());
  b.steps[0]->rasters[0]->resources = {1};
  CHECK(problem(b).find(wanted) != std::string::npos);
  b = sample_with_tile();
  b.steps[0]->commands[0]->bindings[0]->resource = 1;
  CHECK(problem(b).find("command 'pass' names " + wanted) != std::string::npos);
  b = sample_with_tile();
  b.steps[0]->commands[2]->inputs.clear();
  CHECK(problem(b).find("command 'draw' names " + wanted) != std::string::npos);
  // The same reads of another render pass.
  b = sample_with_tile();
  b.steps[0]->commands[2]->joins = false;
  CHECK(problem(b).find("no subpass before it") != std::string::npos);
  b = sample_with_tile();
  std::swap(b.steps[0]->commands[1]->colors, b.steps[0]->commands[2]->colors);
  CHECK(problem(b).find("input attachment that no subpass wrote") != std::string::npos);
  b = sample_with_tile();
  auto copy = std::make_unique<CommandT>();
  copy->kind = CommandKind::Copy;
  copy->label = "copy";
  copy->source = 1;
  copy->target = 0;
  b.steps[0]->commands.push_back(std::move(copy));
  CHECK(problem(b).find("command 'copy' names " + wanted) != std::string::npos);
  b.resources[1]->storage = Storage::Image;
  CHECK(problem(b).empty());
  b = sample_with_tile();
  b.resources[2]->slot = b.resources[1]->slot;
  CHECK(problem(b).find("memory with one of another storage") != std::string::npos);
}
