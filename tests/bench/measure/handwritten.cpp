// SPDX-License-Identifier: Apache-2.0
// A frame of table4.dr or table5.dr beside the same frame by the shaders of handwritten/: both run in one process, in
// turns, several frames under way, and then each waited for. Their gradients must agree, or the times count for
// nothing.
//
//   bench_handwritten --heading
//   bench_handwritten FILE PROGRAM DEVICE ROUNDS SCATTER NAME=CONSTANT... -- LEAF=SOURCE...
//
// SCATTER is `exact` (64-bit fixed point) or `atomic` (floats), for both. A row on stdout, a line of JSON added to
// FILE.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>

#include "compiler/backend/spirv/spirv.h"
#include "runtime/jit/jit.h"
#include "runtime/vk/memory.h"
#include "runtime/vk/queue.h"
#include "tests/must.h"

using namespace dr;
using runtime::Block;

namespace {

using benchmark::must;
using benchmark::stop;

struct Buffer {
  vk::raii::Buffer buffer{nullptr};
  Block memory;
  vk::DeviceSize bytes = 0;
};

// A buffer as a shader sees it: `texels` where it is only read, for devices whose lanes access storage in turn.
struct Argument {
  const Buffer* buffer;
  vk::Format texels = vk::Format::eUndefined;
};

struct Pass {
  vk::Pipeline pipeline;
  vk::PipelineLayout layout;
  vk::DescriptorSet set;
  int64_t invocations = 0;
  std::vector<const Buffer*> cleared;  // before it, all bytes to `fill`
  std::vector<uint32_t> fill;
  const Buffer* groups = nullptr;  // of an indirect dispatch, instead of `invocations`
};

class Machine {
 public:
  Machine(const runtime::Device& device, std::filesystem::path folder)
      : state_(device.state()),
        queue_(state_, false),
        lanes_in_turn_(device.profile_name() == "lavapipe"),
        folder_(std::move(folder)) {}
  bool lanes_in_turn() const { return lanes_in_turn_; }
  runtime::Queue& queue() { return queue_; }

  Buffer make(vk::DeviceSize bytes, bool on_host = false) {
    if (bytes > state_->properties.limits.maxStorageBufferRange)
      stop("a buffer of " + std::to_string(bytes) + " bytes is more than the device allows");
    vk::BufferCreateInfo info;
    info.size = bytes;
    info.usage = vk::BufferUsageFlagBits::eStorageBuffer | vk::BufferUsageFlagBits::eUniformTexelBuffer |
                 vk::BufferUsageFlagBits::eTransferSrc | vk::BufferUsageFlagBits::eTransferDst |
                 vk::BufferUsageFlagBits::eIndirectBuffer;
    Buffer out;
    out.bytes = bytes;
    out.buffer = vk::raii::Buffer(state_->device, info);
    const auto needs = out.buffer.getMemoryRequirements();
    const vk::MemoryPropertyFlags host =
        vk::MemoryPropertyFlagBits::eHostVisible | vk::MemoryPropertyFlagBits::eHostCoherent;
    const vk::MemoryPropertyFlags local = vk::MemoryPropertyFlagBits::eDeviceLocal;
    const uint32_t type = on_host ? state_->memory_type(needs.memoryTypeBits, host, host)
                                  : state_->memory_type(needs.memoryTypeBits, {}, local);
    out.memory = Block(*state_, needs.size, type, tally_);
    out.buffer.bindMemory(*out.memory.memory(), 0);
    return out;
  }
  Buffer make(const void* data, vk::DeviceSize bytes) {
    Buffer out = make(bytes);
    write(out, data);
    return out;
  }
  void write(const Buffer& to, const void* data) {
    const Buffer staging = make(to.bytes, true);
    void* mapped = staging.memory.memory().mapMemory(0, to.bytes);
    std::memcpy(mapped, data, to.bytes);
    copy(staging, to);
  }
  std::vector<float> floats(const Buffer& from) {
    const Buffer staging = make(from.bytes, true);
    copy(from, staging);
    std::vector<float> out(from.bytes / sizeof(float));
    std::memcpy(out.data(), staging.memory.memory().mapMemory(0, from.bytes), from.bytes);
    return out;
  }

