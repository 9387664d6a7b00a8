// SPDX-License-Identifier: Apache-2.0
// The one place that talks to glslang and SPIRV-Tools.
#include "compiler/backend/spirv/spirv.h"

#include <glslang/Include/ResourceLimits.h>
#include <glslang/Public/ResourceLimits.h>
#include <glslang/Public/ShaderLang.h>
#include <glslang/SPIRV/GlslangToSpv.h>

#include <chrono>
#include <mutex>
#include <set>
#include <spirv-tools/libspirv.hpp>

#include "compiler/backend/spirv/module.h"
#include "compiler/backend/spirv/spare_memory.h"
#include "compiler/ir/graph.h"

namespace dr::backend {

namespace {

// glslang needs one set-up a process.
void initialize_glslang() {
  static std::once_flag once;
  std::call_once(once, [] { glslang::InitializeProcess(); });
}

using namespace dr::spv;  // the numbers of the specification

bool is_float_arithmetic(uint32_t opcode) {
  switch (opcode) {
    case kFNegate:
    case kFAdd:
    case kFSub:
    case kFMul:
    case kFDiv:
    case kFRem:
    case kFMod:
    case kVectorTimesScalar:
    case kMatrixTimesScalar:
    case kVectorTimesMatrix:
    case kMatrixTimesVector:
    case kMatrixTimesMatrix:
    case kOuterProduct:
    case kDot: return true;
    default: return false;
  }
}

}  // namespace

std::vector<uint32_t> decorate_no_contraction(const std::vector<uint32_t>& module, bool but_main) {
  constexpr size_t kHeader = 5;
  std::set<uint32_t> decorated;
  std::vector<uint32_t> ids;
  size_t first_decoration = 0;
  uint32_t main = 0, function = 0;
  for (size_t at = kHeader; at < module.size(); at += std::max<uint32_t>(module[at] >> 16, 1)) {
    const uint32_t opcode = module[at] & 0xffff;
    if (opcode == kDecorate && first_decoration == 0) first_decoration = at;
    if (opcode == kDecorate && module[at + 2] == kNoContraction) decorated.insert(module[at + 1]);
    if (opcode == kEntryPoint) main = module[at + 2];
    if (opcode == kFunction) function = module[at + 2];
    if (is_float_arithmetic(opcode) && !(but_main && function == main)) ids.push_back(module[at + 2]);
  }
  std::vector<uint32_t> extra;
  for (uint32_t id : ids)
    if (decorated.count(id) == 0) extra.insert(extra.end(), {(3u << 16) | kDecorate, id, kNoContraction});
  std::vector<uint32_t> out = module;
  // A shader always has decorations (built-ins, bindings); new ones go before the first.
  if (first_decoration != 0)
    out.insert(out.begin() + static_cast<ptrdiff_t>(first_decoration), extra.begin(), extra.end());
  return out;
}

std::string disassemble(const std::vector<uint32_t>& module) {
  std::string text;
  const spvtools::SpirvTools tools(SPV_ENV_VULKAN_1_1);
  if (!tools.Disassemble(module, &text, SPV_BINARY_TO_TEXT_OPTION_INDENT | SPV_BINARY_TO_TEXT_OPTION_FRIENDLY_NAMES))
    DR_ICE("a module cannot be disassembled");
  return text;
}

namespace {

// Adds what has passed since it was made, or since it last did so.
class Watch {
 public:
  void lap(double& to) {
    const auto now = std::chrono::steady_clock::now();
    to += std::chrono::duration<double, std::milli>(now - last_).count();
    last_ = now;
  }

