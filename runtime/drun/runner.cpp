// SPDX-License-Identifier: Apache-2.0
// What drun does between the command line and the files it writes.
#include "runtime/drun/runner.h"

#include <unistd.h>

#include <algorithm>
#include <charconv>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <functional>
#include <optional>
#include <set>
#include <sstream>

#include "runtime/io/decisions.h"
#include "runtime/io/mesh.h"
#include "runtime/jit/reference_program.h"
#include "runtime/runtime.h"

namespace dr::drun {

namespace {

using io::Array;

volatile std::sig_atomic_t interrupted = 0;  // Ctrl-C: finish the step that runs, then write the results

struct Mistake {
  std::string message;
};

template <class T>
T must(io::Result<T> result) {
  if (!result) throw Mistake{result.error()};
  if constexpr (!std::is_void_v<T>) return std::move(result).value();
}

// The two kinds of device behind one set of calls.
struct Target {
  std::function<io::Result<void>(const std::string&, const Array&)> bind;
  std::function<io::Result<void>(const std::string&, int64_t)> bind_symbol;
  std::function<io::Result<void>(const std::string&, int)> run;
  std::function<io::Result<Array>(const std::string&, const std::string&)> output;
  std::function<io::Result<Array>(const std::string&)> leaf;
  std::function<io::Result<io::Decisions>(const std::string&)> decisions;
};

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
    for (Array& a : raster) {
      auto whole = a.converted(io::ElementKind::Int32);
      if (!whole) return io::Error{whole.error()};
      a = *std::move(whole);
    }
  return out;
}

template <class P>
Target target_of(P& program) {
  return {[&](const std::string& n, const Array& a) { return program.bind(n, a); },
          [&](const std::string& n, int64_t v) { return program.bind_symbol(n, v); },
          [&](const std::string& n, int t) { return program.run(n, t); },
          [&](const std::string& s, const std::string& n) { return program.output(s, n); },
          [&](const std::string& n) { return program.leaf(n); },
          [&](const std::string& s) { return decisions_of(program, s); }};
}

std::vector<uint8_t> read_file(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) throw Mistake{"cannot read '" + path + "'"};
  std::stringstream text;
  text << file.rdbuf();
  const std::string s = text.str();
  return {s.begin(), s.end()};
}

std::string number(double value) {
  char text[32];
  return {text, std::to_chars(text, text + sizeof text, static_cast<float>(value)).ptr};
}

bool is_scalar(const Array& a) { return a.scalar_count() == 1; }

// One line on stderr that is rewritten; silent when stderr is no terminal.
class Progress {
 public:
  Progress(std::string step, int total)
      : step_(std::move(step)), total_(total), terminal_(isatty(STDERR_FILENO) != 0) {}
  void show(int done, const std::string& values) {
    if (!terminal_ || total_ < 2) return;
    const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
    const double rate = seconds > 0 ? done / seconds : 0;
    std::fprintf(stderr, "\r\033[K%s %d/%d  %s  %.1f steps/s  %.0f s left", step_.c_str(), done, total_, values.c_str(),
                 rate, rate > 0 ? (total_ - done) / rate : 0.0);
    std::fflush(stderr);
  }
  ~Progress() {
    if (terminal_ && total_ >= 2) std::fprintf(stderr, "\n");
  }

 private:
  std::string step_;
  int total_;
  bool terminal_;
  std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
};

class Run {
 public:
  Run(const Options& options, const Target& target, const runtime::Program& names)
      : options_(options), target_(target), names_(names) {}

  void process() {
    choose_steps();
    bind();
    if (!options_.out.empty()) std::filesystem::create_directories(options_.out);
    for (const auto& [step, times] : steps_) {
      run_step(step, times);
      if (interrupted) break;
    }
    if (interrupted) std::fprintf(stderr, "interrupted: writing what there is\n");
    write_results();
  }

 private:
  void choose_steps() {
    const std::vector<std::string> all = names_.steps();
    steps_ = options_.steps;
    if (steps_.empty()) {
      if (all.size() != 1)
        throw Mistake{"the program has several steps: choose with --step NAME[=TIMES]; there are " + list(all)};
      steps_.emplace_back(all[0], 1);
    }
    for (const auto& [name, times] : steps_)
      if (std::find(all.begin(), all.end(), name) == all.end())
        throw Mistake{"there is no step '" + name + "'; there are " + list(all)};
  }

  static std::string list(const std::vector<std::string>& names) {
    std::string out;
    for (const std::string& n : names) out += (out.empty() ? "" : ", ") + n;
    return out;
  }