  Pass pass(const std::string& file, const std::string& defines, const std::vector<Argument>& arguments,
            int64_t invocations) {
    std::vector<vk::DescriptorSetLayoutBinding> bindings;
    std::vector<vk::DescriptorPoolSize> sizes;
    for (const Argument& a : arguments) {
      const auto type = reads_texels(a) ? vk::DescriptorType::eUniformTexelBuffer : vk::DescriptorType::eStorageBuffer;
      bindings.emplace_back(static_cast<uint32_t>(bindings.size()), type, 1, vk::ShaderStageFlagBits::eCompute);
      sizes.emplace_back(type, 1);
    }
    set_layouts_.emplace_back(state_->device, vk::DescriptorSetLayoutCreateInfo({}, bindings));
    const vk::PushConstantRange push(vk::ShaderStageFlagBits::eCompute, 0, 4);
    layouts_.emplace_back(state_->device, vk::PipelineLayoutCreateInfo({}, *set_layouts_.back(), push));
    pools_.emplace_back(state_->device,
                        vk::DescriptorPoolCreateInfo(vk::DescriptorPoolCreateFlagBits::eFreeDescriptorSet, 1, sizes));
    sets_.push_back(std::move(
        vk::raii::DescriptorSets(state_->device, vk::DescriptorSetAllocateInfo(*pools_.back(), *set_layouts_.back()))
            .front()));
    for (uint32_t k = 0; k < arguments.size(); ++k) {
      const Argument& a = arguments[k];
      vk::WriteDescriptorSet write(*sets_.back(), k, 0, 1, bindings[k].descriptorType);
      const vk::DescriptorBufferInfo buffer(*a.buffer->buffer, 0, VK_WHOLE_SIZE);
      write.pBufferInfo = &buffer;
      vk::BufferView view;
      if (reads_texels(a)) {
        views_.emplace_back(state_->device,
                            vk::BufferViewCreateInfo({}, *a.buffer->buffer, a.texels, 0, VK_WHOLE_SIZE));
        view = *views_.back();
        write.pTexelBufferView = &view;
      }
      state_->device.updateDescriptorSets(write, {});
    }
    backend::GlslShader shader{{file}, bundle::Stage::Compute, text(file, defines)};
    auto words = backend::assemble(shader, backend::ShaderCache(jit::cache_folder()));
    if (const auto* problem = std::get_if<std::string>(&words)) stop(file + ": " + *problem);
    const auto& code = std::get<std::vector<uint32_t>>(words);
    const vk::raii::ShaderModule module(state_->device, vk::ShaderModuleCreateInfo({}, code));
    const vk::PipelineShaderStageCreateInfo stage({}, vk::ShaderStageFlagBits::eCompute, *module, "main");
    pipelines_.emplace_back(state_->device, nullptr, vk::ComputePipelineCreateInfo({}, stage, *layouts_.back()));
    return {*pipelines_.back(), *layouts_.back(), *sets_.back(), invocations, {}, {}, nullptr};
  }

