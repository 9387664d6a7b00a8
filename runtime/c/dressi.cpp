// SPDX-License-Identifier: Apache-2.0
// The C interface over the C++ API: handles are objects, exceptions and Results become dressi_error().
#include <algorithm>
#include <charconv>
#include <cstdio>
#include <map>
#include <nlohmann/json.hpp>

#include "compiler/ir/initial_step.h"
#include "compiler/target/profile.h"
#include "dsl/source/utf8.h"
#include "runtime/c/handles.h"
#include "runtime/jit/compile_text.h"
#include "runtime/jit/explain_gradient.h"
#include "runtime/jit/rebuild.h"

using Json = nlohmann::ordered_json;
using namespace dr::c;

namespace {

// Calls `use` with each pair of the list.
template <typename Use>
void for_each_option(const char* const* options, const Use& use) {
  for (; options != nullptr && *options != nullptr; options += 2) {
    if (options[1] == nullptr) fail("the option '" + std::string(options[0]) + "' has no value");
    use(std::string(options[0]), std::string(options[1]));
  }
}

// GLSL's name: "mat2x3" has 2 columns of 3 rows.
std::string type_name(const dr::bundle::TypeT& type) {
  using dr::bundle::Scalar;
  const bool is_float = type.scalar == Scalar::Float;
  const std::string rows = std::to_string(type.rows);
  if (type.cols > 1) return "mat" + std::to_string(type.cols) + (type.cols == type.rows ? "" : "x" + rows);
  const char* scalar = is_float                      ? "float"
                       : type.scalar == Scalar::Int  ? "int"
                       : type.scalar == Scalar::Uint ? "uint"
                                                     : "bool";
  if (type.rows == 1) return scalar;
  return (is_float ? "" : std::string(1, scalar[0])) + "vec" + rows;
}

Json extent_of(const dr::bundle::ExtentT& extent) { return {extent.w, extent.h, extent.l}; }

// As Program::comes_from_host, without a program.
bool from_host(const dr::bundle::BundleT& bundle, const std::string& name) {
  for (const auto& leaf : bundle.leaves) {
    if (leaf->name == name && leaf->type->scalar == dr::bundle::Scalar::Bool) return true;
    if (leaf->table_of >= 0 && bundle.leaves[static_cast<size_t>(leaf->table_of)]->name == name) return true;
  }
  return false;
}

// Whether it need not be bound.
bool has_initial(const dr::bundle::BundleT& bundle, const dr::bundle::LeafT& leaf) {
  const std::string step = dr::ir::initial_step_of(leaf.name);
  return !leaf.initial.empty() || leaf.kind == dr::bundle::LeafKind::State ||
         std::ranges::any_of(bundle.steps, [&](const auto& s) { return s->name == step; });
}

std::string info_of(const dr::bundle::BundleT& bundle) {
  Json out = {{"leaves", Json::array()}, {"steps", Json::array()}};
  for (const auto& leaf : bundle.leaves) {
    if (!leaf->table.empty()) continue;  // the runtime makes it
    out["leaves"].push_back({{"name", leaf->name},
                             {"kind", leaf->kind == dr::bundle::LeafKind::Param   ? "param"
                                      : leaf->kind == dr::bundle::LeafKind::Input ? "input"
                                                                                  : "state"},
                             {"type", type_name(*leaf->type)},
                             {"extent", extent_of(*leaf->extent)},
                             {"initial", has_initial(bundle, *leaf)},
                             {"from_host", from_host(bundle, leaf->name)}});
  }
  for (const auto& step : bundle.steps) {
    if (!dr::ir::leaf_of_initial_step(step->name).empty()) continue;
    Json outputs = Json::array(), leaves = Json::array(), changes = Json::array();
    for (const auto& output : step->outputs) {
      const auto& resource = *bundle.resources.at(output->resource);
      outputs.push_back(
          {{"name", output->name}, {"type", type_name(*resource.type)}, {"extent", extent_of(*resource.extent)}});
    }
    for (const uint32_t k : step->leaves) {
      // Of a table what it is made of, which is what a user binds.
      const auto& leaf = *bundle.leaves.at(k);
      const Json name = leaf.table_of < 0 ? leaf.name : bundle.leaves.at(static_cast<size_t>(leaf.table_of))->name;
      if (std::ranges::find(leaves, name) == leaves.end()) leaves.push_back(name);
    }
    for (const uint32_t k : step->changes) changes.push_back(bundle.leaves.at(k)->name);
    out["steps"].push_back({{"name", step->name}, {"outputs", outputs}, {"leaves", leaves}, {"changes", changes}});
  }
  out["symbols"] = bundle.symbols;
  out["profile"] = bundle.profile;
  return out.dump();
}

// Of memory, at least one.
int64_t bytes_of(const std::string& key, const std::string& value) {
  int64_t bytes = 0;
  const auto [end, error] = std::from_chars(value.data(), value.data() + value.size(), bytes);
  if (error != std::errc{} || end != value.data() + value.size() || bytes < 1)
    fail("expected a number of bytes, from 1 on, for '" + key + "', as 536870912, found '" + value + "'");
  return bytes;
}

std::string known_options() {
  std::string out;
  for (const dr::driver::Choice& choice : dr::driver::choices()) out += choice.name + ", ";
  return out + "ablate, adjoint, include, define:NAME and known:NAME";
}

dr::jit::Options compile_options(const char* const* options) {
  dr::jit::Options chosen;
  std::map<std::string, std::string> named;
  // What is given twice would silently count once.
  const auto must_be_new = [&](const std::string& key, const std::string& value) {
    const auto [before, is_new] = named.emplace(key, value);
    if (!is_new) fail("'" + key + "' is given twice, as '" + before->second + "' and '" + value + "'");
  };
  for_each_option(options, [&](const std::string& key, const std::string& value) {
    const auto choice = std::ranges::find(dr::driver::choices(), key, &dr::driver::Choice::name);
    if (choice != dr::driver::choices().end())
      chosen.*choice->value = value;
    else if (key == "ablate")
      chosen.ablate.push_back(value);
    else if (key == "include")
      chosen.include_dirs.push_back(value);
    else if (key == "adjoint")
      chosen.adjoints.push_back(value);
    else if (key.starts_with("define:")) {
      must_be_new(key, value);
      chosen.defines[key.substr(7)] = value;
    } else if (key.starts_with("known:")) {
      must_be_new(key, value);
      const auto numbers = dr::driver::known_value(value);
      if (!numbers) fail("expected numbers with commas for '" + key + "', found '" + value + "'");
      chosen.known[key.substr(6)] = *numbers;
    } else
      fail("unknown option '" + key + "' of compiling; there are " + known_options());
  });
  return chosen;
}

// What stands for a program's file, in messages, bundles and JSON.
std::string file_name(const char* text) {
  std::string name = word(text, "the name");
  for (size_t at = 0; at < name.size();) {
    const size_t length = dr::dsl::utf8_length(name, at);
    if (length == 0) fail("the name of the program is not UTF-8, from byte " + std::to_string(at) + " on");
    const auto c = static_cast<unsigned char>(name[at]);
    const bool is_control = c < ' ' || c == 0x7f || (c == 0xc2 && static_cast<unsigned char>(name[at + 1]) < 0xa0);
    if (is_control)
      fail("the name of the program has a line break or another control character, at byte " + std::to_string(at));
    at += length;
  }
  return name;
}

std::unique_ptr<dressi_bundle> bundle_of(std::vector<uint8_t> bytes) {
  auto tables = dr::bundle::read(bytes);
  if (const auto* problem = std::get_if<std::string>(&tables)) fail(*problem);
  auto bundle = std::make_unique<dressi_bundle>();
  bundle->bytes = std::move(bytes);
  bundle->tables = std::move(std::get<dr::bundle::BundleT>(tables));
  bundle->info = info_of(bundle->tables);
  return bundle;
}

}  // namespace