  void bind() {
    for (const auto& [name, value] : options_.symbols) {
      int64_t number = 0;
      const auto [end, error] = std::from_chars(value.data(), value.data() + value.size(), number);
      if (error != std::errc{} || end != value.data() + value.size())
        throw Mistake{"symbol '" + name + "': expected a whole number, found '" + value + "'"};
      must(target_.bind_symbol(name, number));
    }
    for (const auto& [name, source] : options_.bindings) {
      int components = 0;
      std::vector<std::string> all;
      for (const auto& leaf : names_.leaves()) {
        all.push_back(leaf.name);
        if (leaf.name == name) components = leaf.components;
      }
      if (components == 0) throw Mistake{"there is no leaf '" + name + "'; there are " + list(all)};
      must(target_.bind(name, must(io::load_binding(source, components))));
    }
  }

  void run_step(const std::string& step, int times) {
    Progress progress(step, times);
    const std::vector<std::string> outputs = names_.outputs(step);
    for (int done = 0; done < times && !interrupted;) {
      const int batch = std::min(options_.dump_raster.empty() ? options_.log_every : 1, times - done);
      // The first run alone: it compiles and shows where the fit starts.
      const int now = done == 0 ? 1 : batch;
      must(target_.run(step, std::min(now, times - done)));
      done += std::min(now, times - done);
      if (!options_.dump_raster.empty())
        must(io::save_decisions(options_.dump_raster, step, runs_[step]++, must(target_.decisions(step))));
      std::string values, json = "{\"step\": \"" + step + "\", \"run\": " + std::to_string(done);
      for (const std::string& name : outputs) {
        if (!maybe_scalar(step, name)) continue;
        const Array a = must(target_.output(step, name));
        const std::string text = number(a.to_doubles()[0]);
        values += (values.empty() ? "" : "  ") + name + " = " + text;
        json += ", \"" + name + "\": " + (text.find_first_of("in") == std::string::npos ? text : "null");
      }
      log_ += json + "}\n";
      last_values_[step] = values;
      progress.show(done, values);
      ran_.insert(step);
    }
    if (!last_values_[step].empty()) std::printf("%s: %s\n", step.c_str(), last_values_[step].c_str());
  }

  // Reading an image back at every log line would cost more than the step: sizes are looked at once.
  bool maybe_scalar(const std::string& step, const std::string& name) {
    const auto key = step + "." + name;
    if (auto it = scalar_.find(key); it != scalar_.end()) return it->second;
    return scalar_[key] = is_scalar(must(target_.output(step, name)));
  }

  void write_results() {
    if (!options_.out.empty()) {
      const std::filesystem::path out = options_.out;
      // A name that several steps give, or that a leaf has too, is told apart by its step.
      std::map<std::string, int> uses;
      for (const auto& leaf : names_.leaves())
        if (changed(leaf.name)) ++uses[leaf.name];
      for (const std::string& step : ran_)
        for (const std::string& name : names_.outputs(step)) ++uses[name];
      for (const std::string& step : ran_)
        for (const std::string& name : names_.outputs(step)) {
          const Array a = must(target_.output(step, name));
          if (is_scalar(a)) continue;
          const std::string stem = uses[name] > 1 ? step + "." + name : name;
          must(io::save_array((out / (stem + ".npy")).string(), a));
          const bool picture = a.height > 1 && (a.components == 1 || a.components >= 3) && a.components <= 4 &&
                               a.kind == io::ElementKind::Float32;
          if (!picture) continue;
          // The array is saved; a picture that cannot be (NaN) must not cost what comes after it.
          if (auto saved = io::save_array((out / (stem + ".png")).string(), a); !saved)
            std::fprintf(stderr, "drun: warning: %s\n", saved.error().c_str());
        }
      std::set<std::string> needed;
      for (const std::string& step : ran_)
        for (const std::string& name : names_.needed_leaves(step)) needed.insert(name);
      for (const auto& leaf : names_.leaves()) {
        if (!changed(leaf.name)) continue;
        auto value = target_.leaf(leaf.name);
        if (!value && needed.count(leaf.name) == 0) continue;  // nothing that ran needs it, and it has no data
        must(io::save_array((out / (leaf.name + ".npy")).string(), must(std::move(value))));
      }
      write_text((out / "log.jsonl").string(), log_);
    }
    for (const auto& [file, what] : options_.meshes) write_mesh(file, what);
  }

  // Params and states; what was bound as input is the user's already.
  bool changed(const std::string& leaf) const { return !names_.is_input(leaf); }

  static void write_text(const std::string& path, const std::string& text) {
    const std::string temporary = path + ".partial";
    std::ofstream file(temporary, std::ios::binary);
    file << text;
    file.close();
    if (!file) {
      std::error_code ignored;
      std::filesystem::remove(temporary, ignored);
      throw Mistake{"cannot write '" + path + "'"};
    }
    std::filesystem::rename(temporary, path);
  }

