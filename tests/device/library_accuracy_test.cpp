// SPDX-License-Identifier: Apache-2.0
// Every function of the library on every device: value and gradients at a few thousand operands each, against the
// bounds of accuracy/library_*.cpp. `./dr bench accuracy` takes more, searches for worse ones, and writes
// docs/results/accuracy.md.
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <set>
#include <sstream>

#include "dsl/diagnostic/diagnostic.h"
#include "dsl/syntax/parser.h"
#include "tests/catch.h"
#include "tests/device/accuracy/library.h"
#include "tests/device/devices.h"

using namespace dr;
namespace library = accuracy::library;

namespace {

// The functions and optimizers that a module offers to all, up to where its inner part begins.
std::set<std::string> declared(const std::filesystem::path& path) {
  std::ifstream file(path);
  std::stringstream text;
  text << file.rdbuf();
  const std::string whole = text.str();
  dsl::SourceManager sources;
  dsl::DiagnosticList diagnostics;
  const dsl::Module module = dsl::parse(sources, sources.add(path.string(), whole), diagnostics);
  REQUIRE_FALSE(diagnostics.has_errors());
  const size_t end = whole.find("// ---- Inside");
  std::set<std::string> names;
  for (const dsl::Item& item : module.items) {
    if (item.is_private) continue;
    if (item.kind == dsl::Item::Kind::Fn && item.fn->span.begin < end && !item.fn->vjp_of)
      names.insert(path.stem().string() + "." + item.fn->name.text);
    if (item.kind == dsl::Item::Kind::Optimizer) names.insert(path.stem().string() + "." + item.optimizer->name.text);
  }
  return names;
}

}  // namespace

TEST_CASE("every function of the library has a row of accuracy") {
  std::set<std::string> known, all;
  for (const library::Function& f : library::functions()) {
    known.insert(f.name);
    INFO(f.name << " " << f.part);
    CHECK_FALSE(f.directions.empty());
  }
  for (const library::Elsewhere& other : library::elsewhere()) {
    INFO(other.function);
    CHECK(known.insert(other.function).second);
    CHECK_FALSE(other.where.empty());
  }
  for (const auto& file : std::filesystem::directory_iterator(std::filesystem::path(DR_SOURCE_DIR) / "stdlib/std"))
    if (file.is_regular_file()) all.merge(declared(file.path()));
  CHECK(all.size() > 100);
  for (const std::string& name : all) {
    INFO(name);
    CHECK(known.contains(name));
  }
  for (const std::string& name : known) {
    INFO(name << " is not there any more, or is inside its module");
    CHECK((all.contains(name) || name == "hardsoftras.edge_distance"));
  }
}

TEST_CASE("functions of the library are as accurate on devices as the table says") {
  std::vector<library::Function> functions = library::functions();
  // Whole pictures are in five_roads_test and library_gradients_test, too.
  const char* wanted = std::getenv("DR_ACCURACY_ONLY");
  std::erase_if(functions, [&](const library::Function& f) {
    return wanted != nullptr ? f.name.find(wanted) == std::string::npos : f.slow;
  });
  const auto& devices = test::devices();
  for (size_t k = 0; k < devices.size(); ++k) {
    const auto& [name, device] = devices[k];
    int64_t samples = 0;
    // Each has its share here, for what takes time is to compile them; the benchmark takes all on each.
    std::vector<library::Function> mine;
    for (size_t f = 0; f < functions.size(); ++f)
      if (wanted != nullptr || f % devices.size() == k) mine.push_back(functions[f]);
    const char* more = std::getenv("DR_ACCURACY_BATCHES");
    const int batches = more != nullptr ? std::max(std::atoi(more), 1) : 1;
    library::Options options{.profile = name, .batches = batches, .rounds = batches / 2};
    auto rows = library::measure(device, mine, options);
    // By drivers' built-ins a part of them: docs/results/accuracy_light_native.md has more.
    constexpr size_t kNative = 3;
    std::vector<library::Function> some = mine;
    if (wanted == nullptr)
      std::erase_if(some, [&, n = size_t{0}](const library::Function&) mutable { return n++ % kNative != 0; });
    options.numbers = "native";
    for (library::Row& row : library::measure(device, some, options)) rows.push_back(std::move(row));
    for (const library::Row& row : rows) {
      INFO(name << ", " << row.profile << ": " << row.function << " " << row.part << " " << row.direction << " ("
                << row.metric << "), worst at " << row.worst_input << ": found " << row.found << ", expected "
                << row.expected << "; not finite: " << row.not_finite);
      if (std::getenv("SHOW") != nullptr)
        std::printf("%-8.3g %s %s %s %s: %.3g of %.3g (99.9%%: %.3g), %lld\n", row.worst / row.bound,
                    row.profile.c_str(), row.function.c_str(), row.part.c_str(), row.direction.c_str(), row.worst,
                    row.bound, row.p999, static_cast<long long>(row.samples));
      CHECK(row.worst <= row.bound);
      CHECK(row.not_finite == 0);
      CHECK(row.samples > 0);
      samples += row.samples;
    }
    std::printf("%-12s %zu rows, %lld errors\n", name.c_str(), rows.size(), static_cast<long long>(samples));
    for (const std::string& message : device.validation_messages()) FAIL("validation: " << message);
  }
}
