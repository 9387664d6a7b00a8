// SPDX-License-Identifier: Apache-2.0
// One walk over the module's instructions, then a look at its variables. Numbers are those of the SPIR-V specification.
#include "compiler/backend/bundle/reflect.h"

#include <algorithm>
#include <map>
#include <optional>
#include <set>

#include "compiler/backend/bundle/spirv_numbers.h"

namespace dr::bundle {

namespace {

using namespace dr::spv;  // the numbers of the specification
using Words = std::span<const uint32_t>;

enum StorageClass : uint32_t {
  kUniformConstant = 0,
  kInput = 1,
  kOutput = 3,
  kWorkgroup = 4,
  kPrivate = 6,
  kOfFunction = 7,
  kPushConstant = 9,
  kStorageBuffer = 12,
};
constexpr uint32_t kWorkgroupSize = 25, kLocalSize = 17, kDimBuffer = 5, kDim2d = 1, kDimSubpass = 6;

// Thrown inside of this file.
struct Unfit {
  std::string why;
};

class Reflector {
 public:
  explicit Reflector(Words module) : module_(module) {}

  Reflection process() {
    walk();
    if (entries_ != 1) throw Unfit{"has not one entry point"};
    for (const uint32_t merge : merges_)
      if (targets_.count(merge) == 0) throw Unfit{"has a loop without an end"};
    // SPIRV-Tools lets it pass; the driver's compilers do not.
    for (const uint32_t cast : casts_)
      if (pointers_.count(cast) != 0) throw Unfit{"makes a number of a pointer"};
    for (const Words& v : variables_) variable(v);
    for (const Words& chain : chains_) access_chain(chain);
    group();
    for (const auto& [id, decorations] : decorations_)
      if (const auto it = decorations.find(kSpecId); it != decorations.end()) constant(id, it->second);
    return std::move(out_);
  }

 private:
  void walk() {
    constexpr size_t kHeader = 5;
    for (size_t at = kHeader; at < module_.size();) {
      const size_t count = module_[at] >> 16;
      if (count == 0 || count > module_.size() - at) throw Unfit{"is cut off"};
      instruction(module_[at] & 0xffff, module_.subspan(at, count));
      at += count;
    }
  }

  // Word `k` of an instruction.
  static uint32_t word(const Words& i, size_t k) {
    if (k >= i.size()) throw Unfit{"has an instruction that is cut off"};
    return i[k];
  }

  static std::string text(const Words& i, size_t first) {
    std::string out;
    for (size_t k = first; k < i.size(); ++k)
      for (int byte = 0; byte < 4; ++byte) {
        const char c = static_cast<char>(i[k] >> (8 * byte));
        if (c == 0) return out;
        out += c;
      }
    throw Unfit{"has a text without an end"};
  }

  void instruction(uint32_t opcode, const Words& i) {
    switch (opcode) {
      case kCapability: out_.capabilities.push_back(word(i, 1)); break;
      case kExtInstImport:
        if (text(i, 2) != "GLSL.std.450") throw Unfit{"uses instructions of another set than GLSL's"};
        break;
      case kMemoryModel:
        if (word(i, 1) != 0 || word(i, 2) != 1) throw Unfit{"has another memory model than GLSL's"};
        break;
      case kEntryPoint: entry_point(i); break;
      case kExecutionMode:
        if (word(i, 2) == kLocalSize)
          for (size_t axis = 0; axis < 3; ++axis) out_.group[axis] = {false, word(i, 3 + axis)};
        break;
      case kTypeBool:
      case kTypeInt:
      case kTypeFloat:
      case kTypeVector:
      case kTypeMatrix:
      case kTypeImage:
      case kTypeArray:
      case kTypeRuntimeArray:
      case kTypeStruct:
      case kTypePointer: types_[word(i, 1)] = i; break;
      case kConstant:
      case kSpecConstant:
      case kSpecConstantTrue:
      case kSpecConstantFalse:
      case kConstantComposite:
      case kSpecConstantComposite: constants_[word(i, 2)] = i; break;
      case kVariable:
        variables_.push_back(i);
        variable_of_[word(i, 2)] = i;
        pointers_.insert(word(i, 2));
        break;
      case kAccessChain:
      case kInBoundsAccessChain:
        chains_.push_back(i);
        pointers_.insert(word(i, 2));
        break;
      case kBitcast: casts_.push_back(word(i, 3)); break;
      case kDecorate: decorations_[word(i, 1)][word(i, 2)] = i.size() > 3 ? i[3] : 0; break;
      case kMemberDecorate: members_[{word(i, 1), word(i, 2)}][word(i, 3)] = i.size() > 4 ? i[4] : 0; break;
      case kLoopMerge: merges_.push_back(word(i, 1)); break;
      case kBranch: targets_.insert(word(i, 1)); break;
      case kBranchConditional:
        targets_.insert(word(i, 2));
        targets_.insert(word(i, 3));
        break;
      // Selectors have 32 bits here.
      case kSwitch:
        targets_.insert(word(i, 2));
        for (size_t k = 4; k < i.size(); k += 2) targets_.insert(i[k]);
        break;
      default: break;
    }
  }

