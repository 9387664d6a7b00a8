// SPDX-License-Identifier: Apache-2.0
// Views of a run's memory, the host's and CUDA's, and what its steps did.
#include <nlohmann/json.hpp>

#include "runtime/c/handles.h"

using namespace dr::c;

namespace {

constexpr int kCopy = 2;

int give_cuda(const dr::runtime::CudaArray& from, dressi_run& here, dressi_array& out, int64_t* stride) {
  if (stride != nullptr) *stride = from.stride;
  return give_view(from.array, device_program(here), out);
}

std::vector<dr::runtime::Program::Named> named(const dressi_named_array* arrays, size_t count) {
  std::vector<dr::runtime::Program::Named> out;
  for (size_t k = 0; k < count; ++k)
    if (arrays[k].array.data != nullptr) out.emplace_back(word(arrays[k].name, "a name"), array_of(arrays[k].array));
  return out;
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

namespace {

// As dlpack.h has it, before version 1.
struct DlTensor {
  void* data;
  int32_t device_type, device_id, dimensions;
  uint8_t code, bits;
  uint16_t lanes;
  int64_t *shape, *strides;
  uint64_t offset;
};
struct DlManaged {
  DlTensor tensor;
  void* context;
  void (*deleter)(DlManaged*);
};
struct DlOwner {
  DlManaged managed;
  dressi_array array;
  std::vector<int64_t> shape, strides;
};

}  // namespace

void* dressi_dlpack(dressi_array* array, int device_type, int device_id, int dimensions, const int64_t* shape,
                    const int64_t* strides) {
  return guarded(static_cast<void*>(nullptr), [&]() -> void* {
    given(array, "the array");
    if (dimensions < 0) fail("an array has no " + std::to_string(dimensions) + " dimensions");
    if (dimensions > 0) given(shape, "the shape"), given(strides, "the strides");
    auto owner = std::make_unique<DlOwner>();
    owner->shape.assign(shape, shape + dimensions);
    owner->strides.assign(strides, strides + dimensions);
    enum : uint8_t { kInt, kUint, kFloat, kBool = 6 };
    const uint8_t codes[] = {kFloat, kFloat, kInt, kUint, kBool}, bits[] = {32, 64, 32, 32, 8};
    owner->managed.tensor = {
        array->data,         device_type,           device_id, dimensions, codes[array->kind], bits[array->kind], 1,
        owner->shape.data(), owner->strides.data(), 0};
    owner->array = *array;
    array->owner = nullptr;
    owner->managed.context = owner.get();
    owner->managed.deleter = [](DlManaged* self) {
      auto* const all = static_cast<DlOwner*>(self->context);
      dressi_array_free(&all->array);
      delete all;
    };
    return &owner.release()->managed;
  });
}

int dressi_cuda_device(dressi_device* device) {
  return guarded(0, [&] {
    if (!opened_here(device, "the device").device) fail("the evaluator shares no memory with CUDA");
    return must(device->device->cuda_device()) + 1;
  });
}

int dressi_cuda_stream(dressi_run* run, void* stream) {
  return with_program(0, run, [&](auto&, dressi_run& here) {
    must(on_device(here).cuda_stream(stream));
    return 1;
  });
}

int dressi_cuda_wait(dressi_run* run, void* stream) {
  return with_program(0, run, [&](auto&, dressi_run& here) {
    must(on_device(here).cuda_wait(stream));
    return 1;
  });
}

int dressi_cuda_leaf(dressi_run* run, const char* name, dressi_array* out, int64_t* stride) {
  return with_program(0, run, [&](auto&, dressi_run& here) {
    return give_cuda(must(on_device(here).cuda_leaf(word(name, "the leaf"))), here, given(out, "the array"), stride);
  });
}

int dressi_cuda_output(dressi_run* run, const char* step, const char* name, dressi_array* out, int64_t* stride) {
  return with_program(0, run, [&](auto&, dressi_run& here) {
    return give_cuda(must(on_device(here).cuda_output(word(step, "the step"), word(name, "the output"))), here,
                     given(out, "the array"), stride);
  });
}

int dressi_cuda_run(dressi_run* run, void* stream, const char* step, const dressi_named_array* leaves,
                    size_t leaf_count, const dressi_named_array* outputs, size_t output_count) {
  return with_program(0, run, [&](auto&, dressi_run& here) {
    auto& program = on_device(here);
    must(program.cuda_stream(stream));
    must(program.cuda_run(step == nullptr ? "" : step, named(leaves, leaf_count), named(outputs, output_count)));
    return 1;
  });
}

const char* dressi_counters(dressi_run* run, const char* step) {
  return with_program(static_cast<const char*>(nullptr), run, [&](auto&, dressi_run& here) {
    const std::string of = word(step, "the step");
    const std::vector<std::string> all = on_device(here).steps();
    if (std::ranges::find(all, of) == all.end()) fail("there is no step '" + of + "'");
    const auto counters = on_device(here).counters(of);
    here.text = nlohmann::ordered_json{{"runs", counters.runs},
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
    auto out = nlohmann::ordered_json::array();
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
    auto out = nlohmann::ordered_json::object();
    if (const auto found = must(on_device(here).checked_run(word(step, "the step"))))
      out = {{"label", found->label}, {"value", found->value}, {"place", dr::io::describe(found->place)},
             {"x", found->place.x},   {"y", found->place.y},   {"layer", found->place.layer},
             {"lines", found->lines}};
    here.text = out.dump();
    return here.text.c_str();
  });
}
