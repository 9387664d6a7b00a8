// SPDX-License-Identifier: Apache-2.0
// Sums, minima and maxima over an image. An invocation folds 64 inputs, and up to 64 of them, side by side in a
// workgroup, fold what they found: a dispatch leaves one partial of 4,096 inputs. The tree is the same on every device:
// groups of eight, of eight groups, of 64 of those, and so on. In teams an invocation folds eight inputs, one of eight
// invocations what these found, and so on: the same tree.
#include <functional>
#include <string>

#include "compiler/backend/emit/generator.h"

namespace dr::backend {

using glsl::dim_expression;
using glsl::Shader;
using ir::Dim;
using ir::OpKind;
using ir::ValueId;

namespace {

class ReduceWriter {
 public:
  // `op`: what it does; `type`: of an input.
  ReduceWriter(const ir::Op& op, const ir::Type& type) : kind_(op.kind), type_(type) {}

  // Which inputs an invocation has: `begin` to `end` of result `o`, as lane `lane` of `lanes` for the partial
  // `partial`.
  static void open(Shader& s, const Dim& outs) {
    linear_index(s, "");
    s.body().line("int lanes = pc.a <= 64 ? 1 : min(2 << findMSB((pc.a - 1) / 64), 64);");
    s.body().line("int partial = index / lanes, lane = index % lanes, o = partial / pc.b;");
    s.body().line("int block = (partial % pc.b) * lanes * 64, begin = block + lane * 64;");
    s.body().line("bool is_due = o < " + dim_expression(outs) + ";");
    s.body().line("int end = is_due ? min(begin + 64, pc.a) : begin;");
  }

  // In teams: the same, and what an invocation folds are inputs begin .. end - 1 of result `o`. Partials have a number
  // of invocations that divides that of a workgroup.
  static void open_teams(Shader& s) {
    linear_index(s, "");
    const std::string team = std::to_string(bundle::kReducingTeam);
    s.body().line("int lanes = pc.a <= 64 ? 1 : min(2 << findMSB((pc.a - 1) / 64), 64), o = 0;");
    s.body().line("int here = int(gl_LocalInvocationID.x), width = lanes * " + team + ";");
    s.body().line("int partial = index / width, lane = index % width, first = here - lane;");
    s.body().line("bool is_due = partial < pc.b;");
    s.body().line("int block = partial * lanes * 64, count = is_due ? clamp(pc.a - block, 0, lanes * 64) : 0;");
    s.body().line("int begin = block + lane * 8, end = min(begin + 8, block + count);");
  }

  // Folds what `read` gives for r = begin .. end - 1 into a variable `into`, in groups of eight; statements before may
  // compute it.
  void fold(Shader& s, const std::string& into, const std::function<std::string()>& read) const {
    const std::string first = first_of();
    s.body().line(type_.str() + " " + into + " = " + first + ";");
    s.body().line("for (int g = begin; g < end; g += 8) {");
    s.body().line(type_.str() + " part = " + first + ";");
    s.body().line("int stop = min(g + 8, end);");
    s.body().line("for (int r = g; r < stop; ++r) {");
    s.push_scope();
    s.body().line(type_.str() + " x = " + read() + ";");
    combine(s, "part", "x");
    s.pop_scope();
    s.body().line("}");
    combine(s, into, "part");
    s.body().line("}");
  }

  // The same of scalars 0, 1, ..., which the function `fours` gives four at a time. Where lanes take turns at memory, a
  // read of four words takes as long as one of one word.
  void fold_fours(Shader& s, const std::string& into, const std::string& fours) const {
    const std::string first = first_of();
    s.body().line(type_.str() + " " + into + " = " + first + ";");
    s.body().line("for (int g = begin; g < end; g += 8) {");
    s.body().line(type_.str() + " part = " + first + ", x;");
    const std::string four = ir::vec(4, type_.scalar).str();
    s.body().line(four + " low = " + fours + "(g >> 2), high = " + fours + "((g >> 2) + 1);");
    for (int k = 0; k < 8; ++k) {
      const std::string read = (k < 4 ? "low[" : "high[") + std::to_string(k % 4) + "]";
      s.body().line("x = g + " + std::to_string(k) + " < end ? " + read + " : " + first + ";");
      combine(s, "part", "x");
    }
    combine(s, into, "part");
    s.body().line("}");
  }