  void entry_point(const Words& i) {
    ++entries_;
    constexpr std::pair<uint32_t, Stage> kModels[] = {{0, Stage::Vertex}, {4, Stage::Fragment}, {5, Stage::Compute}};
    const auto* model = std::ranges::find(kModels, word(i, 1), &std::pair<uint32_t, Stage>::first);
    if (model == std::end(kModels) || text(i, 3) != "main") throw Unfit{"has another entry point than main"};
    out_.stage = model->second;
  }

  const Words& type(uint32_t id) const {
    const auto it = types_.find(id);
    if (it == types_.end()) throw Unfit{"has a type that the runtime does not know"};
    return it->second;
  }
  static uint32_t opcode_of(const Words& i) { return i[0] & 0xffff; }

  std::optional<uint32_t> decoration(uint32_t id, Decoration wanted) const {
    const auto it = decorations_.find(id);
    if (it == decorations_.end()) return std::nullopt;
    const auto found = it->second.find(wanted);
    return found == it->second.end() ? std::nullopt : std::optional(found->second);
  }

  // A constant that no specialization changes.
  std::optional<uint32_t> number(uint32_t id) const {
    const auto it = constants_.find(id);
    if (it == constants_.end() || opcode_of(it->second) != kConstant) return std::nullopt;
    return word(it->second, 3);
  }

  static Scalar scalar_of(const Words& t) {
    if (opcode_of(t) == kTypeFloat && word(t, 2) == 32) return Scalar::Float;
    if (opcode_of(t) == kTypeInt && word(t, 2) == 32) return word(t, 3) != 0 ? Scalar::Int : Scalar::Uint;
    throw Unfit{"has a port or an image of other than 32-bit numbers"};
  }

  uint64_t bytes_of(uint32_t id, int depth = 0) const {
    if (depth > 16) throw Unfit{"has types within types without an end"};
    const Words& t = type(id);
    switch (opcode_of(t)) {
      case kTypeBool: return 4;
      case kTypeInt:
      case kTypeFloat: return word(t, 2) / 8;
      case kTypeVector:
      case kTypeMatrix: return bounded(bytes_of(word(t, 2), depth + 1), word(t, 3));
      case kTypeArray: {
        const auto length = number(word(t, 3));
        if (!length) throw Unfit{"has an array whose length is no constant"};
        return bounded(bytes_of(word(t, 2), depth + 1), *length);
      }
      case kTypeStruct: {
        uint64_t sum = 0;
        for (size_t k = 2; k < t.size(); ++k) sum += bytes_of(t[k], depth + 1);
        return bounded(sum, 1);
      }
      default: throw Unfit{"has a variable of a type without a size"};
    }
  }
  static uint64_t bounded(uint64_t bytes, uint64_t count) {
    constexpr uint64_t kMost = uint64_t{1} << 31;
    if (bytes > kMost || count > kMost || bytes * count > kMost) throw Unfit{"has a variable of more than 2^31 bytes"};
    return bytes * count;
  }

  void variable(const Words& v) {
    const Words& pointer = type(word(v, 1));
    if (opcode_of(pointer) != kTypePointer) throw Unfit{"has a variable that is none"};
    const uint32_t id = word(v, 2), pointee = word(pointer, 3);
    switch (word(v, 3)) {
      case kInput:
      case kOutput: port(id, pointee, word(v, 3) == kInput ? out_.inputs : out_.outputs); break;
      case kUniformConstant: image(id, type(pointee)); break;
      case kStorageBuffer: buffer(id, pointee); break;
      case kPushConstant: push(pointee); break;
      case kWorkgroup: out_.shared_bytes = bounded(out_.shared_bytes + bytes_of(pointee), 1); break;
      case kPrivate:
      case kOfFunction:
        // Driver's compilers keep these in registers and on stacks.
        private_bytes_ = bounded(private_bytes_ + bytes_of(pointee), 1);
        if (private_bytes_ > (uint64_t{1} << 22)) throw Unfit{"has local variables of more than 4 MiB"};
        break;
      default: throw Unfit{"has a variable of a storage class that the runtime does not know"};
    }
  }

