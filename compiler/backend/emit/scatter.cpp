// SPDX-License-Identifier: Apache-2.0
// Scatter passes that add by atomics. Exact float sums are independent of order and correct up to one rounding: a first
// run finds the largest contribution, a second adds 64-bit fixed point numbers scaled so that the sum cannot overflow
// (one 64-bit word, or two 32-bit words with carry: the same bits), and a last dispatch turns them into floats.
#include <algorithm>
#include <set>

#include "compiler/backend/analysis/named_once.h"
#include "compiler/backend/analysis/uses.h"
#include "compiler/backend/emit/generator.h"
#include "compiler/backend/glsl/fixed_point.h"
#include "compiler/ir/yields.h"

namespace dr::backend {

using glsl::Accumulator;
using glsl::component;
using glsl::dim_expression;
using glsl::Shader;
using ir::OpKind;
using ir::ValueId;

namespace {

// Words of an accumulator, of 32 bits or of 64 where the schedule says so: 0 the largest finite magnitude,
// 1 the number of contributions where it is counted, then two (one) for each component, then flags for each element,
// four bits a component: see special_flag.
constexpr int kHead = 2;

// Not 0 where a value is anything but zeros; NaN is. Without branches, of which drivers compile many slowly.
std::string any_bits(const ir::Type& type, const std::string& value) {
  std::string out;
  for (int c = 0; c < type.components(); ++c)
    out += (c > 0 ? " | " : "") + ("floatBitsToUint(" + component(type, value, c)) + ")";
  return "(" + out + ") & 0x7fffffffu";
}

std::string word_of(const std::string& element, int components, int c) {
  return std::to_string(kHead) + " + " + element + " * " + std::to_string(components) + " + " + std::to_string(c);
}

constexpr const char* kCountBits = R"(
int bits_of_count(uint count) { return count <= 1u ? 0 : findMSB(count - 1u) + 1; }
)";

// An upper bound of the logarithm of how many contributions there are: `most` from an element, or, if that is
// negative, as counted.
std::string count_bits(int most, const ir::Extent& domain, const std::string& counted) {
  if (most < 0) return "bits_of_count(uint(" + counted + "))";
  int bits = 1;
  while ((1 << (bits - 1)) < most) ++bits;
  return "findMSB(uint(" + dim_expression(element_count(domain)) + ")) + " + std::to_string(bits);
}

// Fewer elements than these have no targets to wait for, and joining takes as long as adding.
constexpr int kWorthJoining = 1 << 14;

// Lanes of a subgroup that add to the same element join their parts, and one of them goes on: for kJoinRounds elements,
// those of its first lanes. Lanes left over go on alone, and so do few, whose atomics take less time than a sum over
// the subgroup. The variable `adds_here` says which go on.
template <class Part>
std::string join_lanes(int n, const Part& part) {
  std::string out = "  bool adds_here = true;\n  for (int round = 0; joins && round < " + std::to_string(kJoinRounds) +
                    "; ++round) {\n    bool same = subgroupBroadcastFirst(element) == element;\n"
                    "    uvec4 lanes = subgroupBallot(same);\n    if (same) {\n"
                    "      if (subgroupBallotBitCount(lanes) > 1u) {\n";
  for (int c = 0; c < n; ++c) out += "        " + part(c) + " = fixed_subgroup_add(" + part(c) + ");\n";
  out +=
      "        flags = subgroupOr(flags);\n        adds_here = subgroupElect();\n      }\n      break;\n    }\n  }\n";
  return out;
}

}  // namespace

ir::Dim words_of_sums(const ir::Type& type, const ir::Extent& extent, bool wide) {
  const ir::Dim words = element_count(extent) * ir::Dim((wide ? 1 : 2) * type.components() + 1) + kHead;
  return wide ? words * ir::Dim(2) : words;
}

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
  s.element_ops(ops_at(graph_, {}, pass.ops, needed));
  const std::string active = active_condition(s, elements.clauses);
  const std::string words = s.bind_words(list, "active_elements", bundle::Access::ReadWrite);
  s.body().line("if (" + active + ") {");
  loop.add(words);
  s.body().line("}");
  const std::string invocations = loop.close();
  dispatch(pass, "_active", s, invocations);
  return list;
}

