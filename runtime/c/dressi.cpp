// SPDX-License-Identifier: Apache-2.0
// The C interface over the C++ API: handles are objects, exceptions and Results become dressi_error().
#include "runtime/c/dressi.h"

#include <cstdio>
#include <cstring>
#include <memory>
#include <mutex>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "compiler/backend/bundle/bundle.h"
#include "compiler/ir/internal_error.h"
#include "compiler/target/profile.h"
#include "runtime/jit/compile_text.h"
#include "runtime/jit/jit.h"
#include "runtime/jit/rebuild.h"
#include "runtime/jit/reference_program.h"
#include "runtime/runtime.h"

using Json = nlohmann::ordered_json;

struct dressi_device {
  std::optional<dr::runtime::Device> device;  // none: the reference
  std::string info;
};

struct dressi_bundle {
  std::vector<uint8_t> bytes;
  dr::bundle::BundleT tables;
  dr::jit::Options options;
  std::string info;
};

struct dressi_run {
  std::mutex mutex;
  // Shared with views of its memory.
  std::variant<std::shared_ptr<dr::runtime::Program>, std::shared_ptr<dr::jit::ReferenceProgram>> program;
  std::string text;  // of the last answer
};

namespace {

thread_local std::string last_error;
thread_local dressi_error_kind last_kind = DRESSI_NO_ERROR;

struct Mistake {
  dressi_error_kind kind;
  std::string text;
};
[[noreturn]] void fail(std::string text, dressi_error_kind kind = DRESSI_USER_ERROR) {
  throw Mistake{kind, std::move(text)};
}

template <typename T>
T must(dr::io::Result<T> result, dressi_error_kind kind = DRESSI_USER_ERROR) {
  if (!result) fail(result.error(), kind);
  if constexpr (!std::is_void_v<T>) return std::move(result).value();
}

// Runs `make`; what it throws becomes the error, and the answer `failed`.
template <typename Make, typename T>
T guarded(T failed, const Make& make) {
  const auto set = [&](dressi_error_kind kind, std::string text) {
    last_kind = kind;
    last_error = std::move(text);
    return failed;
  };
  try {
    return make();
  } catch (Mistake& mistake) {
    return set(mistake.kind, std::move(mistake.text));
  } catch (const dr::ir::InternalError& error) {
    return set(DRESSI_INTERNAL_ERROR, error.what());
  } catch (const std::bad_alloc&) {
    return set(DRESSI_DEVICE_ERROR, "this machine has not enough memory for the program and its data");
  } catch (const std::exception& error) {
    return set(DRESSI_INTERNAL_ERROR, error.what());
  }
}

template <typename T>
T& given(T* pointer, const char* what) {
  if (pointer == nullptr) fail(std::string(what) + " is missing (NULL)");
  return *pointer;
}
std::string word(const char* text, const char* what) { return std::string(&given(text, what)); }

// Calls `use` with each pair of the list.
template <typename Use>
void for_each_option(const char* const* options, const Use& use) {
  for (; options != nullptr && *options != nullptr; options += 2) {
    if (options[1] == nullptr) fail("the option '" + std::string(options[0]) + "' has no value");
    use(std::string(options[0]), std::string(options[1]));
  }
}

std::string type_name(const dr::bundle::TypeT& type) {
  using dr::bundle::Scalar;
  const bool is_float = type.scalar == Scalar::Float;
  if (type.cols > 1) return "mat" + std::to_string(type.cols);
  const char* scalar = is_float                      ? "float"
                       : type.scalar == Scalar::Int  ? "int"
                       : type.scalar == Scalar::Uint ? "uint"
                                                     : "bool";
  if (type.rows == 1) return scalar;
  return (is_float ? "" : std::string(1, scalar[0])) + "vec" + std::to_string(type.rows);
}

Json extent_of(const dr::bundle::ExtentT& extent) { return {extent.w, extent.h, extent.l}; }

std::string info_of(const dr::bundle::BundleT& bundle) {
  Json out;
  for (const auto& leaf : bundle.leaves) {
    if (!leaf->table.empty()) continue;  // the runtime makes it
    out["leaves"].push_back({{"name", leaf->name},
                             {"kind", leaf->kind == dr::bundle::LeafKind::Param   ? "param"
                                      : leaf->kind == dr::bundle::LeafKind::Input ? "input"
                                                                                  : "state"},
                             {"type", type_name(*leaf->type)},
                             {"extent", extent_of(*leaf->extent)},
                             {"initial", !leaf->initial.empty() || leaf->kind == dr::bundle::LeafKind::State}});
  }
  for (const auto& step : bundle.steps) {
    Json outputs = Json::array(), leaves = Json::array(), changes = Json::array();
    for (const auto& output : step->outputs) {
      const auto& resource = *bundle.resources.at(output->resource);
      outputs.push_back(
          {{"name", output->name}, {"type", type_name(*resource.type)}, {"extent", extent_of(*resource.extent)}});
    }
    for (const uint32_t k : step->leaves) leaves.push_back(bundle.leaves.at(k)->name);
    for (const uint32_t k : step->changes) changes.push_back(bundle.leaves.at(k)->name);
    out["steps"].push_back({{"name", step->name}, {"outputs", outputs}, {"leaves", leaves}, {"changes", changes}});
  }
  out["symbols"] = bundle.symbols;
  out["profile"] = bundle.profile;
  return out.dump();
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

dr::runtime::HostArray array_of(const dressi_array& from) {
  if (from.kind < DRESSI_FLOAT32 || from.kind > DRESSI_BOOL)
    fail("unknown kind of scalar " + std::to_string(from.kind));
  const auto kind = static_cast<dr::io::ElementKind>(from.kind);
  const auto scalar = static_cast<int64_t>(dr::io::scalar_size(kind));
  if (from.components < 1 || from.components > 16 || from.width < 1 || from.height < 1 || from.layers < 1)
    fail("expected at least one element of 1 to 16 components, found " + std::to_string(from.width) + " x " +
         std::to_string(from.height) + " x " + std::to_string(from.layers) + " of " + std::to_string(from.components));
  int64_t bytes = scalar * from.components;
  for (const int64_t n : {from.width, from.height, from.layers})
    if (__builtin_mul_overflow(bytes, n, &bytes) || bytes > dr::io::kMaxArrayBytes) fail("the array is too large");
  given(static_cast<const char*>(from.data), "the data of the array");
  return {kind, from.components, from.width, from.height, from.layers, from.data};
}

// What an array that came out belongs to.
struct Owner {
  dr::io::Array copy;
  std::shared_ptr<void> view, program;  // destroyed from the last on
};

template <typename From>
void describe(const From& from, void* data, std::unique_ptr<Owner> owner, dressi_array& out) {
  out.kind = static_cast<int32_t>(from.kind);
  out.components = from.components;
  out.width = from.width;
  out.height = from.height;
  out.layers = from.layers;
  out.data = data;
  out.owner = owner.release();
}

int give(dr::io::Array array, dressi_array& out) {
  auto owner = std::make_unique<Owner>();
  owner->copy = std::move(array);
  const dr::io::Array& from = owner->copy;
  void* const data = owner->copy.bytes.data();
  describe(from, data, std::move(owner), out);
  return 1;
}

int give_view(const dr::runtime::HostArray& array, std::shared_ptr<void> program, dressi_array& out) {
  auto owner = std::make_unique<Owner>();
  owner->view = array.held;
  owner->program = std::move(program);
  describe(array, array.data, std::move(owner), out);
  return 1;
}

constexpr int kCopy = 2;

// Calls `use` with the program of the run, alone with it.
template <typename T, typename Use>
T with_program(T failed, dressi_run* run, const Use& use) {
  return guarded(failed, [&]() -> T {
    dressi_run& here = given(run, "the run");
    const std::lock_guard lock(here.mutex);
    return std::visit([&](auto& program) { return use(*program, here); }, here.program);
  });
}

}  // namespace

int dressi_abi_version(void) { return DRESSI_ABI_VERSION; }
const char* dressi_version(void) { return DR_VERSION; }
const char* dressi_error(void) { return last_error.c_str(); }
dressi_error_kind dressi_error_kind_of_last(void) { return last_kind; }

void dressi_array_free(dressi_array* array) {
  if (array == nullptr) return;
  delete static_cast<Owner*>(array->owner);
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
                     {"profile", out->device->profile_name()}}
                    .dump();
    return out.release();
  });
}