  void port(uint32_t id, uint32_t pointee, std::vector<ReflectedPort>& to) const {
    const auto location = decoration(id, kLocation);
    if (!location) return built_in(id, pointee);
    const Words* t = &type(pointee);
    ReflectedPort out{*location, Scalar::Float, 1};
    if (opcode_of(*t) == kTypeVector) {
      out.components = word(*t, 3);
      t = &type(word(*t, 2));
    }
    out.scalar = scalar_of(*t);
    to.push_back(out);
  }

  // Validators leave some of their types unchecked.
  void built_in(uint32_t id, uint32_t pointee) const {
    const Words* t = &type(pointee);
    if (opcode_of(*t) == kTypeStruct) return;  // gl_PerVertex
    struct BuiltIn {
      uint32_t number, components;
      bool whole;
    };
    // Position, Layer, FragCoord, FragDepth; numbers of workgroups and invocations; of subgroups; VertexIndex,
    // ViewIndex.
    constexpr BuiltIn kKnown[] = {{0, 4, false},   {9, 1, true},    {15, 4, false},  {22, 1, false},  {24, 3, true},
                                  {26, 3, true},   {27, 3, true},   {28, 3, true},   {29, 1, true},   {36, 1, true},
                                  {40, 1, true},   {41, 1, true},   {42, 1, true},   {4416, 4, true}, {4417, 4, true},
                                  {4418, 4, true}, {4419, 4, true}, {4420, 4, true}, {4440, 1, true}};
    const auto number = decoration(id, kBuiltIn);
    const auto* known = std::ranges::find(kKnown, number.value_or(UINT32_MAX), &BuiltIn::number);
    if (known == std::end(kKnown)) throw Unfit{"has a built-in variable that no bundle has"};
    uint32_t components = 1;
    if (opcode_of(*t) == kTypeVector) {
      components = word(*t, 3);
      t = &type(word(*t, 2));
    }
    if (components != known->components || (scalar_of(*t) != Scalar::Float) != known->whole)
      throw Unfit{"has a built-in variable of another type"};
  }

  ReflectedResource resource(uint32_t id, ReflectedResource::Kind kind) const {
    const auto set = decoration(id, kDescriptorSet), binding = decoration(id, kBinding);
    if (!set || !binding) throw Unfit{"has a resource without a binding"};
    ReflectedResource out;
    out.kind = kind;
    out.set = *set;
    out.binding = *binding;
    return out;
  }

  void image(uint32_t id, const Words& t) {
    using Kind = ReflectedResource::Kind;
    if (opcode_of(t) != kTypeImage) throw Unfit{"has a resource that is no image"};
    const uint32_t dim = word(t, 3), arrayed = word(t, 5), multisampled = word(t, 6), sampled = word(t, 7);
    const bool texels = dim == kDimBuffer && arrayed == 0 && sampled == 1,
               layers = dim == kDim2d && arrayed == 1 && sampled == 1,
               input = dim == kDimSubpass && arrayed == 0 && sampled == 2;
    if (multisampled != 0 || (!texels && !layers && !input))
      throw Unfit{"has an image of another kind than bundles have"};
    ReflectedResource out = resource(id, texels ? Kind::Texels : layers ? Kind::Image : Kind::Input);
    out.scalar = scalar_of(type(word(t, 2)));
    if (input) {
      const auto index = decoration(id, kInputAttachmentIndex);
      if (!index) throw Unfit{"has an input attachment without a number"};
      out.input = *index;
    }
    out_.resources.push_back(out);
  }

  bool member_has(uint32_t type, uint32_t member, Decoration wanted) const {
    const auto it = members_.find({type, member});
    return it != members_.end() && it->second.count(wanted) != 0;
  }

