// SPDX-License-Identifier: Apache-2.0
// The programs that are made of some functions of the table.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "compiler/ir/graph.h"
#include "tests/device/accuracy/library.h"

namespace dr::accuracy::library {

// Steps are named step_name(k) by the place of a function, leaves leaf_name(k, operand); the seed is operand "g".
std::string step_name(size_t function);
std::string leaf_name(size_t function, const Operand& operand);
std::string seed_name(size_t function);
std::string along_name(size_t function, const std::string& operand);
// The operands that the value has gradients to, by the function's directions.
std::vector<std::string> moved_operands(const Function& function);
// The names of outputs: "value" or "d_NAME"; with "scale_" or "except_" before them those that only the judge has.
std::string output_name(const Direction& direction);
bool is_next(const Direction& direction);

std::string device_text(std::span<const Function> functions);
std::string judge_text(std::span<const Function> functions);
// Forward and reverse mode: steps that output j_NAME, how the value changes along the leaf along_name(k, NAME), and
// d_NAME, its gradient, for each of the moved operands.
std::string transpose_text(std::span<const Function> functions);
std::string draw_text(std::span<const Function> functions);

// Messages of the compiler end the process, with the text.
ir::Graph graph_of(const std::string& text);

}  // namespace dr::accuracy::library
