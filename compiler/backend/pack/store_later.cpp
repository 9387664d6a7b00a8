// SPDX-License-Identifier: Apache-2.0
// Values that a pass stores because later ones read them, though a pass in between computes them again, are stored by
// that one, if this leaves the first less to compute:
//   a stores p for c, b computes p again for itself    =>    b stores p
// Where b lists the elements that c runs for, p is then stored for those alone.
#include <climits>
#include <tuple>

#include "compiler/backend/pack/step_packer.h"

namespace dr::backend {

namespace {

// A pass looks at so many others of its kind behind it, which keeps packing near linear.
constexpr size_t kReach = 64;

}  // namespace

void StepPacker::store_later() {
  std::map<ValueId, size_t> first_reader;
  for (size_t k = out_.passes.size(); k-- > 0;)
    for (const ValueId v : out_.passes[k].reads) first_reader[v] = k;
  std::map<std::tuple<Extent, bool, bool>, std::vector<size_t>> alike;
  for (size_t k = 0; k < out_.passes.size(); ++k) {
    const Pass& pass = out_.passes[k];
    if (pass.kind() == PassKind::Map) alike[{pass.domain, pass.is_drawn(), pass.steady}].push_back(k);
  }
  for (const auto& [key, members] : alike)
    for (size_t i = 0; i < members.size(); ++i)
      for (size_t j = i + 1; j < std::min(members.size(), i + kReach); ++j) {
        std::vector<ValueId> read_behind;
        for (const ValueId v : out_.passes[members[i]].writes)
          if (const auto reader = first_reader.find(v); reader != first_reader.end() && reader->second > members[j])
            read_behind.push_back(v);
        store_later(out_.passes[members[i]], out_.passes[members[j]], read_behind);
      }
}

void StepPacker::store_later(Pass& early, Pass& late, const std::vector<ValueId>& read_behind) {
  std::vector<ValueId> left, later;
  for (const ValueId v : early.writes) {
    const bool computed = std::ranges::find(late.ops, graph_.value(v).op) != late.ops.end();
    (computed && std::ranges::find(read_behind, v) != read_behind.end() ? later : left).push_back(v);
  }
  if (later.empty() || left.empty()) return;
  Pass more = late;
  more.writes.insert(more.writes.end(), later.begin(), later.end());
  if (!within_limits(more)) return;
  std::sort(more.writes.begin(), more.writes.end());
  Pass less = early;
  set_group(early.ops);
  int level = INT_MAX;
  for (const ValueId v : left) level = std::min(level, level_[graph_.value(v).op.index]);
  close_over(less, left, level);
  if (less.ops.size() >= early.ops.size() || !std::ranges::includes(early.reads, less.reads)) return;
  less.name = pass_name(less);
  more.name = pass_name(more);
  early = std::move(less);
  late = std::move(more);
}

}  // namespace dr::backend
