// SPDX-License-Identifier: Apache-2.0
// Tables of times.
#include "runtime/drun/timing.h"

#include <algorithm>
#include <cstdio>

namespace dr::drun {

namespace {

template <class... Values>
std::string format(const char* pattern, Values... values) {
  char text[512];
  std::snprintf(text, sizeof text, pattern, values...);
  return text;
}

}  // namespace

std::string joined_lines(const std::vector<std::string>& lines) {
  constexpr size_t kMost = 4;
  std::string out;
  std::string file;
  size_t shown = 0;
  for (size_t k = 0; k < lines.size();) {
    const size_t colon = lines[k].rfind(':');
    const std::string name = lines[k].substr(0, colon);
    const int first = std::stoi(lines[k].substr(colon + 1));
    size_t next = k + 1;
    while (next < lines.size() && lines[next] == name + ":" + std::to_string(first + static_cast<int>(next - k)))
      ++next;
    if (++shown > kMost) return out + " ...";
    out += name == file ? "," : (out.empty() ? "" : " ") + name + ":";
    file = name;
    out += std::to_string(first);
    if (next - k > 1) out += "-" + std::to_string(first + static_cast<int>(next - k) - 1);
    k = next;
  }
  return out;
}

std::string timing_table(const std::string& step, std::vector<runtime::CommandTime> times, const jit::Floor& floor) {
  const auto least = [&](const runtime::CommandTime& t) {
    return floor.command_ns + (floor.bytes_per_ns > 0 ? static_cast<double>(t.bytes) / floor.bytes_per_ns : 0);
  };
  double all = 0, least_of_all = 0;
  for (const auto& t : times) {
    all += t.nanoseconds;
    least_of_all += least(t);
  }
  std::stable_sort(times.begin(), times.end(),
                   [](const auto& a, const auto& b) { return a.nanoseconds > b.nanoseconds; });
  std::string out = format("%s: %zu commands, %.1f us with a wait after each", step.c_str(), times.size(), all * 1e-3);
  if (least_of_all > 0) out += format("; %.1f by the profile's cost of a dispatch and of a byte", least_of_all * 1e-3);
  const bool tell = std::ranges::any_of(times, [](const runtime::CommandTime& t) { return t.registers > 0; });
  out += format("\n%10s %6s %9s %6s %6s %8s ", "us", "share", "bytes", "ops", "GB/s", "floor us");
  out += tell ? format("%9s %6s  command\n", "registers", "group") : " command\n";
  for (const auto& t : times) {
    out +=
        format("%10.1f %5.1f%% %9lld %6lld %6.0f %8.1f  ", t.nanoseconds * 1e-3,
               all > 0 ? 100 * t.nanoseconds / all : 0, static_cast<long long>(t.bytes), static_cast<long long>(t.ops),
               t.nanoseconds > 0 ? static_cast<double>(t.bytes) / t.nanoseconds : 0, least(t) * 1e-3);
    if (tell) out += format("%8d %6d  ", t.registers, t.group);
    out += t.label + (t.lines.empty() ? "" : "  " + joined_lines(t.lines)) + "\n";
  }
  return out;
}

}  // namespace dr::drun
