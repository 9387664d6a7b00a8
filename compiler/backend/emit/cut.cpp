// SPDX-License-Identifier: Apache-2.0
// Shaders whose loops a dispatch may not take to their end: what the command says of it, and the code around an
// element's. A shader is the same for all extents; whether it is cut, and into how many dispatches, is known when
// symbols have values.
#include <algorithm>

#include "compiler/backend/emit/generator.h"

namespace dr::backend {

using glsl::Shader;

namespace {

// The trips of our own that a dispatch needs to come to where it goes on: each loop is entered and left once more for
// every element.
int64_t overhead(const Trips& trips, int each) { return 64 + int64_t{each} * (3 * trips.loops + 2); }

}  // namespace

Generator::Cut Generator::cut(Shader& s, const Pass& pass, const Trips& trips, const std::string& element, int each,
                              const ir::Extent* domain) {
  Cut cut;
  const bool long_ones = may_pass_limit(trips, profile_, each), unknown = trips.unknown > 0 && profile_.loop_trips > 0;
  if (!long_ones && !unknown) return cut;
  cut.most = profile_.loop_trips;
  cut.trips = (trips.most + ir::Dim(each > 1 ? 2 : 0)) * ir::Dim(each);
  cut.cuts = true;
  // Where data decides, the shader tells whether a loop did not come to its end.
  cut.watched = unknown || trips.promised > 0;
  cut.element = element;
  // Lanes that go different ways take their trips one after the other, as the driver counts.
  const int64_t lanes = trips.even ? 1 : std::max<int64_t>(profile_.subgroup_size, 1);
  cut.part = static_cast<uint32_t>(std::max<int64_t>(int64_t{cut.most} / lanes - overhead(trips, each), 1));
  s.cut_loops();
  const std::string number = std::to_string(bundle_->resources.size());  // a pass may have several such shaders
  // The words of an element are known when its code is.
  cut.state = add_scratch(pass.name + "_loops_" + number, "1");
  bundle_->resources[cut.state]->room = (cut.trips - ir::Dim(cut.most)).str();
  bundle_->resources[cut.state]->extent->w = element_count(domain == nullptr ? pass.domain : *domain).str();
  if (cut.watched) {
    cut.watch = add_scratch(pass.name + "_unfinished_" + number, "1");
    bundle_->resources[cut.watch]->role = bundle::Role::Watch;
  }
  return cut;
}

void Generator::open_cut(Shader& s, const Cut& cut, const std::string& skip) {
  if (cut.cuts) s.body().line("if (part_trips != 0 && !resume_loops(" + cut.element + ")) " + skip);
}

void Generator::close_cut(Shader& s, const Cut& cut) {
  if (!cut.cuts) return;
  bundle::ResourceT& state = *bundle_->resources[cut.state];
  const auto elements = ir::Dim::parse(state.extent->w);
  state.extent->w = (*elements * ir::Dim(s.cut_loops().words())).str();
  s.cut_loops().set_state(s.bind_words(cut.state, "loops", bundle::Access::ReadWrite));
  s.body().line("if (part_trips != 0) keep_loops(" + cut.element + ");");
  if (cut.watched) {
    const std::string word = s.bind_words(cut.watch, "unfinished_loops", bundle::Access::ReadWrite);
    s.body().line("if (unfinished || (pc.layer == 3 && paused)) " + word + ".d[0] = 1u;");
  }
  s.body().line("if (!paused) {");
  s.push_scope();
}

void Generator::end_cut(Shader& s, const Cut& cut) {
  if (!cut.cuts) return;
  s.pop_scope();
  s.body().line("}");
}

void Generator::set_trips(bundle::CommandT& command, const Cut& cut) {
  if (cut.most == 0) return;
  command.trips = cut.trips.str();
  command.most_trips = cut.most;
  command.part_trips = cut.part;
  if (cut.watched) command.watch = static_cast<int>(cut.watch);
}

}  // namespace dr::backend
