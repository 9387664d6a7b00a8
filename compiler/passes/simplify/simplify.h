// SPDX-License-Identifier: Apache-2.0
// The inside of the pass `simplify`: simplify.cpp walks the graph and rebuilds it through an Emitter, which appends
// each op in its simplest form: folded (simplify_fold.cpp), rewritten by an identity (simplify_identities.cpp), or
// shared with an equal op that stands before it (simplify_share.cpp).
#pragma once

#include <optional>
#include <vector>

#include "compiler/ir/graph.h"
#include "compiler/passes/passes.h"

namespace dr::passes {

// An op of one result and no regions that is about to be appended. `type` and `extent` are its result's.
struct Candidate {
  ir::OpKind kind;
  std::vector<ir::ValueId> operands;
  ir::Attrs attrs;
  ir::Type type;
  ir::Extent extent;
  dsl::Span span;
};

// Ops by a hash of what they compute, which several may share. Open addressing: entries stay.
class OpTable {
 public:
  void insert(uint64_t hash, ir::OpId op);

  // The first op of that hash that `is_equal` says yes to, or an invalid one.
  template <class IsEqual>
  ir::OpId find(uint64_t hash, const IsEqual& is_equal) const {
    if (entries_.empty()) return {};
    const size_t mask = entries_.size() - 1;
    for (size_t at = hash & mask; entries_[at].op.valid(); at = (at + 1) & mask) {
      if (entries_[at].hash == hash && is_equal(entries_[at].op)) return entries_[at].op;
    }
    return {};
  }

 private:
  struct Entry {
    uint64_t hash = 0;
    ir::OpId op;
  };
  std::vector<Entry> entries_;  // a power of two of them, at most half in use
  size_t count_ = 0;
};

class Emitter {
 public:
  // `differentiated`: no gradient is taken of what is emitted.
  Emitter(ir::Builder& to, const Skips& skips, bool differentiated)
      : to_(to), skips_(skips), differentiated_(differentiated), scopes_(1) {}

  ir::Builder& builder() { return to_; }
  // Whether ops of this kind are left out; counts one more that is.
  bool leaves_out(bool Skips::*kind) const { return skips_.*kind; }
  void count(size_t Skips::LeftOut::*kind) {
    if (skips_.left_out) ++(skips_.left_out->*kind);
  }
  const ir::Graph& graph() const { return to_.graph(); }
  const ir::ValueInfo& value(ir::ValueId id) const { return to_.value(id); }
  bool in_root() const { return to_.current_region() == graph().root(); }
  bool differentiated() const { return differentiated_; }

  // The value that the candidate computes: of its type and, in the root region, of its extent.
  ir::ValueId emit(Candidate candidate);
  // What computes the same already and can be seen from here.
  std::optional<ir::ValueId> existing(const Candidate& candidate) const;
  // Appends it as it is; later ops are neither shared with it nor look through it.
  ir::ValueId emit_opaque(Candidate candidate);
  void set_opaque(ir::ValueId id);

  // An op with regions or several results, just appended: an equal op before it, if there is one, else itself.
  ir::OpId share(ir::OpId op);
  // Equal ops are looked for in the open scopes: one for each region that is under construction.
  void open_scope() { scopes_.emplace_back(); }
  void close_scope() { scopes_.pop_back(); }

  // What makes the value; null for region parameters and opaque values, which rules must not look into.
  const ir::Op* definition(ir::ValueId id) const;
  const ir::Op* definition(ir::ValueId id, ir::OpKind kind) const;
  // The components if the value is a constant.
  const std::vector<double>* constant(ir::ValueId id) const;
  // The same of a value that is one constant at each of its elements.
  const std::vector<double>* constant_everywhere(ir::ValueId id) const;
  ir::ValueId make_constant(ir::Type type, std::vector<double> components);
  // The value with an extent that it stretches to. Inside a region a smaller extent is as good, and no op there
  // stretches.
  ir::ValueId stretched(ir::ValueId id, const ir::Extent& extent);

 private:
  ir::ValueId append(Candidate candidate);
  std::optional<ir::ValueId> existing(const Candidate& candidate, uint64_t hash) const;
  // Looks for an equal op in the open scopes.
  template <class IsEqual>
  ir::OpId find(uint64_t hash, const IsEqual& is_equal) const;

  ir::Builder& to_;
  const Skips& skips_;
  const bool differentiated_;
  std::vector<OpTable> scopes_;
  std::vector<bool> opaque_;  // by value; shorter than that, the others are not
};

// The rules; nullopt where none applies.
std::optional<ir::ValueId> fold(Emitter& emitter, const Candidate& candidate);
std::optional<ir::ValueId> apply_identity(Emitter& emitter, const Candidate& candidate);
std::optional<ir::ValueId> pull_gather(Emitter& emitter, const Candidate& gather);  // simplify_gather.cpp

}  // namespace dr::passes