  // One frame, to be submitted as often as wanted.
  struct Recorded {
    vk::raii::CommandBuffer one, several;
  };
  static constexpr int kSeveral = 8;
  Recorded record(const std::vector<Pass>& passes) { return {record(passes, 1), record(passes, kSeveral)}; }
  vk::raii::CommandBuffer record(const std::vector<Pass>& passes, int times) {
    auto commands = queue_.command_buffer();
    commands.begin(vk::CommandBufferBeginInfo(vk::CommandBufferUsageFlagBits::eSimultaneousUse));
    for (int k = 0; k < times; ++k) record(commands, passes);
    commands.end();
    return commands;
  }
  void record(const vk::raii::CommandBuffer& commands, const std::vector<Pass>& passes) {
    using Stage = vk::PipelineStageFlagBits;
    const vk::MemoryBarrier written(vk::AccessFlagBits::eShaderWrite | vk::AccessFlagBits::eTransferWrite,
                                    vk::AccessFlagBits::eShaderRead | vk::AccessFlagBits::eShaderWrite);
    const vk::MemoryBarrier groups_too(written.srcAccessMask,
                                       written.dstAccessMask | vk::AccessFlagBits::eIndirectCommandRead);
    commands.pipelineBarrier(
        Stage::eComputeShader | Stage::eTransfer | Stage::eDrawIndirect, Stage::eComputeShader | Stage::eTransfer, {},
        vk::MemoryBarrier(vk::AccessFlagBits::eMemoryWrite, written.dstAccessMask | vk::AccessFlagBits::eTransferWrite),
        {}, {});
    // What is cleared is used by later passes only, so that nothing waits for it.
    for (const Pass& p : passes)
      for (size_t k = 0; k < p.cleared.size(); ++k)
        commands.fillBuffer(*p.cleared[k]->buffer, 0, VK_WHOLE_SIZE, p.fill[k]);
    for (const Pass& p : passes) {
      if (&p != passes.data() || !p.cleared.empty())
        commands.pipelineBarrier(Stage::eComputeShader | Stage::eTransfer,
                                 p.groups != nullptr ? Stage::eComputeShader | Stage::eDrawIndirect
                                                     : vk::PipelineStageFlags(Stage::eComputeShader),
                                 {}, p.groups != nullptr ? groups_too : written, {}, {});
      const auto groups = static_cast<uint32_t>((p.invocations + 63) / 64);
      const int32_t zero = 0;
      commands.bindPipeline(vk::PipelineBindPoint::eCompute, p.pipeline);
      commands.bindDescriptorSets(vk::PipelineBindPoint::eCompute, p.layout, 0, p.set, {});
      commands.pushConstants<int32_t>(p.layout, vk::ShaderStageFlagBits::eCompute, 0, zero);
      if (p.groups != nullptr)
        commands.dispatchIndirect(*p.groups->buffer, 0);
      else
        commands.dispatch(std::min(groups, 65535u), (groups + 65534) / 65535, 1);
    }
  }

  // ms a frame.
  double run(const Recorded& frame, int times) {
    const auto begin = std::chrono::steady_clock::now();
    for (int done = 0, now = 0; done < times; done += now) {  // as the runtime does
      now = std::min(runtime::Queue::worth_together(pace_), times - done);
      const bool several = now >= kSeveral;
      if (several) now -= now % kSeveral;
      queue_.submit(several ? frame.several : frame.one, several ? now / kSeveral : now, &pace_,
                    several ? kSeveral : 1);
    }
    queue_.finish();
    return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begin).count() / times;
  }

 private:
  bool reads_texels(const Argument& a) const { return lanes_in_turn_ && a.texels != vk::Format::eUndefined; }
  void copy(const Buffer& from, const Buffer& to) {
    queue_.once([&](const vk::raii::CommandBuffer& commands) {
      commands.copyBuffer(*from.buffer, *to.buffer, vk::BufferCopy(0, 0, from.bytes));
      const vk::MemoryBarrier barrier(vk::AccessFlagBits::eTransferWrite, vk::AccessFlagBits::eHostRead);
      commands.pipelineBarrier(vk::PipelineStageFlagBits::eTransfer, vk::PipelineStageFlagBits::eHost, {}, barrier, {},
                               {});
    });
  }
  std::string text(const std::string& file, const std::string& defines) const {
    std::string out =
        "#version 450\n#extension GL_EXT_samplerless_texture_functions : require\n"
        "#extension GL_EXT_shader_atomic_int64 : require\n"
        "#extension GL_EXT_shader_explicit_arithmetic_types_int64 : require\n"
        "#extension GL_EXT_shader_atomic_float : enable\n" +
        defines;
    for (const std::string& name : {std::string("common.glsl"), file}) {
      std::ifstream in(folder_ / name);
      if (!in) stop("cannot read " + (folder_ / name).string());
      std::ostringstream all;
      all << in.rdbuf();
      out += all.str();
    }
    return out;
  }

  std::shared_ptr<runtime::DeviceState> state_;
  runtime::Queue queue_;
  runtime::Pace pace_;
  bool lanes_in_turn_;
  std::filesystem::path folder_;
  std::shared_ptr<runtime::Tally> tally_ = std::make_shared<runtime::Tally>();
  std::vector<vk::raii::DescriptorSetLayout> set_layouts_;
  std::vector<vk::raii::PipelineLayout> layouts_;
  std::vector<vk::raii::DescriptorPool> pools_;
  std::vector<vk::raii::DescriptorSet> sets_;
  std::vector<vk::raii::BufferView> views_;
  std::vector<vk::raii::Pipeline> pipelines_;
};

using Leaves = std::map<std::string, io::Array>;

