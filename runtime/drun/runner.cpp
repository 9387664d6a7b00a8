// SPDX-License-Identifier: Apache-2.0
// Opens the device, loads or compiles the program, and hands both on.
#include "runtime/drun/runner.h"

#include <cstdio>

#include "compiler/io/program_text.h"
#include "compiler/ir/internal_error.h"
#include "runtime/drun/session.h"
#include "runtime/drun/stop.h"
#include "runtime/jit/measure.h"
#include "runtime/jit/rebuild.h"

namespace dr::drun {

namespace {

bool is_bundle(const std::string& file) { return file.size() > 4 && file.ends_with(".drb"); }

// What is made of a program or bundle. What is wrong with a file from elsewhere is told with its name.
template <class T>
T loaded(const Options& options, io::Result<T> result) {
  if (!result && is_bundle(options.file)) throw Mistake{"'" + options.file + "': " + result.error()};
  return must(std::move(result));
}

int list_devices() {
  const auto devices = must(runtime::Device::list());
  for (size_t k = 0; k < devices.size(); ++k)
    std::printf("%zu: %s (%s, Vulkan %s, driver %s)\n", k, devices[k].name.c_str(), devices[k].kind.c_str(),
                devices[k].api_version.c_str(), devices[k].driver.c_str());
  return 0;
}

int measure(const Options& options) {
  const runtime::Device device = must(runtime::Device::open({options.device, false}));
  const std::string profile = must(jit::measure_profile(device));
  if (options.profile_out == "-")
    std::fputs(profile.c_str(), stdout);
  else
    write_text(options.profile_out, profile);
  return 0;
}

// The leaves that are bound, and whether to zeros that the command line has: no run changes an input.
std::map<std::string, bool, std::less<>> zeros_bound(const Options& options) {
  std::map<std::string, bool, std::less<>> out;
  for (const auto& [name, source] : options.bindings) {
    const size_t digits = source.starts_with('=') ? 1 : 0;
    const bool zeros = source.find_first_not_of("[0., ]", digits) == std::string::npos &&
                       source.find('0', digits) != std::string::npos;
    out.emplace(name, zeros);
  }
  return out;
}

std::vector<uint8_t> load_or_compile(const Options& options, const std::string& device_profile,
                                     std::vector<jit::Skip>& skips) {
  if (is_bundle(options.file)) {
    jit::Options compile = options.compile;
    std::erase(compile.ablate, "cache");  // the runtime's part
    compile.include_dirs.clear();         // a habit of command lines, and harmless
    compile.shader_cache = true;
    if (compile != jit::Options{})
      throw Mistake{
          "'" + options.file +
          "' is compiled already: --profile, --lower, --raster, --pack, --scatter, --float, --ablate, --no-skip of "
          "what compiling leaves out and -D are for .dr programs"};
    const std::string bytes = must(io::program_text(options.file));
    return {bytes.begin(), bytes.end()};
  }
  jit::Options compile = options.compile;
  if (compile.profile.empty()) compile.profile = device_profile;
  if (compile.profile.empty()) throw Mistake{"no built-in profile fits the device: give one with --profile"};
  compile.bound = zeros_bound(options);
  jit::Told told;
  auto bundle = jit::compile_file(options.file, compile, &told);
  if (!bundle) {
    std::fputs(bundle.error().c_str(), stderr);
    throw Mistake{};
  }
  std::fputs(told.warnings.c_str(), stderr);
  skips = std::move(told.skips);
  return std::move(bundle).value();
}

}  // namespace

namespace {

int run_program(const Options& options) {
  try {
    if (options.list_devices) return list_devices();
    if (options.measure) return measure(options);
    catch_signals();
    const Timeout timeout(options.timeout);
    std::vector<jit::Skip> skips;
    if (options.device == "reference") {
      // The bundle's tables name leaves, steps and outputs; its graph runs.
      const std::vector<uint8_t> bundle = load_or_compile(options, "lavapipe", skips);
      const runtime::Program names = loaded(options, runtime::Program::describe(bundle));
      jit::ReferenceProgram program = loaded(options, jit::ReferenceProgram::load(bundle));
      Session(options, target_of(program), names, bundle).process();
      return exit_code_of_stop();
    }
    const runtime::Device device = must(runtime::Device::open({options.device, options.validate, options.timing}));
    const auto begin = std::chrono::steady_clock::now();
    const std::vector<uint8_t> bundle = load_or_compile(options, device.profile_name(), skips);
    if (options.timing) std::printf("%s: compiled or read in %.0f ms\n", options.file.c_str(), ms_since(begin));
    runtime::LoadOptions load{.trusted = options.trusted || !is_bundle(options.file),
                              .cache = options.cache,
                              .reuse_commands = options.commands,
                              .pipeline_folder = options.pipelines ? jit::cache_folder() : std::string(),
                              .compile_beside = options.pipelines,
                              .memory_limit = options.memory,
                              .buffer_limit = options.buffers,
                              .store_all = options.check_finite,
                              .warn = {}};  // a session says more
    for (const auto& [step, times] : options.steps) load.steps.push_back(step);
    if (options.rebuild) load.rebuild = jit::rebuilder(bundle, options.compile);
    runtime::Program program = loaded(options, runtime::Program::load(device, bundle, load));
    const jit::Floor floor =
        jit::floor_of(options.compile.profile.empty() ? device.profile_name() : options.compile.profile);
    std::optional<jit::ReferenceCheck> check;
    if (options.check_runs > 0) check = loaded(options, jit::ReferenceCheck::load(bundle));
    Session(options, check ? target_of(program, *check) : target_of(program), program, bundle, skips, floor).process();
    if (const auto messages = device.validation_messages(); !messages.empty()) {
      for (const std::string& m : messages) std::fprintf(stderr, "validation: %s\n", m.c_str());
      return 1;
    }
    return exit_code_of_stop();
  } catch (const Mistake& mistake) {
    if (!mistake.message.empty()) std::fprintf(stderr, "drun: error: %s\n", mistake.message.c_str());
  } catch (const std::bad_alloc&) {
    std::fprintf(stderr, "drun: error: this machine has not enough memory for the program's data\n");
  } catch (const ir::InternalError& e) {
    std::fprintf(stderr, "drun: internal error: %s\n", e.what());
    return 3;  // as of drc
  } catch (const std::exception& e) {
    std::fprintf(stderr, "drun: error: %s\n", e.what());
  }
  return 1;
}

}  // namespace

int run(const Options& options) {
  const int code = run_program(options);
  // What the system buffered may still find no room.
  if (std::fflush(stdout) == 0 && std::ferror(stdout) == 0) return code;
  std::fprintf(stderr, "drun: error: cannot write to stdout\n");
  return code == 0 ? 1 : code;
}

}  // namespace dr::drun
