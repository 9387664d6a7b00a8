// SPDX-License-Identifier: Apache-2.0
// One element-wise op as a differentiated program over many elements at once: its value, its gradient, and a second
// derivative that every adjoint op takes part in. Elements do not meet, so one run gives a difference quotient of each.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "compiler/reference/evaluate.h"
#include "tests/unit/ops/support.h"

namespace dr::gradient_test {

using ops_test::Form;

// The forms of an op that have float operands and a float result.
std::vector<Form> float_forms(ir::OpKind kind);

class Subject {
 public:
  Subject(ir::OpKind kind, const Form& form, size_t elements);

  // A number of one element: component c of operand k; the weight of the result or a direction in the gradient.
  struct Place {
    std::string leaf;
    int component = 0;
  };
  const std::vector<Place>& operands() const { return operands_; }      // the float ones
  const std::vector<Place>& conditions() const { return conditions_; }  // the others
  const std::vector<Place>& weights() const { return weights_; }
  const std::vector<Place>& directions() const { return directions_; }

  std::vector<double> get(const Place& place) const;
  void set(const Place& place, const std::vector<double>& values);

  // For each element: the result's components under the weights, and that sum's derivative at each place of operands();
  // the derivatives under the directions, and that sum's derivative at each place of operands(), then of weights().
  std::vector<double> value();
  std::vector<std::vector<double>> gradient();
  std::vector<double> slope();
  std::vector<std::vector<double>> second();

 private:
  std::vector<reference::Image> run(const std::string& step);

  size_t elements_;
  ir::Graph graph_;
  std::unique_ptr<reference::Session> session_;
  std::map<std::string, reference::Image> data_;
  std::vector<Place> operands_, conditions_, weights_, directions_;
};

}  // namespace dr::gradient_test
