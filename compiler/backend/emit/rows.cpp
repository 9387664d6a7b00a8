// SPDX-License-Identifier: Apache-2.0
// Scatter passes as gathers: each target reads its sources in ascending order from a table (RowsScatter). Float sums
// are 64-bit fixed point numbers in registers, scaled for the largest contribution of the row. Blocks of 256 items that
// lie within one row are summed by a dispatch of their own before, so that no row is walked for long. On a GPU lanes
// share a row: what they add are integers.
#include <algorithm>
#include <set>

#include "compiler/backend/analysis/uses.h"
#include "compiler/backend/emit/generator.h"
#include "compiler/backend/glsl/fixed_point.h"
#include "compiler/backend/schedule/rest.h"

namespace dr::backend {

using glsl::component;
using glsl::dim_expression;
using glsl::Shader;
using ir::Dim;
using ir::ValueId;

namespace {

void declare_block(Shader& s, const Dim& items) {
  s.declare("const int block = " + dim_expression(row_block(items)) + ";\n");
}
constexpr const char* kBlockBits = "findMSB(block - 1) + 1";

// A sum of floats leaves these words for a block: the largest magnitude, flags, and low and high of each component; one
// of integers its components.
int words_of(const ir::Type& type) { return type.is_float() ? 2 + 2 * type.components() : type.components(); }

}  // namespace

Generator::Table Generator::rows_table(const RowsScatter& rows, const RowsOfLeaf& of) {
  std::string columns;
  for (const int c : of.columns) columns += (columns.empty() ? "" : ",") + std::to_string(c);
  const std::string base = "rows of " + schedule_.resources[of.leaf].name + ":" + columns + " to " + rows.targets.str();
  auto [it, is_new] = tables_.try_emplace(base);
  if (is_new) {
    const auto add = [&](const std::string& what, const ir::Type& type, const Dim& count) {
      auto r = std::make_unique<bundle::ResourceT>();
      r->name = base + " " + what;
      r->role = bundle::Role::Leaf;
      r->type = bundle_type(type);
      r->extent = bundle_extent({count, {}, {}});
      auto l = std::make_unique<bundle::LeafT>();
      l->name = r->name;
      l->kind = bundle::LeafKind::Input;
      l->type = bundle_type(type);
      l->extent = bundle_extent({count, {}, {}});
      l->resource = static_cast<uint32_t>(bundle_->resources.size());
      l->table = "rows:" + what + ":" + columns;
      l->table_of = static_cast<int>(of.leaf);
      bundle_->resources.push_back(std::move(r));
      bundle_->leaves.push_back(std::move(l));
      return static_cast<uint32_t>(bundle_->resources.size() - 1);
    };
    it->second.leaf = static_cast<uint32_t>(bundle_->leaves.size());
    it->second.table.starts = add("start", ir::kInt, rows.targets + Dim(1));
    const Dim items = schedule_.resources[of.leaf].extent.w * Dim(rows.names());
    it->second.table.items = add("item", ir::vec(2, ir::Scalar::Int), items);
  }
  step_tables_.insert(it->second.leaf);
  step_tables_.insert(it->second.leaf + 1);
  return it->second.table;
}

namespace {

// The text of one of the two shaders of a pass by rows.
class RowsWriter {
 public:
  RowsWriter(const ir::Graph& graph, const Pass& pass, const std::vector<ir::OpId>& ops, Shader& shader)
      : graph_(graph),
        pass_(pass),
        sums_(pass.get<ScatterPass>().sums),
        rows_(pass.get<ScatterPass>().rows()),
        ops_(ops),
        s_(shader) {
    s_.prelude(glsl::kFixedShift);
    s_.prelude(glsl::kFixedFromFloat);
    s_.prelude(glsl::kFixedAdd);
    if (rows_.sorted() != nullptr)
      plan_places(*rows_.sorted());
    else
      plan_columns(std::get<RowsOfLeaf>(rows_.table));
  }

  const ir::Type& type(size_t k) const { return graph_.value(sums_[k].value).type; }
  bool has_floats() const {
    return std::any_of(sums_.begin(), sums_.end(),
                       [&](const ScatterSum& sum) { return graph_.value(sum.value).type.is_float(); });
  }
  static std::string scalar_name(const ir::Type& type) { return type.scalar == ir::Scalar::Int ? "int" : "uint"; }
  static std::string total(size_t k, int c) { return "total_" + std::to_string(k) + "_" + std::to_string(c); }

