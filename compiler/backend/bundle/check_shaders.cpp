// SPDX-License-Identifier: Apache-2.0
// Validation by SPIRV-Tools, reflection, and comparison with the tables.
#include "compiler/backend/bundle/check_shaders.h"

#include <algorithm>
#include <optional>
#include <spirv-tools/libspirv.hpp>

#include "compiler/backend/bundle/on_all_cores.h"
#include "compiler/backend/bundle/reflect.h"

namespace dr::bundle {

namespace {

using ResourceKind = ReflectedResource::Kind;

// Of the SPIR-V specification, those that drc's shaders declare, and what of the device each needs.
constexpr const bool ShaderLimits::*kAlways = nullptr;
struct Capability {
  uint32_t number;
  const bool ShaderLimits::*needs;
  const char* name;
};
constexpr Capability kCapabilities[] = {
    {1, kAlways, "Shader"},
    {11, &ShaderLimits::int64, "Int64"},
    {12, &ShaderLimits::int64_atomics, "Int64Atomics"},
    {40, kAlways, "InputAttachment"},
    {46, kAlways, "SampledBuffer"},
    {50, kAlways, "ImageQuery"},
    {61, &ShaderLimits::subgroups, "GroupNonUniform"},
    {63, &ShaderLimits::subgroups, "GroupNonUniformArithmetic"},
    {64, &ShaderLimits::subgroups, "GroupNonUniformBallot"},
    {65, &ShaderLimits::shuffles, "GroupNonUniformShuffle"},
    {4439, &ShaderLimits::multiview, "MultiView"},
    {6033, &ShaderLimits::float_atomics, "AtomicFloat32AddEXT"},
};

// Whether the module is what Vulkan 1.1 allows.
std::string validate(const ShaderT& shader) {
  spvtools::SpirvTools tools(SPV_ENV_VULKAN_1_1);
  std::string problem;
  tools.SetMessageConsumer([&](spv_message_level_t level, const char*, const spv_position_t&, const char* message) {
    if (level <= SPV_MSG_ERROR && problem.empty()) problem = message;
  });
  spvtools::ValidatorOptions options;
  options.SetFriendlyNames(false);
  if (tools.Validate(shader.spirv.data(), shader.spirv.size(), options)) return {};
  // What it says may name anything that stands in the file.
  for (char& c : problem)
    if (c < ' ' || c > '~') c = ' ';
  return "is invalid SPIR-V: " + problem.substr(0, 300);
}

class ShaderChecker {
 public:
  ShaderChecker(const BundleT& bundle, const ShaderLimits& limits) : b_(bundle), limits_(limits) {}

  std::string process() {
    look_at_all();
    for (size_t k = 0; k < problems_.size(); ++k)
      if (!problems_[k].empty()) return "shader '" + b_.shaders[k]->name + "' " + problems_[k];
    for (const auto& step : b_.steps)
      for (const auto& c : step->commands)
        if (!command(*c)) return "command '" + c->label + "' and its shader disagree: " + problem_;
    return {};
  }

 private:
  bool fail(const std::string& what) {
    problem_ = what;
    return false;
  }

  // Each on its own, on all cores.
  void look_at_all() {
    reflections_.resize(b_.shaders.size());
    problems_.resize(b_.shaders.size());
    on_all_cores(b_.shaders.size(), [&](size_t k) { problems_[k] = look_at(k); });
  }

  std::string look_at(size_t k) {
    const ShaderT& shader = *b_.shaders[k];
    if (std::string problem = validate(shader); !problem.empty()) return problem;
    auto reflected = reflect(shader.spirv);
    if (const auto* why = std::get_if<std::string>(&reflected)) return *why;
    Reflection& r = reflections_[k] = std::move(std::get<Reflection>(reflected));
    if (r.stage != shader.stage) return "is of another stage than the bundle says";
    for (const uint32_t number : r.capabilities) {
      const auto* known = std::ranges::find(kCapabilities, number, &Capability::number);
      if (known == std::end(kCapabilities))
        return "needs capability " + std::to_string(number) + ", which no bundle has";
      if (known->needs != kAlways && !(limits_.*known->needs))
        return std::string("needs the capability ") + known->name + ", which the device lacks";
    }
    if (r.push_bytes > 16) return "has more than 16 bytes of push constants";
    const auto symbols = static_cast<uint32_t>(b_.symbols.size());
    const uint32_t numbers = symbols + 2, end = numbers + static_cast<uint32_t>(b_.numbers.size());
    for (const uint32_t number : r.constants)
      if (number >= end || (number >= symbols && number < numbers && r.stage != Stage::Compute))
        return "has specialization constant " + std::to_string(number) + ", which is neither a symbol nor a number";
    if (r.stage == Stage::Compute) {
      const bool linear =
          !r.group[1].is_constant && r.group[1].number == 1 && !r.group[2].is_constant && r.group[2].number == 1;
      if (!linear || (r.group[0].is_constant && r.group[0].number != symbols))
        return "has workgroups of another size than the host chooses";
      if (!r.group[0].is_constant && r.group[0].number > limits_.group_invocations)
        return "has workgroups of " + std::to_string(r.group[0].number) + " invocations, the device allows " +
               std::to_string(limits_.group_invocations);
      if (r.shared_bytes > limits_.shared_bytes)
        return "shares " + std::to_string(r.shared_bytes) + " bytes in a workgroup, the device allows " +
               std::to_string(limits_.shared_bytes);
    }
    return {};
  }

