// SPDX-License-Identifier: Apache-2.0
// A run with a page: its steps ask the page how often they may run.
#include "runtime/c/handles.h"

using namespace dr::c;

namespace {

// Values are read by the run's thread, within dressi_watched_step().
dr::watch::Reader reader_of(dressi_run& run) {
  dr::watch::Reader reader;
  reader.outputs = [&run](const std::string& step) { return run.outputs[step]; };
  reader.output = [&run](const std::string& step, const std::string& name) {
    return std::visit([&](auto& program) { return program->output(step, name); }, run.program);
  };
  if (const auto program = device_program(run))
    reader.left_out = [program](const std::string& step) -> std::vector<dr::watch::Left> {
      const auto counters = program->counters(step);
      return {{"commands", counters.run.commands, counters.skipped.commands},
              {"ops", counters.run.ops, counters.skipped.ops},
              {"bytes", counters.run.bytes, counters.skipped.bytes}};
    };
  return reader;
}

}  // namespace

const char* dressi_watch(dressi_run* run, int port) {
  return with_program(static_cast<const char*>(nullptr), run, [&](auto&, dressi_run& here) {
    if (port < 0 || port > 65535) fail("expected a port from 1 to 65535, or 0 for any, found " + std::to_string(port));
    here.watch.reset();  // the old page's port may be the one that is wanted
    here.watched_runs.clear();
    here.watched_step.clear();
    here.watch = must(dr::watch::Watch::open(port, reader_of(here)));
    here.text = here.watch->url();
    return here.text.c_str();
  });
}

int dressi_watch_end(dressi_run* run) {
  return with_program(0, run, [&](auto&, dressi_run& here) {
    if (here.watch && !here.watched_step.empty())
      here.watch->end(here.watched_step, here.watched_runs[here.watched_step]);
    here.watch.reset();
    return 1;
  });
}

int dressi_watched_step(dressi_run* run, const char* step, int times, int* made) {
  return with_program(0, run, [&](auto& program, dressi_run& here) {
    if (times < 1) fail("expected at least one run of a step, found " + std::to_string(times));
    if (!here.watch) fail("the run is not watched");
    const std::string name = word(step, "the step");
    int64_t& before = here.watched_runs[name];
    here.watched_step = name;
    constexpr std::chrono::milliseconds kPatience{100};
    const int now = here.watch->allow(name, before, times, kPatience);
    given(made, "where to count the runs") = now;
    if (now > 0) must(program.run(name, now));
    before += now;
    constexpr int kStopped = 2;
    return here.watch->is_stopped() ? kStopped : 1;
  });
}
