// SPDX-License-Identifier: Apache-2.0
// Writes the text form described in print.h. It prints unsound graphs too: the verifier's messages quote it.
#include "compiler/ir/print.h"

#include <algorithm>
#include <charconv>
#include <cmath>

#include "compiler/ir/text_reader.h"

namespace dr::ir {

bool is_name_char(char c) {
  return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_' || c == '.';
}

std::string_view yield_name(Yield yield) {
  switch (yield) {
    case Yield::Element: return "element";
    case Yield::Sum: return "sum";
    case Yield::Min: return "min";
    case Yield::Max: return "max";
    case Yield::ArgMin: return "argmin";
    case Yield::Scatter: return "scatter";
  }
  DR_ICE("a yield without a name");
}

std::string_view leaf_kind_name(Leaf::Kind kind) {
  switch (kind) {
    case Leaf::Kind::Param: return "param";
    case Leaf::Kind::Input: return "input";
    case Leaf::Kind::State: return "state";
  }
  DR_ICE("a leaf kind without a name");
}

namespace {

constexpr uint32_t kNoNumber = UINT32_MAX;

void number_region(const Graph& graph, RegionId id, std::vector<uint32_t>& numbers, uint32_t& next) {
  const auto give = [&](ValueId value) {
    if (numbers[value.index] == kNoNumber) numbers[value.index] = next++;
  };
  for (ValueId param : graph.region(id).params) give(param);
  for (OpId op : graph.region(id).ops) {
    for (RegionId inner : graph.op(op).regions) number_region(graph, inner, numbers, next);
    for (ValueId result : graph.op(op).results) give(result);
  }
}

class Writer {
 public:
  Writer(const Graph& graph, std::span<const uint32_t> numbers) : graph_(graph), numbers_(numbers) {}

  std::string graph() {
    for (const Leaf& leaf : graph_.leaves) write_leaf(leaf);
    for (OpId op : graph_.region(graph_.root()).ops) write_op(op, 0);
    for (const Step& step : graph_.steps) write_step(step);
    return std::move(out_);
  }

  // Results, name, operands, attributes.
  std::string head(OpId id) {
    write_head(id);
    return std::move(out_);
  }

 private:
  void write_name(std::string_view name) { out_ += written_name(name); }

  template <class T>
  void write_number(T number) {
    char buffer[32];
    out_.append(buffer, std::to_chars(buffer, buffer + sizeof buffer, number).ptr);
  }

  void write_float(double number) {
    if (std::isnan(number)) {  // to_chars would tell the sign of a NaN
      out_ += "nan";
    } else {
      write_number(number);
    }
  }

  template <class Range, class Write>
  void write_list(const Range& items, Write write) {
    bool first = true;
    for (const auto& item : items) {
      if (!first) out_ += ", ";
      write(item);
      first = false;
    }
  }

  template <class Range, class Write>
  void write_attr(std::string_view key, const Range& items, Write write) {
    if (items.empty()) return;
    out_ += ' ';
    out_ += key;
    out_ += " [";
    write_list(items, write);
    out_ += ']';
  }

  void write_use(ValueId id) { out_ += print_use(graph_, id, numbers_); }

  void write_definition(ValueId id) {
    const ValueInfo& info = graph_.value(id);
    write_use(id);
    out_ += info.accumulation ? " : accumulation " : " : ";
    out_ += info.type.str();
    out_ += info.extent.str();
  }

  void write_leaf(const Leaf& leaf) {
    out_ += "leaf ";
    write_name(leaf.name);
    out_ += " : " + leaf.type.str() + leaf.extent.str() + ' ';
    out_ += leaf_kind_name(leaf.kind);
    write_attr("=", leaf.initial, [&](double number) { write_float(number); });
    if (leaf.is_fixed) out_ += " fixed";
    if (!leaf.table.empty()) {
      out_ += " topology " + leaf.table + ' ';
      write_name(leaf.table_of);
    }
    out_ += '\n';
  }

  void write_head(OpId id) {
    const Op& op = graph_.op(id);
    write_list(op.results, [&](ValueId result) { write_definition(result); });
    out_ += op.results.empty() ? "= " : " = ";
    out_ += op_name(op.kind);
    if (!op.operands.empty()) out_ += ' ';
    write_list(op.operands, [&](ValueId operand) { write_use(operand); });
    write_attr("ints", op.attrs.ints, [&](int64_t number) { write_number(number); });
    write_attr("floats", op.attrs.floats, [&](double number) { write_float(number); });
    write_attr("dims", op.attrs.dims, [&](const Dim& dim) { out_ += dim.str(); });
    write_attr("yields", op.attrs.yields, [&](Yield yield) { out_ += yield_name(yield); });
    if (!op.attrs.text.empty()) {
      out_ += " text ";
      out_ += quoted_text(op.attrs.text);
    }
  }

  void write_op(OpId id, size_t depth) {
    out_.append(2 * depth, ' ');
    write_head(id);
    for (RegionId region_id : graph_.op(id).regions) {
      const Region& region = graph_.region(region_id);
      if (!region.params.empty()) {
        out_ += " (";
        write_list(region.params, [&](ValueId param) { write_definition(param); });
        out_ += ')';
      }
      out_ += " {\n";
      for (OpId inner : region.ops) write_op(inner, depth + 1);
      out_.append(2 * depth + 2, ' ');
      out_ += region.yields.empty() ? "yield" : "yield ";
      write_list(region.yields, [&](ValueId yield) { write_use(yield); });
      out_ += '\n';
      out_.append(2 * depth, ' ');
      out_ += '}';
    }
    out_ += '\n';
  }

  void write_step(const Step& step) {
    out_ += "step ";
    write_name(step.name);
    out_ += " {\n";
    for (const Output& output : step.outputs) {
      out_ += "  output ";
      write_name(output.name);
      out_ += ' ';
      write_use(output.value);
      out_ += '\n';
    }
    for (const Update& update : step.updates) {
      out_ += "  update ";
      write_name(update.leaf < graph_.leaves.size() ? graph_.leaves[update.leaf].name : "?");
      out_ += ' ';
      write_use(update.value);
      out_ += '\n';
    }
    out_ += "}\n";
  }

  const Graph& graph_;
  std::span<const uint32_t> numbers_;
  std::string out_;
};

}  // namespace

std::vector<uint32_t> print_numbers(const Graph& graph) {
  std::vector<uint32_t> numbers(graph.value_count(), kNoNumber);
  uint32_t next = 0;
  number_region(graph, graph.root(), numbers, next);
  return numbers;
}

std::string print(const Graph& graph) {
  const auto numbers = print_numbers(graph);
  return Writer(graph, numbers).graph();
}

std::string print_use(const Graph& graph, ValueId id, std::span<const uint32_t> numbers) {
  if (id.index >= numbers.size() || numbers[id.index] == kNoNumber) return "%?";  // only of unsound graphs
  const std::string& name = graph.value(id).name;
  return "%" + (name.empty() ? "" : written_name(name) + ".") + std::to_string(numbers[id.index]);
}

std::string print_op(const Graph& graph, OpId op, std::span<const uint32_t> numbers) {
  return Writer(graph, numbers).head(op);
}

}  // namespace dr::ir