  static Scalar stored(Scalar scalar) { return scalar == Scalar::Bool ? Scalar::Uint : scalar; }

  // `bound`: by binding, null where the host binds what is made for it.
  struct Slot {
    const ResourceT* resource;
    bool read_only;
    uint8_t texel;
    std::optional<uint32_t> input;  // number of the input attachment
  };

  bool resources(const Reflection& r, const std::vector<Slot>& slots) {
    for (const ReflectedResource& use : r.resources) {
      const std::string where = "binding " + std::to_string(use.binding);
      if (use.set != 0 || use.binding >= slots.size()) return fail(where + " is not there");
      const Slot& slot = slots[use.binding];
      const ResourceKind kind = slot.input                                  ? ResourceKind::Input
                                : slot.texel != 0                           ? ResourceKind::Texels
                                : slot.resource->storage == Storage::Buffer ? ResourceKind::Buffer
                                                                            : ResourceKind::Image;
      if (use.kind != kind) return fail(where + " is of another kind");
      if (kind == ResourceKind::Buffer) {
        if (slot.read_only && !use.read_only) return fail(where + " is read, and the shader may write it");
        continue;
      }
      if (use.scalar != stored(slot.resource->type->scalar)) return fail(where + " holds numbers of another kind");
      if (kind == ResourceKind::Input && use.input != *slot.input) return fail(where + " is another input attachment");
    }
    return true;
  }

  const Reflection& of(int shader) const { return reflections_[static_cast<size_t>(shader)]; }

  Slot slot(uint32_t resource, bool read_only) const { return {b_.resources[resource].get(), read_only, 0, {}}; }

  std::vector<Slot> slots(const CommandT& c) const {
    std::vector<Slot> out;
    for (const auto& b : c.bindings) {
      Slot s = slot(b->resource, b->access == Access::Read);
      s.texel = b->texel;
      const auto input = std::ranges::find(c.inputs, b->resource);
      if (input != c.inputs.end()) s.input = static_cast<uint32_t>(input - c.inputs.begin());
      out.push_back(s);
    }
    return out;
  }

  bool draw(const CommandT& c) {
    const Reflection &vertex = of(c.vertex), &fragment = of(c.fragment);
    // Input attachments are the fragment shader's alone.
    for (const ReflectedResource& use : vertex.resources)
      if (use.kind == ResourceKind::Input) return fail("a vertex shader reads an input attachment");
    if (!resources(vertex, slots(c)) || !resources(fragment, slots(c))) return false;
    if (!vertex.inputs.empty()) return fail("the vertex shader reads attributes");
    for (const ReflectedPort& input : fragment.inputs) {
      const auto from = std::ranges::find(vertex.outputs, input.location, &ReflectedPort::location);
      if (from == vertex.outputs.end() || from->scalar != input.scalar || from->components < input.components)
        return fail("the fragment shader reads what the vertex shader does not give");
    }
    std::vector<bool> given(c.colors.size(), false);
    for (const ReflectedPort& output : fragment.outputs) {
      if (output.location >= c.colors.size()) return fail("the fragment shader writes an attachment that is not there");
      const TypeT& type = *b_.resources[c.colors[output.location]]->type;
      if (output.scalar != stored(type.scalar) || output.components < type.rows)
        return fail("the fragment shader writes another type than that of the attachment");
      given[output.location] = true;
    }
    return std::ranges::all_of(given, [](bool one) { return one; }) || fail("an attachment is not written");
  }

  // The host chooses how many invocations a workgroup has, or command and shader say the same number.
  bool group(const Reflection& r, uint32_t group) {
    const bool same = r.group[0].is_constant ? group == 0 : group == r.group[0].number;
    return same || fail("the shader has workgroups of another size");
  }

  // The host binds partial results in place of what the first stage reads.
  bool reduce(const CommandT& c) {
    std::vector<Slot> first = slots(c), last;
    first.push_back(slot(static_cast<uint32_t>(c.target), false));
    last.push_back(slot(static_cast<uint32_t>(c.scratch_a), true));
    last.push_back(first.back());
    return group(of(c.compute), c.group) && group(of(c.next), c.group) && resources(of(c.compute), first) &&
           resources(of(c.next), last);
  }

  bool command(const CommandT& c) {
    switch (c.kind) {
      case CommandKind::Dispatch: return group(of(c.compute), c.group) && resources(of(c.compute), slots(c));
      case CommandKind::Draw: return draw(c);
      case CommandKind::Reduce: return reduce(c);
      case CommandKind::Fill:
      case CommandKind::Copy: break;
    }
    return true;
  }

  const BundleT& b_;
  const ShaderLimits& limits_;
  std::vector<Reflection> reflections_;
  std::vector<std::string> problems_;
  std::string problem_;
};

}  // namespace

std::string check_shaders(const BundleT& bundle, const ShaderLimits& limits) {
  return ShaderChecker(bundle, limits).process();
}

}  // namespace dr::bundle
