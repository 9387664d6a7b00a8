// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>

#include "tests/device/accuracy/library.h"

namespace dr::accuracy::library {

using nlohmann::json;

namespace {

// What stands in a table's cell; JSON has no infinity.
std::string number(double x) {
  char text[32];
  if (x == 0) return "0";
  std::snprintf(text, sizeof text, x >= 1e29 ? "Inf" : "%.1e", x);
  return text;
}

std::string text(const json& row, const char* field) { return row[field].get<std::string>(); }
// In a table's cell, where a bar would end it.
std::string cell(const json& row, const char* field) {
  std::string out;
  for (const char c : text(row, field)) {
    if (c == '|') out += '\\';
    out += c;
  }
  return out;
}
double value(const json& row, const char* field) { return row[field].get<double>(); }

std::string title(const json& row) {
  const std::string part = text(row, "part");
  return "`" + text(row, "function") + "`" + (part.empty() ? "" : " " + part);
}

bool same(const json& a, const json& b) {
  return a["function"] == b["function"] && a["part"] == b["part"] && a["direction"] == b["direction"] &&
         a["profile"] == b["profile"];
}

// Of its bound; where that is 0 any error is beyond it.
double share(const json& row) {
  const double bound = value(row, "bound"), most = value(row, "max");
  return bound > 0 ? most / bound : most > 0 ? 1e30 : 0;
}

}  // namespace

json to_json(std::span<const Row> rows) {
  json all = json::array();
  for (const Row& row : rows)
    all.push_back({{"function", row.function},
                   {"part", row.part},
                   {"direction", row.direction},
                   {"formula", row.formula},
                   {"domain", row.domain},
                   {"metric", row.metric},
                   {"except", row.except},
                   {"why", row.why},
                   {"profile", row.profile},
                   {"samples", row.samples},
                   {"excepted", row.excepted},
                   {"not_finite", row.not_finite},
                   {"bound", row.bound},
                   {"max", std::min(row.worst, 1e30)},
                   {"max_drawn", std::min(row.drawn, 1e30)},
                   {"p999", std::min(row.p999, 1e30)},
                   {"worst_input", row.worst_input},
                   {"expected", row.expected},
                   {"found", row.found},
                   {"pass", row.passes()}});
  return all;
}

void document(const json& all, const std::string& numbers) {
  json names = json::array(), devices = json::object();
  const json* first = nullptr;
  for (const auto& [name, device] : all.items()) {
    json rows = json::array();
    for (const json& row : device.value("library", json::array()))
      if (row["profile"] == numbers) rows.push_back(row);
    if (rows.empty()) continue;
    devices[name]["library"] = std::move(rows);
    names.push_back(name);
  }
  if (names.empty()) return;
  first = &devices[names[0].get<std::string>()]["library"];
  std::printf(R"(
## Library functions

Values of the library's functions and their gradients, with respect to each operand (`d/dx`) and times a random adjoint, which
has one component of the result alone where elements are independent. Entries are in
`tests/device/accuracy/library_*.cpp`; a function of the library that is in neither table nor list fails `library_accuracy_test`.

- Errors of vectors and matrices are the lengths of the differences. *Relative*: over the size of the exact result. *Conditioned*: over
  that size and the change of the result by a relative change of 1 of the operands, taken from small ones: what no computation
  in float32 can avoid is about u = 2^-24 (6e-8) of it; nothing is counted where a decision falls otherwise so close by. *Over* a scale: that
  is computed by the evaluator. *L2*: root of the sum of squares over all elements.
- A bound that was *set beforehand* is older than the function that it holds for; the others have their reason beside them.
- Sizes below 2^-90 count as that much: what devices flush on the way is below their last place.
- Operands are drawn as above, within the domain; special are its ends, 0, 1 and their neighbours, axes and diagonals. Where elements are
  independent, elements near the 64 worst are then looked at, and those near the worst of these, and so on: the largest error is the one
  found so.
- Where an operand is a direction, of length 1, and a drawn one is 0, the result must be finite and no more.
- Pictures are compared with an evaluation that is given the device's faces and tags.
)");
  if (numbers == "native")
    std::printf(
        R"(- Drivers' built-ins stand for our functions ([the profile `native`](accuracy.md#the-profile-native)). Errors add up, so where none of
  a function's ops is off by more than so many times what it may be in the profile `strict`, neither is the result: the bound is that of `strict`,
  times the most by which a built-in's may be larger (of `sin` and `cos` 4300 / 1.7 last places of 1, with angles of 32 turns at most, `atan` 4100 / 8,
  `asin` and `acos` 4900 / 8, `log2` 4 / 3). Where there is no built-in, it is that of `strict`.
)");
  std::printf("\n");
  for (const json& name : names) {
    int64_t failed = 0, samples = 0;
    const json& rows = devices[name.get<std::string>()]["library"];
    for (const json& row : rows) {
      failed += row["pass"].get<bool>() ? 0 : 1;
      samples += row["samples"].get<int64_t>();
    }
    std::printf("- %s: %zu rows, %lld beyond their bound; %lld errors taken.\n", name.get<std::string>().c_str(),
                rows.size(), static_cast<long long>(failed), static_cast<long long>(samples));
  }

