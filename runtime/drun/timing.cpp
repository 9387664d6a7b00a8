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

std::string timing_table(const std::string& step, std::vector<runtime::CommandTime> times) {
  double all = 0;
  for (const auto& t : times) all += t.nanoseconds;
  std::stable_sort(times.begin(), times.end(),
                   [](const auto& a, const auto& b) { return a.nanoseconds > b.nanoseconds; });
  std::string out =
      format("%s: %zu commands, %.1f us with a wait after each\n", step.c_str(), times.size(), all * 1e-3);
  out += format("%10s %6s %9s %6s  %s\n", "us", "share", "bytes", "ops", "command");
  for (const auto& t : times) {
    out += format("%10.1f %5.1f%% %9lld %6lld  ", t.nanoseconds * 1e-3, all > 0 ? 100 * t.nanoseconds / all : 0,
                  static_cast<long long>(t.bytes), static_cast<long long>(t.ops));
    out += t.label + (t.lines.empty() ? "" : "  " + joined_lines(t.lines)) + "\n";
  }
  return out;
}

std::string counters_line(const std::string& step, const runtime::StepCounters& c) {
  const auto part = [](const char* what, int64_t run, int64_t skipped) {
    const double share =
        run + skipped > 0 ? 100.0 * static_cast<double>(skipped) / static_cast<double>(run + skipped) : 0;
    return format("  %s %lld run, %lld left out (%.0f%%)", what, static_cast<long long>(run),
                  static_cast<long long>(skipped), share);
  };
  return step + ": " + std::to_string(c.runs) + (c.runs == 1 ? " run" : " runs") +
         part("commands", c.run.commands, c.skipped.commands) + part("ops", c.run.ops, c.skipped.ops) +
         part("bytes", c.run.bytes, c.skipped.bytes) + "\n";
}

std::string memory_line(const runtime::MemoryUse& use) {
  std::string out = "memory: " + std::to_string(use.device) + " bytes of the device and " + std::to_string(use.host) +
                    " of the host, " + std::to_string(use.peak) + " at most";
  for (size_t k = 0; k < use.host_leaves.size(); ++k)
    out += (k == 0 ? "; the device reads from the host's: " : ", ") + use.host_leaves[k];
  return out + "\n";
}

}  // namespace dr::drun
