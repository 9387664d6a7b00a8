// SPDX-License-Identifier: Apache-2.0
// Tables of rows (RowsScatter) that the device makes: items sorted by target, those of one target in ascending order,
// as the host's are. Digit by digit from the lowest, four bits at a time, in an order that keeps that of equal digits:
// how often each of the 16 stands in each chunk of 64 items, running sums of that, and from there the place of each
// item. Nothing depends on which lane is first, and no lane has more than a chunk to do, however long the rows are.
// What none names a target with goes away with the first digit.
#include "compiler/backend/emit/generator.h"

namespace dr::backend {

using bundle::Access;
using glsl::dim_expression;
using glsl::Shader;
using ir::Dim;
using ir::ValueId;

namespace {

constexpr int kDigitBits = 4, kDigits = 1 << kDigitBits, kIndexBits = 31;
constexpr int kChunk = 64;   // items that a lane sorts; a count fits into 8 bits
constexpr int kGroup = 256;  // counts that a lane sums

// A digit of `key`, and the counts of a chunk, 16 of them of 8 bits each.
constexpr const char* kCounts = R"(
uvec4 seen = uvec4(0u);
int digit_of(int key) { return (key >> pc.a) & 15; }
int count_of(int digit) { return int((seen[digit >> 2] >> (8 * (digit & 3))) & 255u); }
void count(int digit) { seen[digit >> 2] += 1u << (8 * (digit & 3)); }
)";

// How many passes over the digits of 0 .. targets - 1 there are; one at least.
std::string digits_of(const Dim& targets) {
  return "max((findMSB(uint(" + dim_expression(targets) + ") - 1u) + " + std::to_string(kDigitBits) + ") / " +
         std::to_string(kDigitBits) + ", 1)";
}
int most_digits(const Dim& targets) {
  int bits = kIndexBits;
  if (targets.is_constant())
    for (bits = 1; bits < kIndexBits && (targets.constant() - 1) >> bits != 0;) ++bits;
  return (bits + kDigitBits - 1) / kDigitBits;
}

}  // namespace

struct Generator::Sort {
  const Pass& pass;
  const Dim& targets;    // rows
  const Dim count = {};  // of items, some of which may have no target
  const Dim chunks = count.divided_by(kChunk) + Dim(1);
  const Dim counts = chunks * Dim(kDigits);
  const Dim groups = counts.divided_by(kGroup) + Dim(1);
  // Where the number of digits depends on symbols, a last dispatch takes the items from where they are in the end.
  const bool known = targets.is_constant();
  const int digits = most_digits(targets);
  uint32_t keys[2] = {};  // pairs of an item and its target
  uint32_t count_words = 0, group_words = 0;
  Table table = {};

  std::string all_groups() const { return dim_expression(groups); }
};

namespace {

void put(Shader& s, const std::string& where, const std::string& what) {
  s.body().line(where + " = " + s.at_once(ir::kInt, what) + ";");
}

}  // namespace

Generator::Table Generator::sorted_table(const Pass& pass) {
  const RowsScatter& rows = pass.get<ScatterPass>().rows();
  Sort sort{pass, rows.targets, rows.items(pass.domain)};
  const auto scratch = [&](const std::string& name, const Dim& words) {
    return add_scratch(pass.name + name, words.str(), ir::kInt);
  };
  const Dim pairs = sort.count * Dim(2);
  sort.keys[0] = scratch("_keys", pairs);
  if (!sort.known || sort.digits > 1) sort.keys[1] = scratch("_keys_2", pairs);
  sort.count_words = scratch("_counts", sort.counts);
  sort.group_words = scratch("_groups", sort.groups + Dim(1));  // the last: of them all
  sort.table.starts = scratch("_rows_start", rows.targets + Dim(1));
  sort.table.items = scratch("_rows_item", pairs);

  key_pass(pass, sort.keys[0]);
  fill("clear " + pass.name + "_groups", sort.group_words, 0);
  if (sort.known) fill("clear " + pass.name + "_rows_item", sort.table.items, 0xffffffffu);
  for (int digit = 0; digit < sort.digits; ++digit) sort_by_digit(sort, digit);
  if (!sort.known) take_sorted_items(sort);
  find_rows(sort);
  return sort.table;
}

