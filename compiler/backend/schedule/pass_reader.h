// SPDX-License-Identifier: Apache-2.0
// Reads passes, and the values, ops and leaves that lines name. Private to parse.cpp.
#pragma once

#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <unordered_map>
#include <vector>

#include "compiler/backend/schedule/schedule.h"
#include "compiler/ir/text_reader.h"

namespace dr::backend {

class PassReader : protected ir::TextReader {
 protected:
  PassReader(std::string_view text, uint32_t line, const ir::NumberedGraph& graph)
      : TextReader(text, line), graph_(graph.graph), values_(graph.values) {}

  // %7
  bool use(ir::ValueId& out);
  // %7, normal, or position%40
  bool value(ir::ValueId& out);
  bool values(std::vector<ir::ValueId>& out);
  // add %5
  bool op(ir::OpId& out);
  bool leaf_name(uint32_t& out);
  // A pass, behind that word; it becomes the last of its step.
  bool pass(uint32_t stage);

  const ir::Graph& graph_;
  const std::unordered_map<uint64_t, ir::ValueId>& values_;
  Schedule schedule_;
  std::map<std::string, uint32_t, std::less<>> resources_;
  StepSchedule* step_ = nullptr;
  std::map<uint32_t, std::vector<ir::ValueId>> held_;  // values in a resource, in this step

 private:
  // An earlier pass of the step.
  bool pass_name(PassId& out);
  bool kind(Pass& pass);
  bool lowering(ScatterPass& scatter);

  bool ends_pass();
  // One line about a pass, if there is one that passes of its kind may have.
  bool decision(Pass& pass, bool& is_one);

  // Whether the line is one about what such passes have, and, in `ok`, as it should be.
  bool decides(FragmentPass&, bool&) { return false; }
  bool decides(ReducePass& reduce, bool& ok);
  bool decides(DrawnRasterPass&, bool&) { return false; }
  bool decides(MapPass& map, bool& ok);
  bool decides(RasterPass& raster, bool& ok);
  bool decides(ScatterPass& scatter, bool& ok);
  bool decides(ScatterPass& scatter, ExactScatter& exact, bool& ok);
  bool decides(ScatterPass& scatter, AtomicScatter& atomic, bool& ok);
  bool decides(ScatterPass& scatter, BinnedScatter& binned, bool& ok);
  bool decides(ScatterPass&, RowsScatter& rows, bool& ok);

  // Which elements run, and who lists them. `own`: the scatter's run, unless it is joined.
  bool runs(ScatterPass& scatter, OwnRun* own, bool& ok);

  // 4 4 1
  bool numbers(const char* what, std::array<int, 3>& out);
  // loops 8000, watched
  bool cut(std::optional<LoopCut>& out);
  bool watched(bool& out);
  // alone, or: of 64 alone, of 4096 by 8 in 8192, others in 4096
  bool walk(FaceWalk& out);
  // a and b, or c
  bool clauses(Clauses& out);
  bool table(RowsScatter& out);

  // %12 adds %13 in if %40 branch 0 of the table, if %41 branch 1
  bool place(ScatterLeaf& out);
};

}  // namespace dr::backend
