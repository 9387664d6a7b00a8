// SPDX-License-Identifier: Apache-2.0
// One walk to see what is there, one to write it anew. A buffer's parts are variables of its type; an access such as
//   %p = OpAccessChain %pointer %buffer %zero %index
//   %x = OpLoad %float %p
// becomes  %x = OpFunctionCall %float %load %index  of a function that switches on the index's upper bits.
#include "compiler/backend/bundle/split_buffers.h"

#include <algorithm>
#include <bit>
#include <initializer_list>
#include <map>
#include <optional>
#include <set>
#include <spirv-tools/libspirv.hpp>

#include "compiler/backend/bundle/spirv_numbers.h"

namespace dr::bundle {

namespace {

using namespace dr::spv;  // the numbers of the specification
using WordList = std::vector<uint32_t>;

// Thrown inside of this file.
struct NotSplit {
  std::string why;
};

struct Instruction {
  uint32_t opcode = 0, type = 0, result = 0;
  WordList words;
  std::vector<uint32_t> ids;  // that it uses, but for its type
};

// Which words of an instruction name a pointer, and values that are computed.
struct Operands {
  size_t pointer = 0;  // 0: it is no access
  std::vector<size_t> values;
};

Operands operands_of(const Instruction& in) {
  if (in.opcode == kLoad) return {3, {}};
  if (in.opcode == kStore) return {1, {2}};
  if (in.opcode == kAtomicStore) return {1, {4}};
  if (in.opcode == kAtomicLoad || in.opcode == kAtomicIIncrement || in.opcode == kAtomicIDecrement) return {3, {}};
  if (in.opcode == kAtomicCompareExchange) return {3, {7, 8}};
  if (in.opcode == kAtomicExchange || (in.opcode >= kAtomicIAdd && in.opcode <= kAtomicXor) || in.opcode == kAtomicFAdd)
    return {3, {6}};
  return {};
}

// A variable that has parts.
struct Parted {
  Split split;
  WordList variable;            // the instruction
  std::vector<uint32_t> parts;  // ids; the first is its own
  bool texels = false;
  uint32_t log_elements = 0;  // of a part
};

// A pointer into one.
struct Chain {
  const Parted* of = nullptr;
  uint32_t pointer_type = 0, index = 0;
  WordList before, after;  // other indices
};

class Splitter {
 public:
  Splitter(std::span<const uint32_t> module, std::span<const Split> splits)
      : splits_(splits.begin(), splits.end()), header_(module.begin(), module.begin() + 5) {
    const spvtools::Context context(SPV_ENV_VULKAN_1_1);
    const auto take = [](void* to, const spv_parsed_instruction_t* in) {
      static_cast<Splitter*>(to)->take(*in);
      return SPV_SUCCESS;
    };
    if (spvBinaryParse(context.CContext(), this, module.data(), module.size(), nullptr, take, nullptr) != SPV_SUCCESS)
      throw NotSplit{"is no module"};
  }

  WordList process() {
    for (const Instruction& in : all_) look(in);
    for (const Instruction& in : all_) {
      if (in.opcode == kFunction && !in_functions_) {
        in_functions_ = true;
        globals_at_ = out_.size();
      }
      write(in);
    }
    out_.insert(out_.begin() + static_cast<std::ptrdiff_t>(globals_at_), globals_.begin(), globals_.end());
    out_.insert(out_.end(), functions_.begin(), functions_.end());
    header_[3] += new_ids_;
    out_.insert(out_.begin(), header_.begin(), header_.end());
    return std::move(out_);
  }