  void declare_totals() {
    for (size_t k = 0; k < sums_.size(); ++k) {
      const std::string id = std::to_string(k);
      if (type(k).is_float()) line("uint largest_" + id + " = 0u, flags_" + id + " = 0u;");
      if (type(k).is_float()) line("int shift_" + id + " = 0;");
      for (int c = 0; c < type(k).components(); ++c)
        line(type(k).is_float() ? "uvec2 " + total(k, c) + " = uvec2(0u);"
                                : scalar_name(type(k)) + " " + total(k, c) + " = " + scalar_name(type(k)) + "(0);");
    }
  }

  // Adds the sums of a block, which begin at `word` of those of all.
  void add_block(const std::string& blocks) {
    int word = 0;
    const auto get = [&] { return blocks + "(word + " + std::to_string(word++) + ")"; };
    for (size_t k = 0; k < sums_.size(); ++k) {
      const std::string id = std::to_string(k);
      if (!type(k).is_float()) {
        for (int c = 0; c < type(k).components(); ++c) {
          const std::string sum = total(k, c);
          line("if (run == 1) " + sum + " += " + (type(k).scalar == ir::Scalar::Int ? "int(" + get() + ")" : get()) +
               ";");
        }
        continue;
      }
      line("uint block_largest_" + id + " = " + get() + ";");
      line("if (run == 0) largest_" + id + " = max(largest_" + id + ", block_largest_" + id + ");");
      line("else {");
      line("flags_" + id + " |= " + get() + ";");
      line("int by_" + id + " = fixed_shift(block_largest_" + id + ", " + kBlockBits + ") - shift_" + id + ";");
      for (int c = 0; c < type(k).components(); ++c) {
        const std::string sum = total(k, c);
        const std::string low = get(), high = get();
        line(sum + " = fixed_add(" + sum + ", fixed_halved(uvec2(" + low + ", " + high + "), by_" + id + "));");
      }
      line("}");
    }
  }

  // Room for what a lane's first items add, which then read nothing in the second run.
  void declare_kept(int items) {
    kept_ = has_floats() ? items : 0;
    if (kept_ > 0)
      for (const Value& value : values_)
        line(type(value.sum).str() + " kept_" + value.name + "[" + std::to_string(kept_) + "];");
  }

  // Adds item `r`, or in run 0 looks at its magnitude. Where there is room, it is a lane's item number `j`.
  void add_item(const std::string& items) {
    for (const Value& value : values_) line(type(value.sum).str() + " " + value.name + " = " + zero(value) + ";");
    if (kept_ > 0) {
      const std::string has_room = "j < " + std::to_string(kept_);
      line("if (run == 1 && " + has_room + ") {");
      for (const Value& value : values_) line(value.name + " = kept_" + value.name + "[j];");
      line("} else {");
      s_.push_scope();
      compute(items);
      s_.pop_scope();
      line("if (" + has_room + ") {");
      for (const Value& value : values_) line("kept_" + value.name + "[j] = " + value.name + ";");
      line("}");
      line("}");
    } else {
      compute(items);
    }
    for (const Value& value : values_) add_value(value.sum, value.name);
  }

  // Which lane of a row's this is; `index` becomes that of the row.
  void share(int lanes, const std::string& rows) {
    if (lanes > 1) {
      s_.extension("GL_KHR_shader_subgroup_basic");
      s_.extension("GL_KHR_shader_subgroup_shuffle");
      line("index += int(gl_SubgroupID * gl_SubgroupSize + gl_SubgroupInvocationID) - int(gl_LocalInvocationID.x);");
      line("int lane = index % " + std::to_string(lanes) + ";");
      line("index /= " + std::to_string(lanes) + ";");
    }
    line("if (index >= " + rows + ") return;");
  }