Shader Generator::digit_shader(const Sort& sort, const Dim& lanes) const {
  Shader s = strict_shader();
  linear_index(s, dim_expression(lanes));
  if (!sort.known)
    s.body().line("if (pc.a >= " + std::to_string(kDigitBits) + " * " + digits_of(sort.targets) + ") return;");
  return s;
}

void Generator::sort_by_digit(const Sort& sort, int digit) {
  const Pass& pass = sort.pass;
  const std::vector<int> push{kDigitBits * digit, 0, 0};
  const bool last = sort.known && digit == sort.digits - 1;
  const uint32_t from = sort.keys[digit % 2], to = last ? sort.table.items : sort.keys[1 - digit % 2];
  const std::string name = "_digit_" + std::to_string(digit), group = std::to_string(kGroup);
  const std::string place = "digit * " + dim_expression(sort.chunks) + " + index";
  // Goes over the items of a chunk that have a target.
  const auto each_item = [&](Shader& s, const auto& visit) {
    s.declare(kCounts);
    const std::string read = s.read_words(from, "from", "int"), sums = s.read_words(sort.group_words, "groups", "int");
    const std::string chunk = std::to_string(kChunk), sorted = sums + "(" + sort.all_groups() + ")";
    s.body().line("int end = min((index + 1) * " + chunk + ", pc.a == 0 ? " + dim_expression(sort.count) + " : " +
                  sorted + ");");
    s.body().line("for (int r = index * " + chunk + "; r < end; ++r) {");
    s.body().line("int key = " + read + "(2 * r + 1);");
    s.body().line("if (key < 0) continue;");
    s.body().line("int digit = digit_of(key);");
    visit(read, sums);
    s.body().line("count(digit);");
    s.body().line("}");
  };

  Shader count_items = digit_shader(sort, sort.chunks);
  each_item(count_items, [](const std::string&, const std::string&) {});
  const std::string out = count_items.bind_words(sort.count_words, "counts", Access::Write, "int");
  count_items.body().line("for (int digit = 0; digit < " + std::to_string(kDigits) + "; ++digit) {");
  put(count_items, out + ".d[" + place + "]", "count_of(digit)");
  count_items.body().line("}");
  dispatch(pass, name + "_count", count_items, sort.chunks.str(), push);

  sum_counts(sort, name, push);

  Shader move_items = digit_shader(sort, sort.chunks);
  const std::string out_keys = move_items.bind_words(to, "to", Access::Write, "int");
  const std::string before = move_items.read_words(sort.count_words, "counts", "int");
  each_item(move_items, [&](const std::string& read, const std::string& before_group) {
    Shader& s = move_items;
    s.body().line("int slot = " + place + ";");
    s.body().line("int at = " + before + "(slot) + " + before_group + "(slot / " + group + ") + count_of(digit);");
    put(s, out_keys + ".d[2 * at]", read + "(2 * r)");
    put(s, out_keys + ".d[2 * at + 1]", "key");
  });
  dispatch(pass, name + "_move", move_items, sort.chunks.str(), push);
}

// Sums of what stands before: in each group, then over the groups.
void Generator::sum_counts(const Sort& sort, const std::string& name, const std::vector<int>& push) {
  const std::string group = std::to_string(kGroup);
  Shader sum_groups = digit_shader(sort, sort.groups);
  {
    Shader& s = sum_groups;
    const std::string words = s.bind_words(sort.count_words, "counts", Access::ReadWrite, "int");
    const std::string sums = s.bind_words(sort.group_words, "groups", Access::Write, "int");
    s.body().line("int sum = 0, end = min((index + 1) * " + group + ", " + dim_expression(sort.counts) + ");");
    s.body().line("for (int k = index * " + group + "; k < end; ++k) {");
    s.body().line("int count = " + words + ".d[k];");
    put(s, words + ".d[k]", "sum");
    s.body().line("sum += count;");
    s.body().line("}");
    put(s, sums + ".d[index]", "sum");
  }
  dispatch(sort.pass, name + "_groups", sum_groups, sort.groups.str(), push);
  Shader sum_all = digit_shader(sort, Dim(1));
  {
    Shader& s = sum_all;
    const std::string sums = s.bind_words(sort.group_words, "groups", Access::ReadWrite, "int");
    s.body().line("int sum = 0;");
    s.body().line("for (int k = 0; k <= " + sort.all_groups() + "; ++k) {");
    s.body().line("int count = " + sums + ".d[k];");
    s.body().line(sums + ".d[k] = sum;");
    s.body().line("sum += count;");
    s.body().line("}");
  }
  auto& all = dispatch(sort.pass, name + "_all", sum_all, "1", push);
  // 67 million items are more steps than the device may allow: then the runtime refuses them.
  const Dim trips = sort.groups + Dim(2);
  if (const uint32_t most = schedule_.code.loop_trips; most > 0 && (!trips.is_constant() || trips.constant() > most)) {
    all.trips = trips.str();
    all.most_trips = most;
  }
}

