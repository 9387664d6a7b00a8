// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/lowering/choose_code.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <set>

#include "compiler/backend/analysis/divisors.h"
#include "compiler/backend/analysis/live_words.h"
#include "compiler/backend/analysis/raster_parts.h"
#include "compiler/backend/analysis/scatter_leaves.h"
#include "compiler/backend/analysis/uses.h"
#include "compiler/backend/bundle/bundle.h"
#include "compiler/backend/lowering/heavy_branches.h"
#include "compiler/backend/lowering/scatter_costs.h"
#include "compiler/backend/schedule/joined_sums.h"
#include "compiler/backend/schedule/limits.h"
#include "compiler/backend/schedule/trips.h"

namespace dr::backend {

using ir::Dim;
using ir::Graph;
using ir::OpKind;
using ir::ValueId;

namespace {

struct Bins {
  // Faces by the pixels of their boxes: up to the first for one invocation, up to the second for subgroups.
  int small_box, few_box, middle_box;
  // Invocations that share the faces of a list.
  int middle_invocations, large_invocations;
  uint32_t teams;  // that share the lanes of a subgroup for the faces of the first list
};
constexpr Bins kCpu{64, 0, 4096, 1 << 11, 1 << 12, 1};
// Where lanes take turns, each invocation costs what a dozen pixels do, and a lane that walks its box alone holds up
// those beside it, whose faces are on a list: so there are few invocations, and few boxes are small where faces are
// large.
constexpr Bins kInTurn{64, 8, 16384, 1 << 9, 1 << 10, 1};
// Pixels of a box that an invocation walks alone where it looks at wanted ones only: lanes that do so side by side have
// a pixel each all the time, those of a team share few.
constexpr int kWantedBox = 128;
// Lanes that walk small boxes of different shapes take trips for the rows and columns of them all: for boxes of 64
// pixels the sum over y of 64 / (y + 1).
constexpr int64_t kSmallPixels = 320;
// A raster that keeps so many faces of a pixel lists what few faces have, as outlines are. On a CPU, whose lanes take
// each other's branches, a lane that walks its box alone makes all lanes beside it go over that; a team walks the few
// that are left.
constexpr int64_t kManyKept = 12;

// Those of a GPU, which starts few workgroups faster than many, and has work for more in large pictures, whose boxes
// are larger, too. Boxes of some twenty pixels are common, for which a whole subgroup is too many lanes. All of it is
// measured by tests/bench/cases/table4.dr, 256² to 2048² pixels. A face on a pixel's list waits for those before it
// there, so lanes share what is more than one pixel. Lists are of tiles, as a rule, of which there are fewer.
Bins gpu_bins(const Dim& pixels, bool listed) {
  constexpr int64_t kUsual = 1 << 20, kUsualTiles = 1 << 16;
  constexpr uint64_t kPerSide = 128;
  const int64_t count = pixels.evaluate({}).value_or(listed ? kUsualTiles : kUsual);
  const auto side = static_cast<uint64_t>(std::sqrt(static_cast<double>(count)));
  const auto middle = std::bit_floor(std::clamp(kPerSide * side, uint64_t{1} << 15, uint64_t{1} << 18));
  const bool usual = count <= kUsual;
  return {listed ? 1 : 8, 0, 16384, static_cast<int>(middle), usual ? 1 << 14 : 1 << 17, usual ? 4u : 2u};
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
      std::visit(Overloaded{[&](MapPass& own) { own.code = map(pass, own, pass_id(place)); }, [](FragmentPass&) {},
                            [&](ReducePass& own) { own.in_teams = in_teams(pass); },
                            [&](ScatterPass& own) { scatter(pass, own); },
                            [&](RasterPass& own) { own.walk = walk(pass, own); }, [](DrawnRasterPass&) {}},
                 pass.of_kind);
    }
  }

 private:
  MapCode map(const Pass& pass, const MapPass& map, PassId id) const {
    MapCode code;
    if (set_up_for(step_, id) == nullptr) {
      const Trips trips = trips_of(graph_, pass.ops);
      if (options_.list_branches && !map.block && !map.rest) code.heavy = heavy(pass, id, trips);
      const bool lists = std::ranges::any_of(
          listed_for(step_, id), [](const Pass* scatter) { return scatter->get<ScatterPass>().leaves_list(); });
      code.lists_in_runs = profile_.lanes_in_turn && (code.heavy || lists);
      code.cut = cut(code.heavy ? light_trips(pass, *code.heavy) : trips, code.lists_in_runs ? kListedRun : 1);
    }
    code.told = told(pass, map, code, id);
    if (const auto sums = joined_in_groups(step_, id); ends_once(code) && !sums.empty()) {
      code.joining_group = joining_group(pass, id, sums);
      code.in_tiles = !pass.domain.h.is_one();  // lanes of a square add to the same elements; memory is read in rows
    }
    code.each = elements_in_turn(pass, map, code, id);
    return code;
  }

