// SPDX-License-Identifier: Apache-2.0
// Lists of the faces whose boxes are not small, and the teams of invocations that walk them. Private to
// raster_compute.cpp.
#pragma once

#include <algorithm>
#include <array>
#include <string>

#include "compiler/backend/analysis/raster_parts.h"
#include "compiler/backend/emit/generator.h"

namespace dr::backend {

// Faces stand on one of two lists, by the pixels of their boxes: teams of a subgroup walk those of the middle list,
// teams of a thousand invocations the large ones. Where a device lets an invocation take so many trips only
// (Code::loop_trips), a dispatch has as many rows of workgroups as the lists need, and several teams share a face if
// one could not walk it: usual pictures need one row, and one team.
class FaceLists {
 public:
  FaceLists(const std::optional<FaceBins>& bins, uint32_t loop_trips, const RasterParts& parts, const WalkTrips& trips);

  bool used() const { return used_; }
  // Of a team that walks a face of the first list.
  int lanes() const { return std::max(bins_.team, 1); }
  // Whether boxes of up to `small_box` pixels are walked by the invocation that finds them.
  bool walks_alone() const { return bins_.small_box > 0; }
  // Whether there are more faces than pixels, so that boxes have one or two: known before a driver compiles the shader.
  std::string tiny() const;
  std::string small_box() const;
  // Whether the numbers of workgroups stand in the first words.
  bool bounded() const { return limit_ > 0; }
  ir::Dim words() const { return faces_ * ir::Dim(2) + ir::Dim(head()); }
  ir::Dim invocations() const { return ir::Dim(row()); }
  // Of the first words, which are cleared before.
  int cleared() const { return head(); }

  // Whether a box of `area` pixels belongs to a face of the second list.
  std::string is_large() const;
  // A statement that puts the face and layer `index` on a list.
  std::string append(glsl::Shader& s, const std::string& list, const std::string& large,
                     const std::string& index) const;
  // Behind, `item` goes over what `entry_index` of the list the team takes; of a face it takes the pixels `lane`,
  // `lane` + `lanes`, ...
  void open_items(glsl::Shader& s, const std::string& list) const;
  // a / b, for lanes and the width of a box.
  static std::string quotient(const std::string& a, const std::string& b);

 private:
  struct List {
    int team, invocations;  // of a team; of all its teams in the first row
    ir::Dim area;           // of a box, at most
  };
  int head() const { return bounded() ? 5 : 2; }
  int row() const { return lists_[0].invocations + lists_[1].invocations; }
  std::string count(size_t k) const { return std::to_string(head() - 2 + static_cast<int>(k)); }
  void declare_teams(glsl::Shader& s) const;

  const RasterParts& parts_;
  ir::Dim faces_;  // of all layers
  WalkTrips trips_;
  int64_t limit_ = 0;
  bool used_ = false;
  FaceBins bins_;
  std::array<List, 2> lists_;
};

}  // namespace dr::backend
