// SPDX-License-Identifier: Apache-2.0
// Scatter passes that add by atomics: integers, floats in fixed point (fixed_sums.cpp), and floats as they arrive.
// Which elements run, in which dispatches.
#include <algorithm>
#include <set>

#include "compiler/backend/analysis/bins.h"
#include "compiler/backend/analysis/named_once.h"
#include "compiler/backend/analysis/uses.h"
#include "compiler/backend/emit/generator.h"
#include "compiler/backend/glsl/fixed_point.h"
#include "compiler/backend/schedule/limits.h"
#include "compiler/backend/schedule/rest.h"
#include "compiler/ir/yields.h"

namespace dr::backend {

using glsl::Accumulator;
using glsl::component;
using glsl::dim_expression;
using glsl::Shader;
using ir::OpKind;
using ir::ValueId;

namespace {

// Fewer elements than these have no targets to wait for, and joining takes as long as adding.
constexpr int kWorthJoining = 1 << 14;

// An element only grows: what a lane reads late is too small, and the atomic decides. Lanes that name one element send
// the largest of theirs.
std::string add_maximum(const std::string& to, const std::string& x, bool joins) {
  if (!joins) return "  if (" + to + " < " + x + ") atomicMax(" + to + ", " + x + ");\n";
  return "  if (" + to + " < " + x + ") {\n    int most = " + x +
         ";\n    bool sends = true;\n    for (int round = 0; joins && round < " + std::to_string(kJoinRounds) +
         "; ++round) {\n      if (subgroupBroadcastFirst(element) == element) {\n        most = subgroupMax(most);\n"
         "        sends = subgroupElect();\n        break;\n      }\n    }\n    if (sends) atomicMax(" +
         to + ", most);\n  }\n";
}

// A condition: some component is not zero.
std::string is_not_zero(const ir::Type& type, const std::string& x) {
  if (type.is_scalar()) return x + " != " + glsl::zero(type);
  if (type.cols == 1) return "any(notEqual(" + x + ", " + glsl::zero(type) + "))";
  std::string any;
  for (int c = 0; c < type.cols; ++c)
    any += (c == 0 ? "(" : " || ") + is_not_zero(ir::vec(type.rows, type.scalar), x + "[" + std::to_string(c) + "]");
  return any + ")";
}

// Invocations beside each other have an element: as many as a GPU runs at once, which go over the list. A dispatch as
// long as its list would start two microseconds later on an H200, as its size stands in memory. The second run has
// nothing to do as a rule.
constexpr int kAtOnce = 1 << 16, kAtOnceAgain = 1 << 15;
void share_loops(Shader& s) {
  const std::string at_once = std::to_string(kAtOnce), again = std::to_string(kAtOnceAgain);
  s.body().line("int shares = 1 << findMSB(clamp(" + at_once + " / max(end, 1), 1, " + std::to_string(kLoopShares) +
                ")), share = index % shares;");
  s.share_loops("share", "shares");
  s.body().line("for (index /= shares; index < end; index += (pc.a == 0 ? " + at_once + " : " + again +
                ") / shares) {");
  s.push_scope();
}

}  // namespace

int Generator::contributions(const ScatterSum& sum) const {
  int most = 0;
  for (const ValueId term : sum.terms) {
    const int one = backend::contributions(graph_, term);
    most = most < 0 || one < 0 ? -1 : most + one;
  }
  return most;
}

// The ops of a pass without the additions of what it scatters.
std::vector<ir::OpId> Generator::element_ops(const Pass& pass) const {
  std::set<ValueId> sums;
  for (const ScatterSum& sum : pass.get<ScatterPass>().sums) sums.insert(sum.terms.begin(), sum.terms.end());
  std::vector<ir::OpId> out;
  for (const ir::OpId id : pass.ops) {
    const ir::Op& op = graph_.op(id);
    const bool addition = op.kind == OpKind::Add && sums.count(op.operands[0]) != 0 && sums.count(op.operands[1]) != 0;
    if (addition)
      sums.insert(op.results[0]);
    else
      out.push_back(id);
  }
  return out;
}

uint32_t Generator::add_list(const Pass& pass, const std::string& name, bundle::ListKind kind) {
  const uint32_t list = add_scratch(pass.name + "_" + name, (element_count(pass.domain) + ir::Dim(kListHead)).str());
  bundle_->resources[list]->list = kind;
  fill("clear " + pass.name + " " + name, list, 1, std::to_string(kListHead));
  return list;
}

// Lists the elements that add something.
uint32_t Generator::list_active(const Pass& pass) {
  const uint32_t list = add_list(pass, "active", bundle::ListKind::Active);
  Shader s = shader();
  const ActiveList& elements = *pass.get<ScatterPass>().active_list();
  ListingLoop loop(s, pass.domain, std::get<OwnList>(elements.listed_by).in_runs);
  std::vector<ValueId> needed;
  for (const auto& clause : elements.clauses) needed.insert(needed.end(), clause.begin(), clause.end());
  s.element_ops(ops_of(graph_, pass.ops, needed));
  const std::string active = active_condition(s, elements.clauses);
  const std::string words = s.bind_words(list, "active_elements", bundle::Access::ReadWrite);
  s.body().line("if (" + active + ") {");
  loop.add(words, false, pass.get<ScatterPass>().shares_loops() ? kLoopShares : 1);
  s.body().line("}");
  const std::string invocations = loop.close();
  dispatch(pass, "_active", s, invocations);
  return list;
}

uint32_t Generator::list_nonzero(const Pass& pass, uint32_t listed) {
  const uint32_t list = add_list(pass, "nonzero", bundle::ListKind::Active);
  Shader s = shader();
  ListingLoop loop(s, pass.domain, s.read_words(listed, "listed_elements"));
  // Words tell it of exact sums; a float of them takes as long as ten of these questions.
  std::string nonzero;
  for (const ValueId v : pass.get<ScatterPass>().nonzero()) {
    const ir::Type& type = graph_.value(v).type;
    const ir::Extent& extent = resource(v).extent;
    const bool exact = resource(v).is_sums() && !adds_in_bins(extent);
    const std::string at = extent == pass.domain ? "element" : Shader::element_index(extent, "at");
    nonzero += (nonzero.empty() ? "(" : ") && (") + (exact ? anything_added(s, v, at) : is_not_zero(type, s.use(v)));
  }
  s.body().line("if (" + nonzero + ")) {");
  loop.add(s.bind_words(list, "nonzero_elements", bundle::Access::ReadWrite));
  s.body().line("}");
  loop.close();
  leave_guesses(s, pass);
  dispatch(pass, " nonzero", s, element_count(pass.domain).str()).indirect = static_cast<int>(listed);
  return list;
}

std::string Generator::active_condition(Shader& s, const Clauses& clauses) const {
  std::string active;
  for (const auto& clause : clauses) {
    std::string all;
    for (const ValueId v : clause) {
      const ir::Type& type = graph_.value(v).type;
      const std::string x = s.use(v);
      all += (all.empty() ? "" : " && ") + (type.is_bool() ? x : is_not_zero(type, x));
    }
    active += (active.empty() ? "" : " || ") + (clauses.size() > 1 ? "(" + all + ")" : all);
  }
  return active;
}

std::vector<const Pass*> Generator::listed_for(const Pass& pass) const {
  return backend::listed_for(*step_, pass_id(static_cast<size_t>(&pass - step_->passes.data())));
}

std::string Generator::list_suffix(const Pass& scatter) const {
  const std::vector<const Pass*> all = backend::listed_for(*step_, *scatter.lister());
  const auto place = std::ranges::find(all, &scatter) - all.begin();
  return place == 0 ? std::string() : "_" + std::to_string(place + 1);
}

void Generator::store_results(Shader& s, const Pass& pass, const std::vector<const Pass*>& scatters, ListingLoop* loop,
                              bool apart) {
  const std::vector<ValueId>& partial = pass.get<MapPass>().partial;
  const auto is_partial = [&](ValueId v) { return std::ranges::find(partial, v) != partial.end(); };
  for (const ValueId v : pass.writes)
    if (!is_partial(v)) store_changed(s, pass, v);
  if (const auto& told = pass.get<MapPass>().code.told; !told.empty()) tell_not_finite(s, pass, largest_bits(s, told));
  std::string finish;
  std::vector<Target*> together;
  for (const Pass* scatter : scatters)
    if (const auto& how = scatter->get<ScatterPass>(); how.joined_run() != nullptr && how.joins_groups())
      for (Target& t : targets_.at(scatter)) together.push_back(&t);
  find_same_places(together);
  for (const Pass* scatter : scatters) {
    const auto& how = scatter->get<ScatterPass>();
    if (how.joined_run() != nullptr) {
      finish += scatter_where_listed(s, pass, *scatter, apart);
      continue;
    }
    const std::string list =
        s.bind_words(active_lists_.at(scatter), "active_elements" + list_suffix(*scatter), bundle::Access::ReadWrite);
    s.body().line("if (" + active_condition(s, how.clauses()) + ") {");
    const int shares = how.shares_loops() ? kLoopShares : 1;
    if (loop != nullptr)
      loop->add(list, false, shares);
    else
      s.body().line(append(s, list, Shader::element_index(pass.domain, "at"), pass.domain, false, shares) + ";");
    store_partial(s, pass, *scatter);
    clear_listed(s, pass, *scatter);
    s.body().line("}");
  }
  if (!finish.empty()) {
    s.declare("void finish() {\n" + finish + "}\n");
    s.body().line("finish();");
  }
  if (!together.empty()) join_in_group(s, {together.begin(), together.end()});
}

void Generator::store_partial(Shader& s, const Pass& pass, const Pass& scatter) {
  for (const ValueId v : pass.get<MapPass>().partial)
    if (std::ranges::find(scatter.reads, v) != scatter.reads.end()) s.store(v, "at", s.use(v));
}

// Where few elements of a sum got anything, few of a leaf change, and the others are not written.
void Generator::store_changed(Shader& s, const Pass& pass, ValueId v) {
  const auto empties = [&](ValueId read) { return resource(read).is_emptied(); };
  const auto is_old = [&](ValueId read) { return resource_index(read) == resource_index(v); };
  const auto old = std::ranges::find_if(pass.reads, is_old);
  const bool may_skip =
      resource(v).is(Resource::Storage::Leaf) && old != pass.reads.end() && std::ranges::any_of(pass.reads, empties);
  if (may_skip) {
    const ir::Type& type = resource(v).type;
    std::string changed;
    for (int c = 0; c < type.components(); ++c) {
      const auto bits = [&](const std::string& x) {
        return type.is_float() ? "floatBitsToUint(" + component(type, x, c) + ")" : component(type, x, c);
      };
      changed += (c == 0 ? "" : " || ") + bits(s.use(v)) + " != " + bits(s.use(*old));
    }
    s.body().line("if (" + changed + ") {");
  }
  s.store(v, s.at(), s.use(v));
  if (may_skip) s.body().line("}");
}

std::vector<Generator::Target> Generator::scatter_targets(const Pass& pass, size_t first) {
  std::vector<Target> targets;
  const auto& scatter = pass.get<ScatterPass>();
  std::vector<ScatterSum> sums = scatter.sums;
  for (const ValueId v : pass.writes)
    if (graph_.op(graph_.value(v).op).kind == OpKind::ScatterMax) sums.push_back({v, {v}});
  const PassId id = pass_id(static_cast<size_t>(&pass - step_->passes.data()));
  uint32_t special = 0;
  if (scatter.asks()) {
    special = add_scratch(pass.name + "_special", "1");
    fill("clear " + pass.name + " special", special, 0, "1");
  }
  for (const ScatterSum& sum : sums) {
    const Resource& r = resource(sum.value);
    const Pass* const update = r.is_emptied() ? update_of(*step_, id, sum.value) : nullptr;
    if (update != nullptr && stepped_lists_.count(update) == 0) list_stepped(pass, *update, 0);
    const bool maximum = graph_.op(graph_.value(sum.value).op).kind == OpKind::ScatterMax;
    Target t{sum, {std::to_string(first + targets.size()), r.type, r.extent}, resource_index(sum.value), 0};
    t.fixed = r.type.is_float() && scatter.lowering() != ScatterLowering::Atomic && !named_once(graph_, sum.terms);
    t.binned = t.fixed && adds_in_bins(r.extent);
    t.fixed = t.fixed && !t.binned;
    if (t.fixed || t.binned) {
      t.most = contributions(sum);
      if (!r.is_sums()) t.words = add_scratch(r.name + "_sums", words_of_sums(r.type, r.extent, wide_atomics()).str());
      if (scatter.keeps_terms()) t.terms = add_scratch(r.name + "_terms", words_of_terms(t, pass.domain).str());
      if (scatter.guesses()) {
        t.guess = guesses_[t.words] = add_scratch(r.name + "_guess", "1");
        bundle_->resources[t.guess]->role = bundle::Role::Guess;
        t.special = special;
      }
    }
    // The pass that reads emptied sums leaves zeros in all but the head.
    t.emptied = r.is(Resource::Storage::EmptiedSums);
    t.update = update;
    if (scatter.joined_run() != nullptr) t.list = list_suffix(pass);
    t.run = scatter.joins_runs();
    if (scatter.joins_groups()) t.group = step_->pass(*scatter.lister()).get<MapPass>().code.joining_group;
    const bool head = t.emptied || r.is(Resource::Storage::ListedSums);
    if (!r.is(Resource::Storage::Emptied))
      fill("clear " + r.name, t.words, maximum ? 0x80000000u : 0u,
           head ? words_of_head(wide_atomics()).str() : std::string());
    targets.push_back(std::move(t));
  }
  return targets;
}

std::string Generator::declare_target(Shader& s, const Pass& pass, const Target& t, Runs runs, bool lists) {
  const std::string& id = t.accumulator.name;
  const Resource& r = resource(t.sum.value);
  const Adding adding = t.fixed    ? fixed_adding(s, pass, t, runs, lists)
                        : t.binned ? binned_adding(s, pass, t, runs, lists)
                                   : plain_adding(s, pass, t, runs);
  const bool keeps = runs == Runs::First && (t.terms != 0 || pass.get<ScatterPass>().joins_groups());
  const bool pairs = runs == Runs::Second && pass.get<ScatterPass>().joins_pairs();
  const std::string value = "(int element, " + r.type.str() + " value", site = ", int site";
  s.declare("void add_" + id + value + (keeps ? site : "") + ") {\n" + adding.body + "}\n");
  if (pairs) s.declare("void keep_" + id + value + site + ") {\n" + keep_for_pair(s, t) + "}\n");
  const bool sites = keeps || pairs;
  s.declare("void scatter_" + id + "(ivec3 place, " + r.type.str() + " value" + (sites ? site : "") + ") {\n  if (" +
            Shader::in_range(r.extent, "place") + ") " + (pairs ? "keep_" : "add_") + id + "(" +
            Shader::element_index(r.extent, "place") + ", value" + (sites ? ", site" : "") + ");\n}\n");
  for (size_t k = 0; k < t.sum.terms.size(); ++k) {
    Accumulator accumulator = t.accumulator;
    if (sites) accumulator.site = std::to_string(k);
    s.accumulate_into(t.sum.terms[k], std::move(accumulator));
  }
  return adding.finish;
}

Generator::Adding Generator::plain_adding(Shader& s, const Pass& pass, const Target& t, Runs runs) {
  const Resource& r = resource(t.sum.value);
  const bool maximum = graph_.op(graph_.value(t.sum.value).op).kind == OpKind::ScatterMax;
  const std::string buffer = s.bind(step_->stored.at(t.sum.value), bundle::Access::ReadWrite);
  const bool stored = named_once(graph_, t.sum.terms);
  if (r.type.is_float() && !stored) s.extension("GL_EXT_shader_atomic_float");
  Adding out;
  if (runs == Runs::Both) out.body = "  if (pc.a != 0) {\n";  // needs no first run
  // Elements that add nothing may all name one element, such as the first, and would wait for each other there.
  const auto* atomic = std::get_if<AtomicScatter>(&pass.get<ScatterPass>().how);
  const bool tests = r.type.is_float() && atomic != nullptr && atomic->skips_zeros;
  const bool joins = maximum && pass.get<ScatterPass>().joins_parts();
  if (joins) subgroup_extensions(s);
  const int n = r.type.components();
  for (int c = 0; c < n; ++c) {
    const std::string x = component(r.type, "value", c);
    const std::string to = buffer + ".d[element * " + std::to_string(n) + " + " + std::to_string(c) + "]";
    if (stored)
      out.body += "  " + to + " = " + x + ";\n";
    else if (maximum)
      out.body += add_maximum(to, x, joins);
    else
      out.body += "  " + (tests ? "if (" + x + " != 0.0) " : std::string()) + "atomicAdd(" + to + ", " + x + ");\n";
  }
  if (t.update != nullptr) out.body += wake(s, t, any_bits(r.type, "value"));
  if (runs == Runs::Both) out.body += "  }\n";
  return out;
}

std::string Generator::scatter_where_listed(Shader& s, const Pass& pass, const Pass& scatter, bool apart) {
  const auto& how = scatter.get<ScatterPass>();
  const bool fixed = how.lowering() == ScatterLowering::Exact, keeps = how.keeps_terms();
  const bool lists_added = fixed && !keeps && !how.runs_again();
  const std::string suffix = list_suffix(scatter), adds = "adds" + suffix, listed_at = "listed_at" + suffix;
  if (lists_added) s.declare("uint " + adds + " = 0u;\n");
  if (keeps) s.declare("uint " + listed_at + " = 0u;\n");
  std::string finish;
  if (how.asks()) {
    const std::string words =
        s.bind_words(targets_.at(&scatter).front().special, "special_words" + suffix, bundle::Access::ReadWrite);
    s.declare("uint special" + suffix + " = 0u;\n");
    finish += "  if (special" + suffix + " >= 0x7f800000u) atomicOr(" + words + ".d[0], 1u);\n";
  }
  for (Target t : targets_.at(&scatter)) {
    if (apart) t.run = 0;
    finish += declare_target(s, scatter, t, fixed ? Runs::First : Runs::Second, lists_added);
  }
  if (lists_added) s.body().line(adds + " = 0u;");
  s.body().line("if (" + active_condition(s, how.clauses()) + ") {");
  s.push_scope();
  const auto list = [&] {
    const std::string words =
        s.bind_words(active_lists_.at(&scatter), "active_elements" + suffix, bundle::Access::ReadWrite);
    if (how.joins_lanes()) subgroup_extensions(s);
    return append(s, words, Shader::element_index(pass.domain, "at"), pass.domain, how.joins_lanes());
  };
  if (keeps) {
    s.body().line(listed_at + " = " + list() + ";");
    for (const Target& t : targets_.at(&scatter)) keep_no_terms(s, scatter, t);
  }
  std::vector<ir::OpId> ops = element_ops(scatter);
  std::erase_if(ops, [&](ir::OpId id) { return s.is_defined(graph_.op(id).results[0]); });
  s.element_ops(ops);
  if (lists_added) s.body().line("if (" + adds + " != 0u) {\n    " + list() + ";");
  if (fixed) store_partial(s, pass, scatter);
  if (lists_added) s.body().line("}");
  s.pop_scope();
  s.body().line("}");
  return finish;
}

void Generator::scatter_pass(const Pass& pass) {
  const auto& scatter = pass.get<ScatterPass>();
  if (scatter.lowering() == ScatterLowering::Rows) return rows_pass(pass);
  const bool lists = scatter.relists(), joined = scatter.joined_run() != nullptr;
  const bool listed = !scatter.clauses().empty() && !scatter.runs_again();
  const bool keeps = scatter.keeps_terms(), joins_parts = scatter.joins_parts();
  // The second run of a scatter that guesses has nothing to do, as a rule: few invocations go over all elements.
  const bool strides = keeps || (joined && scatter.guesses());
  if (joined && scatter.exact() == nullptr) {
    for (const Target& t : targets_.at(&pass)) resolve_apart(pass, t);
    return;
  }
  uint32_t list = !listed ? 0 : scatter.lister() ? active_lists_.at(&pass) : list_active(pass);
  const bool sifts = !scatter.nonzero().empty();
  if (sifts) list = list_nonzero(pass, list);
  uint32_t adding = 0;
  if (lists) adding = add_list(pass, "adding", bundle::ListKind::Active);
  const std::vector<Target> targets = joined ? targets_.at(&pass) : scatter_targets(pass);
  const ir::Dim invocations = keeps     ? room_for_terms(pass.domain)
                              : strides ? looking_for_guesses(pass.domain)
                                        : element_count(pass.domain);
  const bool asks = scatter.asks();
  const uint32_t groups = asks ? ask_for_guesses(pass, targets, invocations) : 0;
  Shader s = shader();
  // Where elements have several invocations each, the list says where they end.
  linear_index(s, scatter.shares_loops() || asks ? std::string() : dim_expression(invocations));
  if (!lists && !listed && !strides) {
    // Pixels of a square share more elements than those of a row do.
    if (joins_parts && !scatter.cut()) index_in_tiles(s, pass.domain);
    place_from_index(s, pass.domain);
  }
  if (listed && !sifts) leave_guesses(s, pass);
  std::string finish;
  std::vector<ir::OpId> ops = element_ops(pass);
  const Cut cut = this->cut(s, pass, scatter.cut(), lists || listed ? "element" : "index");
  if (lists && !cut.how) s.declare("uint adds = 0u;\n");
  if (lists && cut.how) s.cut_loops().keep(ir::kUint, "adds", true);
  if (joins_parts) s.declare("bool joins = true;\n");
  const bool one_run = joined || scatter.binned() != nullptr;
  for (const Target& t : targets) finish += declare_target(s, pass, t, one_run ? Runs::Second : Runs::Both, lists);
  if (scatter.guesses() && !asks) s.body().line("if (" + guessed_right(targets) + ") return;");
  if (listed)
    for (const ValueId v : true_where_listed(graph_, pass)) {
      const ir::OpId by = graph_.value(v).op;
      const bool here = std::ranges::find(ops, by) != ops.end();
      if (here && graph_.op(by).results.size() > 1) continue;
      s.define(v, "true");
      std::erase(ops, by);
    }
  if (lists) {
    const std::string again = s.bind_words(adding, "adding_elements", bundle::Access::ReadWrite);
    const std::string first = listed ? s.read_words(list, "active_elements") : std::string();
    const std::string item = std::to_string(kListHead) + " + index", end = std::to_string(kListEnd);
    s.body().line("int end = pc.a == 0 ? " +
                  (listed ? "int(" + first + "(" + end + ")) - 1" : dim_expression(element_count(pass.domain))) +
                  " : int(" + again + ".d[" + end + "]) - 1;");
    if (joins_parts) s.body().line("joins = end >= " + std::to_string(kWorthJoining) + ";");
    s.body().line("if (index >= end) return;");
    s.body().line("int element = pc.a == 0 ? " + (listed ? "int(" + first + "(" + item + "))" : "index") + " : int(" +
                  again + ".d[" + item + "]);");
    place_from_index(s, pass.domain, "element");
    open_cut(s, cut, "return;");
    s.element_ops(ops);
    close_cut(s, cut);
    s.body().line("if (pc.a == 0 && adds != 0u) " + append(s, again, "element", pass.domain) + ";");
  } else {
    const std::string room =
        asks ? "int(" + s.read_words(groups, "groups") + "(0)) * " + std::to_string(bundle::kIndirectGroup)
             : dim_expression(invocations);
    if (strides && !listed) {
      s.body().line("for (int element = index; element < " + dim_expression(element_count(pass.domain)) +
                    "; element += " + room + ") {");
      s.push_scope();
      place_from_index(s, pass.domain, "element");
    } else if (listed) {
      const std::string elements = s.read_words(list, "active_elements");
      s.body().line("int end = int(" + elements + "(" + std::to_string(kListEnd) + ")) - 1;");
      if (joins_parts) s.body().line("joins = end >= " + std::to_string(kWorthJoining) + ";");
      if (strides) {
        if (keeps) add_kept_terms(s, pass, targets);
        s.body().line("for (" + (keeps ? "index += " + room : "") + "; index < end; index += " + room + ") {");
        s.push_scope();
      } else if (scatter.shares_loops()) {
        share_loops(s);
      } else {
        s.body().line("if (index >= end) return;");
      }
      s.body().line("int element = int(" + elements + "(" + std::to_string(kListHead) + " + index));");
      place_from_index(s, pass.domain, "element");
    }
    if (scatter.joins_pairs())
      for (const Target& t : targets) s.body().line(begin_pair(t));
    open_cut(s, cut, "return;");
    s.element_ops(ops);
    close_cut(s, cut);
    if (scatter.joins_pairs())
      for (const Target& t : targets) s.body().line(join_in_pair(s, t));
    if (strides || scatter.shares_loops()) {
      s.pop_scope();
      s.body().line("}");
    }
  }
  for (ValueId v : pass.writes)
    if (std::none_of(targets.begin(), targets.end(), [&](const Target& t) { return t.sum.value == v; }))
      s.store(v, "at", s.use(v));
  end_cut(s, cut);
  if (!finish.empty()) {
    s.body().line("finish();");
    s.declare("void finish() {\n" + finish + "}\n");
  }

  const bool two_runs = !finish.empty();
  auto& magnitudes = dispatch(pass, joined ? " add" : "", s, invocations.str(), {two_runs ? 0 : 1, 0, 0});
  if (scatter.shares_loops())
    magnitudes.elements = std::to_string(kAtOnce);
  else if (asks)
    magnitudes.indirect = static_cast<int>(groups);
  else if (listed && !strides)
    magnitudes.indirect = static_cast<int>(list);
  set_trips(magnitudes, cut);
  if (two_runs) {
    auto& sums_run = command(bundle::CommandKind::Dispatch, pass.name + " add");
    sums_run.compute = magnitudes.compute;
    for (const auto& b : magnitudes.bindings) sums_run.bindings.push_back(std::make_unique<bundle::BindingT>(*b));
    sums_run.elements = scatter.shares_loops() ? std::to_string(kAtOnceAgain) : magnitudes.elements;
    if (lists) sums_run.indirect = static_cast<int>(adding);
    sums_run.push = {1, 0, 0};
    set_trips(sums_run, cut);
  }
  for (const Target& t : targets) resolve_apart(pass, t);
}

void Generator::resolve_apart(const Pass& pass, const Target& target) {
  if (!resource(target.sum.value).is_sums()) scatter_resolve(pass, target);
}

void Generator::scatter_resolve(const Pass& pass, const Target& target) {
  const Accumulator& accumulator = target.accumulator;
  const ValueId value = target.sum.value;
  const ir::Type& type = accumulator.type;
  const int n = type.components();
  if (!type.is_float()) {
    if (graph_.op(graph_.value(value).op).kind != OpKind::ScatterMax) return;
    const ir::Dim count = element_count(accumulator.extent) * ir::Dim(n);
    Shader s = shader();
    linear_index(s, dim_expression(count));
    const std::string buffer = s.bind(step_->stored.at(value), bundle::Access::ReadWrite);
    s.body().line("if (" + buffer + ".d[index] == (-2147483647 - 1)) " + buffer + ".d[index] = 0;");
    dispatch(pass, "_resolve", s, count.str());
    return;
  }
  if (!target.fixed && !target.binned) return;
  const ir::Dim count = element_count(accumulator.extent);
  Shader s = shader();
  linear_index(s, dim_expression(count));
  const std::string out = s.bind(step_->stored.at(value), bundle::Access::Write);
  const FloatSums floats = float_sums(s, type, accumulator.extent, target.words, target.most, pass.domain);
  s.body().line(floats.statements);
  for (int c = 0; c < n; ++c)
    s.body().line(out + ".d[index * " + std::to_string(n) + " + " + std::to_string(c) +
                  "] = " + s.at_once(ir::kFloat, floats.components[static_cast<size_t>(c)]) + ";");
  dispatch(pass, "_resolve", s, count.str());
}

}  // namespace dr::backend
