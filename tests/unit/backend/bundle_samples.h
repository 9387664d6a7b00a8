// SPDX-License-Identifier: Apache-2.0
// A small sound bundle, and changes of it that are not.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "compiler/backend/bundle/bundle.h"
#include "tests/catch.h"

namespace dr::bundle {

inline std::unique_ptr<ExtentT> extent(const char* w) {
  auto e = std::make_unique<ExtentT>();
  e->w = w;
  e->h = e->l = "1";
  return e;
}

inline BundleT sample() {
  BundleT b;
  b.version = kVersion;
  b.profile = "lavapipe";
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
  step->leaves = {0};
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

// A change of a bundle, and what check() says of it.
struct Change {
  std::function<void(BundleT&)> make;
  std::string says;
};

inline void expect(BundleT (*start)(), const std::vector<Change>& changes) {
  CHECK(check(start()).empty());
  for (const Change& change : changes) {
    BundleT b = start();
    change.make(b);
    const std::string said = check(b);
    INFO("expected: " << change.says << "\n  found: " << said);
    CHECK(said.find(change.says) != std::string::npos);
    CHECK_FALSE(said.empty());
  }
}

inline CommandT& command(BundleT& b, size_t k = 0) { return *b.steps[0]->commands[k]; }

}  // namespace dr::bundle
