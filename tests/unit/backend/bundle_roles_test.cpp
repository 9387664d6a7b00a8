// SPDX-License-Identifier: Apache-2.0
// What memory is for: what is written before it is read, what stays between runs, and what loops keep between parts.
#include "compiler/backend/bundle/bundle.h"
#include "tests/catch.h"
#include "tests/unit/backend/bundle_samples.h"

using namespace dr::bundle;

namespace {

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

// Word 1, a watch or a guess, bound by a dispatch.
BundleT sample_with_word(Role role) {
  BundleT b = sample();
  b.resources.push_back(std::make_unique<ResourceT>(*b.resources[0]));
  ResourceT& word = *b.resources[1];
  word.name = "word";
  word.role = role;
  word.type->scalar = Scalar::Uint;
  word.extent = extent("1");
  word.slot = 1;
  CommandT& pass = command(b);
  pass.bindings.push_back(std::make_unique<BindingT>());
  pass.bindings[1]->resource = 1;
  pass.bindings[1]->access = Access::ReadWrite;
  if (role == Role::Watch) pass.finite = 1;
  return b;
}

BundleT sample_with_watch() { return sample_with_word(Role::Watch); }
BundleT sample_with_guess() { return sample_with_word(Role::Guess); }

// A dispatch whose loops go on: resource 1 is what they keep, and 2 how many groups are left.
BundleT sample_with_parts() {
  BundleT b = sample();
  CommandT& pass = command(b);
  for (const char* name : {"loops", "left"}) {
    b.resources.push_back(std::make_unique<ResourceT>(*b.resources[0]));
    ResourceT& r = *b.resources.back();
    r.name = name;
    r.role = Role::Scratch;
    r.room = "V - 4";
    r.slot = static_cast<uint32_t>(b.resources.size()) - 1;
    pass.bindings.push_back(std::make_unique<BindingT>());
    pass.bindings.back()->resource = r.slot;
    pass.bindings.back()->access = Access::ReadWrite;
  }
  b.loop_trips = 4;
  pass.trips = "V";
  pass.most_trips = pass.part_trips = 4;
  pass.left = 2;
  return b;
}

}  // namespace

TEST_CASE("memory is written before it is read") {
  const std::string early = "reads 'counts', which no command before it writes";
  expect(sample_with_counts,
         {{[](auto& b) { b.steps[0]->commands.erase(b.steps[0]->commands.begin()); }, early},
          {[](auto& b) { std::swap(b.steps[0]->commands[0], b.steps[0]->commands[2]); }, early},
          {[](auto& b) { b.resources[2]->slot = b.resources[1]->slot; }, "and writes what shares its memory"},
          {[](auto& b) { b.steps[0]->commands.pop_back(); }, "gives 'value', which none of its commands writes"}});
}

TEST_CASE("words that stay are words, shared with none and given to nobody") {
  const std::vector<Change> both = {
      {[](auto& b) { b.resources[1]->extent = extent("V"); }, "is a watch or a guess, and no word"},
      {[](auto& b) { b.resources[1]->type->rows = 2; }, "is a watch or a guess, and no word"},
      {[](auto& b) { b.resources[1]->slot = 0; }, "shares memory, but stays"},
      {[](auto& b) { b.steps[0]->outputs[0]->resource = 1; }, "names 'word', no value"},
      {[](auto& b) { b.resources[1]->room = "V"; }, "does without room that it needs"}};
  expect(sample_with_watch, both);
  expect(sample_with_guess, both);
}

TEST_CASE("words of zeros are a buffer of their own") {
  const auto sample_with_zeros = [] {
    BundleT b = sample_with_guess();
    b.resources[1]->role = Role::Zeros;
    b.resources[1]->extent = extent("V");
    return b;
  };
  expect(+sample_with_zeros, {{[](auto& b) { b.resources[1]->slot = 0; }, "shares memory, but stays"},
                              {[](auto& b) { b.steps[0]->outputs[0]->resource = 1; }, "names 'word', no value"},
                              {[](auto& b) { b.resources[1]->room = "V"; }, "does without room that it needs"}});
}

TEST_CASE("a watch is bound by the command that names it") {
  expect(sample_with_watch,
         {{[](auto& b) { command(b).finite = -1; }, "binds a watch that it does not name"},
          {[](auto& b) { command(b).watch = 0; }, "is watched by what is no watch"},
          {[](auto& b) { command(b).bindings.pop_back(); }, "is watched by a resource that it does not bind"},
          {[](auto& b) { command(b).watch = -2; }, "is watched by no resource"}});
  expect(sample_with_guess, {{[](auto& b) { command(b).finite = 1; }, "is watched by what is no watch"}});
}

TEST_CASE("what loops keep is scratch memory of a dispatch whose loops go on") {
  expect(sample_with_parts, {{[](auto& b) { b.resources[1]->role = Role::Value; }, "does without room that it needs"},
                             {[](auto& b) { b.resources[1]->room = "V -"; }, "resource 'loops'"},
                             {[](auto& b) { command(b).bindings[1]->access = Access::Read; }, "and does not write it"},
                             {[](auto& b) { command(b).left = -1; }, "does not say how it goes on"},
                             {[](auto& b) { command(b).left = 0; }, "goes on as a value says"},
                             {[](auto& b) {
                                command(b).part_trips = 0;
                                command(b).left = -1;
                              },
                              "no loops that go on, and touches 'loops'"}});
}
