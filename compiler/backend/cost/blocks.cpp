// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/cost/blocks.h"

#include <algorithm>
#include <set>

#include "compiler/backend/analysis/axes.h"
#include "compiler/backend/analysis/read_part.h"
#include "compiler/backend/cost/cost.h"
#include "compiler/backend/schedule/trips.h"

namespace dr::backend {

using ir::Graph;
using ir::Op;
using ir::OpId;
using ir::OpKind;

namespace {

// A read of a component that a cache has, beside an addition: its address, whether it is within the image, the load.
// Where lanes read in turn, one takes as long as they all.
constexpr double kRead = 12, kReadInTurn = 24;
// What else a trip takes, and how many trips a loop is taken to have whose bounds are not numbers.
constexpr double kTrip = 3, kTripsOfUnknown = 32, kInnerTrips = 8;
// A block pays from this share of the work on.
constexpr double kWorthwhile = 0.75;
// Elements of a block, the words that are kept for all of them, and how long its text may be in op_size() units: longer
// ones take a driver long, and registers run out.
constexpr int kMostElements = 16, kMostWordsInTurn = 32, kMostWordsRead = 64;
constexpr double kMostText = 1500;
// Invocations that a device needs to be busy.
constexpr int64_t kBusyLanesInTurn = 256, kBusy = 131072;
// Reads that go into shared memory are repeated at least so often. To wait for each other takes each invocation as long
// as some reads.
constexpr double kRepeated = 4, kWait = 4;
constexpr int kMostTrips = 64;

// What the ops of a pass take at an element, by the axes along which they change.
struct Work {
  std::array<double, 8> cost{}, text{};
  int words = 0;          // of what loops combine
  bool branches = false;  // regions, but for such loops and plain branches behind: their text for each element would
                          // take drivers minutes
  bool shares = false;    // some reads in a loop change along some of the domain's axes only
};

class Chooser {
 public:
  Chooser(const Graph& graph, const target::Profile& profile) : graph_(graph), profile_(profile), changing_(graph) {}

  std::optional<Block> choose(const Pass& pass, double share_to_beat) {
    std::optional<Block> best;
    domain_ = axes_of(pass.domain);
    std::array<std::optional<Work>, 8> work;
    const auto of = [&](Axes axes) -> const Work& {
      std::optional<Work>& w = work[axes];
      if (!w) {
        w.emplace();
        for (const OpId id : pass.ops) add(graph_.op(id), axes, 1, *w, false);
      }
      return *w;
    };
    double least = kWorthwhile * share_to_beat;
    const int most_words = profile_.lanes_in_turn ? kMostWordsInTurn : kMostWordsRead;
    static constexpr int kSizes[] = {1, 2, 3, 4, 8};
    for (const int w : kSizes)
      for (const int h : kSizes)
        for (const int l : kSizes) {
          const Block block{.each = {w, h, l}, .together = {}};
          const auto axes = static_cast<Axes>((w > 1 ? 1 : 0) | (h > 1 ? 2 : 0) | (l > 1 ? 4 : 0));
          if (axes == 0 || (axes & ~domain_) != 0 || block.elements() > kMostElements) continue;
          if (!keeps_busy(pass.domain, block)) continue;
          const Work& all = of(axes);
          if (!all.shares || all.branches || all.words * block.elements() > most_words) continue;
          if (sum(all.text, block) > kMostText) continue;
          const double whole = std::max(total(all.cost), 1.0);
          const double share = waste(pass.domain, block) * sum(all.cost, block) / block.elements() / whole;
          if (share < least - 1e-9) {
            least = share;
            best = block;
          }
        }
    if (best && !profile_.lanes_in_turn) best->together = read_together(pass, *best);
    return best;
  }

 private:
  static double total(const std::array<double, 8>& values) {
    double all = 0;
    for (const double v : values) all += v;
    return all;
  }

  // What changes along some axes is there once for each place of the block on those.
  static double sum(const std::array<double, 8>& values, const Block& block) {
    double all = 0;
    for (size_t axes = 0; axes < 8; ++axes) {
      double times = 1;
      for (size_t axis = 0; axis < 3; ++axis)
        if (((axes >> axis) & 1) != 0) times *= block.each[axis];
      all += times * values[axes];
    }
    return all;
  }