std::string Generator::active_condition(Shader& s, const Clauses& clauses) const {
  std::string active;
  for (const auto& clause : clauses) {
    std::string all;
    for (const ValueId v : clause) {
      const ir::Type& type = graph_.value(v).type;
      const std::string x = s.use(v);
      all += (all.empty() ? "" : " && ") + (type.is_bool()     ? x
                                            : type.is_scalar() ? x + " != " + glsl::zero(type)
                                                               : "any(notEqual(" + x + ", " + glsl::zero(type) + "))");
    }
    active += (active.empty() ? "" : " || ") + (clauses.size() > 1 ? "(" + all + ")" : all);
  }
  return active;
}

const Pass* Generator::listed_for(const Pass& pass) const {
  return backend::listed_for(*step_, pass_id(static_cast<size_t>(&pass - step_->passes.data())));
}

void Generator::store_results(Shader& s, const Pass& pass, ListingLoop* loop, bool active) {
  const std::vector<ValueId>& partial = pass.get<MapPass>().partial;
  const auto is_partial = [&](ValueId v) { return std::ranges::find(partial, v) != partial.end(); };
  for (const ValueId v : pass.writes)
    if (!is_partial(v)) s.store(v, s.at(), s.use(v));
  tell_not_finite(s, pass);
  const Pass* const scatter = listed_for(pass);
  if (scatter == nullptr || !active) return;
  if (scatter->get<ScatterPass>().joined_run() != nullptr) return scatter_where_listed(s, pass, *scatter);
  const std::string list = s.bind_words(active_lists_.at(scatter), "active_elements", bundle::Access::ReadWrite);
  s.body().line("if (" + active_condition(s, scatter->get<ScatterPass>().clauses()) + ") {");
  if (loop != nullptr)
    loop->add(list);
  else
    s.body().line(append(s, list, Shader::element_index(pass.domain, "at")) + ";");
  for (const ValueId v : partial) s.store(v, "at", s.use(v));
  s.body().line("}");
}

std::vector<Generator::Target> Generator::scatter_targets(const Pass& pass) {
  std::vector<Target> targets;
  const auto& scatter = pass.get<ScatterPass>();
  std::vector<ScatterSum> sums = scatter.sums;
  for (const ValueId v : pass.writes)
    if (graph_.op(graph_.value(v).op).kind == OpKind::ScatterMax) sums.push_back({v, {v}});
  for (const ScatterSum& sum : sums) {
    const Resource& r = resource(sum.value);
    const bool maximum = graph_.op(graph_.value(sum.value).op).kind == OpKind::ScatterMax;
    Target t{sum, {std::to_string(targets.size()), r.type, r.extent}, resource_index(sum.value), 0};
    t.fixed = r.type.is_float() && scatter.lowering() != ScatterLowering::Atomic && !named_once(graph_, sum.terms);
    if (t.fixed) {
      t.most = contributions(sum);
      if (!r.is(Resource::Storage::Sums))
        t.words = add_scratch(r.name + "_sums", words_of_sums(r.type, r.extent, wide_atomics()).str());
      if (scatter.keeps_terms()) t.terms = add_scratch(r.name + "_terms", words_of_terms(t, pass.domain).str());
      if (scatter.guesses()) {
        t.guess = guesses_[t.words] = add_scratch(r.name + "_guess", "1");
        bundle_->resources[t.guess]->role = bundle::Role::Guess;
      }
    }
    fill("clear " + r.name, t.words, maximum ? 0x80000000u : 0u);
    targets.push_back(std::move(t));
  }
  return targets;
}

std::string Generator::declare_target(Shader& s, const Pass& pass, const Target& t, Runs runs, bool lists) {
  const std::string& id = t.accumulator.name;
  const Resource& r = resource(t.sum.value);
  const Adding adding = t.fixed ? fixed_adding(s, pass, t, runs, lists) : plain_adding(s, pass, t, runs);
  const bool keeps = t.terms != 0 && runs == Runs::First;
  s.declare("void add_" + id + "(int element, " + r.type.str() + " value" + (keeps ? ", int site" : "") + ") {\n" +
            adding.body + "}\nvoid scatter_" + id + "(ivec3 place, " + r.type.str() + " value" +
            (keeps ? ", int site" : "") + ") {\n  if (" + Shader::in_range(r.extent, "place") + ") add_" + id + "(" +
            Shader::element_index(r.extent, "place") + ", value" + (keeps ? ", site" : "") + ");\n}\n");
  for (size_t k = 0; k < t.sum.terms.size(); ++k) {
    Accumulator accumulator = t.accumulator;
    if (keeps) accumulator.site = std::to_string(k);
    s.accumulate_into(t.sum.terms[k], std::move(accumulator));
  }
  return adding.finish;
}