int dressi_abi_version(void) { return DRESSI_ABI_VERSION; }
const char* dressi_version(void) { return DR_VERSION; }
const char* dressi_error(void) { return last_error.c_str(); }
dressi_error_kind dressi_error_kind_of_last(void) { return last_kind; }

void dressi_array_free(dressi_array* array) {
  if (array == nullptr) return;
  auto* const owner = static_cast<Owner*>(array->owner);
  // What only a view keeps alive of a device of the process before is left as it is.
  if (owner != nullptr && (owner->program == nullptr || owner->maker.is_this_process())) delete owner;
  array->owner = array->data = nullptr;
}

const char* dressi_devices(void) {
  thread_local std::string text;
  return guarded(static_cast<const char*>(nullptr), [] {
    Json out = Json::array();
    for (const auto& info : must(dr::runtime::Device::list(), DRESSI_DEVICE_ERROR))
      out.push_back(
          {{"name", info.name}, {"kind", info.kind}, {"api_version", info.api_version}, {"driver", info.driver}});
    text = out.dump();
    return text.c_str();
  });
}

dressi_device* dressi_device_open(const char* name, int validation) {
  return guarded(static_cast<dressi_device*>(nullptr), [&] {
    auto out = std::make_unique<dressi_device>();
    const std::string wanted = name == nullptr ? "" : name;
    if (wanted == "reference") {
      out->info = Json{{"name", "reference"}, {"kind", "evaluator"}, {"profile", ""}}.dump();
      return out.release();
    }
    out->device = must(dr::runtime::Device::open({.name = wanted, .validation = validation != 0}), DRESSI_DEVICE_ERROR);
    const auto info = out->device->info();
    out->info = Json{{"name", info.name},
                     {"kind", info.kind},
                     {"api_version", info.api_version},
                     {"driver", info.driver},
                     {"profile", out->device->profile_name()},
                     {"shares_memory", out->device->shares_memory()}}
                    .dump();
    return out.release();
  });
}

