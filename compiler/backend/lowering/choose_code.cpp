// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/lowering/choose_code.h"

#include <algorithm>
#include <bit>

#include "compiler/backend/analysis/divisors.h"
#include "compiler/backend/analysis/raster_parts.h"
#include "compiler/backend/lowering/heavy_branches.h"
#include "compiler/backend/schedule/limits.h"
#include "compiler/backend/schedule/trips.h"

namespace dr::backend {

using ir::Dim;
using ir::Graph;
using ir::OpKind;
using ir::ValueId;

namespace {

// Lanes of a subgroup from which on a device is a GPU.
constexpr uint32_t kWideSubgroup = 16;

struct Bins {
  // Faces by the pixels of their boxes: up to the first for one invocation, up to the second for subgroups.
  int small_box, middle_box;
  // Invocations that share the faces of a list.
  int middle_invocations, large_invocations;
};
constexpr Bins kCpu{64, 4096, 1 << 13, 1 << 12};
// A raster that keeps so many faces of a pixel lists what few faces have, as outlines are. On a CPU, whose lanes take
// each other's branches, a lane that walks its box alone makes all lanes beside it go over that; a team walks the few
// that are left.
constexpr int64_t kManyKept = 12;

// Those of a GPU, which starts few workgroups faster than many, and has work for more in large pictures.
Bins gpu_bins(const Dim& pixels) {
  constexpr int64_t kLeast = 1 << 15, kUnknown = 1 << 17, kMost = 1 << 19;
  const auto count = pixels.evaluate({});
  const int64_t invocations = count ? std::clamp(*count / 4, kLeast, kMost) : kUnknown;
  const auto middle = static_cast<int>(std::bit_floor(static_cast<uint64_t>(invocations)));
  return {8, 4096, middle, middle / 2};
}

// The trips of our own that a dispatch needs to come to where it goes on: each loop is entered and left once more for
// every element.
int64_t overhead(const Trips& trips, int each) { return 64 + int64_t{each} * (3 * trips.loops + 2); }

class StepCode {
 public:
  StepCode(const Graph& graph, const target::Profile& profile, const CodeOptions& options, Schedule& schedule,
           StepSchedule& step)
      : graph_(graph), profile_(profile), options_(options), schedule_(schedule), step_(step) {}

  void process() {
    for (size_t place = 0; place < step_.passes.size(); ++place) {
      Pass& pass = step_.passes[place];
      pass.code = {};
      switch (pass.kind) {
        case Pass::Kind::Map:
          if (!pass.hardware) map(pass, static_cast<int>(place));
          break;
        case Pass::Kind::Reduce: break;
        case Pass::Kind::Scatter: scatter(pass); break;
        case Pass::Kind::Raster:
          if (!pass.hardware) raster(pass);
          break;
      }
    }
  }

 private:
  // Elements that an invocation of a shader with a list takes, one after the other.
  static int each(const Pass& pass) { return pass.code.lists_in_runs ? kListedRun : 1; }

  void map(Pass& pass, int place) {
    PassCode& code = pass.code;
    const bool sets_up = std::ranges::any_of(step_.passes, [&](const Pass& p) { return p.set_up_by == place; });
    if (!sets_up) {
      const Trips trips = trips_of(graph_, pass.ops);
      if (options_.list_branches && pass.block.elements() == 1)
        code.heavy = heavy_branches(graph_, pass, trips, profile_);
      const bool lists = std::ranges::any_of(step_.passes, [&](const Pass& p) { return p.listed_by == place; });
      code.lists_in_runs = profile_.lanes_in_turn && (lists || !code.heavy.empty());
      code.cut = cut(code.heavy.empty() ? trips : light_trips(pass), each(pass));
      if (!code.heavy.empty()) {
        code.heavy_cut = cut(trips, 1);
        code.heavy_by_subgroups = profile_.subgroup_arithmetic && !profile_.lanes_in_turn;
        code.heavy_apart = profile_.lanes_in_turn ? 0 : profile_.subgroup_size;
      }
    }
    code.told = told(pass);
  }

  // What loops of the first dispatch take, which leaves the heavy branches out.
  Trips light_trips(const Pass& pass) const {
    Trips all;
    for (const ir::OpId id : pass.ops) {
      const bool left_out = std::ranges::find(pass.code.heavy, id) != pass.code.heavy.end();
      all += left_out ? trips_of(graph_, graph_.region(graph_.op(id).regions[1]).ops) : trips_of(graph_, {&id, 1});
    }
    return all;
  }

  LoopCut cut(const Trips& trips, int each) const {
    const bool long_ones = may_pass_limit(trips, profile_, each),
               unknown = trips.unknown > 0 && profile_.loop_trips > 0;
    if (!long_ones && !unknown) return {};
    // Lanes that go different ways take their trips one after the other, as the driver counts.
    const int64_t lanes = trips.even ? 1 : std::max<int64_t>(profile_.subgroup_size, 1);
    const int64_t part = int64_t{profile_.loop_trips} / lanes - overhead(trips, each);
    // Where data decides, the shader tells whether a loop did not come to its end.
    return {static_cast<uint32_t>(std::max<int64_t>(part, 1)), unknown || trips.promised > 0};
  }

