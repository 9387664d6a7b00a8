// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/analysis/source_lines.h"

#include <algorithm>
#include <functional>
#include <map>

namespace dr::backend {

namespace {

// In the order of the graph's text: an op stands before those of its regions.
void each_op(const ir::Graph& graph, ir::RegionId region, const std::function<void(ir::OpId)>& visit) {
  for (const ir::OpId id : graph.region(region).ops) {
    visit(id);
    for (const ir::RegionId inner : graph.op(id).regions) each_op(graph, inner, visit);
  }
}

}  // namespace

SourceLines::SourceLines(const ir::Graph& graph, const dsl::SourceManager& sources) : lines_(graph.op_count()) {
  std::map<uint32_t, uint32_t> files;  // FileId -> index
  each_op(graph, graph.root(), [&](ir::OpId id) {
    const dsl::Span& span = graph.op(id).span;
    if (!span.valid()) return;
    const auto [file, is_new] = files.try_emplace(span.file.index, static_cast<uint32_t>(files_.size()));
    if (is_new) files_.emplace_back(sources.name(span.file));
    lines_[id.index] = {file->second, sources.position(span.file, span.begin).line};
  });
}

SourceLines::SourceLines(const ir::Graph& graph, const bundle::BundleT& bundle)
    : files_(bundle.files), lines_(graph.op_count()) {
  size_t next = 0;
  each_op(graph, graph.root(), [&](ir::OpId id) {
    if (next < bundle.op_lines.size()) lines_[id.index] = bundle.op_lines[next++];
  });
}

std::optional<bundle::Line> SourceLines::of(ir::OpId op) const {
  if (op.index >= lines_.size() || lines_[op.index].line() == 0) return std::nullopt;
  return lines_[op.index];
}

SourceLines SourceLines::moved(const std::vector<ir::OpId>& from) const {
  SourceLines out;
  out.files_ = files_;
  for (const ir::OpId op : from) out.lines_.push_back(of(op).value_or(bundle::Line()));
  return out;
}

std::vector<bundle::Line> SourceLines::in_text_order(const ir::Graph& graph) const {
  std::vector<bundle::Line> out;
  each_op(graph, graph.root(), [&](ir::OpId id) { out.push_back(of(id).value_or(bundle::Line())); });
  return out;
}

}  // namespace dr::backend
