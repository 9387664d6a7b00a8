// SPDX-License-Identifier: Apache-2.0
// What bundles say of resources: tables, rasters, who writes them before whom, what shares memory, and the words that
// runs leave for later ones or for the host.
#include "compiler/backend/bundle/bundle.h"
#include "tests/unit/backend/bundle_sample.h"

using namespace dr::bundle;

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
  expect(sample_with_raster, {{[](auto& b) { b.steps[0]->rasters[0]->resources = {1}; }, "no tag for each face"},
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

// Counts (resource 1, scratch) are cleared, counted in, and read for a value (2).
BundleT sample_with_counts() {
  BundleT b = sample();
  for (const char* name : {"counts", "value"}) {
    b.resources.push_back(std::make_unique<ResourceT>(*b.resources[0]));
    b.resources.back()->name = name;
    b.resources.back()->role = b.resources.size() > 2 ? Role::Value : Role::Scratch;
    b.resources.back()->slot = static_cast<uint32_t>(b.resources.size());
  }
  auto& commands = b.steps[0]->commands;
  const auto add = [&](std::vector<std::pair<uint32_t, Access>> bindings) {
    commands.push_back(std::make_unique<CommandT>(*commands[0]));
    commands.back()->bindings.clear();
    for (const auto& [resource, access] : bindings) {
      commands.back()->bindings.push_back(std::make_unique<BindingT>());
      commands.back()->bindings.back()->resource = resource;
      commands.back()->bindings.back()->access = access;
    }
  };
  add({{1, Access::ReadWrite}});
  add({{1, Access::Read}, {2, Access::Write}});
  CommandT& clear = *commands[0];
  clear.kind = CommandKind::Fill;
  clear.compute = -1;
  clear.elements.clear();
  clear.bindings.clear();
  clear.target = 1;
  b.steps[0]->outputs[0]->resource = 2;
  return b;
}

TEST_CASE("memory is written before it is read") {
  const std::string early = "reads 'counts', which no command before it writes";
  expect(sample_with_counts,
         {{[](auto& b) { b.steps[0]->commands.erase(b.steps[0]->commands.begin()); }, early},
          {[](auto& b) { std::swap(b.steps[0]->commands[0], b.steps[0]->commands[2]); }, early},
          {[](auto& b) { b.resources[2]->slot = b.resources[1]->slot; }, "and writes what shares its memory"},
          {[](auto& b) { b.steps[0]->commands.pop_back(); }, "gives 'value', which none of its commands writes"}});
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

namespace {

// A dispatch that goes on, behind one that clears (0), with the words by which it does so: a watch (1), a guess (2),
// what loops keep between its parts (3), and as how many workgroups it goes on (4).
BundleT sample_with_words() {
  BundleT b = sample();
  b.loop_trips = 1000;
  CommandT& go = command(b);
  go.trips = "V";
  go.most_trips = 1000;
  go.part_trips = 500;
  go.watch = 1;
  go.left = 4;
  for (const auto& [name, role] : {std::pair("watch", Role::Watch), std::pair("guess", Role::Guess),
                                   std::pair("state", Role::Scratch), std::pair("left", Role::Scratch)}) {
    auto r = std::make_unique<ResourceT>(*b.resources[0]);
    r->name = name;
    r->role = role;
    r->slot = static_cast<uint32_t>(b.resources.size());
    r->extent = extent("1");
    go.bindings.push_back(std::make_unique<BindingT>());
    go.bindings.back()->resource = r->slot;
    go.bindings.back()->access = Access::ReadWrite;
    b.resources.push_back(std::move(r));
  }
  b.resources[3]->extent = extent("4 * V");
  b.resources[3]->room = "V - 1000";
  b.resources[4]->extent = extent("8");
  // The last command has no loops.
  auto last = std::make_unique<CommandT>();
  last->kind = CommandKind::Dispatch;
  last->label = "last";
  last->compute = 0;
  last->elements = "V";
  last->bindings.push_back(std::make_unique<BindingT>());
  auto& commands = b.steps[0]->commands;
  commands.push_back(std::move(last));
  auto clear = std::make_unique<CommandT>();
  clear->kind = CommandKind::Fill;
  clear->label = "clear";
  clear->target = 4;
  commands.insert(commands.begin(), std::move(clear));
  return b;
}

Change of(void (*make)(BundleT&), const char* says) { return {make, says}; }

}  // namespace

TEST_CASE("a watch is a word that the command which sets it names") {
  expect(sample_with_words,
         {of([](BundleT& b) { b.resources[1]->extent = extent("2"); }, "is a watch or a guess, and no word"),
          of([](BundleT& b) { b.resources[1]->extent = extent("V"); }, "is a watch or a guess, and no word"),
          of([](BundleT& b) { b.resources[1]->type->rows = 3; }, "is a watch or a guess, and no word"),
          of([](BundleT& b) { command(b, 1).watch = -1; }, "binds a watch that it does not name"),
          of([](BundleT& b) { command(b, 2).bindings[0]->resource = 1; }, "binds a watch that it does not name"),
          of([](BundleT& b) { command(b, 1).watch = 3; }, "binds a watch that it does not name"),
          of([](BundleT& b) { command(b, 1).finite = 2; }, "is watched by what is no watch"),
          of([](BundleT& b) { command(b, 1).finite = 0; }, "is watched by what is no watch"),
          of([](BundleT& b) { command(b, 1).finite = 17; }, "is watched by a resource that it does not bind"),
          of([](BundleT& b) { command(b, 1).finite = -7; }, "is watched by no resource"),
          of([](BundleT& b) { command(b, 2).watch = 1; }, "is watched by a resource that it does not bind"),
          of([](BundleT& b) { b.resources[1]->slot = b.resources[4]->slot; }, "shares memory, but stays"),
          of([](BundleT& b) { b.steps[0]->outputs[0]->resource = 1; }, "names 'watch', no value")});
}

TEST_CASE("a guess is a word that stays, and no result") {
  const auto pin = [](BundleT& b) {
    b.steps[0]->pins.push_back(std::make_unique<OutputT>(*b.steps[0]->outputs[0]));
    b.steps[0]->pins[0]->resource = 2;
  };
  expect(sample_with_words,
         {of([](BundleT& b) { b.resources[2]->extent->h = "2"; }, "is a watch or a guess, and no word"),
          of([](BundleT& b) { b.resources[2]->type->rows = 2; }, "is a watch or a guess, and no word"),
          of([](BundleT& b) { b.resources[2]->storage = Storage::Image; }, "what lives in buffers"),
          of([](BundleT& b) { b.resources[2]->slot = b.resources[3]->slot; }, "shares memory, but stays"),
          of([](BundleT& b) { b.steps[0]->outputs[0]->resource = 2; }, "names 'guess', no value"),
          of(pin, "names 'guess', no value"),
          of([](BundleT& b) { b.resources[2]->room = "V"; }, "does without room that it needs")});
}

TEST_CASE("what loops keep between parts is scratch memory of a command that goes on") {
  expect(sample_with_words,
         {of([](BundleT& b) { b.resources[3]->room = "V -"; }, "which is no expression"),
          of([](BundleT& b) { b.resources[3]->room = "W - 1000"; }, "unknown symbol"),
          of([](BundleT& b) { b.resources[3]->role = Role::Value; }, "does without room that it needs"),
          of([](BundleT& b) { command(b, 1).bindings[3]->access = Access::Read; }, "and does not write it"),
          of([](BundleT& b) { command(b, 1).bindings[3]->access = Access::Write; }, "and does not write it"),
          of(
              [](BundleT& b) {
                command(b, 2).bindings[0]->resource = 3;
                command(b, 2).bindings[0]->access = Access::ReadWrite;
              },
              "has no loops that go on"),
          of([](BundleT& b) { command(b, 1).part_trips = 0; }, "does not say how it goes on"),
          of([](BundleT& b) { command(b, 1).left = -1; }, "does not say how it goes on"),
          of([](BundleT& b) { command(b, 1).left = -7; }, "goes on as a resource says that it does not bind"),
          of([](BundleT& b) { command(b, 1).left = 2; }, "goes on as a value says"),
          of([](BundleT& b) { command(b, 1).bindings[4]->access = Access::Read; }, "goes on as a value says"),
          of([](BundleT& b) { command(b, 1).most_trips = 999; }, "takes other trips at most than the bundle says"),
          of([](BundleT& b) { command(b, 1).most_trips = 0; }, "takes no trips"),
          of([](BundleT& b) { command(b, 1).trips = "V *"; }, "which is no expression")});
}
