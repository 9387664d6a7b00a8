// SPDX-License-Identifier: Apache-2.0
// Elements that an invocation computes side by side: its members. An op whose value changes along none of the axes by
// which two members differ is written once for both, so that its reads are done once. Each member's own sums see their
// terms in the order in which they would alone: the bits are the same.
#include <algorithm>
#include <utility>

#include "compiler/backend/analysis/uses.h"
#include "compiler/backend/glsl/shader.h"
#include "compiler/ir/yields.h"

namespace dr::backend::glsl {

using ir::Op;
using ir::OpId;
using ir::ValueId;
using ir::Yield;

void Shader::set_members(ChangingAxes& changing, std::vector<Member> members) {
  changing_ = &changing;
  members_ = std::move(members);
  waiting_.assign(members_.size(), Scopes(1));
  at_ = members_[0].at;
  all_members();
}

void Shader::enter_member(size_t member) {
  if (member == member_) return;
  waiting_[member_] = std::exchange(scopes_, std::move(waiting_[member]));
  member_ = member;
  at_ = members_[member].at;
}

void Shader::only_member(size_t member) {
  enter_member(member);
  running_ = {member};
}

void Shader::all_members() {
  running_.clear();
  for (size_t k = 0; k < members_.size(); ++k) running_.push_back(k);
}

// Those of the members at hand that are at the same place on these axes.
std::vector<std::vector<size_t>> Shader::alike(Axes axes) const {
  if (running_.size() == 1) return {running_};
  std::vector<std::vector<size_t>> groups;
  const auto same = [&](size_t a, size_t b) {
    for (size_t axis = 0; axis < 3; ++axis)
      if (((axes >> axis) & 1) != 0 && members_[a].place[axis] != members_[b].place[axis]) return false;
    return true;
  };
  for (const size_t k : running_) {
    const auto group = std::ranges::find_if(groups, [&](const auto& g) { return same(g[0], k); });
    group == groups.end() ? groups.push_back({k}) : group->push_back(k);
  }
  return groups;
}

// What an op of all members uses of stored values, so that each is loaded once.
void Shader::load_for_all(const Op& op) {
  for (const ValueId v : uses_of(graph_, op).at_element) {
    if (graph_.value(v).region != graph_.root() || step_.stored.count(v) == 0 || is_defined(v)) continue;
    for (const std::vector<size_t>& group : alike(changing_->of(v))) {
      enter_member(group[0]);
      const std::string name = use(v);
      for (const size_t k : group) {
        enter_member(k);
        scopes_.front()[v] = name;
      }
    }
  }
}

void Shader::op_of_all(const Op& op) {
  if (op.parent == graph_.root()) load_for_all(op);
  Axes between = 0;
  for (const Member& m : members_)
    for (size_t axis = 0; axis < 3; ++axis)
      if (m.place[axis] != members_[0].place[axis]) between |= static_cast<Axes>(1 << axis);
  if (shares_trips(op, between, *changing_)) return reduce_op(op);
  for (const std::vector<size_t>& group : alike(changing_->of(op))) {
    enter_member(group[0]);
    const std::vector<size_t> all = std::exchange(running_, {group[0]});
    this->op(op);
    running_ = all;
    for (const ValueId v : op.results) {
      const auto found = scopes_.back().find(v);
      if (found == scopes_.back().end()) continue;
      const std::string text = found->second;
      for (const size_t k : group) {
        enter_member(k);
        define(v, text);
      }
      enter_member(group[0]);
    }
  }
}

// --- Loops that combine what their trips give ---

// Declares what a Reduce combines for one member, and gives the names.
std::vector<std::string> Shader::reduce_variables(const Op& op, const std::string& begin,
                                                  std::vector<std::string>& enter) {
  std::vector<std::string> names;
  const std::vector<ir::Yielded> yields = ir::yielded(graph_, op, op.regions[0]);
  for (size_t k = 0; k < op.results.size(); ++k) {
    const ir::ValueInfo& info = graph_.value(op.results[k]);
    const Yield yield = op.attrs.yields[k];
    names.push_back(yield == Yield::Scatter ? std::string() : unique(info.name.empty() ? "reduce" : info.name));
    if (yield == Yield::Sum) loop_variable(enter, info.type, names[k], zero(info.type));
    if (yield == Yield::Min || yield == Yield::Max)
      loop_variable(enter, info.type, names[k], limit(info.type, yield == Yield::Min));
    if (yield == Yield::ArgMin) {
      loop_variable(enter, info.type, names[k], begin + " - 1");
      const ir::Type& key = graph_.value(yields[k].value).type;
      loop_variable(enter, key, names[k] + "_best", limit(key, true));
      loop_variable(enter, ir::kBool, names[k] + "_none", "true");
    }
  }
  return names;
}

// For all members at hand.
void Shader::reduce_op(const Op& op) {
  enter_member(running_[0]);
  std::string begin = use(op.operands[0]), end = use(op.operands[1]);
  const ir::Region& body = graph_.region(op.regions[0]);
  const std::vector<std::vector<size_t>> groups = alike(running_.size() == 1 ? Axes{0} : changing_->of(op));
  std::vector<std::vector<std::string>> names;
  std::vector<std::string> enter;
  for (const std::vector<size_t>& group : groups) {
    enter_member(group[0]);
    names.push_back(reduce_variables(op, begin, enter));
  }
  forward_accumulators(op, op.regions[0]);
  const bool together = together_ && running_.size() > 1 && graph_.region(op.regions[0]).parent == together_->loop;
  if (together) {
    begin = open_together(begin, end);
    end = "min(" + begin + " + " + std::to_string(together_->trips) + ", " + end + ")";
  }
  const std::string trip = unique("i");
  const bool shared = begin_shared(op);
  if (shared) {
    // Counted from 0, since a range may end at the last integer.
    const std::string trips = unique("trips"), k = unique("k");
    body_.line("uint " + trips + " = " + begin + " < " + end + " ? uint(" + end + ") - uint(" + begin + ") : 0u;");
    body_.line("for (uint " + k + " = uint(" + sharing_->share + "); " + k + " < " + trips + "; " + k + " += uint(" +
               sharing_->shares + ")) {");
    body_.line("int " + trip + " = " + begin + " + int(" + k + ");");
  } else if (cut_) {
    loop_variable(enter, ir::kInt, trip, begin);
    open_loop(enter, trip + " < " + end, "++" + trip);
  } else {
    body_.line("for (int " + trip + " = " + begin + "; " + trip + " < " + end + "; ++" + trip + ") {");
  }
  if (together) since_[body.params[0]] = "(" + trip + " - " + begin + ")";
  const std::vector<size_t> running = running_;
  for (const size_t k : running) {
    enter_member(k);
    push_scope();
    define(body.params[0], trip);
  }
  element_ops(body.ops);
  std::vector<std::vector<Part>> found;
  for (const std::vector<size_t>& group : groups) {
    enter_member(group[0]);
    found.push_back(parts(op, op.regions[0]));
  }
  if (cut_) cut_->finish_trip(body_);
  for (size_t g = 0; g < groups.size(); ++g) combine(op, names[g], trip, found[g]);
  for (const size_t k : running) {
    enter_member(k);
    pop_scope();
  }
  close_loop();
  if (shared) end_shared(op, names[0]);
  if (together) body_.line("}");
  for (size_t g = 0; g < groups.size(); ++g)
    for (const size_t m : groups[g]) {
      enter_member(m);
      for (size_t k = 0; k < op.results.size(); ++k)
        if (!names[g][k].empty()) define(op.results[k], names[g][k]);
    }
}

// What a loop combines or counts, which starts as `first`; `enter` are the statements that a cut loop begins with.
void Shader::loop_variable(std::vector<std::string>& enter, const ir::Type& type, const std::string& name,
                           const std::string& first) {
  if (cut_)
    enter.push_back(cut_->keep(type, name) + " = " + first + ";");
  else
    body_.line(type.str() + " " + name + " = " + first + ";");
}

void Shader::open_loop(const std::vector<std::string>& enter, const std::string& goes_on, const std::string& advance) {
  if (cut_)
    cut_->open(body_, enter, goes_on, advance);
  else
    body_.line("for (; " + goes_on + "; " + advance + ") {");
}

void Shader::close_loop() { cut_ ? cut_->close(body_) : body_.line("}"); }

// --- Reads that a workgroup does together ---

void Shader::read_together(SharedReads reads) {
  together_ = std::move(reads);
  for (const auto& [id, part] : together_->reads) {
    const Op& op = graph_.op(id);
    const ir::Type& type = graph_.value(op.results[0]).type;
    const std::string name = "s_" + std::to_string(shared_.size());
    shared_[id] = name;
    declare("shared " + type.str() + " " + name + "[" + std::to_string(part.elements()) + "];\n");
  }
}

// The first place of the image in a part whose first trip is `trip`.
std::string Shader::first_place(const ReadPart& part, const std::string& trip) {
  std::string place;
  for (const ReadPart::Component& c : part.at) {
    std::string sum = std::to_string(c.constant);
    const auto plus = [&](const std::string& what, int64_t times) {
      sum += " + " + (times == 1 ? what : what + " * " + std::to_string(times));
    };
    static const char* const kAxis[] = {".x", ".y", ".z"};
    for (const ReadPart::Term& t : c.terms) {
      if (t.axis >= 0)
        plus(together_->origin + kAxis[t.axis], t.times);
      else if (graph_.region(graph_.value(t.trip).region).parent == together_->loop)
        plus(trip, t.times);
      else
        plus(std::to_string(t.first), t.times);
    }
    for (const auto& [v, times] : c.others) plus(use(v), times);
    place += (place.empty() ? "" : ", ") + sum;
  }
  return "ivec3(" + place + ")";
}

// Opens a loop over the parts of a loop's trips, in which the workgroup reads what they need; gives the first trip.
std::string Shader::open_together(const std::string& begin, const std::string& end) {
  std::string first = unique("first");
  body_.line("for (int " + first + " = " + begin + "; " + first + " < " + end + "; " + first +
             " += " + std::to_string(together_->trips) + ") {");
  body_.line("barrier();");
  for (const auto& [id, part] : together_->reads) {
    const Op& op = graph_.op(id);
    const std::string origin = unique("origin"), n = unique("n");
    body_.line("ivec3 " + origin + " = " + first_place(part, first) + ";");
    body_.line("for (int " + n + " = " + together_->lane + "; " + n + " < " + std::to_string(part.elements()) + "; " +
               n + " += " + std::to_string(together_->group) + ") {");
    const std::string w = std::to_string(part.at[0].extent), h = std::to_string(part.at[1].extent);
    const std::string in_part =
        "ivec3(" + n + " % " + w + ", (" + n + " / " + w + ") % " + h + ", " + n + " / (" + w + " * " + h + "))";
    body_.line(shared_.at(id) + "[" + n + "] = " + gather(op.operands[0], origin + " + " + in_part) + ";");
    body_.line("}");
  }
  body_.line("barrier();");
  return first;
}

// An expression of what a gather finds, where the workgroup has read it.
std::optional<std::string> Shader::shared_read(const Op& op) {
  const auto shared = shared_.find(graph_.value(op.results[0]).op);
  if (shared == shared_.end()) return std::nullopt;
  const auto read = std::ranges::find(together_->reads, shared->first, &std::pair<OpId, ReadPart>::first);
  static const char* const kAxis[] = {".x", ".y", ".z"};
  std::string index = "0";
  int64_t stride = 1;
  for (const ReadPart::Component& c : read->second.at) {
    for (const ReadPart::Term& t : c.terms) {
      const auto since = since_.find(t.trip);
      const std::string what = t.axis >= 0             ? members_[member_].in_group + kAxis[t.axis]
                               : since != since_.end() ? since->second
                                                       : "(" + use(t.trip) + " - " + std::to_string(t.first) + ")";
      index += " + " + what + (t.times * stride == 1 ? "" : " * " + std::to_string(t.times * stride));
    }
    stride *= c.extent;
  }
  return shared->second + "[" + index + "]";
}

}  // namespace dr::backend::glsl