  // Floats that the step leaves in a leaf, or in an output of one element, where the device has a buffer left for the
  // word that tells of them.
  std::vector<ValueId> told(const Pass& pass) const {
    const auto stays = [&](ValueId v) {
      const auto is_it = [&](const auto& named) { return named.second == v; };
      return std::ranges::any_of(step_.updates, is_it) ||
             (resource(v).extent.is_unit() && std::ranges::any_of(step_.outputs, is_it));
    };
    const auto is_partial = [&](ValueId v) { return std::ranges::find(pass.partial, v) != pass.partial.end(); };
    std::vector<ValueId> out, bound = pass.reads;
    for (const ValueId v : pass.writes) {
      if (!is_partial(v)) bound.push_back(v);
      if (resource(v).type.is_float() && !resource(v).half && stays(v) && !is_partial(v)) out.push_back(v);
    }
    const LoopCut& cut = pass.code.heavy_cut.cuts() ? pass.code.heavy_cut : pass.code.cut;
    const Bindings all = bindings_of(schedule_.resources, resources_of(step_, bound), 0);
    const uint32_t have =
        all.buffers + all.images + (cut.cuts() ? 1 : 0) + (cut.watched ? 1 : 0) + (pass.code.heavy.empty() ? 0 : 1);
    if (have + 1 > profile_.max_per_stage_descriptor_storage_buffers || have + 1 > profile_.max_per_stage_resources)
      out.clear();
    return out;
  }

  void scatter(Pass& pass) {
    pass.code.skips_zeros =
        pass.scatter == ScatterLowering::Atomic && !profile_.lanes_in_turn &&
        std::ranges::any_of(pass.sums, [&](const ScatterSum& sum) { return graph_.value(sum.value).type.is_float(); });
    if (pass.scatter == ScatterLowering::Rows) return;
    pass.code.lists_in_runs = profile_.lanes_in_turn && !pass.active.empty() && pass.listed_by < 0;
    pass.code.cut = cut(trips_of(graph_, pass.ops), 1);
  }

  void raster(Pass& pass) {
    const ir::Op& op = graph_.op(pass.ops.back());
    const Pass* setup = pass.sets_up_again ? &step_.passes[static_cast<size_t>(pass.set_up_by)] : nullptr;
    const WalkTrips trips = walk_trips(graph_, pass, op, setup, schedule_.code.wide_words);
    const RasterParts parts = raster_parts(op);
    const Dim pixels = parts.w * parts.h;
    const int64_t limit = profile_.loop_trips;
    const Bins bins = profile_.subgroup_size >= kWideSubgroup ? gpu_bins(pixels) : kCpu;
    // Lanes that walk small boxes of different shapes take trips for the rows and columns of them all: for boxes of 64
    // pixels the sum over y of 64 / (y + 1).
    constexpr int64_t kSmallPixels = 320;
    const bool short_ones = trips.pixel.is_constant() && kSmallPixels * (trips.pixel.constant() + 1) < limit / 2;
    FaceWalk& walk = pass.code.walk;
    walk.watched = limit > 0 && trips.watched;
    walk.lists = profile_.subgroup_size > 1 || limit > 0;
    if (!walk.lists) return;
    const bool few_faces = bins.small_box == kCpu.small_box && static_cast<int64_t>(parts.count) >= kManyKept;
    walk.small_box = !few_faces && (limit == 0 || short_ones) ? bins.small_box : 0;
    walk.middle_box = bins.middle_box;
    // A power of two, so that teams share the invocations evenly whatever the profile says.
    walk.team = static_cast<int>(std::bit_floor(std::clamp(profile_.subgroup_size, 1u, 128u)));
    walk.middle_invocations = bins.middle_invocations;
    walk.large_invocations = bins.large_invocations;
  }

  const Resource& resource(ValueId v) const { return schedule_.resources[step_.stored.at(v).index]; }

  const Graph& graph_;
  const target::Profile& profile_;
  const CodeOptions& options_;
  const Schedule& schedule_;
  StepSchedule& step_;
};

void choose_divisors(const Graph& graph, Code& code) {
  for (uint32_t k = 0; k < graph.op_count(); ++k) {
    const ir::Op& op = graph.op(ir::OpId{k});
    if (op.kind != OpKind::Div || !graph.value(op.operands[1]).type.is_float()) continue;
    const ValueId by = op.operands[1];
    if (hide_as_divisor(graph, by, code.native))
      code.hidden_divisors.insert(by);
    else if (hide_as_divisor(graph, by, false))
      code.strict_hidden_divisors.insert(by);
    if (is_moderate(graph, by)) code.moderate_divisors.insert(by);
  }
}

}  // namespace

void choose_code(const Graph& graph, const target::Profile& profile, const CodeOptions& options, Schedule& schedule) {
  Code& code = schedule.code = {};
  code.native = options.native_floats;
  code.texel_reads = code.hidden_stores = profile.lanes_in_turn;
  code.wide_words = profile.shader_int64 && profile.shader_buffer_int64_atomics;
  code.layers_at_once = profile.max_multiview_view_count > 0;
  // A processor fills memory faster than its shaders do.
  if (profile.subgroup_size >= kWideSubgroup) code.clears = profile.max_per_stage_descriptor_storage_buffers;
  code.loop_trips = profile.loop_trips;
  choose_divisors(graph, code);
  for (StepSchedule& step : schedule.steps) StepCode(graph, profile, options, schedule, step).process();
}

}  // namespace dr::backend