Generator::Adding Generator::fixed_adding(Shader& s, const Pass& pass, const Target& t, Runs runs, bool lists) {
  const bool guesses = t.guess != 0;
  // Where a map adds, few lanes of a subgroup do.
  const bool joins_lanes = pass.get<ScatterPass>().joins_lanes() && !(runs == Runs::First && guesses);
  const std::string& id = t.accumulator.name;
  const std::string buffer = s.bind_words(t.words, "sums_" + id, bundle::Access::ReadWrite, sum_word());
  if (wide_atomics()) wide_extensions(s);
  if (joins_lanes) subgroup_extensions(s);
  s.prelude(glsl::kFixedShift);
  Adding out;
  if (runs != Runs::Second) {
    if (runs == Runs::Both) out.body += "  if (pc.a == 0) {\n";
    out.body += find_largest(s, pass, t, lists);
    if (runs == Runs::Both) out.body += guesses ? "  }\n" : "  } else {\n";
    const std::string guard = runs == Runs::Both ? "pc.a == 0 && " : "",
                      elect = joins_lanes ? " && subgroupElect()" : "";
    if (joins_lanes) out.finish += "  largest_" + id + " = subgroupMax(largest_" + id + ");\n";
    out.finish += "  if (" + guard + "largest_" + id + " != 0u" + elect + ") atomicMax(" + buffer + ".d[0], " +
                  sum_word() + "(largest_" + id + "));\n";
    if (t.most < 0)
      out.finish += "  if (" + guard + "count_" + id + " != 0u) atomicAdd(" + buffer + ".d[1], " +
                    std::string(sum_word()) + "(count_" + id + "));\n";
  }
  if (runs == Runs::First && !guesses) return out;
  s.prelude(glsl::kFixedFromFloat);
  s.prelude(joins_lanes ? glsl::kFixedSubgroup : "");
  choose_shift(s, pass, t, runs, buffer);
  out.body += add_fixed(s, t, runs, joins_lanes, buffer);
  if (runs == Runs::Both && !guesses) out.body += "  }\n";
  return out;
}

std::string Generator::find_largest(Shader& s, const Pass& pass, const Target& t, bool lists) {
  const std::string& id = t.accumulator.name;
  const ir::Type& type = t.accumulator.type;
  s.declare("uint largest_" + id + " = 0u" + (t.most < 0 ? ", count_" + id + " = 0u" : "") + ";\n");
  std::string out;
  if (t.most < 0) out += "    ++count_" + id + ";\n";
  for (int c = 0; c < type.components(); ++c)
    out += "    largest_" + id + " = max(largest_" + id + ", finite_magnitude(" + component(type, "value", c) + "));\n";
  if (t.terms != 0) out += keep_term(s, pass, t);
  if (lists) out += "    adds |= " + any_bits(type, "value") + ";\n";
  return out;
}

void Generator::choose_shift(Shader& s, const Pass& pass, const Target& t, Runs runs, const std::string& buffer) {
  const std::string& id = t.accumulator.name;
  const std::string where = runs == Runs::Both ? "if (pc.a == 1) " : "";
  s.declare("int shift_" + id + " = 0;\n");
  if (t.guess != 0) {
    const std::string guess = s.read_words(t.guess, "guess_" + id);
    s.declare("int guessed_" + id + " = 0;\n");
    s.body().line("guessed_" + id + " = int(" + guess + "(0));");
    s.body().line("shift_" + id + " = guessed_" + id + ";");
  }
  if (runs == Runs::First) return;
  s.prelude(t.most < 0 ? kCountBits : "");
  s.body().line(where + "shift_" + id + " = fixed_shift(uint(" + buffer + ".d[0]), " +
                count_bits(t.most, pass.domain, buffer + ".d[1]") + ");");
  // The first run may have computed a contribution with other roundings, even one that is all rounding error: larger
  // ones would overflow the sum.
  if (s.native()) {
    s.declare("float limit_" + id + " = 0.0;\n");
    s.body().line(where + "limit_" + id + " = uintBitsToFloat(uint(" + buffer + ".d[0]));");
  }
}

