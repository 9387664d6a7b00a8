// SPDX-License-Identifier: Apache-2.0
// The inside of the pass `simplify`: simplify.cpp walks the graph and rebuilds it through an Emitter, which appends
// each op in its simplest form: folded (simplify_fold.cpp), rewritten by an identity (simplify_identities.cpp), or
// shared with an equal op that stands before it (simplify_share.cpp).
#pragma once

#include <optional>
#include <unordered_map>
#include <unordered_set>
#include <vector>

#include "compiler/ir/graph.h"

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

class Emitter {
 public:
  explicit Emitter(ir::Builder& to) : to_(to), scopes_(1) {}

  ir::Builder& builder() { return to_; }
  const ir::Graph& graph() const { return to_.graph(); }
  const ir::ValueInfo& value(ir::ValueId id) const { return to_.value(id); }
  bool in_root() const { return to_.current_region() == graph().root(); }

  // The value that the candidate computes: of its type and, in the root region, of its extent.
  ir::ValueId emit(Candidate candidate);
  // Appends it as it is; later ops are neither shared with it nor look through it.
  ir::ValueId emit_opaque(const Candidate& candidate);
  void set_opaque(ir::ValueId id) { opaque_.insert(id.index); }

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
  ir::ValueId make_constant(ir::Type type, std::vector<double> components);
  // The value with an extent that it stretches to. Inside a region a smaller extent is as good, and no op there
  // stretches.
  ir::ValueId stretched(ir::ValueId id, const ir::Extent& extent);

  bool changed = false;  // anything came out other than it went in

 private:
  ir::ValueId append(const Candidate& candidate);

  ir::Builder& to_;
  std::vector<std::unordered_multimap<uint64_t, ir::OpId>> scopes_;
  std::unordered_set<uint32_t> opaque_;
};

// The rules; nullopt where none applies.
std::optional<ir::ValueId> fold(Emitter& emitter, const Candidate& candidate);
std::optional<ir::ValueId> apply_identity(Emitter& emitter, const Candidate& candidate);

}  // namespace dr::passes
