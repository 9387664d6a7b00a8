// SPDX-License-Identifier: Apache-2.0
// The runner of the back end's passes: what it demands of their order, and what it does with one that breaks a
// schedule.
#include "compiler/backend/pipeline.h"

#include <algorithm>
#include <vector>

#include "compiler/backend/plan/show.h"
#include "compiler/backend/schedule/text.h"
#include "compiler/ir/internal_error.h"
#include "compiler/ir/parse.h"
#include "tests/catch.h"

using namespace dr;
using namespace dr::backend;
using Catch::Matchers::Contains;

namespace {

constexpr std::string_view kGraph = R"(leaf a : float[V] param
%0 : float[V] = leaf text "a"
%1 : float[V] = exp %0
%2 : float = reduce_sum %1 ints [1, 1, 1]
step go {
  output total %2
}
)";

struct Fixture {
  ir::Graph graph = std::get<ir::Graph>(ir::parse(std::string(kGraph)));
  target::Profile profile = std::get<target::Profile>(target::load_profile("lavapipe"));
  CompileOptions options;

  std::string error_of(const std::vector<BackendPass>& passes) {
    Compilation compilation(graph, profile, options);
    try {
      run_backend(compilation, passes);
    } catch (const ir::InternalError& error) {
      return error.what();
    }
    return "none";
  }
  std::vector<BackendPass> without(std::string_view name) const {
    std::vector<BackendPass> out(backend_passes().begin(), backend_passes().end());
    std::erase_if(out, [&](const BackendPass& pass) { return pass.name == name; });
    return out;
  }
};

std::optional<Limit> forget_a_write(Compilation& compilation) {
  compilation.out.schedule.steps[0].passes[0].writes.clear();
  return std::nullopt;
}

}  // namespace

TEST_CASE_METHOD(Fixture, "all passes run in the order of the table") {
  std::vector<std::string> seen, expected;
  size_t schedules = 0;
  options.hooks.verify_each = true;
  options.hooks.after = [&](std::string_view name, const ir::Graph&, const Schedule* schedule, const bundle::BundleT&,
                            double milliseconds) {
    seen.emplace_back(name);
    schedules += schedule != nullptr;
    CHECK(milliseconds >= 0);
  };
  for (const BackendPass& pass : backend_passes()) expected.emplace_back(pass.name);
  CHECK(error_of({backend_passes().begin(), backend_passes().end()}) == "none");
  CHECK(seen == expected);
  CHECK(schedules == 19);  // up to check-limits
}

TEST_CASE_METHOD(Fixture, "a pass without what it needs is named, with what is missing") {
  CHECK_THAT(error_of(without("choose-sums")), Contains("pass update-in-place needs 'sums chosen'"));
  CHECK_THAT(error_of(without("choose-code")), Contains("pass empty-sums needs 'code chosen'"));
  CHECK_THAT(error_of(without("check-limits")), Contains("pass emit needs 'lowered'"));
  CHECK_THAT(error_of(without("find-dependencies")), Contains("pass clear-together needs 'dependencies'"));
}

TEST_CASE_METHOD(Fixture, "a pass that comes too late is named") {
  auto passes = without("choose-sums");
  const auto list = std::ranges::find(passes, "list-where-computed", &BackendPass::name);
  const auto sums = *std::ranges::find(backend_passes(), "choose-sums", &BackendPass::name);
  list->needs = 0;
  passes.erase(passes.begin() + 1, list);
  passes.insert(passes.begin() + 2, sums);
  CHECK_THAT(error_of(passes), Contains("pass choose-sums has to run before 'places of passes fixed'"));
}

TEST_CASE_METHOD(Fixture, "a schedule that a pass breaks is an internal error with pass, place and dump") {
  options.hooks.verify_each = true;
  const auto facts = static_cast<Facts>(Fact::Packed);
  const std::string error = error_of({backend_passes()[0], {"forget-a-write", forget_a_write, facts}});
  CHECK_THAT(error, Contains("schedule fails verification after pass forget-a-write"));
  CHECK_THAT(error, Contains("step go, pass reduce_sum: reads 'exp' before it is written"));
  CHECK_THAT(error, Contains("step go {\n"));
}

TEST_CASE_METHOD(Fixture, "passes stop where they are told to") {
  std::string last;
  options.hooks.stop_after = "keep-in-tiles";
  options.hooks.after = [&](std::string_view name, const ir::Graph&, const Schedule*, const bundle::BundleT&, double) {
    last = name;
  };
  CHECK(error_of({backend_passes().begin(), backend_passes().end()}) == "none");
  CHECK(last == "keep-in-tiles");
}

TEST_CASE_METHOD(Fixture, "every pass can be stopped after, dumped and verified") {
  options.hooks.verify_each = true;
  for (const BackendPass& pass : backend_passes()) {
    INFO(pass.name);
    std::string last, dump;
    options.hooks.stop_after = pass.name;
    options.hooks.after = [&](std::string_view name, const ir::Graph& of, const Schedule* schedule,
                              const bundle::BundleT& bundle, double) {
      last = name;
      dump = schedule ? print_whole(of, *schedule) : show(bundle);
    };
    options.hooks.break_after.clear();
    CHECK(error_of({backend_passes().begin(), backend_passes().end()}) == "none");
    CHECK(last == pass.name);
    CHECK_THAT(dump, Contains("step go"));
    options.hooks.break_after = pass.name;
    CHECK_THAT(error_of({backend_passes().begin(), backend_passes().end()}),
               Contains("fails verification after pass " + std::string(pass.name)) && Contains("step go"));
  }
}
