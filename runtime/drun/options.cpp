// SPDX-License-Identifier: Apache-2.0
// The command line by CLI11.
#include "runtime/drun/options.h"

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cctype>
#include <charconv>
#include <filesystem>
#include <limits>
#include <string_view>

#include "version_generated.h"

namespace dr::drun {

namespace {

// "name=value"; the value may hold further '='.
std::pair<std::string, std::string> split(const std::string& text, const char* option) {
  const size_t at = text.find('=');
  if (at == 0 || at == std::string::npos)
    throw CLI::ValidationError(option, "expected name=value, found '" + text + "'");
  return {text.substr(0, at), text.substr(at + 1)};
}

// "512M": a number of bytes. K, M, G and T are powers of 1024.
int64_t bytes_of(const std::string& text, const char* option) {
  constexpr std::string_view kUnits = "KMGT";
  uint64_t number = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
  std::string unit(end, text.data() + text.size());
  for (char& c : unit) c = static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
  if (unit.size() > 1 && unit.ends_with("B")) unit.pop_back();
  if (unit.size() > 1 && unit.ends_with("I")) unit.pop_back();
  if (unit == "B") unit.clear();
  const size_t power = unit.empty() ? 0 : unit.size() == 1 ? kUnits.find(unit[0]) + 1 : 0;
  const bool known = unit.empty() || power > 0;
  const int shift = static_cast<int>(10 * power);
  if (error != std::errc{} || !known || number == 0 || number > uint64_t{1} << (62 - shift))
    throw CLI::ValidationError(option, "expected a number of bytes as 1000000, 512M or 2G, found '" + text + "'");
  return static_cast<int64_t>(number << shift);
}

// "90s" or "90": seconds.
double seconds_of(const std::string& text, const char* option, const char* expected) {
  double seconds = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), seconds);
  const std::string_view unit(end, text.data() + text.size());
  if (error != std::errc{} || (!unit.empty() && unit != "s") || !(seconds > 0 && seconds < 1e9))
    throw CLI::ValidationError(option, std::string("expected ") + expected + ", found '" + text + "'");
  return seconds;
}

void set_checkpoints(const std::string& text, Options& options) {
  constexpr const char* kExpected = "a number of runs as 500, of seconds as 30s, or never";
  if (text.empty()) return;
  options.checkpoint_seconds = 0;
  if (text == "never") return;
  if (text.ends_with("s")) {
    options.checkpoint_seconds = seconds_of(text, "--checkpoint-every", kExpected);
    return;
  }
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), options.checkpoint_runs);
  if (error != std::errc{} || end != text.data() + text.size() || options.checkpoint_runs < 1)
    throw CLI::ValidationError("--checkpoint-every", std::string("expected ") + kExpected + ", found '" + text + "'");
}

// What is given twice would silently count once.
void add_once(std::vector<std::pair<std::string, std::string>>& all, const std::string& text, const char* option) {
  auto pair = split(text, option);
  for (const auto& [name, value] : all)
    if (name == pair.first)
      throw CLI::ValidationError(option, "'" + name + "' is given twice, as '" + value + "' and '" + pair.second + "'");
  all.push_back(std::move(pair));
}

int port_of(const std::string& text) {
  constexpr int kMost = 65535;
  int port = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), port);
  if (error == std::errc{} && end == text.data() + text.size() && port >= 0 && port <= kMost) return port;
  throw CLI::ValidationError("--watch", "expected a port from 1 to 65535, or 0 for any, found '" + text + "'");
}

// Whether a word behind --watch is meant as its port, right or wrong: -1, 80.5 and abc are, a file that is there and
// what may be the name of one are not.
bool is_meant_as_port(const std::string& word) {
  std::error_code none;
  if (word.empty() || std::filesystem::exists(word, none)) return false;
  const bool is_signed = word[0] == '-' || word[0] == '+';
  const std::string rest = word.substr(is_signed ? 1 : 0);
  if (rest.empty()) return false;
  if (rest.find_first_not_of("0123456789.") == std::string::npos) return true;
  return !is_signed && rest.find_first_of("./") == std::string::npos;
}

// `--watch 8000` as `--watch=8000`: what else follows an option that needs no value is not its own. The last word
// first, as the parser takes them.
std::vector<std::string> with_port_attached(int argc, char** argv) {
  std::vector<std::string> words;
  for (int i = 1; i < argc; ++i) {
    const std::string word = argv[i];
    if (!words.empty() && words.back() == "--watch" && is_meant_as_port(word)) {
      words.back() += "=" + word;
    } else {
      words.push_back(word);
    }
  }
  std::ranges::reverse(words);
  return words;
}

}  // namespace

