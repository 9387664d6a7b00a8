// SPDX-License-Identifier: Apache-2.0
// The loop over steps.
#include "runtime/drun/session.h"

#include <algorithm>
#include <charconv>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <optional>

#include "compiler/topology/topology.h"
#include "runtime/drun/progress.h"
#include "runtime/drun/results.h"
#include "runtime/drun/stop.h"
#include "runtime/drun/timing.h"
#include "runtime/jit/check_indices.h"

namespace dr::drun {

using io::Array;

namespace {

using Clock = std::chrono::steady_clock;

std::string list(const std::vector<std::string>& names) {
  std::string out;
  for (const std::string& n : names) out += (out.empty() ? "" : ", ") + n;
  return out;
}

// What could not be written while steps run is no reason to end them: `why`, if there is one, is a warning, once until
// it changes.
void tell_unwritten(std::optional<std::string>& told, const std::optional<std::string>& why) {
  if (why && told != why) std::fprintf(stderr, "drun: warning: %s\n", why->c_str());
  told = why;
}

}  // namespace

void Session::process() {
  if (options_.timing && !target_.timed_run)
    throw Mistake{"--timing takes the times of a Vulkan device; the reference has none"};
  if (!options_.counters.empty() && !target_.counters)
    throw Mistake{"--counters are those of a Vulkan device; the reference has none"};
  if (options_.check_finite && !target_.checked_run)
    throw Mistake{"--check-finite looks at a Vulkan device; on the reference use drc eval --check-finite"};
  if (options_.check_runs > 0 && !target_.compared_run)
    throw Mistake{"--check-against-reference compares a Vulkan device with the reference; give --device"};
  if (options_.check_runs > 0 && options_.check_finite)
    throw Mistake{"--check-finite and --check-against-reference look at runs in two ways: give one of them"};
  choose_steps();
  std::set<std::string> giving;
  for (const auto& [step, times] : steps_)
    if (times > 0) giving.insert(step);
  Results(target_, names_).check(options_, giving);
  if (!options_.out.empty()) at_.program = checksum_of(std::as_bytes(bundle_));
  bind();
  if (options_.resume) {
    resume();
    try {
      Results(target_, names_).check(options_, steps_to_come());
    } catch (const Mistake& mistake) {
      throw Mistake{mistake.message + "; what steps gave that ended before --resume stands in '" + options_.out + "'"};
    }
  }
  at_.steps = steps_;
  if (!options_.out.empty()) {
    folder_.take();
    folder_.sweep(checkpoint_folder(options_.out));
  }
  if (options_.watch >= 0) open_watch();
  try {
    run_steps();
    if (watch_ && !ran_.empty()) watch_->end(steps_[at_.entry].first, at_.done);
  } catch (const Mistake& mistake) {
    // What ran before is not lost.
    is_cut_short_ = true;
    if (!ran_.empty() && !under_way_) try {
        write_results();
      } catch (const Mistake& unwritten) {
        std::fprintf(stderr, "drun: warning: %s\n", unwritten.message.c_str());
      }
    if (!has_saved_ || !under_way_) throw;
    throw Mistake{mistake.message + "; what '" + options_.out + "' has stays: --resume goes on from it"};
  }
  if (ran_.empty() && !is_stopping()) std::fprintf(stderr, "nothing is left to run\n");
  if (is_stopping())
    std::fprintf(stderr, "%s%s\n", reason_of_stop(),
                 ran_.empty() ? " before the first run: nothing is written, and what was there stays"
                              : ": writing what there is");
  if (const auto use = target_.memory_use ? target_.memory_use() : runtime::MemoryUse{}; !use.host_leaves.empty())
    std::fprintf(stderr, "drun: warning: the device's memory does not hold all: it reads %s from the host's\n",
                 list(use.host_leaves).c_str());
  if (!options_.counters.empty()) print_counters();
  // A run that was stopped before it did anything leaves what was there before.
  if (!ran_.empty() || !is_stopping()) write_results();
  if (!not_finite_.empty()) throw Mistake{not_finite_};
}

void Session::run_steps() {
  while (at_.entry < steps_.size() && !is_stopping()) {
    const auto& [step, times] = steps_[at_.entry];
    run_step(step, at_.done, times);
    // The last one may get more runs when it is resumed.
    if (at_.done < times || at_.entry + 1 == steps_.size()) break;
    ++at_.entry;
    at_.done = 0;
  }
}

void Session::choose_steps() {
  const std::vector<std::string> all = names_.steps();
  steps_ = options_.steps;
  if (steps_.empty()) {
    if (all.empty()) throw Mistake{"the program has no step: nothing is to run"};
    if (all.size() != 1)
      throw Mistake{"the program has several steps: choose with --step NAME[=TIMES]; there are " + list(all)};
    steps_.emplace_back(all[0], 1);
  }
  for (const auto& [name, times] : steps_)
    if (std::find(all.begin(), all.end(), name) == all.end()) throw Mistake{io::unknown_name("step", name, all)};
}

void Session::bind() {
  std::map<std::string, int64_t> symbols;
  std::map<std::string, Array> bound;
  for (const auto& [name, value] : options_.symbols) {
    int64_t number = 0;
    const auto [end, error] = std::from_chars(value.data(), value.data() + value.size(), number);
    if (error != std::errc{} || end != value.data() + value.size())
      throw Mistake{"symbol '" + name + "': expected a whole number, found '" + value + "'"};
    must(target_.bind_symbol(name, number));
    symbols[name] = number;
  }
  for (const auto& [name, source] : options_.bindings) {
    int components = 0;
    auto kind = io::ElementKind::Float32;
    std::vector<std::string> all;
    for (const auto& leaf : names_.leaves()) {
      all.push_back(leaf.name);
      if (leaf.name == name) components = leaf.components, kind = leaf.kind;
    }
    if (components == 0) throw Mistake{io::unknown_name("leaf", name, all)};
    Array data = must(io::load_binding(source, components));
    if (const auto doubt = options_.unchecked ? std::nullopt : io::doubt_about(source, data))
      std::fprintf(stderr, "drun: warning: leaf '%s': %s\n", name.c_str(), doubt->c_str());
    if (const auto place = options_.unchecked ? std::nullopt : io::first_not_finite(data))
      throw Mistake{"leaf '" + name + "': '" + source + "' has " + io::describe(*place) +
                    "; if the program expects such, give --unchecked"};
    must(target_.bind(name, data));
    if (!options_.out.empty()) at_.data[name] = checksum_of(data.bytes);
    // Of floats the extent is enough.
    if (kind == io::ElementKind::Float32) data.bytes.clear();
    bound.emplace(name, std::move(data));
  }
  if (options_.unchecked) return;
  std::vector<std::string> steps;
  for (const auto& step : steps_) steps.push_back(step.first);
  if (const auto problem = jit::check_indices(bundle_, steps, bound, symbols))
    throw Mistake{*problem + "; if reading 0 there is meant, give --unchecked"};
}

void Session::warn_of_changes(const Checkpoint& before) const {
  if (before.program.empty()) return;
  const auto warn = [](const std::string& what) {
    std::fprintf(stderr, "drun: warning: --resume goes on with %s than the run before had\n", what.c_str());
  };
  if (before.program != at_.program) warn("another program, or for another device,");
  std::set<std::string> names;
  for (const auto* data : {&before.data, &at_.data})
    for (const auto& entry : *data) names.insert(entry.first);
  const auto is_changed = [&](const std::string& name) {
    const auto was = before.data.find(name), now = at_.data.find(name);
    return was == before.data.end() || now == at_.data.end() || was->second != now->second;
  };
  for (const auto& [leaf, data] : before.leaves) {
    names.erase(leaf);
    if (at_.data.contains(leaf) && is_changed(leaf))
      std::fprintf(stderr, "drun: warning: --resume takes '%s' from the checkpoint, not from --bind\n", leaf.c_str());
  }
  for (const std::string& name : names)
    if (is_changed(name)) warn("other data of '" + name + "'");
}

void Session::resume() {
  if (std::filesystem::is_directory(options_.out)) folder_.take();
  Checkpoint left = load_checkpoint(options_.out);
  warn_of_changes(left);
  left.program = at_.program;
  left.data = at_.data;
  at_ = std::move(left);
  // The steps before the one that it stopped in are as they were, and that one is the same.
  const bool same =
      at_.entry < steps_.size() &&
      std::equal(at_.steps.begin(), at_.steps.begin() + static_cast<ptrdiff_t>(at_.entry), steps_.begin()) &&
      at_.steps[at_.entry].first == steps_[at_.entry].first;
  if (!same) {
    std::string before;
    for (const auto& [step, times] : at_.steps) before += " --step " + step + "=" + std::to_string(times);
    throw Mistake{"--resume goes on with the steps of the run before, which were" + before +
                  "; the last one may run more often, and others may follow"};
  }
  if (const auto& [step, times] = steps_[at_.entry]; times < at_.done)
    throw Mistake{"--resume: step '" + step + "' has run " + std::to_string(at_.done) + " times, more often than the " +
                  std::to_string(times) + " that are asked for"};
  for (const auto& [leaf, data] : at_.leaves) must(target_.bind(leaf, data));
  for (const auto& [step, runs] : at_.runs) must(target_.set_runs(step, runs));
  at_.leaves.clear();
  // Steps of another program have nothing to give.
  std::erase_if(at_.outputs, [&](const auto& held) { return !std::ranges::count(names_.steps(), held.first); });
}

// Whose outputs there will be: what steps gave that ended before stands in the files of --out alone.
std::set<std::string> Session::steps_to_come() const {
  std::set<std::string> out;
  for (const auto& [step, outputs] : at_.outputs) out.insert(step);
  for (size_t k = at_.entry; k < steps_.size(); ++k)
    if (steps_[k].second > (k == at_.entry ? at_.done : 0)) out.insert(steps_[k].first);
  return out;
}

int Session::until_line(int done, int times) const {
  if (!options_.dump_raster.empty() || options_.check_finite) return 1;
  const int every = options_.log_every;
  return std::min(done == 0 ? 1 : every - (done - 1) % every, times - done);
}

void Session::run_step(const std::string& step, int& done, int times) {
  Progress progress(step, done, times);
  while (done < times && !is_stopping()) {
    const int left = times - done, line = until_line(done, times);
    int now = line;
    const bool first = ran_.count(step) == 0;
    if (first) now = 1;  // it compiles, and shows where the fit starts
    std::optional<LongWork> compiling;
    if (first && target_.memory_use) compiling.emplace(step + ": the device's driver compiles the step's shaders");
    if (first && options_.timing) prepare(step);
    const auto begin = Clock::now();
    // The last run of all is the one that is looked at.
    const bool looks = options_.timing || !options_.counters.empty();
    if (looks && now == left && now > 1) --now;
    const bool compares = done < options_.check_runs;
    if (compares) now = 1;
    const bool is_single = compares || options_.check_finite || (looks && left == 1);
    if (is_single && allowed(step, done, 1) == 0) break;
    std::string mistake;
    under_way_ = true;
    if (options_.check_finite)
      mistake = checked_run(step, done + 1);
    else if (compares)
      mistake = compared_run(step, done + 1);
    else if (looks && left == 1)
      timed_run(step);
    else
      now = run_for(step, now, done);
    under_way_ = false;
    compiling.reset();
    if (now == 0) break;
    if (first && options_.timing && left > 1)
      std::printf("%s: the first run took %.0f ms, in which some drivers compile\n", step.c_str(), ms_since(begin));
    at_.outputs.erase(step);
    if (ran_.insert(step).second) warn_of_open_meshes(step);
    done += now;
    const int64_t before = at_.runs[step];
    at_.runs[step] += now;
    if (!options_.dump_raster.empty())
      must(io::save_decisions(options_.dump_raster, step, before, must(target_.decisions(step))));
    progress.show(done, scalars(step, done, now == line));
    ran_for_ += ms_since(begin);
    look_for_not_finite(step, done, done == times || is_stopping());
    if (mistake.empty()) mistake = not_finite_;
    if (!mistake.empty()) throw Mistake{mistake};
    checkpoint_when_due(step, 0);
  }
  std::fputs(last_lines_[step].c_str(), stdout);
}

void Session::checkpoint_when_due(const std::string& step, int more) {
  if (options_.out.empty() || is_stopping()) return;
  const bool by_time = options_.checkpoint_seconds > 0 && ms_since(saved_) >= 1e3 * options_.checkpoint_seconds;
  const bool by_runs = options_.checkpoint_runs > 0 && runs_since_saved_ >= options_.checkpoint_runs;
  if (!by_time && !by_runs) return;
  // The last one is written with the results.
  const bool over = at_.done == at_.steps[at_.entry].second;
  if (over && at_.entry + 1 == at_.steps.size()) return;
  Checkpoint now = at_;
  now.done += more;
  now.runs[step] += more;
  std::set<std::string> ran = ran_;
  ran.insert(step);
  const Results results(target_, names_, at_.outputs);
  now.leaves = results.leaves(ran);
  for (const std::string& one : ran)
    if (one != step || over) now.outputs[one] = results.outputs(one);
  tell_unwritten(unwritten_log_, log_.flush());
  try {
    save_checkpoint(options_.out, now);
    unwritten_checkpoint_.reset();
    has_saved_ = true;
  } catch (const Mistake& mistake) {
    tell_unwritten(unwritten_checkpoint_, "no checkpoint, and the run goes on: " + mistake.message);
  }
  runs_since_saved_ = 0;
  saved_ = Clock::now();
}

void Session::warn_of_open_meshes(const std::string& step) {
  const char* const kTable = ".closed";
  for (const std::string& faces : names_.needed_leaves(step)) {
    const std::string leaf = faces + kTable;
    if (!names_.is_input(leaf) || warned_.contains(leaf)) continue;
    const auto closed = target_.leaf(leaf);
    if (!closed) continue;  // no step that ran reads it
    warned_.insert(leaf);
    if (closed->kind == io::ElementKind::Int32 && closed->as<int32_t>()[0] == 0)
      std::fprintf(stderr, "drun: warning: %s\n", topology::not_closed(faces).c_str());
  }
}

// Runs the step so often, or until somebody interrupts, which is looked at several times a second. Gives how often.
int Session::run_for(const std::string& step, int times, int before) {
  int done = 0;
  while (done < times && !(is_stopping() && done > 0) && not_finite_.empty()) {
    int now = std::min(times - done, together_);
    if (watch_) now = allowed(step, before + done, now);
    if (now == 0) break;
    const auto begin = Clock::now();
    if (options_.checkpoint_runs > 0) now = std::clamp(options_.checkpoint_runs - runs_since_saved_, 1, now);
    must(target_.run(step, now));
    const double seconds = ms_since(begin) * 1e-3;
    done += now;
    hear_of_not_finite(step, before + done);
    runs_since_saved_ += now;
    together_ = static_cast<int>(std::clamp(0.2 * now / std::max(seconds, 1e-6), 1.0, 1e6));
    // The device takes its time to start, and the host to know how much it takes at once.
    if (ran_.count(step) != 0) batches_[step].push_back({seconds, now});
    if (done < times && not_finite_.empty()) checkpoint_when_due(step, done);
  }
  return done;
}

void Session::open_watch() {
  watch::Reader reader;
  reader.outputs = [this](const std::string& step) { return names_.outputs(step); };
  reader.output = target_.output;
  if (target_.counters)
    reader.left_out = [this](const std::string& step) -> std::vector<watch::Left> {
      const runtime::StepCounters counters = target_.counters(step);
      const runtime::Work &run = counters.run, &skipped = counters.skipped;
      return {{"commands", run.commands, skipped.commands},
              {"ops", run.ops, skipped.ops},
              {"bytes", run.bytes, skipped.bytes}};
    };
  watch_ = must(watch::Watch::open(options_.watch, std::move(reader)));
  std::fprintf(stderr, "watch: %s\n", watch_->url().c_str());
}

int Session::allowed(const std::string& step, int done, int wanted) {
  if (!watch_) return wanted;
  constexpr std::chrono::milliseconds kPatience{100};  // Ctrl-C and --timeout are heard meanwhile
  while (!is_stopping()) {
    if (const int now = watch_->allow(step, done, wanted, kPatience); now > 0) return now;
    if (watch_->is_stopped()) stop_as_wished();
  }
  return 0;
}

void Session::prepare(const std::string& step) {
  const auto begin = Clock::now();
  const int commands = must(target_.prepare(step));
  std::printf("%s: memory and pipelines of %d commands took %.0f ms\n", step.c_str(), commands, ms_since(begin));
}

void Session::timed_run(const std::string& step) {
  auto result = target_.timed_run(step);
  // A queue may take no times; nothing but --timing needs them.
  if (!result && !options_.timing) return must(target_.run(step, 1));
  const auto times = must(std::move(result));
  counters_.steps[step].lists = lists_of(times);
  for (const runtime::CommandTime& t : times) counters_.steps[step].fragments += t.fragments;
  if (!options_.timing) return;
  if (times.empty()) {
    std::printf("%s: nothing ran: all that it gives was there from the run before\n", step.c_str());
    return;
  }
  std::fputs(timing_table(step, times, floor_).c_str(), stdout);
  if (const std::vector<Batch>& batches = batches_[step]; !batches.empty()) {
    std::vector<double> paces;
    Batch all{0, 0};
    for (const Batch& batch : batches) {
      paces.push_back(batch.seconds / batch.runs);
      all = {all.seconds + batch.seconds, all.runs + batch.runs};
    }
    std::ranges::nth_element(paces, paces.begin() + static_cast<ptrdiff_t>(paces.size() / 2));
    std::printf("%s: %.1f us a run while several are under way; %d runs in %.6f s\n", step.c_str(),
                1e6 * paces[paces.size() / 2], all.runs, all.seconds);
  }
}

std::string Session::checked_run(const std::string& step, int run) {
  const auto found = must(target_.checked_run(step));
  if (!found) return {};
  const std::string lines = joined_lines(found->lines);
  return "run " + std::to_string(run) + " of step '" + step + "': pass '" + found->label + "' stores " +
         io::describe(found->place) + " of '" + found->value + "'" + (lines.empty() ? "" : "; lines " + lines);
}

std::string Session::compared_run(const std::string& step, int run) {
  const jit::Comparison found = must(target_.compared_run(step, at_.runs[step]));
  for (const jit::Difference& one : found.excused)
    std::fprintf(stderr, "drun: warning: step '%s': float32 alone decides otherwise than the reference: %s\n",
                 step.c_str(), describe(one).c_str());
  if (found.differ.empty()) {
    std::printf("%s: run %d agrees with the reference in %d values\n", step.c_str(), run, found.values);
    return {};
  }
  std::string text = "run " + std::to_string(run) + " of step '" + step +
                     "' differs from the reference: " + describe(found.differ.front());
  for (size_t k = 1; k < found.differ.size(); ++k)
    text += (k == 1 ? "; so do, later, '" : ", '") + found.differ[k].value + "'";
  return text;
}

std::string Session::scalars(const std::string& step, int done, bool logged) {
  std::string values, lines, json = "{\"step\": \"" + step + "\", \"run\": " + std::to_string(done);
  for (const std::string& name : names_.outputs(step)) {
    if (!is_short(step, name)) continue;
    const Array value = must(target_.output(step, name));
    const std::vector<double> numbers = value.to_doubles();
    std::string shown, listed;
    for (const double number : numbers) {
      const std::string text = number_text(number, value.kind != io::ElementKind::Float32);
      shown += (shown.empty() ? "" : ", ") + text;
      listed += (listed.empty() ? "" : ", ") + (std::isfinite(number) ? text : "null");
    }
    if (watch_) watch_->add(step, name, done, numbers);
    const bool several = numbers.size() > 1;
    if (several) shown = "(" + shown + ")";
    values += (values.empty() ? "" : "  ") + name + " = " + shown;
    lines += step + "." + name + " = " + shown + "\n";
    json += ", \"" + name + "\": " + (several ? "[" + listed + "]" : listed);
    if (!std::ranges::all_of(numbers, [](double x) { return std::isfinite(x); }))
      tell_not_finite(step, name, "output '" + step + "." + name + "' is " + shown + " in run " + std::to_string(done));
  }
  json += "}\n";
  last_lines_[step] = lines;
  if (!logged) return values;
  tell_unwritten(unwritten_log_, log_.add(json, at_.log));
  at_.log += json;
  return values;
}

// Reading an image back at every log line would cost more than the step: sizes are looked at once.
bool Session::is_short(const std::string& step, const std::string& name) {
  const auto key = step + "." + name;
  if (auto it = short_.find(key); it != short_.end()) return it->second;
  const Array a = must(target_.output(step, name));
  return short_[key] = a.size() == 1;
}

// Once for each output of a step and each leaf; what is wrong then stays wrong.
void Session::tell_not_finite(const std::string& step, const std::string& name, const std::string& what) {
  if (!told_.insert(step + "." + name).second) return;
  const std::string message =
      what + ": --check-finite names the pass and line where it begins (with --pack naive, the op)";
  if (!options_.strict_finite) {
    std::fprintf(stderr, "drun: warning: %s\n", message.c_str());
  } else if (not_finite_.empty()) {
    not_finite_ = message;
  }
}

void Session::hear_of_not_finite(const std::string& step, int done) {
  if (!target_.told_not_finite) return;
  std::vector<std::string> passes = must(target_.told_not_finite(step));
  std::erase_if(passes, [&](const std::string& pass) { return told_.count(step + "." + pass) != 0; });
  if (passes.empty()) return;
  const size_t before = told_.size();
  (void)scalars(step, done, false);
  look_for_not_finite(step, done, true);
  // What leaves and outputs hold now may be finite again.
  const bool is_there = told_.size() != before;
  for (const std::string& pass : passes) {
    if (!is_there)
      tell_not_finite(step, pass,
                      "pass " + pass + " left a NaN or Inf by run " + std::to_string(done) + " of step '" + step + "'");
    told_.insert(step + "." + pass);
  }
}

void Session::look_for_not_finite(const std::string& step, int done, bool last) {
  constexpr double kMostOfTime = 0.01;
  if (!last && looked_ > kMostOfTime * ran_for_) return;
  const auto begin = Clock::now();
  for (const auto& leaf : names_.leaves()) {
    if (leaf.kind != io::ElementKind::Float32 || !names_.changes(step, leaf.name)) continue;
    if (const auto place = io::first_not_finite(must(target_.leaf(leaf.name))))
      tell_not_finite("", leaf.name,
                      "'" + leaf.name + "' has " + io::describe(*place) + " after run " + std::to_string(done) +
                          " of step '" + step + "'");
  }
  looked_ += ms_since(begin);
}

void Session::print_counters() {
  for (const std::string& step : ran_) counters_.steps[step].work = target_.counters(step);
  counters_.memory = target_.memory_use();
  counters_.pipelines = target_.pipelines();
  counters_.rebuilds = target_.rebuilds();
  std::fputs((options_.counters == "json" ? print_json(counters_) : print(counters_)).c_str(), stdout);
}

std::set<std::string> Session::given() const {
  std::set<std::string> out = ran_;
  for (const auto& [step, outputs] : at_.outputs) out.insert(step);
  return out;
}

void Session::write_results() {
  Results results(target_, names_, at_.outputs);
  // What is written is told of when it is: --strict-finite stops with the numbers there to look at.
  std::vector<std::pair<io::ResultName, io::Place>> not_finite;
  results.look_with([&](const io::ResultName& name, const Array& data) {
    if (const auto place = io::first_not_finite(data)) not_finite.emplace_back(name, *place);
  });
  write_results(results);
  for (const auto& [name, place] : not_finite)
    tell_not_finite(name.step, name.name, "output '" + name.step + "." + name.name + "' has " + io::describe(place));
}

void Session::write_results(const Results& results) {
  const std::set<std::string> steps = given();
  const bool stopped = is_stopping() || is_cut_short_;
  if (options_.out.empty()) return results.write_asked(options_, steps, stopped);
  at_.leaves = results.leaves(ran_);
  std::string failed;
  const auto fail = [&](const std::string& message) { failed += (failed.empty() ? "" : "; ") + message; };
  const auto attempt = [&](const auto& write) {
    try {
      write();
    } catch (const Mistake& mistake) {
      fail(mistake.message);
    }
  };
  if (const auto why = options_.resume ? log_.restore(at_.log) : log_.flush()) fail(*why);
  attempt([&] { results.write_outputs(options_.out, steps, at_.leaves, options_.resume || ran_.empty()); });
  attempt([&] { results.write_asked(options_, steps, stopped); });
  const bool is_whole = failed.empty();
  // No run is lost by a file that cannot be written: the checkpoint holds what the file would.
  if (is_whole)
    at_.outputs.clear();
  else
    for (const std::string& step : steps) at_.outputs[step] = results.outputs(step);
  attempt([&] {
    save_checkpoint(options_.out, at_);
    has_saved_ = true;
    if (!is_whole) failed += "; --resume writes it without running again";
  });
  if (!failed.empty()) throw Mistake{failed};
}

}  // namespace dr::drun
