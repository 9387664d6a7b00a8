// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/measure/every_float.h"

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <vector>

namespace dr {

namespace {

using nlohmann::json;

std::string number(double x) {
  char text[32];
  if (x == 0) return "0";
  std::snprintf(text, sizeof text, x >= 1e29 ? "Inf" : x >= 1e5 || x < 0.01 ? "%.1e" : x >= 100 ? "%.0f" : "%.2f", x);
  return text;
}
std::string text(const json& row, const char* field) { return row[field].get<std::string>(); }

// What a row is apart from its device.
std::vector<std::string> key_of(const json& row) {
  return {text(row, "op"), text(row, "direction"), text(row, "domain"), text(row, "profile")};
}

}  // namespace

std::string share_of(const json& row) {
  const std::string promise = row.value("promise", "");
  if (promise.find_first_not_of("0123456789") == std::string::npos || promise == "none") return "";
  char text[32];
  std::snprintf(text, sizeof text, ", %.1f%% of it", std::min(100 * row["share"].get<double>(), 1e9));
  return text;
}

void document_every_float(const std::string& folder) {
  std::vector<std::filesystem::path> files;
  std::error_code none;
  for (const auto& entry : std::filesystem::directory_iterator(folder + "/sweep", none))
    if (entry.path().extension() == ".jsonl") files.push_back(entry.path());
  // Files of some ops replace those rows of a file of all.
  std::sort(files.begin(), files.end(), [](const auto& a, const auto& b) {
    return std::pair(a.string().size(), a) < std::pair(b.string().size(), b);
  });
  std::vector<std::vector<std::string>> order;
  std::map<std::vector<std::string>, std::map<std::string, json>> rows;  // by device
  std::map<std::string, std::vector<json>> devices;
  for (const auto& file : files) {
    std::ifstream lines(file);
    for (std::string line; std::getline(lines, line);) {
      json row = json::parse(line, nullptr, false);
      if (row.is_discarded() || !row.contains("op")) continue;
      const auto key = key_of(row);
      if (!rows.contains(key)) order.push_back(key);
      const std::string device = text(row, "name");
      rows[key][device] = std::move(row);
    }
  }
  if (order.empty()) return;
  for (const auto& [key, by_device] : rows)
    for (const auto& [device, row] : by_device) devices[device].push_back(row);

  std::printf(R"(
## Every float

Unary float ops, and their derivatives with adjoint 1, over bit patterns of float32, made by `./dr bench sweep`: on GPUs over all 2^32, which
leaves no chance to the sample; on CPU devices over every 13th, the ends of each exponent and the special values. Domains, scales,
exceptions and bounds are those of the tables above, and so is the judge. Patterns outside the domain, NaN and Inf included, were looked at
for results that are not finite where the exact one is. Cells are as above.

| device | name | driver | patterns | rows | beyond their bound | errors taken |
| --- | --- | --- | --- | --- | --- | --- |
)");
  for (const auto& [device, all] : devices) {
    int64_t errors = 0;
    std::set<std::string> patterns;
    for (const json& row : all) errors += row["n"].get<int64_t>(), patterns.insert(text(row, "patterns"));
    std::string which;
    for (const std::string& p : patterns) which += (which.empty() ? "" : ", ") + p;
    std::printf(
        "| %s | %s | %s | %s | %zu | %lld | %lld |\n", device.c_str(), text(all[0], "device").c_str(),
        text(all[0], "driver").c_str(), which.c_str(), all.size(),
        static_cast<long long>(std::ranges::count_if(all, [](const json& r) { return !r["pass"].get<bool>(); })),
        static_cast<long long>(errors));
  }
  std::printf("\n| op | direction | domain | profile | scale | bound |");
  for (const auto& [device, all] : devices) std::printf(" %s |", device.c_str());
  std::printf("\n| --- | --- | --- | --- | --- | --- |");
  for (size_t k = 0; k < devices.size(); ++k) std::printf(" --- |");
  std::printf("\n");
  for (const auto& key : order) {
    const auto& by_device = rows[key];
    const json& first = by_device.begin()->second;
    const std::string promise = text(first, "promise");
    std::printf("| `%s` | %s | %s | %s | %s | %s |", key[0].c_str(), key[1].c_str(), key[2].c_str(), key[3].c_str(),
                text(first, "scale").c_str(),
                promise.empty() ? number(first["bound"].get<double>()).c_str() : promise.c_str());
    for (const auto& [device, all] : devices) {
      const auto found = by_device.find(device);
      if (found == by_device.end()) {
        std::printf(" |");
        continue;
      }
      const json& row = found->second;
      const double worst = row["max"].get<double>();
      std::printf(" %s%s", row["pass"].get<bool>() ? "" : "**beyond** ", number(worst).c_str());
      if (worst > 0)
        std::printf(" (%s)%s at `%s`", number(row["p999"].get<double>()).c_str(), share_of(row).c_str(),
                    text(row, "worst_input").c_str());
      std::printf(" |");
    }
    std::printf("\n");
  }
}

void document_judge(const std::string& folder) {
  std::ifstream file(folder + "/judge.json");
  const json data = json::parse(file, nullptr, false);
  if (data.is_discarded() || !data.contains("rows")) return;
  std::printf(R"(
## The judge

The float64 evaluator, which judges all of this page, against mpmath %s with 50 digits, which shares nothing with it: %lld values and
derivatives of float ops at operands of their domains and special ones, made by `./dr bench judge`. Errors are relative, in units of 2^-53, where
a last place of float32 is at least 2^28 of them; in parentheses that of 99.9%% of the points. The largest, of `pow`, has a factor below
float64's normal numbers.

| op | value | d/dx1 | d/dx2 | d/dx3 |
| --- | --- | --- | --- | --- |
)",
              text(data, "mpmath").c_str(), static_cast<long long>(data["points"].get<int64_t>()));
  std::vector<std::string> order;
  std::map<std::string, std::map<std::string, std::string>> cells;
  for (const json& row : data["rows"]) {
    const std::string op = text(row, "op");
    if (!cells.contains(op)) order.push_back(op);
    const double worst = row["max"].get<double>();
    cells[op][text(row, "direction")] =
        number(worst) + (worst > 0 ? " (" + number(row["p999"].get<double>()) + ")" : "");
  }
  for (const std::string& op : order) {
    std::printf("| `%s` |", op.c_str());
    for (const char* direction : {"value", "d/dx1", "d/dx2", "d/dx3"})
      std::printf(" %s |", cells[op][direction].c_str());
    std::printf("\n");
  }
}

}  // namespace dr