  void buffer(uint32_t id, uint32_t pointee) {
    const Words& t = type(pointee);
    if (opcode_of(t) != kTypeStruct || t.size() != 3 || opcode_of(type(t[2])) != kTypeRuntimeArray)
      throw Unfit{"has a buffer that is no list"};
    ReflectedResource out = resource(id, ReflectedResource::Kind::Buffer);
    out.read_only = member_has(pointee, 0, kNonWritable) || decoration(id, kNonWritable).has_value();
    out_.resources.push_back(out);
  }

  void push(uint32_t pointee) {
    const Words& t = type(pointee);
    if (opcode_of(t) != kTypeStruct) throw Unfit{"has push constants that are no block"};
    for (uint32_t k = 2; k < t.size(); ++k) {
      const auto it = members_.find({pointee, k - 2});
      const auto offset = it == members_.end() ? 0 : it->second.count(kOffset) ? it->second.at(kOffset) : 0;
      out_.push_bytes = std::max<uint32_t>(out_.push_bytes, static_cast<uint32_t>(bounded(offset + bytes_of(t[k]), 1)));
    }
  }

  // An index that is a constant is within its array: nobody looks when the shader runs.
  void access_chain(const Words& chain) const {
    const auto base = variable_of_.find(word(chain, 3));
    if (base == variable_of_.end()) return;
    const uint32_t storage = word(base->second, 3);
    if (storage != kOfFunction && storage != kPrivate && storage != kWorkgroup) return;
    uint32_t at = word(type(word(base->second, 1)), 3);
    for (size_t k = 4; k < chain.size(); ++k) {
      const Words& t = type(at);
      const auto index = number(chain[k]);
      switch (opcode_of(t)) {
        case kTypeArray: {
          const auto length = number(word(t, 3));
          if (index && length && *index >= *length) throw Unfit{"reads or writes beyond an array"};
          at = word(t, 2);
          break;
        }
        case kTypeVector:
        case kTypeMatrix:
          if (index && *index >= word(t, 3)) throw Unfit{"reads or writes beyond a vector"};
          at = word(t, 2);
          break;
        case kTypeStruct:
          if (!index || *index + size_t{2} >= t.size()) throw Unfit{"names a member that is not there"};
          at = t[*index + 2];
          break;
        default: throw Unfit{"names a part of what has none"};
      }
    }
  }

  // The built-in constant, where there is one, is what counts.
  void group() {
    for (const auto& [id, decorations] : decorations_) {
      const auto built_in = decorations.find(kBuiltIn);
      if (built_in == decorations.end() || built_in->second != kWorkgroupSize) continue;
      const auto whole = constants_.find(id);
      if (whole == constants_.end() || whole->second.size() != 6)
        throw Unfit{"has a size of workgroups that is no constant"};
      for (size_t axis = 0; axis < 3; ++axis) {
        const uint32_t part = whole->second[3 + axis];
        if (const auto fixed = number(part))
          out_.group[axis] = {false, *fixed};
        else if (const auto id_of = decoration(part, kSpecId))
          out_.group[axis] = {true, *id_of};
        else
          throw Unfit{"has a size of workgroups that is no constant"};
      }
    }
  }

  void constant(uint32_t id, uint32_t spec_id) {
    const auto it = constants_.find(id);
    if (it == constants_.end() || opcode_of(it->second) != kSpecConstant)
      throw Unfit{"has a specialization constant that is no whole number"};
    const Words& t = type(word(it->second, 1));
    if (opcode_of(t) != kTypeInt || word(t, 2) != 32)
      throw Unfit{"has a specialization constant that is no whole number of 32 bits"};
    out_.constants.push_back(spec_id);
  }

  Words module_;
  Reflection out_;
  int entries_ = 0;
  uint64_t private_bytes_ = 0;
  std::map<uint32_t, Words> types_, constants_, variable_of_;
  std::vector<Words> variables_, chains_;
  std::map<uint32_t, std::map<uint32_t, uint32_t>> decorations_;
  std::map<std::pair<uint32_t, uint32_t>, std::map<uint32_t, uint32_t>> members_;
  std::vector<uint32_t> merges_;
  std::set<uint32_t> targets_, pointers_;
  std::vector<uint32_t> casts_;  // of what
};

}  // namespace

std::variant<Reflection, std::string> reflect(std::span<const uint32_t> module) {
  try {
    return Reflector(module).process();
  } catch (const Unfit& unfit) {
    return unfit.why;
  }
}

}  // namespace dr::bundle