  // What lanes found of the largest magnitudes; sums of integers, in no order.
  void join_largest(int lanes) {
    if (lanes == 1 || !has_floats()) return;
    line("if (run == 0) {");
    for (int by = 1; by < lanes; by *= 2)
      for (size_t k = 0; k < sums_.size(); ++k)
        if (type(k).is_float()) {
          const std::string largest = "largest_" + std::to_string(k);
          line(largest + " = max(" + largest + ", " + shuffled(largest, by) + ");");
        }
    line("}");
  }
  void join_totals(int lanes) {
    for (int by = 1; by < lanes; by *= 2)
      for (size_t k = 0; k < sums_.size(); ++k) {
        const std::string flags = "flags_" + std::to_string(k);
        if (type(k).is_float()) line(flags + " |= " + shuffled(flags, by) + ";");
        for (int c = 0; c < type(k).components(); ++c)
          line(type(k).is_float()
                   ? total(k, c) + " = fixed_add(" + total(k, c) + ", " + shuffled(total(k, c), by) + ");"
                   : total(k, c) + " += " + shuffled(total(k, c), by) + ";");
      }
  }

  void set_shifts(const std::string& count) {
    for (size_t k = 0; k < sums_.size(); ++k)
      if (type(k).is_float())
        line("shift_" + std::to_string(k) + " = fixed_shift(largest_" + std::to_string(k) + ", " + count + ");");
  }

 private:
  void line(const std::string& text) { s_.body().line(text); }
  static std::string shuffled(const std::string& value, int by) {
    return "subgroupShuffleXor(" + value + ", " + std::to_string(by) + "u)";
  }
  int column_of(ValueId index) const {
    const ir::Op* op = &graph_.op(graph_.value(index).op);
    while (op->kind == ir::OpKind::Broadcast) op = &graph_.op(graph_.value(op->operands[0]).op);
    return op->kind == ir::OpKind::Extract ? static_cast<int>(op->attrs.ints[0]) : 0;
  }

  // A variable of what an item adds to a sum: of one term at most for every name or place, as adding takes most of the
  // text.
  struct Value {
    size_t sum;
    std::string name;
    std::set<int64_t> at;  // the names or places, by number
  };
  std::string zero(const Value& value) const { return glsl::zero(type(value.sum)); }

  // The value that a term of the sum at this name or place goes to.
  size_t value_for(size_t sum, int64_t at) {
    auto into = std::ranges::find_if(values_, [&](const Value& v) { return v.sum == sum && v.at.count(at) == 0; });
    if (into == values_.end()) into = values_.insert(into, {sum, s_.unique("x"), {}});
    into->at.insert(at);
    return static_cast<size_t>(into - values_.begin());
  }

  // What a source adds by the name `at` of those of a table of the host's.
  struct ByColumn {
    int64_t at;
    ValueId added;
    size_t value;
  };
  void plan_columns(const RowsOfLeaf& table) {
    for (size_t name = 0; name < table.columns.size(); ++name)
      for (size_t k = 0; k < sums_.size(); ++k)
        for (const ValueId term : sums_[k].terms) {
          const ir::Op& op = graph_.op(graph_.value(term).op);
          const auto at = static_cast<int64_t>(name);
          if (column_of(op.operands[0]) == table.columns[name])
            by_column_.push_back({at, op.operands[1], value_for(k, at)});
        }
  }

  // What a source adds at a place that the device sorts.
  struct AtPlace {
    int64_t at;
    ScatterLeaf leaf;
    const ScatterLeaf* place;
    size_t value;
  };
  void plan_places(const SortedRows& table) {
    for (size_t k = 0; k < sums_.size(); ++k)
      for (const ValueId v : sums_[k].terms) {
        const auto leaves = scatter_leaves(graph_, v);
        for (const ScatterLeaf& leaf : *leaves) {
          const auto place =
              std::ranges::find_if(table.places, [&](const ScatterLeaf& p) { return p.same_place(leaf); });
          const int64_t at = place - table.places.begin();
          at_places_.push_back({at, leaf, &*place, value_for(k, at)});
        }
      }
  }