  Array named(const std::string& name) {
    for (const std::string& step : ran_)
      for (const std::string& output : names_.outputs(step))
        if (output == name) return must(target_.output(step, name));
    return must(target_.leaf(name));
  }

  void write_mesh(const std::string& file, const std::string& what) {
    std::vector<std::string> parts;
    std::stringstream text(what);
    for (std::string part; std::getline(text, part, ':');) parts.push_back(part);
    if (parts.size() < 2 || parts.size() > 4)
      throw Mistake{"--mesh " + file + ": expected POSITION:FACE[:UV[:UV_FACE]], found '" + what + "'"};
    const Array positions = named(parts[0]), faces = named(parts[1]);
    if (positions.components != 3 || positions.kind != io::ElementKind::Float32)
      throw Mistake{"--mesh " + file + ": '" + parts[0] + "' is not made of vec3"};
    if (faces.components != 3 || faces.kind != io::ElementKind::Int32)
      throw Mistake{"--mesh " + file + ": '" + parts[1] + "' is not made of ivec3"};
    std::optional<Array> uv, uv_faces;
    if (parts.size() == 4) {
      uv_faces = named(parts[3]);
      if (uv_faces->components != 3 || uv_faces->kind != io::ElementKind::Int32)
        throw Mistake{"--mesh " + file + ": '" + parts[3] + "' is not made of ivec3"};
    }
    if (parts.size() >= 3) {
      uv = named(parts[2]);
      if (uv->components != 2 || uv->kind != io::ElementKind::Float32)
        throw Mistake{"--mesh " + file + ": '" + parts[2] + "' is not made of vec2"};
    }
    io::MeshView view{.positions = positions.as<float>(), .indices = faces.as<int32_t>()};
    if (uv) view.uv = uv->as<float>();
    if (uv_faces) view.uv_indices = uv_faces->as<int32_t>();
    must(io::save_mesh(file, view));
  }

  const Options& options_;
  const Target& target_;
  const runtime::Program& names_;
  std::vector<std::pair<std::string, int>> steps_;
  std::set<std::string> ran_;
  std::map<std::string, std::string> last_values_;
  std::map<std::string, int64_t> runs_;
  std::map<std::string, bool> scalar_;
  std::string log_;
};

int list_devices() {
  const auto devices = must(runtime::Device::list());
  for (size_t k = 0; k < devices.size(); ++k)
    std::printf("%zu: %s (%s, Vulkan %s)\n", k, devices[k].name.c_str(), devices[k].kind.c_str(),
                devices[k].api_version.c_str());
  return 0;
}

std::vector<uint8_t> load_or_compile(const Options& options, const std::string& device_profile) {
  if (options.file.size() > 4 && options.file.ends_with(".drb")) return read_file(options.file);
  jit::Options compile = options.compile;
  if (compile.profile.empty()) compile.profile = device_profile;
  if (compile.profile.empty()) throw Mistake{"no built-in profile fits the device: give one with --profile"};
  auto bundle = jit::compile_file(options.file, compile);
  if (auto* messages = std::get_if<std::string>(&bundle)) {
    std::fputs(messages->c_str(), stderr);
    throw Mistake{};
  }
  return std::move(std::get<std::vector<uint8_t>>(bundle));
}

}  // namespace

int run(const Options& options) {
  try {
    if (options.list_devices) return list_devices();
    std::signal(SIGINT, [](int) { interrupted = 1; });
    if (options.device == "reference") {
      // The bundle's tables name leaves, steps and outputs; its graph runs.
      const std::vector<uint8_t> bundle = load_or_compile(options, "lavapipe");
      const runtime::Program names = must(runtime::Program::describe(bundle));
      jit::ReferenceProgram program = must(jit::ReferenceProgram::load(bundle));
      Run(options, target_of(program), names).process();
      return 0;
    }
    const runtime::Device device = must(runtime::Device::open({options.device, options.validate}));
    runtime::Program program = must(runtime::Program::load(device, load_or_compile(options, device.profile_name())));
    Run(options, target_of(program), program).process();
    if (const auto messages = device.validation_messages(); !messages.empty()) {
      for (const std::string& m : messages) std::fprintf(stderr, "validation: %s\n", m.c_str());
      return 1;
    }
    return 0;
  } catch (const Mistake& mistake) {
    if (!mistake.message.empty()) std::fprintf(stderr, "drun: error: %s\n", mistake.message.c_str());
  } catch (const std::bad_alloc&) {
    std::fprintf(stderr, "drun: error: this machine has not enough memory for the program's data\n");
  } catch (const std::exception& e) {
    std::fprintf(stderr, "drun: error: %s\n", e.what());
  }
  return 1;
}

}  // namespace dr::drun