// Vectors of three as vectors of four.
template <class T>
std::vector<T> padded(const io::Array& array) {
  const auto from = array.as<T>();
  std::vector<T> out(from.size() / 3 * 4);
  for (size_t k = 0; k < from.size(); ++k) out[k / 3 * 4 + k % 3] = from[k];
  return out;
}

// The face beyond each edge (corner k to k + 1), -1 where there is none: as `neighbours` of std.mesh.
std::vector<int32_t> faces_beyond(const io::Array& face) {
  const auto corner = face.as<int32_t>();
  std::map<std::pair<int32_t, int32_t>, std::vector<int32_t>> at;
  const auto key = [&](size_t f, size_t k) { return std::minmax({corner[f * 3 + k], corner[f * 3 + (k + 1) % 3]}); };
  const size_t count = corner.size() / 3;
  for (size_t f = 0; f < count; ++f)
    for (size_t k = 0; k < 3; ++k) at[key(f, k)].push_back(static_cast<int32_t>(f));
  std::vector<int32_t> out(count * 4, -1);
  for (size_t f = 0; f < count; ++f)
    for (size_t k = 0; k < 3; ++k)
      if (const auto& both = at[key(f, k)]; both.size() == 2) out[f * 4 + k] = both[both[0] == static_cast<int32_t>(f)];
  return out;
}

// perspective(40) * look_at(eye), as GLSL.
std::string view_from(double y, double z) {
  const double length = std::hypot(y, z), f = 1 / std::tan(std::acos(-1.0) / 9), near = 0.1, far = 100;
  const double by = y / length, bz = z / length;  // back; up is (0, bz, -by)
  const double depth = far / (near - far), rest = near * far / (near - far);
  char out[400];
  std::snprintf(out, sizeof out,
                "#define VIEW mat4(%.9g, 0, 0, 0, 0, %.9g, %.9g, %.9g, 0, %.9g, %.9g, %.9g, 0, 0, %.9g, %.9g)\n", f,
                -f * bz, depth * by, -by, f * by, depth * bz, -bz, rest - depth * length, length);
  return out;
}

// The frames of both tables: what is shared, and then each.
struct Frame {
  std::vector<Buffer> buffers = {};
  std::vector<Pass> passes = {};
  Buffer gradient = {};
  int lanes = 0;
};

constexpr vk::Format kFloat = vk::Format::eR32Sfloat, kVec2 = vk::Format::eR32G32Sfloat,
                     kVec3 = vk::Format::eR32G32B32Sfloat, kVec4 = vk::Format::eR32G32B32A32Sfloat,
                     kIvec4 = vk::Format::eR32G32B32A32Sint, kEntry = vk::Format::eR32G32Uint,
                     kUint = vk::Format::eR32Uint;