  // A GPU waits for the 64 inputs of an invocation, few of which run where one number is asked for.
  bool in_teams(const Pass& pass) const {
    const ir::Op& op = graph_.op(pass.ops.back());
    const ir::ValueInfo& result = graph_.value(op.results[0]);
    constexpr int kMostComponents = 4;  // that a workgroup's memory holds
    return profile_.is_gpu() && profile_.max_compute_work_group_invocations >= static_cast<uint32_t>(kReducingGroup) &&
           result.extent.is_unit() && result.type.components() <= kMostComponents;
  }

  // A processor of 65,536 registers holds one workgroup of 256 where an invocation has more than 128. For one of 512
  // the driver keeps less in registers, and twice as many invocations run. A map that has fewer anyway takes longer in
  // large workgroups, whose invocations wait for each other.
  int joining_group(const Pass& pass, PassId id, const std::vector<const ScatterSum*>& sums) const {
    constexpr int kManyWords = 180;  // take more than 128 registers
    std::vector<ir::OpId> ops = pass.ops;
    std::set<ir::OpId> here(ops.begin(), ops.end());
    for (const Pass* scatter : listed_for(step_, id))
      for (const ir::OpId op : scatter->ops)
        if (here.insert(op).second) ops.push_back(op);
    std::vector<ValueId> added;
    for (const ScatterSum* sum : sums)
      for (const ValueId term : sum->terms)
        if (const auto leaves = scatter_leaves(graph_, term))
          for (const ScatterLeaf& leaf : *leaves) added.insert(added.end(), {leaf.index, leaf.value});
    const bool many = live_words(graph_, ops, added) > kManyWords;
    return many && groups_have_room(graph_, profile_, sums, kLargeJoiningGroup) ? kLargeJoiningGroup : kJoiningGroup;
  }

  // An invocation's own cost is that of many operations where lanes access memory in turn, the store that tells of NaN
  // most of all: elements share it, as many as leave work for all processors. Maps that read neighbours lose by it.
  int elements_in_turn(const Pass& pass, const MapPass& map, const MapCode& code, PassId id) const {
    const bool plain =
        map.partial.empty() && !map.rest && !map.block && !code.heavy && !code.cut && !pass.domain.is_unit();
    if (!profile_.lanes_in_turn || code.told.empty() || !plain || set_up_for(step_, id) != nullptr ||
        !listed_for(step_, id).empty())
      return 1;
    Trips trips = trips_of(graph_, pass.ops);
    trips.most = trips.most + Dim(2);
    int each = kMostInTurn;
    if (const auto count = (pass.domain.w * pass.domain.h * pass.domain.l).evaluate({}))
      while (each > 1 && each > *count / bundle::kLeastInvocations) each /= 2;
    while (each > 1 && needs_cut(trips, profile_, each)) each /= 2;
    return each;
  }

  std::optional<HeavyBranches> heavy(const Pass& pass, PassId id, const Trips& trips) const {
    HeavyBranches heavy;
    heavy.ops = heavy_branches(graph_, pass, trips, profile_);
    if (heavy.ops.empty())
      if (const auto select = heavy_select(graph_, pass, sinks(pass, id), trips, profile_)) heavy.ops = {*select};
    if (heavy.ops.empty()) return std::nullopt;
    heavy.cut = cut(trips, 1);
    heavy.by_subgroups = profile_.subgroup_arithmetic && !profile_.lanes_in_turn;
    // An invocation that walks the list takes the trips of many elements.
    heavy.apart = profile_.lanes_in_turn || profile_.loop_trips > 0 ? 0 : profile_.subgroup_size;
    heavy.shares_loops = share_loops(graph_, heavy.ops, profile_);
    if (heavy.shares_loops) heavy.apart = std::min<uint32_t>(heavy.apart, kLoopShares);
    if (!heavy.cut && has_room_for_two_lists(id)) heavy.unlikely = unlikely_branches(graph_, pass, heavy.ops, profile_);
    return heavy;
  }