 private:
  std::chrono::steady_clock::time_point last_ = std::chrono::steady_clock::now();
};

// glslang's words for it, or what it says is wrong.
std::variant<std::vector<uint32_t>, std::string> translate(const GlslShader& shader) {
  SpareMemory spare;
  initialize_glslang();
  const EShLanguage stage = shader.stage == bundle::Stage::Vertex     ? EShLangVertex
                            : shader.stage == bundle::Stage::Fragment ? EShLangFragment
                                                                      : EShLangCompute;
  glslang::TShader text(stage);
  const char* source = shader.source.c_str();
  text.setStrings(&source, 1);
  text.setEnvInput(glslang::EShSourceGlsl, stage, glslang::EShClientVulkan, 110);
  text.setEnvClient(glslang::EShClientVulkan, glslang::EShTargetVulkan_1_1);
  text.setEnvTarget(glslang::EShTargetSpv, glslang::EShTargetSpv_1_3);
  const auto rules = static_cast<EShMessages>(EShMsgSpvRules | EShMsgVulkanRules);
  if (!text.parse(GetDefaultResources(), 450, false, rules)) return std::string(text.getInfoLog());
  glslang::TProgram program;
  program.addShader(&text);
  if (!program.link(rules)) return std::string(program.getInfoLog());
  std::vector<uint32_t> module;
  glslang::SpvOptions options;
  options.disableOptimizer = true;
  glslang::GlslangToSpv(*program.getIntermediate(stage), module, &options);
  spare.done();
  return module;
}

std::variant<std::vector<uint32_t>, std::string> assemble(const GlslShader& shader, AssembleTimes& times) {
  Watch watch;
  auto translated = translate(shader);
  if (std::holds_alternative<std::string>(translated)) return translated;
  std::vector<uint32_t> module = std::get<std::vector<uint32_t>>(std::move(translated));
  module = decorate_no_contraction(module, shader.native);
  watch.lap(times.glslang);

  std::string problems;
  const spvtools::MessageConsumer note = [&](spv_message_level_t level, const char*, const spv_position_t&,
                                             const char* message) {
    if (level <= SPV_MSG_ERROR) problems += std::string(message) + "\n";
  };
  // Drivers optimize. What is done here makes modules smaller and takes linear time: calls and variables go.
  // SPIRV-Tools' passes for it take quadratic time, and so does SwiftShader where it is left to do it.
  std::optional<spirv::Module> parsed = spirv::parse(module, problems);
  if (!parsed) return "glslang's words are no module: " + problems;
  spirv::inline_calls(*parsed);
  spirv::remove_variables(*parsed);
  module = spirv::write(*parsed);
  watch.lap(times.inlining);

  spvtools::SpirvTools tools(SPV_ENV_VULKAN_1_1);
  tools.SetMessageConsumer(note);
  spvtools::ValidatorOptions numbers;
  numbers.SetFriendlyNames(false);  // to make names takes quadratic time where many ids have the same one
  const bool valid = tools.Validate(module.data(), module.size(), numbers);
  watch.lap(times.validation);
  if (!valid) return "invalid SPIR-V: " + problems;
  return module;
}

}  // namespace

std::variant<std::vector<uint32_t>, std::string> assemble(const GlslShader& shader, const ShaderCache& cache,
                                                          AssembleTimes* times) {
  AssembleTimes none;
  AssembleTimes& to = times ? *times : none;
  Watch watch;
  // Whatever else the words depend on: this file, and the libraries.
  const glslang::Version version = glslang::GetVersion();
  static const std::string kTools = DR_SPIRV_SOURCE_HASH " " + std::to_string(version.major) + "." +
                                    std::to_string(version.minor) + "." + std::to_string(version.patch) + " " +
                                    spvSoftwareVersionDetailsString() + "\n";
  const std::string key =
      kTools + bundle::EnumNameStage(shader.stage) + (shader.native ? " native\n" : "\n") + shader.source;
  auto found = cache.find(key);
  watch.lap(to.cache);
  if (found) return *std::move(found);
  auto result = assemble(shader, to);
  watch = {};
  if (const auto* words = std::get_if<std::vector<uint32_t>>(&result)) cache.store(key, *words);
  watch.lap(to.cache);
  return result;
}

}  // namespace dr::backend