  // In teams: each time an eighth of the lanes goes on, with what eight lanes found.
  void close_teams(Shader& s, const std::string& target) const {
    s.declare("shared " + type_.str() + " totals[" + std::to_string(kReducingGroup) + "];\n");
    for (const char* last : {"total", "total_2", "total_3"}) {
      s.body().line("barrier();");
      s.body().line(std::string("if (lane < count) totals[here] = ") + last + ";");
      s.body().line("barrier();");
      s.body().line("count = (count + 7) / 8;");
      s.body().line("begin = first + lane * 8;");
      s.body().line("end = min(begin + 8, first + count);");
      const std::string next = last == std::string("total")     ? "total_2"
                               : last == std::string("total_2") ? "total_3"
                                                                : "all";
      fold(s, next, [] { return "totals[r]"; });
    }
    s.body().line("if (lane != 0 || !is_due) return;");
    store(s, target);
  }

  // The lanes of a partial fold their totals, and the first one stores what comes of it.
  void close(Shader& s, const std::string& target) const {
    constexpr int kMostInGroup = 256;
    s.declare("shared " + type_.str() + " totals[" + std::to_string(kMostInGroup) + "];\n");
    s.body().line("int here = int(gl_LocalInvocationID.x);");
    s.body().line("totals[here] = total;");
    s.body().line("barrier();");
    s.body().line("if (lane != 0 || !is_due) return;");
    s.body().line("begin = here;");
    s.body().line("end = here + min(lanes, (pc.a - block + 63) / 64);");
    fold(s, "all", [] { return "totals[r]"; });
    store(s, target);
  }

 private:
  void store(Shader& s, const std::string& target) const {
    const int n = type_.components();
    for (int c = 0; c < n; ++c)
      s.body().line(target + ".d[partial * " + std::to_string(n) + " + " + std::to_string(c) +
                    "] = " + glsl::component(type_, "all", c) + ";");
  }

  // What changes no result.
  std::string first_of() const {
    return kind_ == OpKind::ReduceSum ? glsl::zero(type_) : glsl::limit(type_, kind_ == OpKind::ReduceMin);
  }

  void combine(Shader& s, const std::string& into, const std::string& what) const {
    if (kind_ == OpKind::ReduceSum) {
      s.body().line(into + " = " + into + " + " + what + ";");
      return;
    }
    for (int c = 0; c < type_.components(); ++c) {
      const std::string now = glsl::component(type_, into, c), other = glsl::component(type_, what, c);
      s.body().line("if (" + other + (kind_ == OpKind::ReduceMin ? " < " : " > ") + now + ") " + now + " = " + other +
                    ";");
    }
  }