  // Whether a shader that reads a list of elements and lists some of them has room for both.
  bool has_room_for_two_lists(PassId id) const {
    Bindings all = listing_bindings(schedule_.resources, step_, id);
    all.more += 2;
    return fits(profile_, all);
  }

  // What a map stores, and adds where it does so itself.
  std::vector<ValueId> sinks(const Pass& pass, PassId id) const {
    std::vector<ValueId> out = pass.writes;
    for (const Pass* scatter : listed_for(step_, id)) {
      const auto& how = scatter->get<ScatterPass>();
      for (const std::vector<ValueId>& clause : how.clauses()) out.insert(out.end(), clause.begin(), clause.end());
      for (const ScatterSum& sum : how.sums)
        for (const ValueId term : sum.terms)
          if (const ir::Op& op = graph_.op(graph_.value(term).op); op.kind == OpKind::ScatterAdd)
            out.push_back(op.operands[1]);
    }
    return out;
  }

  // What loops of the first dispatch take, which leaves the heavy branches out.
  Trips light_trips(const Pass& pass, const HeavyBranches& heavy) const {
    Trips all;
    for (const ir::OpId id : pass.ops) {
      const bool left_out = graph_.op(id).kind == OpKind::If && std::ranges::find(heavy.ops, id) != heavy.ops.end();
      all += left_out ? trips_of(graph_, graph_.region(graph_.op(id).regions[1]).ops) : trips_of(graph_, {&id, 1});
    }
    return all;
  }

  // `each`: elements that an invocation takes, one after the other.
  std::optional<LoopCut> cut(const Trips& trips, int each) const {
    const bool long_ones = may_pass_limit(trips, profile_, each),
               unknown = trips.unknown > 0 && profile_.loop_trips > 0;
    if (!long_ones && !unknown) return std::nullopt;
    // Lanes that go different ways take their trips one after the other, as the driver counts.
    const int64_t lanes = trips.even ? 1 : std::max<int64_t>(profile_.subgroup_size, 1);
    const int64_t part = int64_t{profile_.loop_trips} / lanes - overhead(trips, each);
    // Where data decides, the shader tells whether a loop did not come to its end.
    return LoopCut{static_cast<uint32_t>(std::max<int64_t>(part, 1)), unknown || trips.promised > 0};
  }

  // Floats that the step leaves in a leaf, or in an output of one element, where the device has a buffer left for the
  // word that tells of them.
  std::vector<ValueId> told(const Pass& pass, const MapPass& map, const MapCode& code, PassId id) const {
    const auto stays = [&](ValueId v) {
      const auto is_it = [&](const auto& named) { return named.second == v; };
      return std::ranges::any_of(step_.updates, is_it) ||
             (resource(v).extent.is_unit() && std::ranges::any_of(step_.outputs, is_it));
    };
    const auto is_partial = [&](ValueId v) { return std::ranges::find(map.partial, v) != map.partial.end(); };
    std::vector<ValueId> out;
    size_t writes = 0;
    for (const ValueId v : pass.writes) {
      if (!is_partial(v)) ++writes;
      if (resource(v).type.is_float() && !resource(v).is(Resource::Storage::Halves) && stays(v) && !is_partial(v))
        out.push_back(v);
    }
    const std::optional<LoopCut>& cut = code.heavy && code.heavy->cut ? code.heavy->cut : code.cut;
    Bindings all = bindings_of(schedule_.resources, resources_of(step_, pass.reads), writes);
    all.more = 1 + (cut ? 2 : 0) + (cut && cut->watched ? 1 : 0) + (code.heavy ? 1 : 0) +
               (code.heavy && !code.heavy->unlikely.empty() ? 1 : 0) + lists_bound(listed_for(step_, id).size()) +
               cleared_bound(schedule_.resources, step_, id) + (map.rest ? 1 : 0) +
               static_cast<uint32_t>(guesses_bound(schedule_.resources, step_, pass));
    if (!fits(profile_, all)) out.clear();
    return out;
  }

  void scatter(const Pass& pass, ScatterPass& scatter) const {
    if (ActiveList* list = scatter.active_list())
      if (auto* own = std::get_if<OwnList>(&list->listed_by)) own->in_runs = profile_.lanes_in_turn;
    std::visit(Overloaded{[&](ExactScatter& exact) {
                            exact.cut = cut(trips_of(graph_, pass.ops), 1);
                            exact.joins_groups =
                                exact.joins_groups && ends_once(step_.pass(*scatter.lister()).get<MapPass>().code);
                          },
                          [&](RowsScatter& rows) { rows.lanes = lanes_of(rows); },
                          [&](BinnedScatter& binned) { binned.cut = cut(trips_of(graph_, pass.ops), 1); },
                          [&](AtomicScatter& atomic) {
                            atomic.cut = cut(trips_of(graph_, pass.ops), 1);
                            atomic.skips_zeros = !profile_.lanes_in_turn && sums_floats(scatter);
                          }},
               scatter.how);
  }