void dressi_device_free(dressi_device* device) {
  if (device != nullptr && (!device->device || device->maker.is_this_process())) delete device;
}
const char* dressi_device_info(dressi_device* device) {
  return guarded(static_cast<const char*>(nullptr), [&] { return given(device, "the device").info.c_str(); });
}

dressi_bundle* dressi_compile(const char* name, const char* text, dressi_device* device, const char* const* options) {
  return guarded(static_cast<dressi_bundle*>(nullptr), [&] {
    dr::jit::Options chosen = compile_options(options);
    if (device != nullptr) opened_here(device, "the device");
    if (chosen.profile.empty() && device != nullptr && device->device) chosen.profile = device->device->profile_name();
    if (chosen.profile.empty()) chosen.profile = "lavapipe";  // what runs on the evaluator is the graph alone
    const auto profile = dr::target::load_profile(chosen.profile);
    if (const auto* problem = std::get_if<std::string>(&profile)) fail(*problem);
    dr::jit::Told told;
    auto bytes = must(dr::jit::compile_text(file_name(name), word(text, "the text"),
                                            std::get<dr::target::Profile>(profile), chosen, &told));
    std::fputs(told.warnings.c_str(), stderr);
    auto out = bundle_of(std::move(bytes));
    out->options = std::move(chosen);
    return out.release();
  });
}

const char* dressi_explain_gradient(const char* name, const char* text, const char* const* options, const char* loss,
                                    const char* with_respect_to) {
  thread_local std::string answer;
  return guarded(static_cast<const char*>(nullptr), [&] {
    auto explained = dr::jit::explain_gradient(file_name(name), word(text, "the text"), compile_options(options),
                                               word(loss, "the loss"), word(with_respect_to, "the leaf"));
    if (auto* problem = std::get_if<std::string>(&explained)) fail(std::move(*problem));
    answer = std::get<dr::jit::Explanation>(std::move(explained)).json;
    return answer.c_str();
  });
}

dressi_bundle* dressi_bundle_read(const void* bytes, size_t size) {
  return guarded(static_cast<dressi_bundle*>(nullptr), [&] {
    const auto* data = static_cast<const uint8_t*>(bytes);
    if (data == nullptr || size == 0) fail("a bundle of no bytes");
    return bundle_of({data, data + size}).release();
  });
}

void dressi_bundle_free(dressi_bundle* bundle) { delete bundle; }

const void* dressi_bundle_bytes(dressi_bundle* bundle, size_t* size) {
  return guarded(static_cast<const void*>(nullptr), [&] {
    const auto& bytes = given(bundle, "the bundle").bytes;
    given(size, "where to say how many bytes there are") = bytes.size();
    return static_cast<const void*>(bytes.data());
  });
}

const char* dressi_bundle_info(dressi_bundle* bundle) {
  return guarded(static_cast<const char*>(nullptr), [&] { return given(bundle, "the bundle").info.c_str(); });
}

