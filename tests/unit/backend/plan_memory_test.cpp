// SPDX-License-Identifier: Apache-2.0
// Memory plans: sound on random command lists and close to what is needed; updates in place only where nothing needs
// the old value.
#include "compiler/backend/plan/plan_memory.h"

#include <random>

#include "compiler/backend/compile.h"
#include "compiler/backend/lowering/update_in_place.h"
#include "compiler/ir/parse.h"
#include "tests/catch.h"

using namespace dr;
using namespace dr::backend;

namespace {

std::unique_ptr<bundle::ResourceT> resource(const std::string& name, bundle::Storage storage, const std::string& w) {
  auto r = std::make_unique<bundle::ResourceT>();
  r->name = name;
  r->storage = storage;
  r->role = bundle::Role::Value;
  r->type = std::make_unique<bundle::TypeT>();
  r->type->scalar = bundle::Scalar::Float;
  r->extent = std::make_unique<bundle::ExtentT>();
  r->extent->w = w;
  r->extent->h = r->extent->l = "1";
  return r;
}

void access(bundle::CommandT& c, uint32_t r, bundle::Access how) {
  auto b = std::make_unique<bundle::BindingT>();
  b->resource = r;
  b->access = how;
  c.bindings.push_back(std::move(b));
}

// Steps of commands that each write a few new values and read some earlier ones.
bundle::BundleT random_bundle(std::mt19937_64& random) {
  static const char* const kSizes[] = {"W", "2 * W", "W * H", "3 * W * H", "V", "(W + 1) / 2", "7", "W * H * N"};
  bundle::BundleT b;
  b.symbols = {"H", "N", "V", "W"};
  for (int s = 0; s < 2; ++s) {
    auto step = std::make_unique<bundle::StepT>();
    std::vector<uint32_t> made;
    for (int k = 0; k < 12; ++k) {
      auto c = std::make_unique<bundle::CommandT>();
      for (uint64_t n = random() % 3; n > 0 && !made.empty(); --n)
        access(*c, made[random() % made.size()], bundle::Access::Read);
      std::vector<uint32_t> now;
      for (uint64_t n = random() % 3; n > 0; --n) {
        const auto id = static_cast<uint32_t>(b.resources.size());
        const auto storage = random() % 4 == 0 ? bundle::Storage::Image : bundle::Storage::Buffer;
        b.resources.push_back(resource("r" + std::to_string(id), storage, kSizes[random() % 8]));
        access(*c, id, bundle::Access::Write);
        now.push_back(id);
      }
      made.insert(made.end(), now.begin(), now.end());
      step->commands.push_back(std::move(c));
    }
    if (!made.empty() && random() % 2 == 0) {
      auto o = std::make_unique<bundle::OutputT>();
      o->resource = made[random() % made.size()];
      step->outputs.push_back(std::move(o));
    }
    b.steps.push_back(std::move(step));
  }
  return b;
}

ir::Graph parse(const std::string& text) {
  auto parsed = ir::parse(text);
  if (auto* error = std::get_if<ir::ParseError>(&parsed)) FAIL("line " << error->line << ": " << error->message);
  return std::move(std::get<ir::Graph>(parsed));
}

// Names of the leaves that are updated in place.
std::string in_place(const std::string& text, bool fused = true) {
  const ir::Graph graph = parse(text);
  const auto profile = std::get<target::Profile>(target::load_profile("lavapipe"));
  PackOptions options;
  options.fused = fused;
  Schedule schedule = pack(graph, profile, options);
  const size_t before = schedule.resources.size();
  update_in_place(graph, schedule);
  std::string names;
  size_t count = 0;
  for (const auto& [leaf, value] : schedule.steps[0].updates)
    if (schedule.steps[0].stored.at(value).index == leaf) {
      names += graph.leaves[leaf].name;
      ++count;
    }
  CHECK(schedule.resources.size() == before - count);
  for (const Violation& problem : check_schedule(graph, schedule, profile)) FAIL(problem.text);
  return names;
}

const std::string kTwoLeaves =
    "leaf p : float[V] param\nleaf q : float[V] param\nleaf i : int[V] input\n"
    "%0 : float[V] = leaf text \"p\"\n%1 : float[V] = leaf text \"q\"\n%2 : int[V] = leaf text \"i\"\n";

}  // namespace

TEST_CASE("random programs get sound plans between the least and one slot for each") {
  std::mt19937_64 random(11);
  double planned = 0, least = 0;
  for (int k = 0; k < 500; ++k) {
    bundle::BundleT b = random_bundle(random);
    plan_memory(b);
    for (const std::string& problem : check_memory(b)) FAIL(problem);
    const auto use = memory_use(b, {{"W", 640}, {"H", 480}, {"V", 2000}, {"N", 3}});
    REQUIRE(use);
    CHECK(use->planned >= use->lower_bound);
    CHECK(use->planned <= use->unshared);
    planned += static_cast<double>(use->planned);
    least += static_cast<double>(use->lower_bound);
  }
  INFO("planned " << planned / least << " times what is needed at least");
  CHECK(planned <= 1.30 * least);  // the least mixes buffers and images, and knows the symbols' values
}