Frame make_frame(Machine& machine, const std::string& table, bool exact, int64_t size, int64_t texture, Leaves& leaves,
                 int lanes, bool check) {
  Frame frame;
  frame.lanes = lanes;
  frame.buffers.reserve(16);
  const auto keep = [&](Buffer buffer) -> const Buffer& {
    frame.buffers.push_back(std::move(buffer));
    return frame.buffers.back();
  };
  const auto upload = [&](const auto& values) -> const Buffer& {
    return keep(machine.make(values.data(), values.size() * sizeof(values[0])));
  };
  const int64_t vertices = leaves.at("position").size(), faces = leaves.at("face").size(), pixels = size * size;
  const bool silhouette = table == "table4", fill = machine.lanes_in_turn();
  const int64_t sum_count = silhouette ? 2 * vertices : 3 * texture * texture, sum_bytes = exact ? 8 : 4;
  const int64_t clearing = std::max(pixels / 4, vertices);  // invocations that clear
  std::ostringstream d;
  d << "#define W " << size << "\n#define V " << vertices << "\n#define F " << faces << "\n#define T " << texture
    << "\n#define LANES " << lanes << "\n#define SUMS " << sum_count << "\n#define CLEARING " << clearing << "\n";
  d << (exact ? "#define EXACT\n#define SUM_SCALE " : "#define SUM_SCALE ")
    << (silhouette ? "4294967296.0\n" : "274877906944.0\n");  // 2^32: thin edges pull hard; 2^38: at most 1 a pixel
  if (machine.lanes_in_turn()) d << "#define LANES_IN_TURN\n";
  if (!fill) d << "#define CLEAR\n";
  if (check) d << "#define CHECK\n";
  d << (silhouette ? view_from(0.4, 4.4) : view_from(0, 4.687));
  const std::string defines = d.str();

  const Buffer& position = upload(padded<float>(leaves.at("position")));
  const Buffer& face = upload(padded<int32_t>(leaves.at("face")));
  const std::vector<float> numbers = {leaves.at("rate").to_floats()[0],
                                      silhouette ? 1.0f : leaves.at("hold").to_floats()[0]};
  const Buffer& rate = upload(numbers);
  const Buffer& screen = keep(machine.make(static_cast<vk::DeviceSize>(vertices * 16)));
  const Buffer& entries = keep(machine.make(static_cast<vk::DeviceSize>(pixels * 8)));
  const Buffer& sums = keep(machine.make(static_cast<vk::DeviceSize>(sum_count * sum_bytes)));
  const auto raster = [&](const Buffer& of) {
    std::vector<Argument> arguments = {{&of, kVec4}, {&screen}};
    if (!fill) arguments.insert(arguments.end(), {{&entries}, {&sums}});
    frame.passes.push_back(machine.pass("vertex.comp", defines, arguments, fill ? vertices : clearing));
    if (fill) frame.passes.back().cleared = {&entries, &sums}, frame.passes.back().fill = {0xffffffffu, 0};
    frame.passes.push_back(
        machine.pass("raster.comp", defines, {{&face, kIvec4}, {&screen, kVec4}, {&entries}}, faces * lanes));
  };
  // A pass over pixels, where `if` saves nothing over a list of those that it has work for.
  const auto listed = [&](const std::string& file, const std::string& which, std::vector<Argument> arguments) {
    if (!fill) return frame.passes.push_back(machine.pass(file, defines, arguments, pixels));
    const Buffer& list = keep(machine.make(static_cast<vk::DeviceSize>(pixels + 4) * 4));
    frame.passes.front().cleared.push_back(&list);
    frame.passes.front().fill.push_back(0);
    frame.passes.push_back(machine.pass("list.comp", defines + which, {{&entries, kEntry}, {&list}}, pixels));
    arguments.push_back({&list, kUint});
    frame.passes.push_back(machine.pass(file, defines + "#define LISTED\n", arguments, 0));
    frame.passes.back().groups = &list;
  };
  const vk::Format sum_format = exact ? kEntry : kFloat;
  if (check) frame.gradient = machine.make(static_cast<vk::DeviceSize>(silhouette ? vertices * 16 : sum_count * 4));
  if (silhouette) {
    const Buffer& beyond = upload(faces_beyond(leaves.at("face")));
    const Buffer& goal_position = upload(padded<float>(leaves.at("goal")));
    const Buffer& goal = keep(machine.make(static_cast<vk::DeviceSize>(pixels * 4)));
    std::vector<Argument> pixel = {{&entries, kEntry}, {&screen, kVec4}, {&face, kIvec4}, {&beyond, kIvec4}, {&goal}};
    raster(goal_position);  // the target stands still: once
    frame.passes.push_back(machine.pass("table4_pixel.comp", defines + "#define TARGET\n", pixel, pixels));
    const auto once = machine.record(frame.passes);
    machine.run(once, 1);
    frame.passes.clear();
    raster(position);
    pixel.back().texels = kFloat;
    pixel.push_back({&sums});
    listed("table4_pixel.comp", "#define EDGES\n", pixel);
    std::vector<Argument> update = {{&sums, sum_format}, {&position}, {&rate, kFloat}};
    if (check) update.push_back({&frame.gradient});
    frame.passes.push_back(machine.pass("table4_update.comp", defines, update, vertices));
  } else {
    const Buffer& uv = upload(leaves.at("uv").to_floats());
    const Buffer& uv_face = upload(padded<int32_t>(leaves.at("uv_face")));
    const Buffer& texels = upload(std::vector<float>(static_cast<size_t>(sum_count), 0.5f));
    std::vector<float> photograph(static_cast<size_t>(pixels) * 3);
    for (int64_t k = 0; k < pixels; ++k) {
      const int64_t column = k % size, row = k / size;
      const double x = static_cast<double>(column) / static_cast<double>(size),
                   y = static_cast<double>(row) / static_cast<double>(size);
      const double rgb[3] = {0.5 + 0.4 * std::sin(40 * x), y, 0.5 + 0.4 * std::cos(30 * y)};
      for (size_t c = 0; c < 3; ++c) photograph[static_cast<size_t>(k) * 3 + c] = static_cast<float>(rgb[c]);
    }
    const Buffer& goal = upload(photograph);
    raster(position);
    listed("table5_pixel.comp", "",
           {{&entries, kEntry},
            {&screen, kVec4},
            {&face, kIvec4},
            {&uv, kVec2},
            {&uv_face, kIvec4},
            {&texels, kVec3},
            {&goal, kVec3},
            {&sums}});
    std::vector<Argument> update = {{&sums, sum_format}, {&texels, kVec3}, {&rate, kFloat}, {&texels}, {&position}};
    if (check) update.push_back({&frame.gradient});
    frame.passes.push_back(machine.pass("table5_update.comp", defines, update, std::max(texture * texture, vertices)));
  }
  return frame;
}