 private:
  void take(const spv_parsed_instruction_t& in) {
    Instruction out{in.opcode, in.type_id, in.result_id, {in.words, in.words + in.num_words}, {}};
    for (uint16_t k = 0; k < in.num_operands; ++k) switch (in.operands[k].type) {
        case SPV_OPERAND_TYPE_ID:
        case SPV_OPERAND_TYPE_MEMORY_SEMANTICS_ID:
        case SPV_OPERAND_TYPE_SCOPE_ID: out.ids.push_back(in.words[in.operands[k].offset]); break;
        default: break;
      }
    if (in.opcode == kTypeVoid) void_ = in.result_id;
    if (in.opcode == kTypeInt && in.words[2] == 32 && in.words[3] == 0) uint_ = in.result_id;
    if (in.opcode == kTypeFunction) types_of_functions_[{in.words + 2, in.words + in.num_words}] = in.result_id;
    all_.push_back(std::move(out));
  }

  uint32_t fresh() { return header_[3] + new_ids_++; }

  static void add(WordList& to, uint32_t opcode, std::initializer_list<std::span<const uint32_t>> operands) {
    const size_t at = to.size();
    to.push_back(0);
    for (const auto& some : operands) to.insert(to.end(), some.begin(), some.end());
    to[at] = static_cast<uint32_t>(to.size() - at) << 16 | opcode;
  }
  static void add(WordList& to, uint32_t opcode, std::initializer_list<uint32_t> words) {
    add(to, opcode, {std::span(words.begin(), words.size())});
  }

  // ---- What is there ----
  void look(const Instruction& in) {
    if (in.type != 0) type_of_[in.result] = in.type;
    switch (in.opcode) {
      case kDecorate:
        if (in.words[2] == kBinding) bindings_[in.words[1]] = in.words[3];
        if (in.words[2] == kArrayStride) strides_[in.words[1]] = in.words[3];
        return;
      case kTypePointer:
      case kTypeStruct:
      case kTypeImage: types_[in.result] = in.words; return;
      case kConstant: constants_[in.result] = in.words[3]; return;
      case kVariable: variable(in); return;
      case kFunction: body_ = true; return;
      case kAccessChain:
      case kInBoundsAccessChain:
        if (chain(in)) return;
        break;
      case kLoad:
        if (const auto it = parted_.find(in.words[3]); it != parted_.end() && it->second.texels) {
          texels_[in.result] = &it->second;
          return;
        }
        break;
      default: break;
    }
    if (body_) access(in);
  }

  void variable(const Instruction& in) {
    const auto binding = bindings_.find(in.result);
    if (binding == bindings_.end()) return;
    const auto split = std::ranges::find(splits_, binding->second, &Split::binding);
    if (split == splits_.end()) return;
    Parted parted{*split, in.words, {in.result}, false, split->log_size};
    for (uint32_t k = 1; k < split->parts; ++k) parted.parts.push_back(fresh());
    const WordList& pointee = types_.at(types_.at(in.type)[3]);
    parted.texels = (pointee[0] & 0xffff) == kTypeImage;
    if (!parted.texels) {
      const auto stride = strides_.find(pointee.size() == 3 ? pointee[2] : 0);
      if (stride == strides_.end() || !std::has_single_bit(stride->second))
        throw NotSplit{"has a buffer whose elements are of another size than bundles have"};
      parted.log_elements -= static_cast<uint32_t>(std::countr_zero(stride->second));
    }
    parted_[in.result] = std::move(parted);
  }

  // Whether it is a pointer into a part that must be looked for: where the index is known, it lies in the first.
  bool chain(const Instruction& in) {
    const auto parted = parted_.find(in.words[3]);
    if (parted == parted_.end()) return false;
    if (in.words.size() < 6) throw NotSplit{"passes a buffer on"};
    const Parted& of = parted->second;
    const auto known = constants_.find(in.words[5]);
    if (known != constants_.end() && known->second >> of.log_elements == 0) return true;
    chains_[in.result] = {&of, in.type, in.words[5], {in.words[4]}, {in.words.begin() + 6, in.words.end()}};
    for (const uint32_t index : chains_[in.result].after)
      if (constants_.count(index) == 0) throw NotSplit{"picks a component of a buffer's element by a computed number"};
    return true;
  }