dressi_run* dressi_run_open(dressi_device* device, dressi_bundle* bundle, const char* const* options) {
  return guarded(static_cast<dressi_run*>(nullptr), [&]() -> dressi_run* {
    opened_here(device, "the device");
    given(bundle, "the bundle");
    auto run = std::make_unique<dressi_run>();
    for (const auto& step : bundle->tables.steps)
      for (const auto& output : step->outputs) run->outputs[step->name].push_back(output->name);
    const auto warn = [here = run.get()](const std::string& warning) {
      if (here->warn != nullptr)
        here->warn(warning.c_str(), here->warn_context);
      else
        dr::runtime::warn_on_stderr(warning);
    };
    dr::runtime::LoadOptions load;
    load.warn = warn;
    bool rebuild = true;
    const auto is_on = [](const std::string& key, const std::string& value) {
      if (value != "on" && value != "off") fail("expected on or off for '" + key + "', found '" + value + "'");
      return value == "on";
    };
    for_each_option(options, [&](const std::string& key, const std::string& value) {
      if (key == "cache")
        load.cache = is_on(key, value);
      else if (key == "store_all")
        load.store_all = is_on(key, value);
      else if (key == "share")
        load.share = is_on(key, value);
      else if (key == "rebuild")
        rebuild = is_on(key, value);
      else if (key == "memory")
        load.memory_limit = bytes_of(key, value);
      else
        fail("unknown option '" + key + "' = '" + value +
             "' of a run; there are cache, rebuild, store_all, share (on, off) and memory (bytes)");
    });
    if (!device->device) {
      run->program =
          std::make_shared<dr::jit::ReferenceProgram>(must(dr::jit::ReferenceProgram::load(bundle->bytes, warn)));
      return run.release();
    }
    if (rebuild) load.rebuild = dr::jit::rebuilder(bundle->bytes, bundle->options);
    auto program = must(dr::runtime::Program::load(*device->device, bundle->bytes, load), DRESSI_DEVICE_ERROR);
    run->program = std::make_shared<dr::runtime::Program>(std::move(program));
    return run.release();
  });
}

void dressi_run_free(dressi_run* run) {
  if (run == nullptr || !run->maker.is_this_process()) return;
  if (run->caller == std::this_thread::get_id())
    run->is_freed = true;
  else
    delete run;
}

int dressi_on_warning(dressi_run* run, dressi_warn warn, void* context) {
  return with_program(0, run, [&](auto&, dressi_run& here) {
    here.warn = warn;
    here.warn_context = context;
    return 1;
  });
}

int dressi_bind(dressi_run* run, const char* leaf, const dressi_array* data) {
  return with_program(0, run, [&](auto& program, dressi_run&) {
    const dr::runtime::HostArray array = array_of(given(data, "the array"));
    if constexpr (std::is_same_v<decltype(program), dr::runtime::Program&>)
      must(program.bind(word(leaf, "the leaf"), array));
    else
      must(program.bind(word(leaf, "the leaf"), array.copied()));
    return 1;
  });
}

int dressi_bind_symbol(dressi_run* run, const char* symbol, int64_t value) {
  return with_program(0, run, [&](auto& program, dressi_run&) {
    must(program.bind_symbol(word(symbol, "the symbol"), value));
    return 1;
  });
}

int dressi_step(dressi_run* run, const char* step, int times) {
  return with_program(0, run, [&](auto& program, dressi_run&) {
    if (times < 1) fail("expected at least one run of a step, found " + std::to_string(times));
    must(program.run(word(step, "the step"), times));
    return 1;
  });
}

int dressi_set_runs(dressi_run* run, const char* step, int64_t runs) {
  return with_program(0, run, [&](auto& program, dressi_run&) {
    must(program.set_runs(word(step, "the step"), runs));
    return 1;
  });
}

int dressi_output(dressi_run* run, const char* step, const char* name, dressi_array* out) {
  return with_program(0, run, [&](auto& program, dressi_run&) {
    return give(must(program.output(word(step, "the step"), word(name, "the output"))), given(out, "the array"));
  });
}

int dressi_leaf(dressi_run* run, const char* name, dressi_array* out) {
  return with_program(0, run, [&](auto& program, dressi_run&) {
    return give(must(program.leaf(word(name, "the leaf"))), given(out, "the array"));
  });
}
