// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/spirv/module.h"

#include <spirv-tools/libspirv.hpp>

namespace dr::backend::spirv {

namespace {

// A name or a decoration.
bool is_about(const Instruction& in) {
  return in.opcode() == kName || in.opcode() == kMemberName || in.opcode() == kDecorate ||
         in.opcode() == kMemberDecorate;
}

struct Reader {
  Module module;
  Function* function = nullptr;

  void take(const spv_parsed_instruction_t& in) {
    std::vector<Word> kinds(in.num_words, Word::Literal);
    for (uint16_t k = 0; k < in.num_operands; ++k) {
      const spv_parsed_operand_t& operand = in.operands[k];
      switch (operand.type) {
        case SPV_OPERAND_TYPE_RESULT_ID: kinds[operand.offset] = Word::Result; break;
        case SPV_OPERAND_TYPE_ID:
        case SPV_OPERAND_TYPE_TYPE_ID:
        case SPV_OPERAND_TYPE_MEMORY_SEMANTICS_ID:
        case SPV_OPERAND_TYPE_SCOPE_ID: kinds[operand.offset] = Word::Id; break;
        default: break;
      }
    }
    if (in.opcode == kEntryPoint) module.entry = in.words[2];
    if (in.opcode == kFunction) {
      module.functions.emplace_back();
      function = &module.functions.back();
      function->id = in.result_id;
    }
    if (in.opcode == kFunctionParameter) function->parameters.push_back(in.result_id);
    if (in.opcode == kFunctionEnd) {
      function = nullptr;
      return;
    }
    const bool head = in.opcode == kFunction || in.opcode == kFunctionParameter;
    Stream& to = function == nullptr      ? module.globals
                 : head                   ? function->head
                 : in.opcode == kVariable ? function->variables
                                          : function->body;
    to.add({in.words, in.num_words}, kinds);
  }
};

}  // namespace

std::optional<Module> parse(std::span<const uint32_t> words, std::string& problem) {
  Reader reader;
  if (words.size() < 5) {
    problem = "it has no header";
    return std::nullopt;
  }
  reader.module.header.assign(words.begin(), words.begin() + 5);
  const spvtools::Context context(SPV_ENV_VULKAN_1_1);
  const auto take = [](void* to, const spv_parsed_instruction_t* in) {
    static_cast<Reader*>(to)->take(*in);
    return SPV_SUCCESS;
  };
  spv_diagnostic diagnostic = nullptr;
  const spv_result_t result =
      spvBinaryParse(context.CContext(), &reader, words.data(), words.size(), nullptr, take, &diagnostic);
  if (diagnostic != nullptr && diagnostic->error != nullptr) problem = diagnostic->error;
  spvDiagnosticDestroy(diagnostic);
  if (result != SPV_SUCCESS) return std::nullopt;
  return std::move(reader.module);
}

namespace {

// By id: types, constants and variables that a function needs, also by way of others; functions and what they define.
std::vector<bool> used_ids(const Module& module) {
  std::vector<bool> used(module.header[3]);
  const auto use = [&](const Instruction& in) {
    for (size_t k = 1; k < in.words.size(); ++k)
      if (in.kinds[k] != Word::Literal) used[in.words[k]] = true;
  };
  for (const Function& f : module.functions)
    for (const Stream* s : {&f.head, &f.variables, &f.body}) for_each_instruction(*s, use);
  std::vector<Instruction> globals;
  for_each_instruction(module.globals, [&](const Instruction& in) {
    globals.push_back(in);
    // The size of a workgroup counts though nothing reads it.
    if (in.opcode() == kDecorate && in.words[2] == kBuiltIn) used[in.words[1]] = true;
    if (in.result() == 0 && !is_about(in)) use(in);
  });
  // What they need stands before them.
  for (auto in = globals.rbegin(); in != globals.rend(); ++in)
    if (in->result() != 0 && (used[in->result()] || in->opcode() == kExtInstImport)) use(*in);
  return used;
}

}  // namespace

std::vector<uint32_t> write(const Module& module) {
  const std::vector<bool> used = used_ids(module);
  std::vector<uint32_t> out = module.header;
  const auto append = [&](std::span<const uint32_t> words) { out.insert(out.end(), words.begin(), words.end()); };
  for_each_instruction(module.globals, [&](const Instruction& in) {
    const uint32_t subject = is_about(in) ? in.words[1] : in.result();
    if (subject == 0 || used[subject]) append(in.words);
  });
  for (const Function& f : module.functions) {
    append(f.head.words);
    append(std::span(f.body.words).first(2));  // the first label
    append(f.variables.words);
    append(std::span(f.body.words).subspan(2));
    out.push_back((1u << 16) | kFunctionEnd);
  }
  return out;
}

}  // namespace dr::backend::spirv