  // Elements that blocks beyond the domain's end compute for nothing.
  static double waste(const ir::Extent& domain, const Block& block) {
    const ir::Dim* const sizes[] = {&domain.w, &domain.h, &domain.l};
    double waste = 1;
    for (size_t axis = 0; axis < 3; ++axis) {
      if (!sizes[axis]->is_constant() || sizes[axis]->constant() < 1) continue;
      const int64_t n = sizes[axis]->constant(), each = block.each[axis];
      const int64_t whole = (n + each - 1) / each * each;
      waste *= static_cast<double>(whole) / static_cast<double>(n);
    }
    return waste;
  }

  bool keeps_busy(const ir::Extent& domain, const Block& block) const {
    const auto elements = (domain.w * domain.h * domain.l).evaluate({});
    if (!elements) return true;
    return *elements / block.elements() >= (profile_.lanes_in_turn ? kBusyLanesInTurn : kBusy);
  }

  // `axes`: those along which a block has several elements.
  void add(const Op& op, Axes axes, double times, Work& work, bool in_loop) {
    const int components = op.results.empty() ? 1 : graph_.value(op.results[0]).type.components();
    if (shares_trips(op, axes, changing_)) {
      const auto fixed = fixed_trips(graph_, op);
      const double trips = fixed ? static_cast<double>(fixed->count) : in_loop ? kInnerTrips : kTripsOfUnknown;
      for (const ir::ValueId v : op.results) work.words += graph_.value(v).type.components();
      work.cost[0] += times * trips * kTrip;
      for (const OpId id : graph_.region(op.regions[0]).ops) add(graph_.op(id), axes, times * trips, work, true);
      return;
    }
    const Axes changes = changing_.of(op);
    work.branches = work.branches || (!op.regions.empty() && (in_loop || !is_plain_branch(op)));
    if (op.kind == OpKind::Gather && in_loop && (changes & axes) != axes) work.shares = true;
    work.cost[changes] += times * cost(op, components);
    work.text[changes] += static_cast<double>(op_size(graph_, op));
  }

  // An `if` of arithmetic alone, as activations of layers are.
  bool is_plain_branch(const Op& op) const {
    const auto is_plain = [&](OpId id) {
      return graph_.op(id).regions.empty() && graph_.op(id).kind != OpKind::Gather;
    };
    return op.kind == OpKind::If && std::ranges::all_of(op.regions, [&](ir::RegionId region) {
             return std::ranges::all_of(graph_.region(region).ops, is_plain);
           });
  }

  double cost(const Op& op, int components) const {
    if (op.kind == OpKind::Gather) return (profile_.lanes_in_turn ? kReadInTurn : kRead) * components;
    double all = op_cost(op.kind) * components;
    for (const ir::RegionId region : op.regions)
      for (const OpId id : graph_.region(region).ops) {
        const Op& inner = graph_.op(id);
        const int n = inner.results.empty() ? 1 : graph_.value(inner.results[0]).type.components();
        all += (op.kind == OpKind::If ? 1 : kInnerTrips) * cost(inner, n);
      }
    return all;
  }

  // --- Reads of a workgroup ---

  std::optional<GroupReads> read_together(const Pass& pass, const Block& block) {
    if (needs_cut(trips_of(graph_, pass.ops), profile_)) return std::nullopt;
    int wide = 0;
    for (const int n : block.each) wide += n > 1 ? 1 : 0;
    const auto most = static_cast<int>(profile_.max_compute_work_group_invocations);
    if (wide < 2 || most < 64) return std::nullopt;
    std::array<int, 3> group{1, 1, 1};
    // 16 along the first axis, or as many as it has blocks; along the others what is left.
    int left = std::min(most >= 256 ? 256 : most >= 128 ? 128 : 64, 256);
    const ir::Dim* const sizes[] = {&pass.domain.w, &pass.domain.h, &pass.domain.l};
    for (size_t axis = 0; axis < 3; ++axis) {
      if (block.each[axis] == 1) continue;
      int& n = group[axis] = wide == 1 ? left : left >= 128 ? (wide == 3 ? 4 : 16) : 8;
      if (wide == 3 && axis == 0) n = left / 16;
      if (sizes[axis]->is_constant())
        while (n > 1 && (n / 2) * block.each[axis] >= sizes[axis]->constant()) n /= 2;
      left /= n;
      --wide;
    }
    saved_ = 0;
    const GroupReads start{.group = group, .loop = {}, .gathers = {}};
    std::optional<GroupReads> best;
    for (const OpId id : pass.ops) look_for_reads(id, Block{block.each, start}, best);
    return best;
  }

