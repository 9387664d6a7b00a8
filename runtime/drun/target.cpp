// SPDX-License-Identifier: Apache-2.0
// Programs as targets.
#include "runtime/drun/target.h"

namespace dr::drun {

namespace {

io::Result<io::Decisions> decisions_of(runtime::Program& program, const std::string& step) {
  auto rasters = program.rasters(step);
  if (!rasters) return io::Error{rasters.error()};
  auto pins = program.pins(step);
  if (!pins) return io::Error{pins.error()};
  return io::Decisions{*std::move(rasters), *std::move(pins)};
}

io::Result<io::Decisions> decisions_of(jit::ReferenceProgram& program, const std::string& step) {
  io::Decisions out{program.rasters(step), program.pins(step)};
  for (auto& raster : out.rasters)
    for (io::Array& a : raster) {
      auto whole = a.converted(io::ElementKind::Int32);
      if (!whole) return io::Error{whole.error()};
      a = *std::move(whole);
    }
  return out;
}

template <class P>
Target common(P& program) {
  Target t;
  t.bind = [&](const std::string& leaf, const io::Array& data) { return program.bind(leaf, data); };
  t.bind_symbol = [&](const std::string& symbol, int64_t value) { return program.bind_symbol(symbol, value); };
  t.run = [&](const std::string& step, int times) { return program.run(step, times); };
  t.set_runs = [&](const std::string& step, int64_t runs) { return program.set_runs(step, runs); };
  t.output = [&](const std::string& step, const std::string& name) { return program.output(step, name); };
  t.leaf = [&](const std::string& leaf) { return program.leaf(leaf); };
  t.decisions = [&](const std::string& step) { return decisions_of(program, step); };
  return t;
}

}  // namespace

double ms_since(std::chrono::steady_clock::time_point begin) {
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begin).count();
}

Target target_of(runtime::Program& program) {
  Target t = common(program);
  t.prepare = [&](const std::string& step) { return program.command_count(step); };
  t.timed_run = [&](const std::string& step) { return program.timed_run(step); };
  t.checked_run = [&](const std::string& step) { return program.checked_run(step); };
  t.told_not_finite = [&](const std::string& step) { return program.told_not_finite(step); };
  t.memory_use = [&] { return program.memory_use(); };
  t.pipelines = [&] { return program.pipelines(); };
  t.rebuilds = [&] { return program.rebuilds(); };
  t.counters = [&](const std::string& step) { return program.counters(step); };
  return t;
}

Target target_of(runtime::Program& program, jit::ReferenceCheck& check) {
  Target t = target_of(program);
  t.bind_symbol = [&](const std::string& symbol, int64_t value) {
    auto bound = program.bind_symbol(symbol, value);
    return bound ? check.bind_symbol(symbol, value) : bound;
  };
  t.compared_run = [&](const std::string& step, int64_t runs) { return check.run(program, step, runs); };
  return t;
}

Target target_of(jit::ReferenceProgram& program) { return common(program); }

}  // namespace dr::drun