std::string Generator::add_fixed(Shader& s, const Target& t, Runs runs, bool joins_lanes, const std::string& buffer) {
  const std::string& id = t.accumulator.name;
  const ir::Type& type = t.accumulator.type;
  const bool wide = wide_atomics();
  const int n = type.components();
  const auto part = [](int c) { return "part_" + std::to_string(c); };
  const auto fixed = [&](int c, const std::string& shift) {
    std::string x = component(type, "value", c);
    if (s.native()) x = "clamp(" + x + ", -limit_" + id + ", limit_" + id + ")";
    return s.at_once(ir::vec(2, ir::Scalar::Uint), "fixed_from_float(" + x + ", " + shift + id + ")");
  };
  std::string out = "  uint flags = 0u;\n";
  for (int c = 0; c < n; ++c) {
    out += "  flags |= special_flag(" + component(type, "value", c) + ") << " + std::to_string(4 * c) + ";\n";
    out += "  uvec2 " + part(c) + " = " + fixed(c, "shift_") + ";\n";
  }
  if (t.guess != 0 && runs != Runs::First) {
    s.prelude(glsl::kFixedMinus);
    if (runs == Runs::Both) out += "  if (pc.a == 1) {\n";
    for (int c = 0; c < n; ++c)
      out += "  " + part(c) + " = fixed_minus(" + part(c) + ", " + fixed(c, "guessed_") + ");\n";
    if (runs == Runs::Both) out += "  }\n";
  }
  if (joins_lanes) out += join_lanes(n, part) + "  if (adds_here) {\n";
  for (int c = 0; c < n; ++c) {
    if (wide) {
      out += "  if (" + part(c) + " != uvec2(0u)) atomicAdd(" + buffer + ".d[" + word_of("element", n, c) +
             "], wide_of(" + part(c) + "));\n";
    } else {
      const std::string word = word_of("element", 2 * n, 2 * c);
      out += "  if (" + part(c) + " != uvec2(0u)) {\n    uint old = atomicAdd(" + buffer + ".d[" + word + "], " +
             part(c) + ".x);\n    atomicAdd(" + buffer + ".d[" + word_of("element", 2 * n, 2 * c + 1) + "], " +
             part(c) + ".y + (old + " + part(c) + ".x < old ? 1u : 0u));\n  }\n";
    }
  }
  const std::string flags = std::to_string(kHead) + " + " +
                            dim_expression(element_count(t.accumulator.extent) * ir::Dim((wide ? 1 : 2) * n)) +
                            " + element";
  out += "  if (flags != 0u) atomicOr(" + buffer + ".d[" + flags + "], " + std::string(sum_word()) + "(flags));\n";
  if (joins_lanes) out += "  }\n";
  return out;
}

std::string Generator::guessed_right(const std::vector<Target>& targets) {
  std::string out = "pc.a == 1";
  for (const Target& t : targets) out += " && shift_" + t.accumulator.name + " == guessed_" + t.accumulator.name;
  return out;
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
  const int n = r.type.components();
  for (int c = 0; c < n; ++c) {
    const std::string x = component(r.type, "value", c);
    const std::string to = buffer + ".d[element * " + std::to_string(n) + " + " + std::to_string(c) + "]";
    if (stored)
      out.body += "  " + to + " = " + x + ";\n";
    else
      out.body += "  " + (tests ? "if (" + x + " != 0.0) " : std::string()) + (maximum ? "atomicMax(" : "atomicAdd(") +
                  to + ", " + x + ");\n";
  }
  if (runs == Runs::Both) out.body += "  }\n";
  return out;
}