  std::printf(
      "\n### Worst first\n\nThe rows that are nearest to their bounds, or beyond.\n\n"
      "| function | direction | device | error over bound | at |\n| --- | --- | --- | --- | --- |\n");
  // Of each row the device where it is worst, the first of those that are alike.
  std::vector<std::pair<std::string, const json*>> order;
  for (const json& row : *first) {
    std::pair<std::string, const json*> worst{"", nullptr};
    for (const json& name : names)
      for (const json& other : devices[name.get<std::string>()]["library"])
        if (same(row, other) && (worst.second == nullptr || share(other) > share(*worst.second)))
          worst = {name.get<std::string>(), &other};
    order.push_back(worst);
  }
  std::stable_sort(order.begin(), order.end(),
                   [](const auto& a, const auto& b) { return share(*a.second) > share(*b.second); });
  for (size_t k = 0; k < std::min<size_t>(order.size(), 20); ++k) {
    const json& row = *order[k].second;
    std::printf("| %s | %s | %s | %.2f | `%s` |\n", title(row).c_str(), text(row, "direction").c_str(),
                order[k].first.c_str(), std::min(share(row), 1e6), text(row, "worst_input").c_str());
  }

  std::printf(
      "\n### All rows\n\nEach cell has the largest error, and in parentheses that of 99.9%% of the random samples.\n\n"
      "| function | direction | domain | samples | metric | bound |");
  for (const json& name : names) std::printf(" %s |", name.get<std::string>().c_str());
  std::printf(" why |\n| --- | --- | --- | --- | --- | --- |");
  for (size_t k = 0; k < names.size(); ++k) std::printf(" --- |");
  std::printf(" --- |\n");
  for (const json& row : *first) {
    const std::string except = cell(row, "except");
    std::printf("| %s | %s | %s | %lld | %s%s | %s |", title(row).c_str(), text(row, "direction").c_str(),
                cell(row, "domain").c_str(), static_cast<long long>(row["samples"].get<int64_t>()),
                cell(row, "metric").c_str(), except.empty() ? "" : (", except " + except).c_str(),
                number(value(row, "bound")).c_str());
    for (const json& name : names) {
      const json& rows = devices[name.get<std::string>()]["library"];
      const auto found = std::find_if(rows.begin(), rows.end(), [&](const json& r) { return same(r, row); });
      if (found == rows.end()) {
        std::printf(" |");
        continue;
      }
      std::printf(" %s%s", (*found)["pass"].get<bool>() ? "" : "**beyond** ", number(value(*found, "max")).c_str());
      if (value(*found, "max") > 0) std::printf(" (%s)", number(value(*found, "p999")).c_str());
      std::printf(" |");
    }
    std::printf(" %s |\n", cell(row, "why").c_str());
  }
  std::printf("\n### Not in the table\n\n");
  for (const Elsewhere& other : elsewhere()) std::printf("- `%s`: %s\n", other.function.c_str(), other.where.c_str());
}

}  // namespace dr::accuracy::library
