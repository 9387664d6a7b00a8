// SPDX-License-Identifier: Apache-2.0
// What a run did and what it left out, as text and as JSON: `--counters`. docs/explain/skipping.md says what each is.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "runtime/jit/jit.h"
#include "runtime/runtime.h"

namespace dr::drun {

struct StepCounts {
  runtime::StepCounters work;
  std::vector<jit::Skip> lists;  // elements that were listed in the last run, and the others
  int64_t fragments = 0;         // that draws of the last run ran for, where the device counts them
};

struct Counters {
  std::vector<jit::Skip> compiled;  // of a program that was compiled now
  std::map<std::string, StepCounts> steps;
  runtime::MemoryUse memory;
  runtime::PipelineCounters pipelines;
  int rebuilds = 0;
};

// By the names of lists, in alphabetical order.
std::vector<jit::Skip> lists_of(const std::vector<runtime::CommandTime>& commands);

// A line for each step, which begins with its name, and one for each part: lists, compiled, pipelines, memory.
std::string print(const Counters& counters);
// One line: {"steps": {NAME: {"runs": N, "skips": {ID: {"unit", "done", "avoided"}}}}, "skips": {ID: ...}, "rebuilds":
// N,
//  "memory": {...}}
std::string print_json(const Counters& counters);

}  // namespace dr::drun