  // An item is read by its number, which is read before: a row by one lane takes as long as these reads wait for each
  // other. Where a GPU has more rows than it runs at once, others run meanwhile, and to join takes time.
  int lanes_of(const RowsScatter& rows) const {
    constexpr int64_t kAtOnce = 1 << 18;
    if (!lanes_join(profile_) || !profile_.subgroup_shuffle || profile_.loop_trips > 0 ||
        profile_.subgroup_size < kLoopShares)
      return 1;
    int lanes = kLoopShares;
    while (lanes > 1 && rows.targets.is_constant() && rows.targets.constant() * lanes > kAtOnce) lanes /= 2;
    return lanes;
  }

  // Whether each invocation of a map has one element, which it computes to the end.
  static bool ends_once(const MapCode& code) { return !code.lists_in_runs && !code.heavy && !code.cut; }

  bool sums_floats(const ScatterPass& scatter) const {
    return std::ranges::any_of(scatter.sums,
                               [&](const ScatterSum& sum) { return graph_.value(sum.value).type.is_float(); });
  }

  FaceWalk walk(const Pass& pass, const RasterPass& raster) const {
    const ir::Op& op = graph_.op(pass.ops.back());
    const Pass* setup = raster.setup ? &step_.pass(raster.setup->pass) : nullptr;
    const KeptPixels kept = kept_pixels(schedule_, step_, op);
    FaceWalk walk;
    if (const auto wanted = wanted_pixels(graph_, op); wanted && kept != KeptPixels::Bits && profile_.lanes_in_turn)
      walk.wanted = wanted->bits;
    const WalkTrips trips =
        walk_trips(graph_, pass, op, setup, kept, kept == KeptPixels::Bits || walk.wanted.has_value());
    const RasterParts parts = raster_parts(op);
    const Dim pixels = parts.w * parts.h;
    const int64_t limit = profile_.loop_trips;
    const Bins bins = profile_.is_gpu() ? gpu_bins(pixels, parts.listed) : profile_.lanes_in_turn ? kInTurn : kCpu;
    const Dim alone = walk.wanted ? wanted_trips(trips.pixel) : Dim(kSmallPixels) * trips.pixel;
    const bool short_ones = alone.is_constant() && alone.constant() + kSmallPixels < limit / 2;
    const bool sets_up_unknown = setup != nullptr && trips_of(graph_, setup->ops).unknown > 0;
    walk.watched = limit > 0 && (trips.watched || sets_up_unknown);
    if (profile_.subgroup_size <= 1 && limit == 0) return walk;
    const bool few_faces = bins.small_box == kCpu.small_box && static_cast<int64_t>(parts.count) >= kManyKept;
    FaceBins& lists = walk.lists.emplace();
    const int small_box = walk.wanted ? kWantedBox : bins.small_box;
    lists.small_box = !few_faces && (limit == 0 || short_ones) ? small_box : 0;
    lists.few_box = lists.small_box > 0 ? bins.few_box : 0;
    // A power of two, so that teams share the invocations evenly whatever the profile says.
    lists.team = static_cast<int>(std::bit_floor(std::clamp(profile_.subgroup_size / bins.teams, 1u, 128u)));
    lists.middle_box = limit > 0 ? bounded_box(bins.middle_box, lists.team, limit, trips) : bins.middle_box;
    lists.middle_invocations = bins.middle_invocations;
    lists.large_invocations = bins.large_invocations;
    walk.in_turn = in_turn(raster, walk, parts.cull,
                           lists.small_box == 0 ? Dim(0)
                           : walk.wanted        ? alone
                                                : Dim(2) * alone);
    return walk;
  }

  // What an invocation takes that walks a box of `kWantedBox` pixels: the wanted ones, and all words of its rows to
  // find them, for which lanes wait one after the other.
  Dim wanted_trips(const Dim& pixel) const {
    return Dim(kWantedBox) * (pixel + Dim(1) + Dim(static_cast<int64_t>(profile_.subgroup_size)));
  }