  // Pointers are read and written through, and nothing else.
  void access(const Instruction& in) const {
    const Operands operands = operands_of(in);
    for (const uint32_t id : in.ids) {
      if (parted_.count(id) != 0) throw NotSplit{"uses a buffer as a whole"};
      if (chains_.count(id) != 0 && (operands.pointer == 0 || in.words[operands.pointer] != id))
        throw NotSplit{"passes a pointer on"};
      if (texels_.count(id) != 0 && in.opcode != kImageFetch) throw NotSplit{"uses a texel buffer as a whole"};
    }
  }

  // ---- What becomes of it ----
  void write(const Instruction& in) {
    const auto copy = [&] { out_.insert(out_.end(), in.words.begin(), in.words.end()); };
    const bool names = in.opcode == kName || in.opcode == kDecorate;
    if (names && chains_.count(in.words[1]) != 0) return;
    const auto about = names ? parted_.find(in.words[1]) : parted_.end();
    if (in.opcode == kDecorate && about != parted_.end()) {
      copy();
      for (uint32_t k = 1; k < about->second.split.parts; ++k) {
        WordList words = in.words;
        words[1] = about->second.parts[k];
        if (words[2] == kBinding) words[3] = about->second.split.more + k - 1;
        out_.insert(out_.end(), words.begin(), words.end());
      }
      return;
    }
    if (const auto it = parted_.find(in.result); in.opcode == kVariable && it != parted_.end()) {
      copy();
      for (uint32_t k = 1; k < it->second.split.parts; ++k) {
        WordList words = in.words;
        words[2] = it->second.parts[k];
        out_.insert(out_.end(), words.begin(), words.end());
      }
      return;
    }
    if (chains_.count(in.result) != 0) return;
    if (const auto it = in.opcode == kImageFetch ? texels_.find(in.words[3]) : texels_.end(); it != texels_.end())
      return call(in, {it->second, 0, in.words[4], {}, {}}, {3, {}});
    const Operands operands = operands_of(in);
    const auto through = operands.pointer == 0 ? chains_.end() : chains_.find(in.words[operands.pointer]);
    if (through == chains_.end()) return copy();
    call(in, through->second, operands);
  }

  // In place of an access.
  void call(const Instruction& in, const Chain& chain, const Operands& operands) {
    // What two accesses have in common that are one function.
    WordList key{chain.of->parts[0], chain.pointer_type, type_of_.at(chain.index)};
    key.insert(key.end(), chain.after.begin(), chain.after.end());
    WordList text = in.words, parameters{type_of_.at(chain.index)}, arguments{chain.index};
    if (in.result != 0) text[2] = 0;
    text[operands.pointer] = 0;
    if (in.opcode == kImageFetch) text[4] = 0;
    for (const size_t k : operands.values) {
      arguments.push_back(text[k]);
      parameters.push_back(text[k] = type_of_.at(text[k]));
    }
    key.insert(key.end(), text.begin(), text.end());
    uint32_t& function = functions_by_key_[key];
    if (function == 0) function = make_function(in, chain, operands, parameters);
    const uint32_t type = in.result != 0 ? in.type : void_type();
    const uint32_t head[] = {type, in.result != 0 ? in.result : fresh(), function};
    add(out_, kFunctionCall, {std::span(head), std::span(arguments)});
  }