bool parse_options(int argc, char** argv, Options& options, int& exit_code) {
  CLI::App app("drun runs a Dressi program (.dr) or bundle (.drb).", "drun");
  app.set_version_flag("--version", std::string("drun ") + version());
  std::vector<std::string> bindings, symbols, steps, saves, meshes, defines;
  app.add_option("FILE", options.file, "a .dr program or a .drb bundle");
  app.add_option("--bind,-b", bindings,
                 "NAME=SOURCE: data of a leaf: mesh.obj:position, image.png (colours as linear light; image.png:raw as "
                 "stored), array.npy, =[1, 2, 3]");
  app.add_option("--symbol,-s", symbols, "NAME=NUMBER: value of an extent symbol that no data gives");
  app.add_option("--step", steps,
                 "NAME[=TIMES]: step to run; several run one after another (default: the only one, once)");
  const CLI::Option* out = app.add_option("--out,-o", options.out, "folder for outputs, params and the log");
  app.add_option("--save", saves,
                 "NAME=FILE: write an output, STEP.NAME, or a leaf as .npy, .csv or .png after the run");
  app.add_option(
      "--mesh", meshes,
      "FILE=POSITION:FACE[:UV[:UV_FACE[:TEXTURE]]][:PART=NAME ...]: write leaves or outputs as a .obj, .gltf "
      "or .glb file after the run, with parts of a material");
  app.add_option("--dump-raster", options.dump_raster,
                 "folder for the faces, tags and pinned values of every run, for drc eval --freeze");
  app.add_option("--device,-d", options.device,
                 "part of a device's name, its number, or 'reference' for the float64 evaluator");
  app.add_option("--log-every", options.log_every, "read scalar outputs every so many runs of a step")
      ->capture_default_str()
      ->check(CLI::Validator(
          [](const std::string& text) {
            return text.starts_with('-') || text == "0" ? "expected 1 or more, found " + text : std::string();
          },
          "POSITIVE"));
  for (const driver::Choice& choice : driver::choices()) {
    const bool is_profile = choice.name == "profile";
    CLI::Option* option = app.add_option("--" + choice.name, options.compile.*choice.value,
                                         choice.text + (is_profile ? " (default: the device's own)" : ""));
    if (!is_profile) option->capture_default_str();
    if (!choice.words.empty()) option->check(CLI::IsMember(choice.words));
  }
  app.add_option("-D", defines, "NAME=VALUE: replace a const of the program");
  app.add_option("-I", options.compile.include_dirs, "folder to look for imported modules in");
  std::vector<std::string> ablate;
  app.add_option("--ablate", ablate,
                 "parts to switch off, with commas: substages, stages, remat, cache, blocks, guesses, emptying")
      ->delimiter(',');
  std::vector<std::string> skips = jit::skip_names();
  skips.insert(skips.end(), {"rebuild", "commands", "pipelines", "shaders"});
  std::vector<std::string> no_skip;
  app.add_option("--no-skip", no_skip, "do work that would be left out, with commas: see docs/explain/skipping.md")
      ->delimiter(',')
      ->type_name("ID")
      ->check(CLI::IsMember(skips));
  std::string memory, buffers, timeout, checkpoints;
  app.add_option("--memory", memory,
                 "device memory to take at most, in bytes or as 512M; inputs beyond that are read from the host's "
                 "(default: all that the device has)");
  app.add_option(
      "--buffers", buffers,
      "bytes that a shader sees of a buffer at once, as 1M; larger ones are bound in parts, with the same bits "
      "(default: what the device allows)");
  app.add_option("--timeout", timeout,
                 "seconds after which the run stops, writes what there is and exits with 124 (default: none)");
  app.add_option("--checkpoint-every", checkpoints,
                 "write a checkpoint to --out every so many runs (500) or seconds (30s), or never (default: 60s)");
  app.add_flag("--trusted", options.trusted,
               "the bundle is of somebody whom you trust: its shaders go to the driver without a check");
  app.add_flag("--resume", options.resume, "go on where the run that wrote to --out stopped");
  app.add_flag("--timing", options.timing, "print the device's time of each command in the last run of a step");
  app.add_flag(
      "--check-finite", options.check_finite,
      "run command by command and stop after the run that stores the first NaN or Inf: names pass, element and "
      "lines (--pack naive: of one op). Slow");
  app.add_flag("--strict-finite", options.strict_finite,
               "stop, with exit code 1, where a printed output or a param holds a NaN or Inf (default: warn)");
  CLI::Option* check = app.add_flag(
      "--check-against-reference{1}", options.check_runs,
      "compare the first run of each step, or the first so many (=RUNS), with the float64 evaluator: exit "
      "with 1 where an output, changed leaf or raster differs, and name the pass that wrote the first one. Slow");
  app.add_flag("--unchecked", options.unchecked,
               "take bound data as it is: with NaN, Inf, and indices of elements that are not there");
  const CLI::Option* counters =
      app.add_flag("--counters{text}", options.counters,
                   "print what was done and what was left out, and the memory taken; --counters=json for programs");
  std::string port;
  const CLI::Option* watch =
      app.add_flag(
             "--watch{0}", port,
             "serve a page about the run on this machine alone, at a port (--watch 8000) or any: losses, pictures, "
             "speed, what is left out, and buttons to pause, step and stop")
          ->type_name("PORT");
  app.add_flag("--validate", options.validate, "run under the Vulkan validation layer and fail on its messages");
  app.add_flag("--devices", options.list_devices, "list the Vulkan devices");
  app.add_subcommand("devices", "list the Vulkan devices")->callback([&] { options.list_devices = true; });
  CLI::App* profile = app.add_subcommand("profile", "measure a device and write its profile, for --profile");
  profile->add_option("--device,-d", options.device, "part of a device's name, or its number");
  profile->add_option("-o", options.profile_out, "file to write; - is stdout")->capture_default_str();
  profile->callback([&] { options.measure = true; });
  try {
    app.parse(with_port_attached(argc, argv));
    if (watch->count() > 0) options.watch = port_of(port);
    for (const std::string& b : bindings) add_once(options.bindings, b, "--bind");
    for (const std::string& s : symbols) add_once(options.symbols, s, "--symbol");
    for (const std::string& s : saves) options.saves.push_back(split(s, "--save"));
    for (const std::string& m : meshes) options.meshes.push_back(split(m, "--mesh"));
    std::vector<std::pair<std::string, std::string>> consts;
    for (const std::string& d : defines) add_once(consts, d, "-D");
    options.compile.defines.insert(consts.begin(), consts.end());
    for (const std::string& s : steps) {
      const size_t at = s.find('=');
      int times = 1;
      if (at != std::string::npos) {
        const std::string count = s.substr(at + 1);
        const char* const end = count.data() + count.size();
        const auto read = std::from_chars(count.data(), end, times);
        if (read.ec != std::errc() || read.ptr != end || times < 0)
          throw CLI::ValidationError("--step", "expected a number of runs after '=', up to " +
                                                   std::to_string(std::numeric_limits<int>::max()) + ", found '" +
                                                   count + "'");
      }
      options.steps.emplace_back(s.substr(0, at), times);
    }
    if (counters->count() > 0 && options.counters != "text" && options.counters != "json")
      throw CLI::ValidationError("--counters", "expected text or json, found '" + options.counters + "'");
    // The runtime's parts and, of both and of the compiler, the others.
    const std::pair<std::string_view, bool*> of_runtime[] = {{"rebuild", &options.rebuild},
                                                             {"commands", &options.commands},
                                                             {"pipelines", &options.pipelines},
                                                             {"shaders", &options.compile.shader_cache}};
    ablate.insert(ablate.end(), no_skip.begin(), no_skip.end());
    for (const std::string& part : ablate) {
      if (part == "cache") options.cache = false;
      const auto it = std::ranges::find(of_runtime, part, &std::pair<std::string_view, bool*>::first);
      if (it != std::end(of_runtime))
        *it->second = false;
      else
        options.compile.ablate.push_back(part);
    }
    if (out->count() > 0 && options.out.empty())
      throw CLI::ValidationError("--out", "expected a folder, found nothing");
    if (!memory.empty()) options.memory = bytes_of(memory, "--memory");
    if (!buffers.empty()) options.buffers = bytes_of(buffers, "--buffers");
    if (!timeout.empty()) options.timeout = seconds_of(timeout, "--timeout", "a number of seconds as 90 or 90s");
    set_checkpoints(checkpoints, options);
    if (check->count() > 0 && options.check_runs < 1)
      throw CLI::ValidationError("--check-against-reference", "expected a number of runs, 1 or more");
    if (options.resume && options.out.empty())
      throw CLI::ValidationError("--resume", "needs --out, the folder of the run to go on with");
    if (options.file.empty() && !options.list_devices && !options.measure) throw CLI::RequiredError("FILE");
  } catch (const CLI::ParseError& e) {
    exit_code = app.exit(e) == 0 ? 0 : 2;
    return false;
  }
  return true;
}

}  // namespace dr::drun
