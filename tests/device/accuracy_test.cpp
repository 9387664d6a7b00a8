// SPDX-License-Identifier: Apache-2.0
// Every op of the table on every device: value and derivatives at random and special operands, in last places of the
// exact result, against the bounds of accuracy/cases*.cpp. `./dr bench accuracy` takes more samples and writes
// docs/results/accuracy.md.
#include <cstdio>
#include <set>

#include "compiler/ops/op.h"
#include "tests/catch.h"
#include "tests/device/accuracy/measure.h"
#include "tests/device/devices.h"

using namespace dr;

TEST_CASE("the accuracy table has every op") {
  std::set<ir::OpKind> kinds;
  for (const accuracy::Case& c : accuracy::cases()) kinds.insert(c.kind);
  for (const auto& other : accuracy::elsewhere()) CHECK(kinds.insert(other.kind).second);
  for (const ir::OpKind kind : ir::all_op_kinds()) {
    INFO(ir::op_name(kind));
    CHECK(kinds.contains(kind));
  }
  // Each float operand of a differentiable element-wise op has its derivative looked at.
  for (const accuracy::Case& c : accuracy::cases()) {
    if (ops::info(c.kind).shape != ops::Shape::Elementwise || !ops::info(c.kind).differentiable) continue;
    INFO(c.name);
    for (const accuracy::Derivative& d : c.derivatives) CHECK(c.operands.at(d.operand).type.is_float());
  }
}

TEST_CASE("every op is as accurate on devices as the table says") {
  const std::vector<accuracy::Case> cases = accuracy::cases();
  for (const auto& [name, device] : test::devices()) {
    struct Way {
      const char *lower, *floats;
    };
    for (const auto& [lower, floats] : {Way{"compute", "strict"}, {"fragment", "strict"}, {"compute", "native"}}) {
      int64_t samples = 0, special = 0;
      const auto rows =
          accuracy::measure(device, cases, {.profile = name, .lower = lower, .float_profile = floats, .random = 2048});
      for (const accuracy::Row& row : rows) {
        INFO(name << " " << lower << " " << floats << ": " << row.op << " " << row.direction << ", worst at "
                  << row.worst_input << ": found " << row.found << ", expected " << row.expected << ", " << row.share
                  << " of what is allowed; not finite: " << row.not_finite);
        CHECK(row.share <= 1);
        CHECK(row.not_finite == 0);
        CHECK(row.samples > 0);
        samples += row.samples;
        special += row.special;
      }
      std::printf("%-12s %-9s %s: %zu functions, %lld errors, %lld special values outside the domains\n", name.c_str(),
                  lower, floats, rows.size(), static_cast<long long>(samples), static_cast<long long>(special));
    }
    for (const std::string& message : device.validation_messages()) FAIL("validation: " << message);
  }
}