// How far two gradients are apart: the norm of the difference over that of the compiled one.
double distance(const io::Array& compiled, const std::vector<float>& found) {
  const std::vector<double> expected = compiled.to_doubles();
  const size_t stride = found.size() / (expected.size() / 3);
  double difference = 0, norm = 0;
  for (size_t k = 0; k < expected.size(); ++k) {
    difference += std::pow(expected[k] - static_cast<double>(found[k / 3 * stride + k % 3]), 2);
    norm += expected[k] * expected[k];
  }
  return std::sqrt(difference / norm);
}

double quantile(std::vector<double> values, double q) {
  std::sort(values.begin(), values.end());
  return values[static_cast<size_t>(std::llround(q * static_cast<double>(values.size() - 1)))];
}

int bench(int argc, char** argv) {
  const std::filesystem::path program_file = argv[2];
  const std::string table = program_file.stem(), scatter = argv[5];
  const int rounds = std::max(std::atoi(argv[4]), 1);
  jit::Options options;
  std::vector<std::pair<std::string, std::string>> bindings;
  int k = 6;
  for (; k < argc && std::string_view(argv[k]) != "--"; ++k) {
    const std::string word = argv[k];
    options.defines[word.substr(0, word.find('='))] = word.substr(word.find('=') + 1);
  }
  for (++k; k < argc; ++k) {
    const std::string word = argv[k];
    bindings.emplace_back(word.substr(0, word.find('=')), word.substr(word.find('=') + 1));
  }
  const auto number = [&](const char* name) {
    const auto it = options.defines.find(name);
    return it == options.defines.end() ? 0 : std::atoll(it->second.c_str());
  };
  const int64_t size = number("size"), texture = number("T");

  const auto device = must(runtime::Device::open({argv[3], false}));
  if (!device.state()->int64_atomics)
    stop("the device has no 64-bit atomics in buffers, which the hand-written raster needs");
  const bool exact = scatter == "exact";
  if (!exact && !device.state()->float_atomics) stop("the device has no float atomics in buffers: use `exact`");
  options.profile = device.profile_name().empty() ? "lavapipe" : device.profile_name();
  options.scatter = exact ? "auto" : "atomic";
  auto bundle = jit::compile_file(program_file, options);
  if (!bundle) stop(bundle.error());
  auto program = must(runtime::Program::load(device, *bundle));
  Leaves leaves;
  for (const auto& [leaf, source] : bindings) {
    for (const auto& info : program.leaves())
      if (info.name == leaf) leaves[leaf] = must(must(io::load_binding(source, info.components)).converted(info.kind));
    if (leaves.count(leaf) == 0) stop("there is no leaf '" + leaf + "'");
    must(program.bind(leaf, leaves[leaf]));
  }

  Machine machine(device, program_file.parent_path() / "../measure/handwritten");
  must(program.run("look", 1));
  const io::Array expected = must(program.output("look", "gradient"));
  double apart = 0;
  {
    const Frame frame = make_frame(machine, table, exact, size, texture, leaves, 1, true);
    const auto commands = machine.record(frame.passes);
    machine.run(commands, 1);
    apart = distance(expected, machine.floats(frame.gradient));
  }
  // As many lanes a face as are fastest here.
  Frame best;
  double least = HUGE_VAL;
  for (const int lanes : machine.lanes_in_turn() ? std::vector{1} : std::vector{1, 4, 8, 32, 128, 512}) {
    Frame frame = make_frame(machine, table, exact, size, texture, leaves, lanes, false);
    const auto commands = machine.record(frame.passes);
    machine.run(commands, 3);
    const double once = machine.run(commands, 3);
    const double ms = machine.run(commands, std::clamp(static_cast<int>(30 / once), 1, 300));
    if (ms < least) least = ms, best = std::move(frame);
  }
  const auto commands = machine.record(best.passes);

  const auto compiled_run = [&](int times) {
    const auto begin = std::chrono::steady_clock::now();
    must(program.run("frame", times));
    return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begin).count() / times;
  };
  compiled_run(3);
  const int compiled_times = std::clamp(static_cast<int>(200 / compiled_run(3)), 1, 5000),
            own_times = std::clamp(static_cast<int>(200 / least), 1, 5000);
  std::vector<double> compiled, own, ratios;
  for (int round = 0; round < rounds; ++round) {
    compiled.push_back(compiled_run(compiled_times));
    own.push_back(machine.run(commands, own_times));
    ratios.push_back(compiled.back() / own.back());
  }
  std::vector<double> waited, own_waited;
  // In turns of many frames, as those that are under way are: behind a frame of the other's, each would find its
  // memory and shaders out of the caches.
  constexpr int kTurns = 5;
  const int times = std::clamp(compiled_times / 10, 3, 100);
  for (int turn = 0; turn < kTurns; ++turn) {
    for (int left = times; left > 0; --left) waited.push_back(compiled_run(1));
    for (int left = times; left > 0; --left) own_waited.push_back(machine.run(commands, 1));
  }
  // Where the gradients differ, the two do not do the same, and a ratio of times means nothing.
  const bool agree = apart < 0.02;
  const auto three = [](const std::vector<double>& v) {
    return nlohmann::json{1000 * quantile(v, 0.25), 1000 * quantile(v, 0.5), 1000 * quantile(v, 0.75)};
  };
  std::printf("%9lld %6lld %8lld  %-7s %10.1f %10.1f %10.1f … %-10.1f %7.2f %10.1f %10.1f %9.1e %s\n",
              static_cast<long long>(leaves.at("face").size()), static_cast<long long>(size),
              static_cast<long long>(texture), scatter.c_str(), 1000 * quantile(compiled, 0.5),
              1000 * quantile(own, 0.5), 1000 * quantile(own, 0.25), 1000 * quantile(own, 0.75), quantile(ratios, 0.5),
              1000 * quantile(waited, 0.5), 1000 * quantile(own_waited, 0.5), apart,
              agree ? "" : "the gradients differ: does not count");
  std::ofstream(argv[1], std::ios::app) << nlohmann::json{{"bench", table},
                                                          {"twin", true},
                                                          {"device", device.info().name},
                                                          {"triangles", leaves.at("face").size()},
                                                          {"pixels", size},
                                                          {"texture", texture},
                                                          {"scatter", scatter},
                                                          {"us", 1000 * quantile(compiled, 0.5)},
                                                          {"us_quartiles", three(compiled)},
                                                          {"handwritten_us", 1000 * quantile(own, 0.5)},
                                                          {"handwritten_us_quartiles", three(own)},
                                                          {"ratio", quantile(ratios, 0.5)},
                                                          {"waited_us", 1000 * quantile(waited, 0.5)},
                                                          {"handwritten_waited_us", 1000 * quantile(own_waited, 0.5)},
                                                          {"lanes_a_face", best.lanes},
                                                          {"gradients_apart", apart},
                                                          {"counts", agree}}
                                        << "\n";
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc == 2 && std::string_view(argv[1]) == "--heading") {
    std::printf("%9s %6s %8s  %-7s %10s %10s %24s %6s %10s %10s %9s\n", "triangles", "pixels", "texture", "sums",
                "us a frame", "by hand", "quartiles", "ratio", "waited for", "by hand", "apart");
    return 0;
  }
  if (argc < 8) {
    std::fputs("usage: bench_handwritten FILE PROGRAM DEVICE ROUNDS exact|atomic NAME=CONSTANT... -- LEAF=SOURCE...\n",
               stderr);
    return 2;
  }
  try {
    return bench(argc, argv);
  } catch (const runtime::Failure& failure) {
    stop(failure.message);
  } catch (const std::exception& e) {
    stop(std::string("Vulkan reports: ") + e.what());
  }
}