  // Where a device lets an invocation take so many trips only, a team can walk some boxes of the middle list one after
  // the other, however large: else each face of the list would need workgroups of its own, most of which find little to
  // do.
  static int bounded_box(int box, int team, int64_t limit, const WalkTrips& trips) {
    constexpr int64_t kBoxes = 7;
    if (!trips.listed.is_constant() || !trips.face.is_constant()) return box;
    const int64_t steps = (limit / kBoxes - trips.face.constant() - 3) / (trips.listed.constant() + 1);
    return static_cast<int>(std::clamp<int64_t>(steps * team, team, box));
  }

  // Conditions without each of which a face is culled, where `cull` is `!(a && b)`.
  void shown_by(ValueId v, bool culled, std::vector<ValueId>& out) const {
    const ir::Op& op = graph_.op(graph_.value(v).op);
    if (culled && op.kind == OpKind::LogicalNot) return shown_by(op.operands[0], false, out);
    if (culled) return;
    if (op.kind == OpKind::LogicalAnd)
      for (const ValueId both : op.operands) shown_by(both, false, out);
    else
      out.push_back(v);
  }

  // What an invocation costs anyway, and to list a face, lanes pay together, whether one of them does or not: several
  // faces share it.
  std::optional<FacesInTurn> in_turn(const RasterPass& raster, const FaceWalk& walk, ValueId cull,
                                     const Dim& walked) const {
    if (!profile_.lanes_in_turn || walk.watched) return std::nullopt;
    const Pass* setup = raster.setup ? &step_.pass(raster.setup->pass) : nullptr;
    FacesInTurn turn{setup == nullptr ? std::vector<ValueId>() : shown_first(*setup, cull), kMostInTurn};
    if (turn.shown.empty() && setup != nullptr && !setup->get<MapPass>().partial.empty()) return std::nullopt;
    const Dim set_up = setup == nullptr ? Dim(0) : trips_of(graph_, setup->ops).most;
    const Dim trips = Dim(2) * (set_up + Dim(4)) + walked;
    if (profile_.loop_trips == 0) return turn;
    if (!trips.is_constant()) return std::nullopt;
    while (turn.each > 1 && turn.each * trips.constant() > int64_t{profile_.loop_trips}) turn.each /= 2;
    return turn.each > 1 ? std::optional(turn) : std::nullopt;
  }

  // Lanes take each other's branches: faces that are culled early are worth another look where most of the work comes
  // behind.
  std::vector<ValueId> shown_first(const Pass& setup, ValueId cull) const {
    // What is stored of a face is stored of all.
    if (setup.get<MapPass>().partial.size() != setup.writes.size()) return {};
    std::vector<ValueId> conditions, out;
    shown_by(cull, true, conditions);
    const size_t most = ops_in(setup.ops) / 2;
    for (const ValueId v : conditions) {
      std::vector<ValueId> more = out;
      more.push_back(v);
      const std::vector<ir::OpId> first = ops_of(graph_, setup.ops, more);
      const bool here = std::ranges::find(setup.ops, graph_.value(v).op) != setup.ops.end();
      if (here && ops_in(first) <= most && trips_of(graph_, first).loops == 0) out = std::move(more);
    }
    return out;
  }

  size_t ops_in(std::span<const ir::OpId> ops) const {
    size_t count = ops.size();
    for (const ir::OpId id : ops)
      for (const ir::RegionId region : graph_.op(id).regions) count += ops_in(graph_.region(region).ops);
    return count;
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
    if (!code.divides_by_any && is_moderate(graph, by)) code.moderate_divisors.insert(by);
  }
}

}  // namespace

void choose_code(const Graph& graph, const target::Profile& profile, const CodeOptions& options, Schedule& schedule) {
  Code& code = schedule.code = {};
  code.native = options.native_floats;
  code.texel_reads = code.hidden_stores = code.divides_by_any = profile.lanes_in_turn;
  code.hidden_zeros = profile.lanes_in_turn && !code.native;
  code.no_else = profile.else_doubles_compile;
  code.wide_words = profile.shader_int64 && profile.shader_buffer_int64_atomics;
  code.layers_at_once = profile.max_multiview_view_count > 0;
  // A processor fills memory faster than its shaders do.
  if (profile.is_gpu()) code.clears = profile.max_per_stage_descriptor_storage_buffers;
  code.loop_trips = profile.loop_trips;
  choose_divisors(graph, code);
  for (StepSchedule& step : schedule.steps) StepCode(graph, profile, options, schedule, step).process();
}

}  // namespace dr::backend
