// SPDX-License-Identifier: Apache-2.0
// What draws and compute shaders of a raster share: its operands by their part, and its closures in GLSL. Private to
// raster_*.cpp.
#pragma once

#include <algorithm>
#include <initializer_list>
#include <span>
#include <string>
#include <vector>

#include "compiler/backend/analysis/raster_parts.h"
#include "compiler/backend/emit/generator.h"

namespace dr::backend {

inline constexpr const char* kIsNan = R"(
bool dr_no_number(float x) { return (floatBitsToUint(x) & 0x7fffffffu) > 0x7f800000u; }
bool dr_no_number(vec2 x) { return dr_no_number(x.x) || dr_no_number(x.y); }
)";

// Emits what the closures share, for the element at `at` and the face `face`.
class RasterClosures {
 public:
  RasterClosures(glsl::Shader& shader, const ir::Graph& graph, const Pass& pass, const ir::Op& op)
      : shader_(shader), graph_(graph), pass_(pass), op_(op), parts_(raster_parts(op)) {}

  // From here on, what this shader has computed of its face is not loaded.
  void set_up() { set_up_ = true; }
  // A value of the record; `place` names the face and layer.
  std::string record(ir::ValueId value, const std::string& place) {
    const ir::Op& def = graph_.op(graph_.value(value).op);
    if (def.kind == ir::OpKind::Const) return glsl::literal(graph_.value(value).type, def.attrs.floats);
    return set_up_ && shader_.is_defined(value) ? shader_.use(value) : shader_.load(value, place);
  }
  // Loads the fields once, those that some of these closures are made of.
  void load_fields(const std::string& place, std::initializer_list<RasterRegion> closures) {
    for (size_t k = 0; k < parts_.fields.size(); ++k) {
      const auto uses = [&](RasterRegion which) { return uses_field(graph_, op_, which, k); };
      if (std::ranges::none_of(closures, uses)) {
        fields_.emplace_back();
        continue;
      }
      const std::string name = shader_.unique("field");
      shader_.body().line(graph_.value(parts_.fields[k]).type.str() + " " + name + " = " +
                          record(parts_.fields[k], place) + ";");
      fields_.push_back(name);
    }
  }
  // What the closures capture and is recomputed here.
  void captured() { shader_.element_ops({pass_.ops.begin(), pass_.ops.end() - 1}); }
  std::string closure(RasterRegion which) {
    define_parameters(which);
    return shader_.region(op_.regions[which])[0];
  }
  // From here to end_of_candidates() the closures share what they compute; with `ahead` what is one value for a face is
  // computed here, not for each candidate.
  void begin_candidates(bool ahead) {
    const std::span regions = std::span(op_.regions).subspan(kDepth, 3);
    shader_.begin_sharing({pass_.ops.begin(), pass_.ops.end() - 1}, regions);
    if (!ahead) return;
    for (const RasterRegion which : {kDepth, kKeep, kTag}) define_fields(which);
    shader_.compute_ahead(regions);
  }
  // A candidate that the face does not keep is left by the statement `otherwise`. `holds`: a condition that does.
  void leave_unless_kept(const std::string& otherwise, std::optional<ir::ValueId> holds = {}) {
    define_parameters(kKeep);
    shader_.leave_unless(op_.regions[kKeep], otherwise, holds);
  }
  void end_of_candidates() { shader_.end_sharing(); }
  // A candidate without a depth is left by the statement `otherwise`.
  void key_from_depth(const std::string& otherwise) {
    const std::string depth = closure(kDepth);
    shader_.body().line("uint key = uint(floor(clamp(" + depth + ", 0.0, 1.0) * 16777215.0));");
    if (has_depth_always(graph_, op_)) return;
    shader_.body().line("bool no_depth = dr_no_number(" + depth + ");");
    shader_.body().line("if (no_depth) " + otherwise + ";");
  }

 private:
  void define_fields(RasterRegion which) {
    const ir::Region& region = graph_.region(op_.regions[which]);
    for (size_t k = 0; k < fields_.size(); ++k)
      if (!fields_[k].empty()) shader_.define(region.params[k], fields_[k]);
  }
  void define_parameters(RasterRegion which) {
    define_fields(which);
    shader_.define(graph_.region(op_.regions[which]).params[fields_.size()], "p");
  }

  glsl::Shader& shader_;
  const ir::Graph& graph_;
  const Pass& pass_;
  const ir::Op& op_;
  RasterParts parts_;
  std::vector<std::string> fields_;
  bool set_up_ = false;
};

}  // namespace dr::backend
