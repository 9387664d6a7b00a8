// SPDX-License-Identifier: Apache-2.0
// Packing of one step, private to pack*.cpp: what is computed again and what is stored (pack.cpp), what scatters
// compute themselves (absorb.cpp), then which shader computes what (shaders.cpp) and stores it (store_later.cpp).
#pragma once

#include <algorithm>
#include <map>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <vector>

#include "compiler/backend/analysis/uses.h"
#include "compiler/backend/cost/blocks.h"
#include "compiler/backend/pack/pack.h"
#include "compiler/backend/schedule/limits.h"

namespace dr::backend {

using ir::Extent;
using ir::Graph;
using ir::Op;
using ir::OpId;
using ir::OpKind;
using ir::ValueId;

// Whether a value is small beside those of a domain: a number, or a list beside images.
inline bool is_small(const Extent& extent, const Extent& domain) {
  return extent.is_unit() || (extent.h.is_one() && !domain.h.is_one());
}

// How often a name was given, in all steps.
using Names = std::map<std::string, int>;

// Members of a set of dense indices, emptied in no time.
class Marks {
 public:
  explicit Marks(size_t count = 0) : mark_(count) {}
  void clear() { ++now_; }
  void cover(size_t count) { mark_.resize(std::max(mark_.size(), count)); }
  bool has(size_t k) const { return mark_[k] == now_; }
  bool add(size_t k) {  // whether it is new
    if (mark_[k] == now_) return false;
    mark_[k] = now_;
    return true;
  }

 private:
  std::vector<uint32_t> mark_;
  uint32_t now_ = 1;
};

class StepPacker {
 public:
  StepPacker(const Graph& graph, const ir::Step& step, const target::Profile& profile, const PackOptions& options,
             std::vector<Resource>& resources, Names& names);
  StepSchedule process();

 private:
  // What a shader must hold to compute its targets, grown target by target.
  struct Cone {
    std::vector<OpId> ops;
    std::vector<ValueId> reads;
    uint32_t buffers = 0, images = 0;  // that it reads
    size_t size = 0;                   // op_size() of its ops
  };

  // pack.cpp
  const Op& def(ValueId v) const { return graph_.op(graph_.value(v).op); }
  bool recomputable(ValueId v, OpId user) const;  // where `user` uses it
  int loads_of(const ir::ValueInfo& gathered) const;
  void find_recomputable();
  void find_users();
  void find_levels();
  bool drawn(const Op& raster) const;  // by draws: fragment shaders cannot stop and go on later
  bool is_image(ValueId v) const;      // how it is stored, if it is
  bool in_same_pass(const Op& user, OpId user_id, ValueId v) const;
  void find_stored();
  bool any_stored(const Op& op) const;
  void add_resource(ValueId v, const Op& op);
  uint32_t resource_index(ValueId v) const { return resource_[v.index]; }
  Resource& resource(ValueId v) { return resources_[resource_[v.index]]; }
  const Resource& resource(ValueId v) const { return resources_[resource_[v.index]]; }

  // absorb.cpp
  void find_absorbed();
  void find_looped();
  void absorb_into(OpId scatter);
  bool stored_anyway(ValueId v) const;

  // shaders.cpp
  void make_passes();
  void add_map_passes(const Extent& domain, const std::vector<OpId>& group, int level);
  void add_map_pass(const Extent& domain, const std::vector<ValueId>& targets, int level, bool hardware);
  void run_in_blocks(Pass& pass);
  void compute(Pass& pass);
  bool stops(const Pass& pass) const;
  std::vector<ValueId> choose(std::span<const ValueId>& targets, int level, bool hardware);
  std::vector<std::vector<ValueId>> gathered(std::span<const ValueId> targets, size_t most, const Extent& domain,
                                             int level);
  void merge_passes();
  void merge_passes(std::span<Pass> passes);
  std::optional<Pass> merged(const Pass& from, const Pass& into);
  void set_group(std::span<const OpId> ops);
  void begin_cone(int level);
  void grow(ValueId target, size_t most = SIZE_MAX);
  bool is_read(ValueId v, OpId user) const;
  bool is_loaded(ValueId v, OpId user) const;
  void close_over(Pass& pass, const std::vector<ValueId>& targets, int level);
  bool within_limits(const Pass& pass) const;
  bool fits_with_loops(Bindings all, std::span<const OpId> ops) const;
  void spill(const Pass& pass);
  void add_pass(Pass pass);
  std::string pass_name(const Pass& pass) const;

  // store_later.cpp
  void store_later();
  void store_later(Pass& early, Pass& late, const std::vector<ValueId>& read_behind);

  // cut.cpp
  // In op_size() units. Longer shaders are cut: drivers take quadratic time for one. Each part makes what it needs of
  // the forward sweep again.
  static constexpr size_t kMaxSize = 8192;
  void store_before(ValueId v, const Extent& domain);
  size_t size_again(ValueId v, OpId id, int level, size_t most);
  void cut(const Extent& domain, const std::vector<ValueId>& targets, int level);

  const Graph& graph_;
  const ir::Step& step_;
  const target::Profile& profile_;
  const PackOptions& options_;
  std::vector<Resource>& resources_;
  Names& names_;
  BlockChooser blocks_;
  StepSchedule out_;
  std::vector<bool> live_;
  std::vector<OpId> order_;
  std::vector<uint32_t> position_;  // in order_, by OpId index
  std::vector<Uses> uses_;
  std::vector<int> recompute_cost_;
  std::vector<size_t> size_;  // op_size(), by OpId index
  // By OpId index: to compute it again would read other places again, or values that are stored anyway.
  std::vector<bool> gathers_, loads_;
  int recompute_limit_ = 0;
  std::vector<bool> steady_;    // whether an op depends on what the step changes, by OpId index
  std::vector<bool> looped_;    // long loops stand before an op, at its element, by OpId index
  std::vector<bool> absorbed_;  // by OpId index: run by the one scatter that uses them
  std::vector<int> level_;
  std::set<ValueId> roots_, updated_;
  // By ValueId index.
  std::vector<std::vector<OpId>> users_;
  std::vector<bool> read_elsewhere_;
  std::vector<bool> stored_;
  std::vector<uint32_t> resource_;
  std::optional<ResourceId> counter_;  // that of the step's runs
  std::vector<bool> written_;          // by map passes so far
  std::vector<bool> spilled_;          // stored because a shader would read too much otherwise

  // The cone that is being grown, and who its members are. The ops of the group are computed in the same pass.
  Cone cone_;
  int cone_level_ = 0;
  Marks group_, in_cone_, read_, read_resource_, elsewhere_;
};

}  // namespace dr::backend
