// SPDX-License-Identifier: Apache-2.0
// Shaders whose loops a dispatch may not take to their end: what the command says of it, and the code around an
// element's. A shader is the same for all extents; whether it is cut, and into how many dispatches, is known when
// symbols have values.
#include "compiler/backend/emit/generator.h"

namespace dr::backend {

using glsl::Shader;

Generator::Cut Generator::cut(Shader& s, const Pass& pass, const std::optional<LoopCut>& how,
                              const std::string& element, int each, const ir::Extent* domain) {
  Cut cut;
  if (!how) return cut;
  cut.how = how;
  cut.trips = (trips_of(graph_, pass.ops).most + ir::Dim(each > 1 ? 2 : 0)) * ir::Dim(each);
  cut.element = element;
  s.cut_loops();
  const std::string number = std::to_string(bundle_->resources.size());  // a pass may have several such shaders
  // The words of an element are known when its code is.
  cut.state = add_scratch(pass.name + "_loops_" + number, "1");
  bundle_->resources[cut.state]->room = (cut.trips - ir::Dim(schedule_.code.loop_trips)).str();
  bundle_->resources[cut.state]->extent->w = element_count(domain == nullptr ? pass.domain : *domain).str();
  cut.left = add_scratch(pass.name + "_left_" + number, "8");
  bundle_->resources[cut.left]->room = bundle_->resources[cut.state]->room;
  if (cut.how->watched) cut.watch = add_watch(pass.name + "_unfinished_" + number);
  return cut;
}

void Generator::open_cut(Shader& s, const Cut& cut, const std::string& skip) {
  if (cut.how) s.body().line("if (part_trips != 0 && !resume_loops(" + cut.element + ")) " + skip);
}

void Generator::close_cut(Shader& s, const Cut& cut) {
  if (!cut.how) return;
  bundle::ResourceT& state = *bundle_->resources[cut.state];
  const auto elements = ir::Dim::parse(state.extent->w);
  state.extent->w = (*elements * ir::Dim(s.cut_loops().words())).str();
  s.cut_loops().set_state(s.bind_words(cut.state, "loops", bundle::Access::ReadWrite));
  s.body().line("if (part_trips != 0) keep_loops(" + cut.element + ");");
  // All that stop say the same.
  const std::string left = s.bind_words(cut.left, "left_groups", bundle::Access::ReadWrite);
  s.body().line("if (part_trips != 0 && paused && pc.layer > 0) {");
  s.body().line("int next_part = (pc.layer + 1) % 2 * 4;");
  for (const char* const k : {"0", "1", "2"})
    s.body().line(left + ".d[next_part + " + k + "] = gl_NumWorkGroups[" + k + "];");
  s.body().line("}");
  if (cut.how->watched) {
    const std::string word = s.bind_words(cut.watch, "unfinished_loops", bundle::Access::ReadWrite);
    s.body().line("if (unfinished || (pc.layer < 0 && paused)) " + word + ".d[0] = 1u;");
  }
  s.body().line("if (!paused) {");
  s.push_scope();
}

void Generator::end_cut(Shader& s, const Cut& cut) {
  if (!cut.how) return;
  s.pop_scope();
  s.body().line("}");
}

void Generator::set_trips(bundle::CommandT& command, const Cut& cut) const {
  if (!cut.how) return;
  command.trips = cut.trips.str();
  command.most_trips = schedule_.code.loop_trips;
  command.part_trips = cut.how->part;
  command.left = static_cast<int>(cut.left);
  if (cut.how->watched) command.watch = static_cast<int>(cut.watch);
}

}  // namespace dr::backend