void dressi_device_free(dressi_device* device) { delete device; }
const char* dressi_device_info(dressi_device* device) { return device == nullptr ? "" : device->info.c_str(); }

dressi_bundle* dressi_compile(const char* name, const char* text, dressi_device* device, const char* const* options) {
  return guarded(static_cast<dressi_bundle*>(nullptr), [&] {
    dr::jit::Options chosen;
    for_each_option(options, [&](const std::string& key, const std::string& value) {
      if (key == "profile")
        chosen.profile = value;
      else if (key == "lower")
        chosen.lower = value;
      else if (key == "raster")
        chosen.raster = value;
      else if (key == "pack")
        chosen.pack = value;
      else if (key == "scatter")
        chosen.scatter = value;
      else if (key == "float")
        chosen.float_profile = value;
      else if (key == "ablate")
        chosen.ablate.push_back(value);
      else if (key == "include")
        chosen.include_dirs.push_back(value);
      else if (key == "adjoint")
        chosen.adjoints.push_back(value);
      else if (key.starts_with("define:"))
        chosen.defines[key.substr(7)] = value;
      else
        fail("unknown option '" + key +
             "' of compiling; there are profile, lower, raster, pack, scatter, float, ablate, adjoint, include and "
             "define:NAME");
    });
    if (chosen.profile.empty() && device != nullptr && device->device) chosen.profile = device->device->profile_name();
    if (chosen.profile.empty()) chosen.profile = "lavapipe";  // what runs on the evaluator is the graph alone
    const auto profile = dr::target::load_profile(chosen.profile);
    if (const auto* problem = std::get_if<std::string>(&profile)) fail(*problem);
    dr::jit::Told told;
    auto bytes = dr::jit::compile_text(word(name, "the name"), word(text, "the text"),
                                       std::get<dr::target::Profile>(profile), chosen, &told);
    if (auto* messages = std::get_if<std::string>(&bytes)) fail(std::move(*messages));
    std::fputs(told.warnings.c_str(), stderr);
    auto out = bundle_of(std::get<std::vector<uint8_t>>(std::move(bytes)));
    out->options = std::move(chosen);
    return out.release();
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
  if (bundle == nullptr || size == nullptr) return nullptr;
  *size = bundle->bytes.size();
  return bundle->bytes.data();
}

const char* dressi_bundle_info(dressi_bundle* bundle) { return bundle == nullptr ? "" : bundle->info.c_str(); }

dressi_run* dressi_run_open(dressi_device* device, dressi_bundle* bundle, const char* const* options) {
  return guarded(static_cast<dressi_run*>(nullptr), [&]() -> dressi_run* {
    given(device, "the device");
    given(bundle, "the bundle");
    if (!device->device)
      return new dressi_run{
          {}, std::make_shared<dr::jit::ReferenceProgram>(must(dr::jit::ReferenceProgram::load(bundle->bytes))), {}};
    dr::runtime::LoadOptions load;
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
      else if (key == "rebuild")
        rebuild = is_on(key, value);
      else if (key == "memory" && !value.empty() && value.size() < 19 &&
               value.find_first_not_of("0123456789") == std::string::npos)
        load.memory_limit = std::stoll(value);
      else
        fail("unknown option '" + key + "' = '" + value +
             "' of a run; there are cache, rebuild, store_all (on, off) and memory (bytes)");
    });
    if (rebuild) load.rebuild = dr::jit::rebuilder(bundle->bytes, bundle->options);
    auto program = must(dr::runtime::Program::load(*device->device, bundle->bytes, load), DRESSI_DEVICE_ERROR);
    return new dressi_run{{}, std::make_shared<dr::runtime::Program>(std::move(program)), {}};
  });
}