void Generator::scatter_where_listed(Shader& s, const Pass& pass, const Pass& scatter) {
  const auto& how = scatter.get<ScatterPass>();
  const bool fixed = how.lowering() == ScatterLowering::Exact, keeps = how.keeps_terms();
  if (fixed && !keeps) s.declare("uint adds = 0u;\n");
  if (keeps) s.declare("uint listed_at = 0u;\n");
  std::string finish;
  for (const Target& t : targets_.at(&scatter))
    finish += declare_target(s, scatter, t, fixed ? Runs::First : Runs::Second, fixed && !keeps);
  if (fixed && !keeps) s.body().line("adds = 0u;");
  s.body().line("if (" + active_condition(s, how.clauses()) + ") {");
  s.push_scope();
  const auto list = [&] {
    const std::string words = s.bind_words(active_lists_.at(&scatter), "active_elements", bundle::Access::ReadWrite);
    if (how.joins_lanes()) subgroup_extensions(s);
    return append(s, words, Shader::element_index(pass.domain, "at"), how.joins_lanes());
  };
  if (keeps) {
    s.body().line("listed_at = " + list() + ";");
    for (const Target& t : targets_.at(&scatter)) keep_no_terms(s, scatter, t);
  }
  std::vector<ir::OpId> ops = element_ops(scatter);
  std::erase_if(ops, [&](ir::OpId id) { return s.is_defined(graph_.op(id).results[0]); });
  s.element_ops(ops);
  if (fixed) {
    if (!keeps) s.body().line("if (adds != 0u) {\n    " + list() + ";");
    for (const ValueId v : pass.get<MapPass>().partial) s.store(v, "at", s.use(v));
    if (!keeps) s.body().line("}");
  }
  s.pop_scope();
  s.body().line("}");
  if (fixed) {
    s.declare("void finish() {\n" + finish + "}\n");
    s.body().line("finish();");
  }
}

