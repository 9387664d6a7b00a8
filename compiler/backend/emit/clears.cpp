// SPDX-License-Identifier: Apache-2.0
// What a step clears, cleared by one dispatch, and what it copies, copied by one. A GPU's driver makes a kernel of its
// own of each fill or copy, between which and the dispatches around it the device does nothing; a dispatch runs beside
// the ones before it, for which it need not wait. Large memory stays the driver's to fill and to copy, which is faster
// then.
#include <algorithm>
#include <set>
#include <utility>

#include "compiler/backend/bundle/levels.h"
#include "compiler/backend/emit/generator.h"
#include "compiler/backend/plan/dependencies.h"
#include "compiler/ir/graph.h"

namespace dr::backend {

using bundle::CommandKind;
using bundle::CommandT;
using glsl::Shader;
using ir::Dim;

namespace {

// An invocation clears so many words: starting a workgroup takes a GPU longer than some stores do.
constexpr int64_t kWordsEach = 16, kCopiedEach = 4;
// Of what is seldom cleared.
constexpr int64_t kSeldomEach = 256;
// A command's name goes on until it is so long.
constexpr size_t kMostNamed = 2000;
// The most words of a target, when all symbols are as large as the side of a picture.
constexpr int64_t kMostWords = 1 << 23;
constexpr int64_t kSide = 1024;

Dim parsed(const std::string& extent) {
  const auto dim = Dim::parse(extent);
  if (!dim) DR_ICE("the extent '" + extent + "' of a bundle does not parse");
  return *dim;
}

// The words that a fill or copy writes.
Dim words_written(const bundle::BundleT& bundle, const CommandT& command) {
  if (!command.elements.empty()) return parsed(command.elements);
  const bundle::ResourceT& r = *bundle.resources[static_cast<size_t>(command.target)];
  const Dim elements = parsed(r.extent->w) * parsed(r.extent->h) * parsed(r.extent->l);
  return is_words(r) ? elements : elements * Dim(r.type->rows * r.type->cols);
}

bool is_small(const bundle::BundleT& bundle, const CommandT& command) {
  ir::SymbolValues sides;
  for (const std::string& symbol : bundle.symbols) sides[symbol] = kSide;
  const auto words = words_written(bundle, command).evaluate(sides);
  return words && *words <= kMostWords;
}

bool clears_epochs(const bundle::BundleT& bundle, const CommandT& fill) {
  return bundle.resources[static_cast<size_t>(fill.target)]->role == bundle::Role::EpochEntries;
}

bool is_small_fill(const bundle::BundleT& bundle, const CommandT& command) {
  if (command.kind != CommandKind::Fill) return false;
  return clears_epochs(bundle, command) || is_small(bundle, command);
}

bool is_small_copy(const bundle::BundleT& bundle, const CommandT& command) {
  const auto is_buffer = [&](int r) {
    return bundle.resources[static_cast<size_t>(r)]->storage == bundle::Storage::Buffer;
  };
  return command.kind == CommandKind::Copy && is_buffer(command.source) && is_buffer(command.target) &&
         is_small(bundle, command);
}

// By resource, whether a step touches it among its last commands, those that no longer chain of waits ends behind. The
// fill of such a resource waits for the whole run before; the others run beside the end of that.
std::vector<bool> touched_last(const bundle::BundleT& bundle, const bundle::StepT& step) {
  bundle::Levels levels;
  size_t end = 0;
  for (const auto& c : step.commands) {
    std::vector<bundle::Levels::Touch> touches;
    for_each_access(*c, [&](uint32_t r, bundle::Access access) {
      touches.push_back({r, access != bundle::Access::Read});
    });
    end = std::max(end, levels.add(touches) + 1);
  }
  std::vector<bool> out;
  for (uint32_t r = 0; r < bundle.resources.size(); ++r) out.push_back(levels.behind(r) == end);
  return out;
}

// The small fills that may take the place of the one at `first`, itself among them: those that run whenever it does,
// whose targets nothing touches before they are filled, and that wait for the run before alike.
std::vector<size_t> fills_with(const bundle::BundleT& bundle, const bundle::StepT& step, const std::vector<bool>& last,
                               size_t first, size_t most) {
  const auto waits = [&](size_t k) { return last[static_cast<size_t>(step.commands[k]->target)]; };
  std::vector<size_t> out;
  std::set<uint32_t> touched;
  for (size_t k = first; k < step.commands.size() && out.size() < most; ++k) {
    const CommandT& c = *step.commands[k];
    const bool joins = is_small_fill(bundle, c) && run_together(c, *step.commands[first]) && waits(k) == waits(first) &&
                       touched.count(static_cast<uint32_t>(c.target)) == 0;
    if (joins) out.push_back(k);
    for_each_access(c, [&](uint32_t resource, bundle::Access) { touched.insert(resource); });
  }
  return out;
}

}  // namespace

void Generator::clear_together() {
  if (schedule_.code.clears == 0) return;
  for (size_t k = 0; k < schedule_.steps.size(); ++k) {
    step_ = &schedule_.steps[k];
    out_ = bundle_->steps[k].get();
    const std::vector<bool> last = touched_last(*bundle_, *out_);
    for (size_t at = 0; at < out_->commands.size(); ++at) {
      if (is_small_copy(*bundle_, *out_->commands[at])) copy_by_dispatch(*out_->commands[at]);
      if (!is_small_fill(*bundle_, *out_->commands[at])) continue;
      const std::vector<size_t> fills = fills_with(*bundle_, *out_, last, at, schedule_.code.clears);
      clear_by_dispatch(fills);
    }
  }
}

void Generator::copy_by_dispatch(CommandT& copy) {
  const Dim words = words_written(*bundle_, copy);
  const Dim invocations = (words + Dim(kCopiedEach - 1)).divided_by(kCopiedEach);
  const std::string stride = glsl::dim_expression(invocations);
  Shader s = strict_shader();
  linear_index(s, stride);
  const std::string from = s.read_words(static_cast<uint32_t>(copy.source), "source"),
                    to = s.bind_words(static_cast<uint32_t>(copy.target), "target", bundle::Access::Write);
  s.body().line("for (int i = index; i < " + glsl::dim_expression(words) + "; i += " + stride + ") " + to +
                ".d[i] = " + from + "(i);");
  copy.kind = CommandKind::Dispatch;
  copy.source = copy.target = -1;
  copy.elements = invocations.str();
  copy.count = (words + words).str();
  copy.push = {0, 0, 0};
  copy.compute = add_shader("copy", bundle::Stage::Compute, s);
  copy.bindings = s.take_bindings();
}

void Generator::clear_by_dispatch(const std::vector<size_t>& fills) {
  const auto clear = std::make_unique<CommandT>(*out_->commands[fills.front()]);
  Dim invocations = 0, all = 0;  // the words of all targets together may be too many for an int
  for (const size_t k : fills) {
    const Dim words = words_written(*bundle_, *out_->commands[k]);
    const bool epochs = clears_epochs(*bundle_, *out_->commands[k]);
    const int64_t each = epochs ? kSeldomEach : kWordsEach;
    invocations = invocations + (words + Dim(each - 1)).divided_by(each);
    all = all + (epochs ? (words + Dim(bundle::kEpochs - 1)).divided_by(bundle::kEpochs) : words);
  }
  const std::string stride = glsl::dim_expression(invocations);
  Shader s = strict_shader();
  linear_index(s, stride);
  clear->label = "clear";
  size_t named = 0;
  std::set<std::pair<uint32_t, uint32_t>> lines;
  for (size_t k = 0; k < fills.size(); ++k) {
    const CommandT& fill = *out_->commands[fills[k]];
    const std::string words = glsl::dim_expression(words_written(*bundle_, fill));
    const bool epochs = clears_epochs(*bundle_, fill);
    const std::string name = s.bind_words(static_cast<uint32_t>(fill.target), "cleared_" + std::to_string(k),
                                          epochs ? bundle::Access::ReadWrite : bundle::Access::Write),
                      loop = "for (int i = index; i < " + words + "; i += " + stride + ") " + name +
                             ".d[i] = " + std::to_string(fill.value) + "u;";
    if (epochs) {
      // See lowering/clear_by_epochs.h; elements are of two words.
      const std::string epoch = name + ".d[" + words + "]", next = "next_" + std::to_string(k);
      s.body().line("uint " + next + " = " + name + ".d[" + words + " + 2];");
      s.body().line("if (index == 0) " + epoch + " = " + next + " == 0u ? " + std::to_string(bundle::kEpochs) +
                    "u : " + next + ";");
      s.body().line("if (" + next + " == 0u) " + loop);
    } else {
      s.body().line(loop);
    }
    if (clear->label.size() < kMostNamed) {
      clear->label += (k == 0 ? "" : ",") + fill.label.substr(std::string("clear").size());
      ++named;
    }
    for (const bundle::Line& line : fill.lines) lines.emplace(line.file(), line.line());
  }
  if (named < fills.size()) clear->label += " and " + std::to_string(fills.size() - named) + " more";
  clear->kind = CommandKind::Dispatch;
  clear->target = -1;
  clear->value = 0;
  clear->elements = invocations.str();
  clear->count = all.str();
  clear->push = {0, 0, 0};
  clear->compute = add_shader("clear", bundle::Stage::Compute, s);
  clear->bindings = s.take_bindings();
  clear->lines.clear();
  for (const auto& [file, line] : lines) clear->lines.emplace_back(file, line);
  *out_->commands[fills.front()] = *clear;
  for (size_t k = fills.size(); k-- > 1;)
    out_->commands.erase(out_->commands.begin() + static_cast<std::ptrdiff_t>(fills[k]));
}

}  // namespace dr::backend
