// SPDX-License-Identifier: Apache-2.0
// What the library's functions take says its type, so that a wrong argument is told at the call. What has none has a
// reason here: a number, a vector or an image of them, never a struct.
#include <algorithm>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <set>

#include "dsl/syntax/parser.h"
#include "tests/catch.h"

using namespace dr;

namespace {

struct Untyped {
  const char* module;
  std::vector<const char*> params;
  const char* why;
};

constexpr const char* kColour = "of the type that the colours have, one value or an image";
constexpr const char* kAny = "numbers or vectors, one value or an image, each for itself";

const std::vector<Untyped>& untyped() {
  static const std::vector<Untyped> kAll = {
      {"coverage.dr", {"background"}, kColour},
      {"hardsoftras.dr", {"background"}, kColour},
      {"strands.dr", {"background", "opacity"}, kColour},
      {"features.dr", {"k"}, "known to the compiler, or the number of a trip"},
      {"loss.dr", {"a", "b", "x", "delta", "mask", "color", "background", "peak"}, kAny},
      {"optim.dr", {"rate", "decay", "beta1", "beta2", "epsilon", "a", "b", "g", "x", "low", "high"}, kAny},
      {"solve.dr", {"start", "residual", "b", "x", "rest", "g"}, kAny},
  };
  return kAll;
}

bool has_reason(const std::string& module, const std::string& param) {
  return std::ranges::any_of(untyped(), [&](const Untyped& u) {
    return u.module == module && std::ranges::find(u.params, param) != u.params.end();
  });
}

}  // namespace

TEST_CASE("what the library's functions take has a type or a reason") {
  size_t functions = 0;
  std::set<std::string> used;
  for (const auto& file : std::filesystem::recursive_directory_iterator(DR_SOURCE_DIR "/stdlib/std")) {
    if (file.path().extension() != ".dr") continue;
    std::ifstream stream(file.path(), std::ios::binary);
    const std::string text(std::istreambuf_iterator<char>(stream), {});
    dsl::SourceManager sources;
    dsl::DiagnosticList diagnostics;
    const dsl::Module module = dsl::parse(sources, sources.add(file.path().string(), text), diagnostics);
    REQUIRE_FALSE(diagnostics.has_errors());
    for (const dsl::Item& item : module.items) {
      if (item.is_private || (item.kind != dsl::Item::Kind::Fn && item.kind != dsl::Item::Kind::Optimizer)) continue;
      const bool is_fn = item.kind == dsl::Item::Kind::Fn;
      ++functions;
      for (const dsl::Param& param : is_fn ? item.fn->params : item.optimizer->params) {
        if (param.type) continue;
        const std::string name = file.path().filename().string();
        INFO(name << ": '" << param.name.text << "' of '" << (is_fn ? item.fn->name : item.optimizer->name).text
                  << "'");
        CHECK(has_reason(name, param.name.text));
        used.insert(name + " " + param.name.text);
      }
    }
  }
  CHECK(functions > 300);
  for (const Untyped& u : untyped()) {
    for (const char* param : u.params) {
      INFO(u.module << " " << param << " has a type, or is there no more");
      CHECK(used.contains(std::string(u.module) + " " + param));
    }
  }
}