void Generator::scatter_pass(const Pass& pass) {
  const auto& scatter = pass.get<ScatterPass>();
  if (scatter.lowering() == ScatterLowering::Rows) return rows_pass(pass);
  const bool lists = scatter.relists(), listed = !scatter.clauses().empty(), joined = scatter.joined_run() != nullptr;
  const bool keeps = scatter.keeps_terms(), joins_lanes = scatter.joins_lanes();
  // The second run of a scatter that guesses has nothing to do, as a rule: few invocations go over all elements.
  const bool strides = keeps || (joined && scatter.guesses());
  if (joined && scatter.lowering() == ScatterLowering::Atomic) return;
  const uint32_t list = !listed ? 0 : scatter.lister() ? active_lists_.at(&pass) : list_active(pass);
  uint32_t adding = 0;
  if (lists) adding = add_list(pass, "adding", bundle::ListKind::Active);
  const std::vector<Target> targets = joined ? targets_.at(&pass) : scatter_targets(pass);
  const ir::Dim invocations = strides ? room_for_terms(pass.domain) : element_count(pass.domain);
  Shader s = shader();
  linear_index(s, dim_expression(invocations));
  if (!lists && !listed) place_from_index(s, pass.domain);
  std::string finish;
  const std::vector<ir::OpId> ops = element_ops(pass);
  const Cut cut = this->cut(s, pass, scatter.cut(), lists || listed ? "element" : "index");
  if (lists && !cut.how) s.declare("uint adds = 0u;\n");
  if (lists && cut.how) s.cut_loops().keep(ir::kUint, "adds", true);
  if (joins_lanes) s.declare("bool joins = true;\n");
  for (const Target& t : targets) finish += declare_target(s, pass, t, joined ? Runs::Second : Runs::Both, lists);
  if (scatter.guesses()) s.body().line("if (" + guessed_right(targets) + ") return;");
  if (lists) {
    const std::string again = s.bind_words(adding, "adding_elements", bundle::Access::ReadWrite);
    const std::string first = listed ? s.read_words(list, "active_elements") : std::string();
    const std::string item = std::to_string(kListHead) + " + index", end = std::to_string(kListEnd);
    s.body().line("int end = pc.a == 0 ? " +
                  (listed ? "int(" + first + "(" + end + ")) - 1" : dim_expression(element_count(pass.domain))) +
                  " : int(" + again + ".d[" + end + "]) - 1;");
    if (joins_lanes) s.body().line("joins = end >= " + std::to_string(kWorthJoining) + ";");
    s.body().line("if (index >= end) return;");
    s.body().line("int element = pc.a == 0 ? " + (listed ? "int(" + first + "(" + item + "))" : "index") + " : int(" +
                  again + ".d[" + item + "]);");
    place_from_index(s, pass.domain, "element");
    open_cut(s, cut, "return;");
    s.element_ops(ops);
    close_cut(s, cut);
    s.body().line("if (pc.a == 0 && adds != 0u) " + append(s, again, "element") + ";");
  } else {
    if (listed) {
      const std::string elements = s.read_words(list, "active_elements");
      s.body().line("int end = int(" + elements + "(" + std::to_string(kListEnd) + ")) - 1;");
      if (joins_lanes) s.body().line("joins = end >= " + std::to_string(kWorthJoining) + ";");
      if (strides) {
        const std::string room = dim_expression(invocations);
        if (keeps) add_kept_terms(s, pass, targets);
        s.body().line("for (" + (keeps ? "index += " + room : "") + "; index < end; index += " + room + ") {");
        s.push_scope();
      } else {
        s.body().line("if (index >= end) return;");
      }
      s.body().line("int element = int(" + elements + "(" + std::to_string(kListHead) + " + index));");
      place_from_index(s, pass.domain, "element");
    }
    open_cut(s, cut, "return;");
    s.element_ops(ops);
    close_cut(s, cut);
    if (strides) {
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
  if (listed && !strides) magnitudes.indirect = static_cast<int>(list);
  set_trips(magnitudes, cut);
  if (two_runs) {
    auto& sums_run = command(bundle::CommandKind::Dispatch, pass.name + " add");
    sums_run.compute = magnitudes.compute;
    for (const auto& b : magnitudes.bindings) sums_run.bindings.push_back(std::make_unique<bundle::BindingT>(*b));
    sums_run.elements = magnitudes.elements;
    if (lists) sums_run.indirect = static_cast<int>(adding);
    sums_run.push = {1, 0, 0};
    set_trips(sums_run, cut);
  }
  for (const Target& t : targets)
    if (!resource(t.sum.value).is(Resource::Storage::Sums)) scatter_resolve(pass, t);
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
  if (!target.fixed) return;
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

Generator::FloatSums Generator::float_sums(Shader& s, const ir::Type& type, const ir::Extent& extent, uint32_t words,
                                           int most, const ir::Extent& domain) const {
  const bool wide = wide_atomics();
  if (wide) wide_extensions(s);
  const std::string sums = s.read_words(words, "sums_" + std::to_string(words), sum_word());
  s.prelude(glsl::kFixedShift);
  s.prelude(glsl::kFixedToFloat);
  s.prelude(most < 0 ? kCountBits : "");
  const int n = type.components();
  FloatSums out;
  out.statements = "int shift = fixed_shift(uint(" + sums + "(0)), " + count_bits(most, domain, sums + "(1)") +
                   "); uint flags = uint(" + sums + "(" + std::to_string(kHead) + " + " +
                   dim_expression(element_count(extent) * ir::Dim((wide ? 1 : 2) * n)) + " + index));";
  if (const auto guess = guesses_.find(words); guess != guesses_.end())
    out.statements += " if (index == 0) " +
                      s.bind_words(guess->second, "guess_" + std::to_string(words), bundle::Access::Write) +
                      ".d[0] = uint(shift);";
  for (int c = 0; c < n; ++c) {
    const std::string number = wide ? "words_of(" + sums + "(" + word_of("index", n, c) + "))"
                                    : "uvec2(" + sums + "(" + word_of("index", 2 * n, 2 * c) + "), " + sums + "(" +
                                          word_of("index", 2 * n, 2 * c + 1) + "))";
    out.components.push_back("fixed_to_float(" + number + ", shift, (flags >> " + std::to_string(4 * c) + ") & 15u)");
  }
  return out;
}

std::string Generator::sums_reader(Shader& s, ValueId value, const std::string& function) const {
  const ir::ValueInfo& info = graph_.value(value);
  for (const Pass& pass : step_->passes) {
    const auto* scatter = pass.as<ScatterPass>();
    if (scatter == nullptr) continue;
    for (const ScatterSum& sum : scatter->sums) {
      if (sum.value != value) continue;
      const FloatSums floats =
          float_sums(s, info.type, info.extent, resource_index(value), contributions(sum), pass.domain);
      std::string components;
      for (const std::string& c : floats.components) components += (components.empty() ? "" : ", ") + c;
      return info.type.str() + " " + function +
             "(ivec3 at) {\n  int index = " + Shader::element_index(info.extent, "at") + ";\n  " + floats.statements +
             "\n  return " + info.type.str() + "(" + components + ");\n}\n";
    }
  }
  DR_ICE("sums that no pass of the step adds up");
}

}  // namespace dr::backend