  // The values of item `r`.
  void compute(const std::string& items) {
    line("int item = " + items + "(2 * r);");
    const int64_t names = rows_.names();
    const std::string source = "item / " + std::to_string(names);
    const ir::Extent& e = pass_.domain;
    line("int term = item % " + std::to_string(names) + ";");
    if (rows_.sorted() == nullptr || (e.h.is_one() && e.l.is_one())) {
      line("ivec3 at = ivec3(" + source + ", 0, layer);");
    } else {
      line("int source = " + source + ";");
      const std::string w = dim_expression(e.w), h = dim_expression(e.h);
      line("ivec3 at = ivec3(source % " + w + ", (source / " + w + ") % " + h + ", source / (" + w + " * " + h + "));");
    }
    for (size_t k = 0; k < by_column_.size();) {
      const int64_t name = by_column_[k].at;
      line(names == 1 ? std::string("{") : "if (term == " + std::to_string(name) + ") {");
      s_.push_scope();
      for (; k < by_column_.size() && by_column_[k].at == name; ++k) {
        const ByColumn& term = by_column_[k];
        s_.element_ops(ops_of(graph_, ops_, std::span(&term.added, 1)));
        line(values_[term.value].name + " = " + s_.use(term.added) + ";");
      }
      s_.pop_scope();
      line("}");
    }
    // Reads of one texture take most of what they add from the same values, so all of it is computed and one chosen,
    // rather than each in a branch of its own.
    std::set<ir::OpId> computed;
    for (const AtPlace& term : at_places_) {
      std::string condition = "term == " + std::to_string(term.at);
      const std::string value = value_at(term.leaf, *term.place, computed, condition);
      line("if (" + condition + ") " + values_[term.value].name + " = " + value + ";");
    }
  }

  // The value of a leaf, with ops that are not `computed` yet. What the table does not know of its conditions is added
  // to `condition`.
  std::string value_at(const ScatterLeaf& leaf, const ScatterLeaf& place, std::set<ir::OpId>& computed,
                       std::string& condition) {
    std::vector<ValueId> wanted{leaf.value};
    for (const ScatterLeaf::Branch& branch : place.path)
      if (!branch.in_table) wanted.push_back(graph_.op(branch.op).operands[0]);
    std::vector<ir::OpId> ops = ops_at(graph_, leaf, ops_, wanted);
    std::erase_if(ops, [&](ir::OpId id) { return !computed.insert(id).second; });
    s_.element_ops(ops);
    for (const ScatterLeaf::Branch& branch : place.path)
      if (!branch.in_table)
        condition += std::string(" && ") + (branch.region == 0 ? "" : "!") + s_.use(graph_.op(branch.op).operands[0]);
    return s_.use(leaf.value);
  }

  // `x`: a variable.
  void add_value(size_t k, const std::string& x) {
    const std::string id = std::to_string(k);
    if (!type(k).is_float()) {
      const char* once = has_floats() ? "if (run == 1) " : "";  // other sums of the pass go over the items twice
      for (int c = 0; c < type(k).components(); ++c) line(once + total(k, c) + " += " + component(type(k), x, c) + ";");
      return;
    }
    line("if (run == 0) {");
    for (int c = 0; c < type(k).components(); ++c)
      line("largest_" + id + " = max(largest_" + id + ", finite_magnitude(" + component(type(k), x, c) + "));");
    line("} else {");
    for (int c = 0; c < type(k).components(); ++c) {
      std::string part = component(type(k), x, c);
      line("flags_" + id + " |= " + flag_of(part, c) + ";");
      // As in scatter.cpp.
      const std::string limit = "uintBitsToFloat(largest_" + id + ")";
      if (s_.native()) part = "clamp(" + part + ", -" + limit + ", " + limit + ")";
      line(total(k, c) + " = fixed_add(" + total(k, c) + ", fixed_from_float(" + part + ", shift_" + id + "));");
    }
    line("}");
  }

