// SPDX-License-Identifier: Apache-2.0
// Which line of the program each op of a graph comes from. A bundle keeps it for the ops of its graph's text, so that
// what is compiled from that text again knows its lines, too.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "bundle_generated.h"
#include "compiler/ir/graph.h"
#include "dsl/source/source.h"

namespace dr::backend {

class SourceLines {
 public:
  SourceLines() = default;
  // From the ops' spans, which are of `sources`.
  SourceLines(const ir::Graph& graph, const dsl::SourceManager& sources);
  // From a bundle whose graph's text `graph` was read from; none where the bundle has none.
  SourceLines(const ir::Graph& graph, const bundle::BundleT& bundle);

  const std::vector<std::string>& files() const { return files_; }
  // Of `files`; none for what no line stands for.
  std::optional<bundle::Line> of(ir::OpId op) const;
  // Of a graph that was written anew; `from` says by op which one it was, if it was there.
  SourceLines moved(const std::vector<ir::OpId>& from) const;
  // As Bundle.op_lines keeps it.
  std::vector<bundle::Line> in_text_order(const ir::Graph& graph) const;

 private:
  std::vector<std::string> files_;
  std::vector<bundle::Line> lines_;  // by op; line 0: none
};

}  // namespace dr::backend
