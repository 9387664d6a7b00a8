// SPDX-License-Identifier: Apache-2.0
// Small programs in the graph's text form, run on small images.
#pragma once

#include <limits>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "compiler/ir/graph.h"
#include "compiler/reference/evaluate.h"

namespace dr::reference_test {

using reference::Image;
using Images = std::map<std::string, Image>;

// The graph of a text, which must be right.
ir::Graph parse(std::string_view text);

// Component-major data, as in Image.
Image image(std::string_view type, int64_t width, int64_t height, int64_t layers, std::vector<double> data);
// A row of scalars.
Image row(std::string_view type, std::vector<double> data);

// Binds the leaves and runs the step "s" once; both must succeed.
Images run(const ir::Graph& graph, const Images& leaves, const reference::Options& options = {});
Images run(std::string_view text, const Images& leaves, const reference::Options& options = {});
// The same for a step that has the output "r" alone.
Image result(std::string_view text, const Images& leaves, const reference::Options& options = {});
// The message of a run that must fail.
reference::EvalError error(const ir::Graph& graph, const Images& leaves, const reference::Options& options = {});

using Numbers = std::vector<double>;

inline constexpr double kInfinity = std::numeric_limits<double>::infinity();
inline constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

}  // namespace dr::reference_test