  // The loop with the largest share of reads that others of the workgroup do too, or one inside it.
  void look_for_reads(OpId id, const Block& block, std::optional<GroupReads>& best) {
    const Op& op = graph_.op(id);
    if (!shares_trips(op, 7, changing_)) return;
    const auto fixed = fixed_trips(graph_, op);
    std::set<int> trips;
    for (int n = kMostTrips; n >= 1; n /= 2) trips.insert(n);
    if (fixed && fixed->count >= 1 && fixed->count <= kMostTrips) {
      trips.insert(static_cast<int>(fixed->count));
      trips.erase(trips.upper_bound(static_cast<int>(fixed->count)), trips.end());
    }
    for (const int n : trips) {
      Block with = block;
      with.together->loop = id;
      with.together->trips = n;
      const double saved = reads_saved(op, with, *with.together);
      const auto room = static_cast<int64_t>(profile_.max_compute_shared_memory_size / 2);
      if (with.together->gathers.empty() || saved <= saved_ || shared_bytes(graph_, with).value_or(room + 1) > room)
        continue;
      saved_ = saved;
      best = std::move(with.together);
    }
    for (const OpId inner : graph_.region(op.regions[0]).ops) look_for_reads(inner, block, best);
  }

  // Fills the gathers of what is read together; of the reads of a trip, those that are repeated by others.
  double reads_saved(const Op& loop, const Block& block, GroupReads& together) {
    double saved = 0;
    for (const OpId id : gathers_in(graph_, loop)) {
      const Op& gather = graph_.op(id);
      const auto part = read_part(graph_, gather, together.loop, block.box(), together.trips, changing_);
      if (!part) continue;
      double reads = static_cast<double>(together.invocations()) * together.trips;
      const Axes changes = changing_.of(gather);
      for (size_t axis = 0; axis < 3; ++axis)
        if (((changes >> axis) & 1) != 0) reads *= block.each[axis];
      bool always = true;  // not in a branch
      for (OpId at = graph_.region(gather.parent).parent; at != together.loop;
           at = graph_.region(graph_.op(at).parent).parent) {
        always = always && graph_.op(at).kind == OpKind::Reduce;
        const auto fixed = always ? fixed_trips(graph_, graph_.op(at)) : std::nullopt;
        reads *= fixed ? static_cast<double>(fixed->count) : kInnerTrips;
      }
      if (!always) continue;
      const auto once = static_cast<double>(part->elements());
      if (reads < kRepeated * once) continue;
      saved += (reads - once) / together.trips;
      together.gathers.push_back(id);
    }
    saved -= kWait * together.invocations() / together.trips;
    return saved;
  }

  const Graph& graph_;
  const target::Profile& profile_;
  ChangingAxes changing_;
  Axes domain_ = 0;
  double saved_ = 0;
};

}  // namespace

struct BlockChooser::State {
  Chooser chooser;
};

BlockChooser::BlockChooser(const Graph& graph, const target::Profile& profile)
    : graph_(graph), profile_(profile), state_(nullptr) {}

BlockChooser::~BlockChooser() = default;

std::optional<Block> BlockChooser::choose(const Pass& pass, double share_to_beat) {
  if (std::ranges::none_of(pass.ops, [&](OpId id) { return graph_.op(id).kind == OpKind::Reduce; }))
    return std::nullopt;
  if (!state_) state_ = std::make_unique<State>(State{Chooser(graph_, profile_)});
  return state_->chooser.choose(pass, share_to_beat);
}

}  // namespace dr::backend