  const ir::Graph& graph_;
  const Pass& pass_;
  const std::vector<ScatterSum>& sums_;
  const RowsScatter& rows_;
  const std::vector<ir::OpId>& ops_;
  Shader& s_;
  std::vector<Value> values_;
  std::vector<ByColumn> by_column_;
  std::vector<AtPlace> at_places_;
  int kept_ = 0;
};

}  // namespace

// Sums of the blocks that lie within one row, so many words of each of `blocks` times `layers`.
void Generator::sum_blocks(const Pass& pass, const Table& table, const std::vector<ir::OpId>& ops, const Dim& blocks,
                           const Dim& layers, uint32_t sums, int words) {
  const std::vector<ScatterSum>& all = pass.get<ScatterPass>().sums;
  const int lanes = pass.get<ScatterPass>().rows().lanes;
  const std::string block = "block", per_block = std::to_string(words);
  const Dim all_items = pass.get<ScatterPass>().rows().items(pass.domain);
  Shader b = shader();
  RowsWriter writer(graph_, pass, ops, b);
  declare_block(b, all_items);
  linear_index(b, "");
  writer.share(lanes, dim_expression(blocks * layers));
  const std::string items = b.read_words(table.items, "items", "int");
  const std::string out = b.bind_words(sums, "blocks", bundle::Access::Write);
  b.body().line("int layer = index / " + dim_expression(blocks) + ";");
  b.body().line("int begin = (index % " + dim_expression(blocks) + ") * " + block + ", end = begin + " + block + ";");
  b.body().line("if (end > " + dim_expression(all_items) + ") return;");
  b.body().line("int row = " + items + "(2 * begin + 1);");
  b.body().line("if (row < 0 || row != " + items + "(2 * end - 1)) return;");
  writer.declare_totals();
  b.body().line("for (int run = " + std::string(writer.has_floats() ? "0" : "1") + "; run < 2; ++run) {");
  b.body().line(lanes == 1 ? "for (int r = begin; r < end; ++r) {"
                           : "for (int r = begin + lane; r < end; r += " + std::to_string(lanes) + ") {");
  b.push_scope();
  writer.add_item(items);
  b.pop_scope();
  b.body().line("}");
  writer.join_largest(lanes);
  writer.set_shifts(kBlockBits);
  b.body().line("}");
  writer.join_totals(lanes);
  if (lanes > 1) b.body().line("if (lane != 0) return;");
  int word = 0;
  const auto put = [&](const std::string& value) {
    b.body().line(out + ".d[index * " + per_block + " + " + std::to_string(word++) + "] = " + value + ";");
  };
  for (size_t k = 0; k < all.size(); ++k) {
    const std::string id = std::to_string(k);
    const bool floats = writer.type(k).is_float();
    if (floats) put("largest_" + id), put("flags_" + id);
    for (int c = 0; c < writer.type(k).components(); ++c) {
      const std::string total = RowsWriter::total(k, c);
      if (floats)
        put(total + ".x"), put(total + ".y");
      else
        put("uint(" + total + ")");
    }
  }
  dispatch(pass, "_blocks", b, (blocks * layers * Dim(lanes)).str());
}

void Generator::rows_pass(const Pass& pass) {
  const std::vector<ScatterSum>& all = pass.get<ScatterPass>().sums;
  const RowsScatter& rows = pass.get<ScatterPass>().rows();
  const Table table = std::visit(Overloaded{[&](const RowsOfLeaf& of) { return rows_table(rows, of); },
                                            [&](const SortedRows&) { return sorted_table(pass); }},
                                 rows.table);
  const std::vector<ir::OpId> ops = element_ops(pass);
  const Dim layers = rows.sorted() != nullptr ? Dim(1) : pass.domain.l;  // that one table serves
  const Dim all_items = rows.items(pass.domain);
  const Dim blocks = all_items.divided_by(row_block(Dim(1)).constant()) + Dim(1);
  int words = 0;
  for (const ScatterSum& sum : all) words += words_of(graph_.value(sum.value).type);
  const std::string block = "block", per_block = std::to_string(words);
  const uint32_t sums = add_scratch(pass.name + "_blocks", (blocks * layers * Dim(words)).str());
  const Pass* update = update_of(*step_, pass_id(static_cast<size_t>(&pass - step_->passes.data())));
  if (update != nullptr) list_stepped(pass, *update, table.starts);
  if (update != nullptr && update->get<MapPass>().rest->in_blocks) update = nullptr;  // no list says which rows run

  sum_blocks(pass, table, ops, blocks, layers, sums, words);

  Shader s = shader();
  RowsWriter writer(graph_, pass, ops, s);
  declare_block(s, all_items);
  s.prelude(glsl::kFixedToFloat);
  std::string target = "index";
  const int lanes = update == nullptr ? rows.lanes : 1;
  constexpr int kKept = 4;
  if (lanes > 1) writer.declare_kept(kKept);
  if (update == nullptr) {
    linear_index(s, "");
    writer.share(lanes, dim_expression(rows.targets * layers));
  } else {
    s.body().line("int target = " + stepped_index(s, stepped_lists_.at(update)) + ";");
    target = "target";
  }
  const std::string starts = s.read_words(table.starts, "starts", "int");
  const std::string items = s.read_words(table.items, "items", "int");
  const std::string in = s.read_words(sums, "blocks");
  s.body().line("int layer = " + target + " / " + dim_expression(rows.targets) + ";");
  s.body().line("int row = " + target + " % " + dim_expression(rows.targets) + ";");
  s.body().line("int begin = " + starts + "(row), end = " + starts + "(row + 1);");
  s.body().line("int bits = findMSB(uint(end - begin)) + 1;");
  writer.declare_totals();
  s.body().line("for (int run = " + std::string(writer.has_floats() ? "0" : "1") + "; run < 2; ++run) {");
  if (lanes == 1) {
    s.body().line("for (int r = begin; r < end;) {");
    s.body().line("if (r % " + block + " == 0 && end - r >= " + block + ") {");
  } else {
    // The items before the first whole block, the whole blocks, and those behind them.
    s.body().line("int first = min((begin + " + block + " - 1) / " + block + " * " + block + ", end);");
    s.body().line("int lone = first - begin, whole = (end - first) / " + block + ";");
    s.body().line("int count = end - begin - whole * (" + block + " - 1);");
    s.body().line("for (int k = lane, j = 0; k < count; k += " + std::to_string(lanes) + ", ++j) {");
    s.body().line("bool is_block = k >= lone && k < lone + whole;");
    s.body().line("int r = begin + k + clamp(k - lone, 0, whole) * (" + block + " - 1);");
    s.body().line("if (is_block) {");
  }
  s.body().line("int word = (layer * " + dim_expression(blocks) + " + r / " + block + ") * " + per_block + ";");
  writer.add_block(in);
  if (lanes == 1) s.body().line("r += " + block + ";");
  s.body().line("} else {");
  s.push_scope();
  writer.add_item(items);
  s.pop_scope();
  if (lanes == 1) s.body().line("++r;");
  s.body().line("}");
  s.body().line("}");
  writer.join_largest(lanes);
  writer.set_shifts("bits");
  s.body().line("}");
  writer.join_totals(lanes);
  for (size_t k = 0; k < all.size(); ++k) {
    const ScatterSum& sum = all[k];
    const std::string out = s.bind(step_->stored.at(sum.value), bundle::Access::Write);
    const int n = writer.type(k).components();
    const auto put = [&](const std::string& total, const std::string& shift, const std::string& c) {
      const std::string value = writer.type(k).is_float()
                                    ? "fixed_to_float(" + total + ", shift_" + std::to_string(k) + ", " +
                                          flag_at("flags_" + std::to_string(k), shift) + ")"
                                    : total;
      s.body().line(out + ".d[" + target + " * " + std::to_string(n) + " + " + c +
                    "] = " + s.at_once({writer.type(k).scalar, 1, 1}, value) + ";");
    };
    if (lanes < n || n == 1) {
      if (lanes > 1) s.body().line("if (lane == 0) {");
      for (int c = 0; c < n; ++c) put(RowsWriter::total(k, c), std::to_string(kFlagBits * c), std::to_string(c));
      if (lanes > 1) s.body().line("}");
    } else {
      // A component a lane.
      std::string total = RowsWriter::total(k, n - 1);
      for (int c = n - 2; c >= 0; --c)
        total = "lane == " + std::to_string(c) + " ? " + RowsWriter::total(k, c) + " : " + total;
      s.body().line("if (lane < " + std::to_string(n) + ") {");
      s.body().line((writer.type(k).is_float() ? "uvec2" : RowsWriter::scalar_name(writer.type(k))) +
                    std::string(" of_lane = ") + total + ";");
      put("of_lane", "(" + std::to_string(kFlagBits) + " * lane)", "lane");
      s.body().line("}");
    }
  }
  auto& walk = dispatch(pass, "", s, (rows.targets * layers * Dim(lanes)).str());
  if (update != nullptr) {
    walk.indirect = static_cast<int>(stepped_lists_.at(update));
    for (const ScatterSum& sum : all) bundle_->resources[resource_index(sum.value)]->partial = true;
  }
  const Dim trips = row_walk(all_items, Dim(0), 1);  // where items have loops, all is known
  if (schedule_.code.loop_trips == 0 || trips.is_constant()) return;
  walk.trips = trips.str();
  walk.most_trips = schedule_.code.loop_trips;
}

}  // namespace dr::backend
