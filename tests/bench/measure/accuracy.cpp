// SPDX-License-Identifier: Apache-2.0
// The accuracy table measured on devices, and docs/results/accuracy.md from it.
//
//   bench_accuracy measure FILE NAME [DEVICE] [SAMPLES]   one device, as NAME; its figures replace those in FILE
//   bench_accuracy library FILE NAME DEVICE PROFILE MODULE... [K/N]
//                                                         modules or functions of the library ("light", "tone.neutral")
//                                                         in a profile of floats, strict or native, in place of their
//                                                         rows there; with K/N every Nth of them from the Kth on
//   bench_accuracy join FILE FROM...                      the rows of other files in place of theirs in FILE
//   bench_accuracy document FILE > docs/results/accuracy.md       all devices of FILE
//   bench_accuracy light FILE PROFILE > docs/results/accuracy_light.md    what lights a frame, of FILE's devices; of
//                                                                         native: accuracy_light_native.md
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>

#include "compiler/ops/op.h"
#include "tests/bench/measure/every_float.h"
#include "tests/device/accuracy/library.h"
#include "tests/device/accuracy/measure.h"

using namespace dr;
using nlohmann::json;

namespace {

// Cases of one bundle: more of them take more memory than time.
constexpr size_t kTogether = 24;

[[noreturn]] void stop(const std::string& why) {
  std::fprintf(stderr, "bench_accuracy: %s\n", why.c_str());
  std::exit(1);
}

json read(const std::string& path) {
  std::ifstream file(path);
  if (!file) return {{"devices", json::object()}};
  json data = json::parse(file, nullptr, false);
  if (data.is_discarded() || !data.contains("devices")) stop("'" + path + "' is not what this program writes");
  return data;
}

// JSON has no infinity.
json json_of(const accuracy::Row& row) {
  return {{"op", row.op},
          {"direction", row.direction},
          {"domain", row.domain},
          {"scale", row.scale},
          {"why", row.why},
          {"samples", row.samples},
          {"special", row.special},
          {"not_finite", row.not_finite},
          {"bound", row.bound},
          {"promise", row.promise},
          {"max_ulp", std::min(row.worst, 1e30)},
          {"share", std::min(row.share, 1e30)},
          {"p999_ulp", std::min(row.p999, 1e30)},
          {"max_relative", std::min(row.relative, 1e30)},
          {"max_near_zero", row.near_zero},
          {"worst_input", row.worst_input},
          {"expected", row.expected},
          {"found", row.found},
          {"pass", row.passes()}};
}

// The profile that a device is compiled for.
std::string profile_of(const runtime::Device& device) {
  const std::string known = device.profile_name();
  return known.empty() ? "lavapipe" : known;
}

// Rows of the library in place of those of the same function, direction and profile; others behind.
void put(json& there, json rows) {
  json all = std::move(there["library"]);
  if (all.is_null()) all = json::array();
  for (json& row : rows) {
    const auto old = std::ranges::find_if(all, [&](const json& other) {
      return std::ranges::all_of(std::array{"function", "part", "direction", "profile"},
                                 [&](const char* field) { return other[field] == row[field]; });
    });
    if (old == all.end())
      all.push_back(std::move(row));
    else
      *old = std::move(row);
  }
  there["library"] = std::move(all);
}

// Functions of these modules, or with "K/N" at the end every Nth from the Kth on.
int measure_modules(const std::string& path, const std::string& name, const std::string& wanted,
                    const std::string& numbers, std::span<char* const> modules) {
  auto device = runtime::Device::open({wanted, false});
  if (!device) stop(device.error());
  size_t first = 0, step = 1;
  if (std::sscanf(modules.back(), "%zu/%zu", &first, &step) == 2) modules = modules.first(modules.size() - 1);
  if (step == 0) stop("every 0th function");
  std::vector<accuracy::library::Function> some;
  for (size_t k = 0; accuracy::library::Function & f : accuracy::library::functions()) {
    const bool meant = std::ranges::any_of(
        modules, [&](const char* module) { return f.name.starts_with(module + std::string(".")) || f.name == module; });
    if (meant && k++ % step == first) some.push_back(std::move(f));
  }
  if (some.empty()) stop("no function of the library in these modules");
  const std::vector<accuracy::library::Row> rows =
      accuracy::library::measure(*device, some, {.profile = profile_of(*device), .numbers = numbers});
  json data = read(path);
  json& there = data["devices"][name];
  there["device"] = device->info().name;
  there["driver"] = device->info().driver;
  put(there, accuracy::library::to_json(rows));
  std::ofstream(path) << data.dump(1) << "\n";
  const auto beyond = std::ranges::count_if(rows, [](const accuracy::library::Row& row) { return !row.passes(); });
  for (const accuracy::library::Row& row : rows)
    if (!row.passes())
      std::printf("%s %s %s: %g, %g allowed, at %s\n", row.function.c_str(), row.part.c_str(), row.direction.c_str(),
                  row.worst, row.bound, row.worst_input.c_str());
  std::printf("%s, %s: %zu rows, %lld beyond their bound\n", name.c_str(), numbers.c_str(), rows.size(),
              static_cast<long long>(beyond));
  return beyond == 0 ? 0 : 1;
}

int join(const std::string& path, std::span<char* const> others) {
  json data = read(path);
  for (const char* other : others) {
    json from = read(other);
    for (auto& [name, device] : from["devices"].items()) {
      json& there = data["devices"][name];
      there["device"] = device["device"];
      there["driver"] = device["driver"];
      put(there, std::move(device["library"]));
    }
  }
  std::ofstream(path) << data.dump(1) << "\n";
  return 0;
}

// The rows of library functions; how many are beyond their bounds goes to `failed`.
json measure_library(const runtime::Device& device, const std::string& profile, int64_t samples, int& failed) {
  std::vector<accuracy::library::Function> functions = accuracy::library::functions();
  accuracy::library::Options options{.profile = profile};
  if (samples < (1 << 18)) {  // --quick: to compile them all takes too long
    options.batches = options.rounds = 2;
    std::vector<accuracy::library::Function> some;
    for (size_t k = 0; k < functions.size(); k += 5) some.push_back(functions[k]);
    functions = std::move(some);
  }
  const std::vector<accuracy::library::Row> rows = accuracy::library::measure(device, functions, options);
  for (const accuracy::library::Row& row : rows) {
    if (row.passes()) continue;
    ++failed;
    std::printf("%s %s %s: %g, %g allowed, at %s\n", row.function.c_str(), row.part.c_str(), row.direction.c_str(),
                row.worst, row.bound, row.worst_input.c_str());
  }
  std::printf("%zu rows of library functions\n", rows.size());
  return accuracy::library::to_json(rows);
}

// `measured`: when and at what commit, for the page.
int measure(const std::string& path, const std::string& name, const std::string& wanted, int64_t samples,
            const std::string& measured) {
  auto device = runtime::Device::open({wanted, false});
  if (!device) stop(device.error());
  const std::string profile = profile_of(*device);
  const std::vector<accuracy::Case> cases = accuracy::cases();
  json both = json::object();
  int failed = 0;
  for (const char* floats : {"strict", "native"}) {
    json rows = json::array();
    int beyond = 0;
    for (size_t first = 0; first < cases.size(); first += kTogether) {
      const auto some = std::span(cases).subspan(first, std::min(kTogether, cases.size() - first));
      const accuracy::Options options{.profile = profile, .float_profile = floats, .random = samples};
      for (const accuracy::Row& row : accuracy::measure(*device, some, options)) {
        rows.push_back(json_of(row));
        if (row.passes()) continue;
        ++beyond;
        failed += row.promise.empty() ? 1 : 0;  // what a driver promises and does not keep is told, no failure of ours
        std::printf("%s %s %s: %g last places, %g of what is allowed, at %s\n", floats, row.op.c_str(),
                    row.direction.c_str(), row.worst, row.share, row.worst_input.c_str());
      }
    }
    std::printf("%s (%s), %s: %zu rows, %d beyond their bound\n", name.c_str(), device->info().name.c_str(), floats,
                rows.size(), beyond);
    both[floats] = std::move(rows);
  }
  json library = measure_library(*device, profile, samples, failed);
  json data = read(path);
  data["devices"][name] = {{"device", device->info().name},        {"driver", device->info().driver},
                           {"vulkan", device->info().api_version}, {"measured", measured},
                           {"rows", std::move(both["strict"])},    {"native", std::move(both["native"])},
                           {"library", std::move(library)}};
  std::ofstream(path) << data.dump(1) << "\n";
  return failed == 0 ? 0 : 1;
}

std::string number(double x) {
  char text[32];
  if (x == 0) return "0";
  std::snprintf(text, sizeof text, x >= 1e29 ? "Inf" : x >= 100 || x < 0.01 ? "%.1e" : "%.2f", x);
  return text;
}

// What a device's rows say of one of another's: the largest error, that of 99.9%, and where it is largest.
std::string cell(const json& rows, const json& row) {
  const auto found = std::find_if(rows.begin(), rows.end(), [&](const json& r) {
    return r["op"] == row["op"] && r["direction"] == row["direction"] && r["domain"] == row["domain"];
  });
  if (found == rows.end()) return "";
  const double worst = (*found)["max_ulp"].get<double>();
  const std::string text = ((*found)["pass"].get<bool>() ? "" : "**beyond** ") + number(worst);
  if (worst == 0) return text;
  return text + " (" + number((*found)["p999_ulp"].get<double>()) + ")" + share_of(*found) + " at `" +
         (*found)["worst_input"].get<std::string>() + "`";
}

std::string verdict(const json& rows) {
  int64_t failed = 0, samples = 0, special = 0;
  for (const json& row : rows) {
    failed += row["pass"].get<bool>() ? 0 : 1;
    samples += row["samples"].get<int64_t>();
    special += row["special"].get<int64_t>();
  }
  return std::to_string(rows.size()) + " rows, " + std::to_string(failed) + " beyond their bound; " +
         std::to_string(samples) + " errors taken, " + std::to_string(special) + " special values";
}

// The rows of the float profile `native` that have a bound of their own, and those beyond the strict one.
void document_native(const json& devices) {
  std::printf(R"(
## The profile `native`

With `--float=native` drivers' built-ins stand for our functions ([floats](../explain/floats.md)). Bounds are what Vulkan promises of
the built-in, and what follows for functions and derivatives that are made of it (`tests/device/accuracy/cases_native.cpp`): n last places
of a factor are 2n of the product, since a last place is worth half as much at the upper end of a binade as at the lower; a
derivative adds its own roundings. Where the promise is absolute, the scale says of what: 2^-11 of 1 is 4096 last places. `none`: nothing
is promised there, and results must only be finite. A result within its bound of the largest number may be Inf. Where a bound depends on the
operands, cells say how much of it an error is at most, and at which operands; the largest error may be elsewhere. Rows that are missing
here have the same GLSL in both profiles, but for contraction, and are held to the bounds above; they are listed where they exceed
one. The last column has why a bound is what it is.

| op | direction | domain | scale | bound |)");
  for (const auto& [name, device] : devices.items()) std::printf(" %s |", name.c_str());
  std::printf(" why |\n| --- | --- | --- | --- | --- | --- |");
  for (size_t k = 0; k < devices.size(); ++k) std::printf(" --- |");
  std::printf("\n");
  for (const json& row : devices.begin().value().value("native", json::array())) {
    const std::string promise = row["promise"].get<std::string>();
    bool listed = !promise.empty();
    std::string cells;
    for (const auto& [name, device] : devices.items()) {
      const std::string text = cell(device.value("native", json::array()), row);
      listed = listed || text.starts_with("**");
      cells += " " + text + " |";
    }
    if (!listed) continue;
    std::printf("| `%s` | %s | %s | %s | %s |%s %s |\n", row["op"].get<std::string>().c_str(),
                row["direction"].get<std::string>().c_str(), row["domain"].get<std::string>().c_str(),
                row["scale"].get<std::string>().c_str(),
                promise.empty() ? number(row["bound"].get<double>()).c_str() : promise.c_str(), cells.c_str(),
                row["why"].get<std::string>().c_str());
  }
}

// One row an op and direction, by operation in the order of the table, a column a device.
int document(const std::string& path) {
  const json data = read(path);
  const json& devices = data["devices"];
  if (devices.empty()) stop("'" + path + "' has no device");
  std::printf(R"(# Accuracy

How far the ops are off on devices, in both float profiles, made by `./dr bench accuracy` from `bench-out/accuracy.json`; `tests/device/accuracy_test`
holds a smaller sample to the same bounds. The judge is the float64 evaluator on the same graph, given the same float32
operands.

- Operands: half of the random ones have a uniform exponent over the whole domain, half are uniform in [-8, 8]; besides there are
  zeros, subnormals, the ends of the range, powers of two, multiples of pi/2, thresholds of exp, and their combinations. Special
  values outside the domain, Inf and NaN included, must give a finite result where the exact one is finite.
- Errors are in last places of float32, of the larger of the exact result and the *scale*: none for functions with full relative
  accuracy. Derivatives (`d/dx2`: by the second operand) are times a random adjoint.
- Devices may flush subnormal numbers. So a result below the normal numbers counts as right when it is found there too, a derivative
  within 2^7 of either end of the range, where one of its factors may have left it; where an operand or the result is subnormal,
  derivatives must be finite and no more.
- A bound of 0 means equal numbers. Bounds of values are those of [ops.md](../reference/ops.md), others say why in the list below; all are in
  `tests/device/accuracy/cases*.cpp`.

Each cell has the largest error, in parentheses that of 99.9%% of the samples, and the operands' bits (integers as numbers) where
it is largest.

| device | name | driver | Vulkan | measured | strict | native |
| --- | --- | --- | --- | --- | --- | --- |
)");
  for (const auto& [name, device] : devices.items()) {
    std::printf("| %s | %s | %s | %s | %s | %s | %s |\n", name.c_str(), device["device"].get<std::string>().c_str(),
                device["driver"].get<std::string>().c_str(), device["vulkan"].get<std::string>().c_str(),
                device.value("measured", "").c_str(), verdict(device["rows"]).c_str(),
                verdict(device.value("native", json::array())).c_str());
  }
  std::printf("\n## The table\n\n| op | direction | domain | samples | scale | bound |");
  for (const auto& [name, device] : devices.items()) std::printf(" %s |", name.c_str());
  std::printf("\n| --- | --- | --- | --- | --- | --- |");
  for (size_t k = 0; k < devices.size(); ++k) std::printf(" --- |");
  std::printf("\n");
  const json& first = devices.begin().value()["rows"];
  for (const json& row : first) {
    std::printf("| `%s` | %s | %s | %lld | %s | %s |", row["op"].get<std::string>().c_str(),
                row["direction"].get<std::string>().c_str(), row["domain"].get<std::string>().c_str(),
                static_cast<long long>(row["samples"].get<int64_t>()), row["scale"].get<std::string>().c_str(),
                number(row["bound"].get<double>()).c_str());
    for (const auto& [name, device] : devices.items()) {
      std::printf(" %s |", cell(device["rows"], row).c_str());
    }
    std::printf("\n");
  }
  std::printf("\n## Why the bounds are what they are\n\n");
  std::vector<std::string> told;
  for (const json& row : first) {
    const std::string why = row["why"].get<std::string>() + " (" + number(row["bound"].get<double>()) + ")";
    if (row["bound"].get<double>() == 0 || row["why"] == "op table") continue;
    const std::string line = "`" + row["op"].get<std::string>() + "` " + row["direction"].get<std::string>();
    std::printf("- %s: %s\n", line.c_str(), why.c_str());
  }
  document_native(devices);
  const std::filesystem::path folder = std::filesystem::path(path).parent_path();
  document_every_float(folder.empty() ? "." : folder.string());
  document_judge(folder.empty() ? "." : folder.string());
  std::printf("\n## Not in the table\n\n");
  for (const accuracy::Elsewhere& other : accuracy::elsewhere())
    std::printf("- `%s`: %s\n", std::string(ir::op_name(other.kind)).c_str(), other.where.c_str());
  accuracy::library::document(devices, "strict");
  return 0;
}

// A page of its own for the modules that light a frame.
int document_light(const std::string& path, const std::string& numbers) {
  const json data = read(path);
  const json& devices = data["devices"];
  if (devices.empty()) stop("'" + path + "' has no device");
  const bool native = numbers == "native";
  std::printf(R"(# Accuracy of what lights a frame%s

How far materials, lamps, environments, shadows, textures and tone mapping are off on devices%s:
`bench_accuracy library FILE NAME DEVICE %s material light environment shadow texture tone` on each, then
`bench_accuracy light FILE %s`.
[Accuracy](accuracy.md) has the ops and the other modules, [another page](%s) the float profile `%s`.

| device | name | driver |
| --- | --- | --- |
)",
              native ? " by drivers' built-ins" : "", native ? " with `--float=native`" : "", numbers.c_str(),
              numbers.c_str(), native ? "accuracy_light.md" : "accuracy_light_native.md", native ? "strict" : "native");
  for (const auto& [name, device] : devices.items())
    std::printf("| %s | %s | %s |\n", name.c_str(), device["device"].get<std::string>().c_str(),
                device["driver"].get<std::string>().c_str());
  accuracy::library::document(devices, numbers);
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  const std::string what = argc > 1 ? argv[1] : "";
  const int64_t samples = argc > 5 ? std::atoll(argv[5]) : int64_t{1} << 18;
  if (what == "document" && argc == 3) return document(argv[2]);
  if (what == "measure" && argc >= 4 && samples > 0)
    return measure(argv[2], argv[3], argc > 4 ? argv[4] : "", samples, argc > 6 ? argv[6] : "");
  if (what == "library" && argc >= 7)
    return measure_modules(argv[2], argv[3], argv[4], argv[5], std::span(argv + 6, static_cast<size_t>(argc - 6)));
  if (what == "join" && argc >= 4) return join(argv[2], std::span(argv + 3, static_cast<size_t>(argc - 3)));
  if (what == "light" && argc == 4) return document_light(argv[2], argv[3]);
  std::fputs(
      "usage: bench_accuracy measure FILE NAME [DEVICE] [SAMPLES] [DATE AND COMMIT] "
      "| library FILE NAME DEVICE PROFILE MODULE... [K/N] | join FILE FROM... | document FILE | light FILE PROFILE\n",
      stderr);
  return 2;
}
