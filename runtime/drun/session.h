// SPDX-License-Identifier: Apache-2.0
// One run of drun on a target: bind, run the steps, write what comes out.
#pragma once

#include <chrono>
#include <filesystem>
#include <map>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <vector>

#include "runtime/drun/checkpoint.h"
#include "runtime/drun/counters.h"
#include "runtime/drun/loss_log.h"
#include "runtime/drun/options.h"
#include "runtime/drun/out_folder.h"
#include "runtime/drun/target.h"
#include "runtime/jit/measure.h"
#include "runtime/watch/watch.h"

namespace dr::drun {

class Results;

class Session {
 public:
  // `names` has the tables of the program that `target` runs, which is `bundle`; `skips` is what compiling left out,
  // `floor` of the device.
  Session(const Options& options, const Target& target, const runtime::Program& names, std::span<const uint8_t> bundle,
          std::vector<jit::Skip> skips = {}, const jit::Floor& floor = {})
      : options_(options),
        target_(target),
        names_(names),
        bundle_(bundle),
        floor_(floor),
        counters_{.compiled = std::move(skips), .steps = {}, .memory = {}, .pipelines = {}, .rebuilds = 0},
        log_(options.out.empty() ? "" : (std::filesystem::path(options.out) / "log.jsonl").string()),
        folder_(options.out) {}
  // Throws Mistake.
  void process();

 private:
  void run_steps();
  void choose_steps();
  void bind();
  void resume();
  // Of a program, or of data, that is not what the run before had, and of leaves that it left and --bind gives.
  void warn_of_changes(const Checkpoint& before) const;
  // From the runs that are `done` to `times`.
  void run_step(const std::string& step, int& done, int times);
  int run_for(const std::string& step, int times, int before);
  // Opens the page of --watch.
  void open_watch();
  // How many of `wanted` runs may be now, after `done` ones: fewer where the page says so, which it may take its time
  // for; 0 where the run is to stop.
  int allowed(const std::string& step, int done, int wanted);
  // How many runs until the next line of the log, which has the first, then every --log-every-th, and the last.
  std::set<std::string> steps_to_come() const;
  int until_line(int done, int times) const;
  // Writes one if it is time, in a run of the step of which `more` runs are not counted yet.
  void checkpoint_when_due(const std::string& step, int more);
  // Makes what the step needs before its first run, and prints how long that took.
  void prepare(const std::string& step);
  // A run whose commands are looked at one by one, for --timing and --counters.
  void timed_run(const std::string& step);
  // The run that is number `run` of all; what it stored that is not finite, or nothing.
  std::string checked_run(const std::string& step, int run);
  // The same with what differs from the reference.
  std::string compared_run(const std::string& step, int run);
  // Reads the scalar outputs for the progress line and, as `logged`, the log.
  std::string scalars(const std::string& step, int done, bool logged);
  bool is_short(const std::string& step, const std::string& name);
  // Params and states that the step changed: reads them back, for a hundredth of the time at most, but `last` in any
  // case.
  void look_for_not_finite(const std::string& step, int done, bool last);
  // What the device said of the last runs.
  void hear_of_not_finite(const std::string& step, int done);
  void tell_not_finite(const std::string& step, const std::string& name, const std::string& what);
  // Warns once of each mesh that the step expects to be closed and that is not.
  void warn_of_open_meshes(const std::string& step);
  void print_counters();
  // Each is written, whatever becomes of the others; throws what could not be.
  void write_results();
  void write_results(const Results& results);
  // The steps whose outputs there are: those that ran, here or before a checkpoint.
  std::set<std::string> given() const;

  const Options& options_;
  const Target& target_;
  const runtime::Program& names_;
  std::span<const uint8_t> bundle_;
  jit::Floor floor_;
  Counters counters_;
  std::vector<std::pair<std::string, int>> steps_;  // and how often
  Checkpoint at_;                                   // where it is
  LossLog log_;
  std::unique_ptr<watch::Watch> watch_;
  OutFolder folder_;
  std::chrono::steady_clock::time_point saved_ = std::chrono::steady_clock::now();
  int runs_since_saved_ = 0;
  bool under_way_ = false;     // runs that failed half-way: nobody knows what the leaves hold
  bool is_cut_short_ = false;  // by a mistake: steps may not have run
  bool has_saved_ = false;     // a checkpoint, in this run
  std::set<std::string> ran_;
  std::set<std::string> warned_;                   // leaves
  std::map<std::string, std::string> last_lines_;  // of each step: STEP.NAME = VALUE
  std::map<std::string, bool> short_;
  std::set<std::string> told_;  // what is not finite
  std::string not_finite_;      // the first of it, where --strict-finite ends the run
  std::optional<std::string> unwritten_log_, unwritten_checkpoint_;  // why, as it was told
  double looked_ = 0, ran_for_ = 0;                                  // ms for NaN, and in all
  int together_ = 1;  // runs of a step between two looks at whether somebody interrupts
  struct Batch {
    double seconds;
    int runs;
  };
  std::map<std::string, std::vector<Batch>> batches_;  // of each step, without its first run
};

}  // namespace dr::drun