void Generator::take_sorted_items(const Sort& sort) {
  Shader s = strict_shader();
  linear_index(s, dim_expression(sort.count));
  const std::string even = s.read_words(sort.keys[0], "even", "int"), odd = s.read_words(sort.keys[1], "odd", "int");
  const std::string sorted = s.read_words(sort.group_words, "groups", "int") + "(" + sort.all_groups() + ")";
  const std::string out = s.bind_words(sort.table.items, "items", Access::Write, "int");
  for (const std::string word : {"2 * index", "2 * index + 1"})
    put(s, out + ".d[" + word + "]",
        "(index >= " + sorted + " ? -1 : " + digits_of(sort.targets) + " % 2 == 0 ? " + even + "(" + word +
            ") : " + odd + "(" + word + "))");
  dispatch(sort.pass, "_rows_item", s, sort.count.str());
}

// The first item of each row by bisection.
void Generator::find_rows(const Sort& sort) {
  const Dim ends = sort.targets + Dim(1);
  Shader s = strict_shader();
  linear_index(s, dim_expression(ends));
  const std::string items = s.read_words(sort.table.items, "items", "int");
  const std::string sorted = s.read_words(sort.group_words, "groups", "int") + "(" + sort.all_groups() + ")";
  const std::string out = s.bind_words(sort.table.starts, "starts", Access::Write, "int");
  s.body().line("int low = 0, high = " + sorted + ";");
  s.body().line("while (low < high) {");
  s.body().line("int middle = low + (high - low) / 2;");
  s.body().line("if (" + items + "(2 * middle + 1) < index) low = middle + 1;");
  s.body().line("else high = middle;");
  s.body().line("}");
  put(s, out + ".d[index]", "low");
  dispatch(sort.pass, "_rows_start", s, ends.str());
}

// The target of each item, -1 where there is none.
void Generator::key_pass(const Pass& pass, uint32_t keys) {
  const auto& scatter = pass.get<ScatterPass>();
  const RowsScatter& rows = scatter.rows();
  const std::vector<ScatterLeaf>& places = rows.sorted()->places;
  const ir::Extent& to = graph_.value(scatter.sums[0].value).extent;
  const std::string names = std::to_string(rows.names());
  Shader s = strict_shader();
  linear_index(s, dim_expression(element_count(pass.domain)));
  place_from_index(s, pass.domain);
  const std::string out = s.bind_words(keys, "keys", Access::Write, "int");
  for (size_t k = 0; k < places.size(); ++k) {
    const ScatterLeaf& leaf = places[k];
    const std::string id = std::to_string(k);
    std::vector<ValueId> wanted{leaf.index};
    for (const ScatterLeaf::Branch& branch : leaf.path)
      if (branch.in_table) wanted.push_back(graph_.op(branch.op).operands[0]);
    s.body().line("{");
    s.push_scope();
    s.element_ops(ops_at(graph_, leaf, pass.ops, wanted));
    s.body().line("ivec3 place = " + s.place_of(leaf.index, s.use(leaf.index), to) + ";");
    std::string valid = Shader::in_range(to, "place");
    for (const ScatterLeaf::Branch& branch : leaf.path)
      if (branch.in_table)
        valid += std::string(" && ") + (branch.region == 0 ? "" : "!") + s.use(graph_.op(branch.op).operands[0]);
    s.body().line("int item = index * " + names + " + " + id + ";");
    s.body().line(out + ".d[2 * item] = " + s.at_once(ir::kInt, "item") + ";");
    s.body().line(out + ".d[2 * item + 1] = " +
                  s.at_once(ir::kInt, "(" + valid + " ? " + Shader::element_index(to, "place") + " : -1)") + ";");
    s.pop_scope();
    s.body().line("}");
  }
  dispatch(pass, "_keys", s, element_count(pass.domain).str());
}

}  // namespace dr::backend