void dressi_run_free(dressi_run* run) { delete run; }

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

namespace {

std::shared_ptr<dr::runtime::Program> device_program(dressi_run& run) {
  auto* program = std::get_if<std::shared_ptr<dr::runtime::Program>>(&run.program);
  return program == nullptr ? nullptr : *program;
}

dr::runtime::Program& on_device(dressi_run& run) {
  const auto program = device_program(run);
  if (!program) fail("the evaluator does not count or time commands");
  return *program;
}

}  // namespace

int dressi_leaf_view(dressi_run* run, const char* name, dressi_array* out) {
  return with_program(0, run, [&](auto& program, dressi_run& here) {
    const std::string leaf = word(name, "the leaf");
    dressi_array& array = given(out, "the array");
    if (const auto shared = device_program(here))
      if (const auto view = must(shared->leaf_view(leaf))) return give_view(*view, shared, array);
    give(must(program.leaf(leaf)), array);
    return kCopy;
  });
}

int dressi_output_view(dressi_run* run, const char* step, const char* name, dressi_array* out) {
  return with_program(0, run, [&](auto& program, dressi_run& here) {
    const std::string of = word(step, "the step"), output = word(name, "the output");
    dressi_array& array = given(out, "the array");
    if (const auto shared = device_program(here))
      if (const auto view = must(shared->output_view(of, output))) return give_view(*view, shared, array);
    give(must(program.output(of, output)), array);
    return kCopy;
  });
}

const char* dressi_counters(dressi_run* run, const char* step) {
  return with_program(static_cast<const char*>(nullptr), run, [&](auto&, dressi_run& here) {
    const auto counters = on_device(here).counters(word(step, "the step"));
    here.text = Json{{"runs", counters.runs},
                     {"commands", counters.run.commands},
                     {"ops", counters.run.ops},
                     {"bytes", counters.run.bytes},
                     {"skipped_commands", counters.skipped.commands},
                     {"skipped_ops", counters.skipped.ops},
                     {"skipped_bytes", counters.skipped.bytes}}
                    .dump();
    return here.text.c_str();
  });
}

const char* dressi_timed_step(dressi_run* run, const char* step) {
  return with_program(static_cast<const char*>(nullptr), run, [&](auto&, dressi_run& here) {
    Json out = Json::array();
    for (const auto& time : must(on_device(here).timed_run(word(step, "the step"))))
      out.push_back({{"label", time.label},
                     {"nanoseconds", time.nanoseconds},
                     {"ops", time.ops},
                     {"bytes", time.bytes},
                     {"lines", time.lines}});
    here.text = out.dump();
    return here.text.c_str();
  });
}

const char* dressi_checked_step(dressi_run* run, const char* step) {
  return with_program(static_cast<const char*>(nullptr), run, [&](auto&, dressi_run& here) {
    Json out = Json::object();
    if (const auto found = must(on_device(here).checked_run(word(step, "the step"))))
      out = {{"label", found->label}, {"value", found->value}, {"place", dr::io::describe(found->place)},
             {"x", found->place.x},   {"y", found->place.y},   {"layer", found->place.layer},
             {"lines", found->lines}};
    here.text = out.dump();
    return here.text.c_str();
  });
}