TEST_CASE("a plan that lets two needed values share memory is told") {
  std::mt19937_64 random(3);
  int told = 0;
  for (int k = 0; k < 20; ++k) {
    bundle::BundleT b = random_bundle(random);
    for (auto& r : b.resources) r->slot = 0;
    told += check_memory(b).empty() ? 0 : 1;
  }
  CHECK(told == 20);
}

// A value is written and read; loops of a later command keep their state in `loops`, which the first of its dispatches
// writes. The command before may touch that state, too.
bundle::BundleT bundle_with_loops(bool overlap) {
  bundle::BundleT b;
  b.symbols = {"V"};
  b.resources.push_back(resource("value", bundle::Storage::Buffer, "V"));
  b.resources.push_back(resource("loops", bundle::Storage::Buffer, "V"));
  b.resources[1]->role = bundle::Role::Scratch;
  b.resources[1]->room = "V - 4";
  b.steps.push_back(std::make_unique<bundle::StepT>());
  auto& commands = b.steps[0]->commands;
  for (int k = 0; k < 3; ++k) commands.push_back(std::make_unique<bundle::CommandT>());
  access(*commands[0], 0, bundle::Access::Write);
  access(*commands[1], 0, bundle::Access::Read);
  access(*commands[overlap ? 1 : 2], 1, bundle::Access::ReadWrite);
  return b;
}

TEST_CASE("what loops keep between parts shares memory with what is over before, and with nothing else") {
  for (const bool overlap : {false, true}) {
    bundle::BundleT b = bundle_with_loops(overlap);
    plan_memory(b);
    CHECK((b.resources[0]->slot == b.resources[1]->slot) == !overlap);
    for (const std::string& problem : check_memory(b)) FAIL(problem);
    b.resources[1]->slot = b.resources[0]->slot;
    CHECK(check_memory(b).empty() == !overlap);
    // Where nothing is held, a word is enough.
    CHECK(memory_use(b, {{"V", 4}})->planned == 16);
    CHECK(memory_use(b, {{"V", 4}})->unshared == 20);
  }
}

TEST_CASE("sizes that need a symbol's value are not guessed") {
  std::mt19937_64 random(5);
  const bundle::BundleT b = random_bundle(random);
  CHECK_FALSE(memory_use(b, {{"W", 640}}));
}

TEST_CASE("an update is written in place where nothing needs the old value") {
  // Element by element.
  CHECK(in_place(kTwoLeaves + "%3 : float[V] = exp %0\nstep go {\n  update p %3\n}\n") == "p");
  // Two that read each other at the same element, in one pass.
  CHECK(in_place(kTwoLeaves +
                 "%3 : float[V] = exp %1\n%4 : float[V] = exp %0\nstep go {\n  update p %3\n  update q %4\n}\n") ==
        "pq");
  // In passes of their own the first would overwrite what the second reads.
  CHECK(in_place(
            kTwoLeaves + "%3 : float[V] = exp %1\n%4 : float[V] = exp %0\nstep go {\n  update p %3\n  update q %4\n}\n",
            false) == "q");
  // At other places.
  CHECK(in_place(kTwoLeaves + "%3 : float[V] = gather %0, %2\nstep go {\n  update p %3\n}\n") == "");
  // An output of the new value, or of the old one.
  CHECK(in_place(kTwoLeaves + "%3 : float[V] = exp %0\nstep go {\n  output y %3\n  update p %3\n}\n") == "");
  CHECK(in_place(kTwoLeaves + "%3 : float[V] = exp %0\nstep go {\n  output y %0\n  update p %3\n}\n") == "");
  // A swap, and one value for two leaves.
  CHECK(in_place(kTwoLeaves + "step go {\n  update p %1\n  update q %0\n}\n") == "");
  CHECK(in_place(kTwoLeaves + "%3 : float[V] = exp %0\nstep go {\n  update p %3\n  update q %3\n}\n") == "");
  // A later pass gathers the old value; one that gathers another leaf does not matter.
  const std::string later =
      "%3 : float[V] = exp %0\n%4 : float = reduce_sum %1 ints [1, 1, 1]\n%5 : float[V] = mul %4, %1\n";
  CHECK(in_place(kTwoLeaves + later + "%6 : float[V] = gather %0, %2\n%7 : float[V] = add %6, %5\n" +
                 "step go {\n  output y %7\n  update p %3\n}\n") == "");
  CHECK(in_place(kTwoLeaves + later + "step go {\n  output y %5\n  update p %3\n}\n") == "p");
  // A reduction's result over the leaf's own extent comes from other places.
  CHECK(in_place("leaf s : float param\n%0 : float = leaf text \"s\"\n%1 : float = reduce_sum %0 ints [1, 1, 1]\n"
                 "step go {\n  update s %1\n}\n") == "");
}
