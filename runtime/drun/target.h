// SPDX-License-Identifier: Apache-2.0
// The two kinds of device, Vulkan and the float64 evaluator, behind one set of calls.
#pragma once

#include <chrono>
#include <functional>
#include <string>
#include <vector>

#include "compiler/io/array/decisions.h"
#include "runtime/jit/reference_check.h"
#include "runtime/jit/reference_program.h"
#include "runtime/runtime.h"

namespace dr::drun {

// The user's or the device's mistake, in a sentence; empty when it is told already.
struct Mistake {
  std::string message;
};

template <class T>
T must(io::Result<T> result) {
  if (!result) throw Mistake{result.error()};
  if constexpr (!std::is_void_v<T>) return std::move(result).value();
}

struct Target {
  std::function<io::Result<void>(const std::string&, const io::Array&)> bind;
  std::function<io::Result<void>(const std::string&, int64_t)> bind_symbol;
  std::function<io::Result<void>(const std::string&, int)> run;
  std::function<io::Result<void>(const std::string&, int64_t)> set_runs;
  std::function<io::Result<io::Array>(const std::string&, const std::string&)> output;
  std::function<io::Result<io::Array>(const std::string&)> leaf;
  std::function<io::Result<io::Decisions>(const std::string&)> decisions;
  // What only a Vulkan device can tell.
  std::function<io::Result<int>(const std::string&)> prepare;  // a step: memory, pipelines; gives its commands
  std::function<io::Result<std::vector<runtime::CommandTime>>(const std::string&)> timed_run;
  std::function<io::Result<std::optional<runtime::NotFinite>>(const std::string&)> checked_run;
  std::function<runtime::StepCounters(const std::string&)> counters;
  // A run of a step that has run so often, compared with the reference's.
  std::function<io::Result<jit::Comparison>(const std::string&, int64_t)> compared_run;
  std::function<runtime::MemoryUse()> memory_use;
  std::function<runtime::PipelineCounters()> pipelines;
  std::function<int()> rebuilds;
  std::function<io::Result<std::vector<std::string>>(const std::string&)> told_not_finite;
};

// Milliseconds since a moment of std::chrono::steady_clock.
double ms_since(std::chrono::steady_clock::time_point begin);

// The program must outlive it.
Target target_of(runtime::Program& program);
// With compared_run.
Target target_of(runtime::Program& program, jit::ReferenceCheck& check);
Target target_of(jit::ReferenceProgram& program);

}  // namespace dr::drun