  uint32_t make_function(const Instruction& in, const Chain& chain, const Operands& operands,
                         const WordList& parameters) {
    const Parted& of = *chain.of;
    const uint32_t result = in.result != 0 ? in.type : void_type(), function = fresh(), merge = fresh();
    add(functions_, kFunction, {result, function, 0, function_type(result, parameters)});
    WordList ids;
    for (const uint32_t type : parameters) {
      ids.push_back(fresh());
      add(functions_, kFunctionParameter, {type, ids.back()});
    }
    add(functions_, kLabel, {fresh()});
    uint32_t index = ids[0];
    if (parameters[0] != uint_type()) add(functions_, kBitcast, {uint_type(), index = fresh(), ids[0]});
    const uint32_t part = fresh(), element = fresh();
    add(functions_, kShiftRightLogical, {uint_type(), part, index, constant(of.log_elements)});
    add(functions_, kBitwiseAnd, {uint_type(), element, index, constant((1u << of.log_elements) - 1)});
    add(functions_, kSelectionMerge, {merge, 0});
    WordList labels, targets, results;
    for (uint32_t k = 0; k < of.split.parts; ++k) labels.push_back(fresh());
    for (uint32_t k = 0; k + 1 < of.split.parts; ++k) targets.insert(targets.end(), {k, labels[k]});
    const uint32_t what[] = {part, labels.back()};
    add(functions_, kSwitch, {std::span(what), std::span(targets)});
    for (uint32_t k = 0; k < of.split.parts; ++k) {
      add(functions_, kLabel, {labels[k]});
      WordList words = in.words;
      if (in.result != 0) results.insert(results.end(), {words[2] = fresh(), labels[k]});
      for (size_t v = 0; v < operands.values.size(); ++v) words[operands.values[v]] = ids[v + 1];
      words[operands.pointer] = fresh();
      if (of.texels) {
        add(functions_, kLoad, {types_.at(of.variable[1])[3], words[operands.pointer], of.parts[k]});
        words[4] = element;
      } else {
        const uint32_t head[] = {chain.pointer_type, words[operands.pointer], of.parts[k]};
        add(functions_, kAccessChain,
            {std::span(head), std::span(chain.before), std::span(&element, 1), std::span(chain.after)});
      }
      functions_.insert(functions_.end(), words.begin(), words.end());
      add(functions_, kBranch, {merge});
    }
    add(functions_, kLabel, {merge});
    if (in.result != 0) {
      const uint32_t head[] = {in.type, fresh()};
      add(functions_, kPhi, {std::span(head), std::span(results)});
      add(functions_, kReturnValue, {head[1]});
    } else {
      functions_.push_back(1u << 16 | kReturn);
    }
    functions_.push_back(1u << 16 | kFunctionEnd);
    return function;
  }

  uint32_t void_type() {
    if (void_ == 0) add(globals_, kTypeVoid, {void_ = fresh()});
    return void_;
  }
  uint32_t uint_type() {
    if (uint_ == 0) add(globals_, kTypeInt, {uint_ = fresh(), 32, 0});
    return uint_;
  }
  uint32_t constant(uint32_t value) {
    uint32_t& id = numbers_[value];
    const uint32_t type = uint_type();
    if (id == 0) add(globals_, kConstant, {type, id = fresh(), value});
    return id;
  }
  uint32_t function_type(uint32_t result, const WordList& parameters) {
    WordList key{result};
    key.insert(key.end(), parameters.begin(), parameters.end());
    uint32_t& id = types_of_functions_[key];
    if (id == 0) {
      id = fresh();
      add(globals_, kTypeFunction, {std::span(&id, 1), std::span(key)});
    }
    return id;
  }

  std::vector<Split> splits_;
  WordList header_;
  std::vector<Instruction> all_;
  uint32_t new_ids_ = 0, void_ = 0, uint_ = 0;
  bool body_ = false, in_functions_ = false;
  std::map<uint32_t, uint32_t> bindings_, strides_, constants_, type_of_, numbers_;  // by id; numbers by value
  std::map<uint32_t, WordList> types_;
  std::map<WordList, uint32_t> types_of_functions_, functions_by_key_;
  std::map<uint32_t, Parted> parted_;         // by variable
  std::map<uint32_t, Chain> chains_;          // by pointer
  std::map<uint32_t, const Parted*> texels_;  // by image
  WordList out_, globals_, functions_;
  size_t globals_at_ = 0;  // where in `out_` they belong
};

}  // namespace

std::variant<std::vector<uint32_t>, std::string> split_buffers(std::span<const uint32_t> module,
                                                               std::span<const Split> splits) {
  try {
    return Splitter(module, splits).process();
  } catch (const NotSplit& unfit) {
    return unfit.why;
  }
}

}  // namespace dr::bundle