  OpKind kind_;
  ir::Type type_;
};

// GLSL of source_place(o, r): the place of element r of result o, both of which count through their axes, x fastest.
std::string source_place(const ir::Op& op, const Dim* const (&axes)[3]) {
  std::string function = "ivec3 source_place(int o, int r) {\n  ivec3 at = ivec3(0);\n";
  for (const bool reduced : {true, false}) {
    const std::string counter = reduced ? "r" : "o";
    std::vector<size_t> counted;
    for (size_t a = 0; a < 3; ++a)
      if ((op.attrs.ints[a] != 0) == reduced && !axes[a]->is_one()) counted.push_back(a);
    for (const size_t a : counted) {
      function += "  at[" + std::to_string(a) + "] = " + counter;
      // What is left for the last one is within it: divisions take longer than the sum.
      if (const std::string d = dim_expression(*axes[a]); a != counted.back())
        function += " % " + d + "; " + counter + " /= " + d;
      function += ";\n";
    }
  }
  return function + "  return at;\n}\n";
}

}  // namespace

void Generator::reduce_pass(const Pass& pass) {
  constexpr int64_t kInputs = 4096;  // of a partial
  const ir::Op& op = graph_.op(pass.ops.back());
  const std::vector<ir::OpId> computing(pass.ops.begin(), pass.ops.end() - 1);  // what is folded
  const ValueId source = op.operands[0], target = op.results[0];
  const ir::Type type = resource(target).type;
  const ir::Extent& from = graph_.value(source).extent;
  const Dim* const axes[] = {&from.w, &from.h, &from.l};
  Dim outs = 1, count = 1;
  for (size_t a = 0; a < 3; ++a)
    (op.attrs.ints[a] != 0 ? count : outs) = (op.attrs.ints[a] != 0 ? count : outs) * *axes[a];
  const int n = type.components();
  const ReduceWriter writer(op, type);
  const std::string word = glsl::storage_scalar(type.scalar);

  const bool in_teams = pass.get<ReducePass>().in_teams;
  const auto open = [&](Shader& s) { in_teams ? ReduceWriter::open_teams(s) : ReduceWriter::open(s, outs); };
  const auto close = [&](Shader& s, const std::string& to) {
    in_teams ? writer.close_teams(s, to) : writer.close(s, to);
  };
  Shader first = strict_shader();
  open(first);
  // The target is bound by number: the first stage may write it or scratch.
  const Dim partials = (count + Dim(kInputs - 1)).divided_by(kInputs),
            later = (count + Dim(kInputs * kInputs - 1)).divided_by(kInputs * kInputs);
  const uint32_t a = add_scratch(pass.name + "_partials", (partials * outs * Dim(n)).str());
  const uint32_t b = add_scratch(pass.name + "_partials_2", (later * outs * Dim(n)).str());
  if (!in_teams && outs.is_one() && computing.empty() && first.may_read_fours(source)) {
    writer.fold_fours(first, "total", first.read_fours(source));
  } else {
    first.declare(source_place(op, axes));
    writer.fold(first, "total", [&] {
      first.body().line("ivec3 at = source_place(o, r);");
      first.element_ops(computing);
      return computing.empty() ? first.load(source, "at") : first.use(source);
    });
  }
  close(first, first.bind_words(a, "partials", bundle::Access::Write, word.c_str()));

  Shader next = strict_shader();
  open(next);
  const std::string in = next.bind_words(a, "inputs", bundle::Access::Read, word.c_str());
  const std::string out = next.bind_words(b, "partials", bundle::Access::Write, word.c_str());
  std::string words;
  for (int c = 0; c < n; ++c)
    words += (c ? ", " : "") + in + ".d[(o * pc.a + r) * " + std::to_string(n) + " + " + std::to_string(c) + "]";
  writer.fold(next, "total", [&] { return type.is_scalar() ? words : type.str() + "(" + words + ")"; });
  close(next, out);

  auto& c = command(bundle::CommandKind::Reduce, pass.name);
  c.group = in_teams ? kReducingGroup : 0;
  c.compute = add_shader(pass.name, bundle::Stage::Compute, first, static_cast<int>(c.group));
  c.bindings = first.take_bindings();
  c.bindings.pop_back();  // the output: target or scratch, as the sizes have it
  c.next = add_shader(pass.name + "_next", bundle::Stage::Compute, next, static_cast<int>(c.group));
  c.target = static_cast<int>(resource_index(target));
  c.outs = outs.str();
  c.count = count.str();
  c.scratch_a = static_cast<int>(a);
  c.scratch_b = static_cast<int>(b);
  c.push = {0, 0, 0};
}

}  // namespace dr::backend
