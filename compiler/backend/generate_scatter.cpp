// SPDX-License-Identifier: Apache-2.0
// Scatter passes. Float sums are exact up to one rounding and independent of order: a first run finds the largest
// contribution and how many there are, a second adds 64-bit fixed point numbers (two 32-bit words with carry, so no
// 64-bit integers are needed) scaled so that the sum cannot overflow, and a last dispatch turns them into floats.
#include <algorithm>

#include "compiler/backend/generate.h"

namespace dr::backend {

using glsl::Accumulator;
using glsl::dim_expression;
using glsl::Shader;
using ir::OpKind;
using ir::Scalar;
using ir::ValueId;

namespace {

// Words 0 and 1 of an accumulator: bits of the largest finite magnitude, number of contributions; then for each
// component (low, high, flags): flags 1 for a +Inf among the contributions, 2 for -Inf, 4 for NaN.
constexpr const char* kFixedShift = R"(
// Power of two that scales contributions below 2^(62 - log2(count)).
int fixed_shift(uint largest, uint count) {
  int exponent = int(largest >> 23) - 126;
  int bits = count <= 1u ? 0 : findMSB(count - 1u) + 1;
  return 62 - bits - exponent;
}

uint finite_magnitude(float value) {
  uint magnitude = floatBitsToUint(value) & 0x7fffffffu;
  return magnitude < 0x7f800000u ? magnitude : 0u;
}
)";

std::string fixed_add(const std::string& name, const std::string& words) {
  return "void fixed_add_" + name + "(int word, float value, int shift) {\n" +
         "  uint bits = floatBitsToUint(value);\n"
         "  uint magnitude = bits & 0x7fffffffu;\n"
         "  if (magnitude == 0u) return;\n"
         "  if (magnitude >= 0x7f800000u) {\n"
         "    atomicOr(" +
         words +
         ".d[word + 2], magnitude > 0x7f800000u ? 4u : (bits >> 31) != 0u ? 2u : 1u);\n"
         "    return;\n"
         "  }\n"
         "  uint mantissa = (magnitude & 0x7fffffu) | (magnitude >= 0x800000u ? 0x800000u : 0u);\n"
         "  int by = max(int(magnitude >> 23), 1) - 150 + shift;\n"
         "  uint low = 0u, high = 0u;\n"
         "  if (by >= 32) { high = mantissa << (by - 32); }\n"
         "  else if (by > 0) { low = mantissa << by; high = mantissa >> (32 - by); }\n"
         "  else if (by == 0) { low = mantissa; }\n"
         "  else if (by >= -24) { low = (mantissa + (1u << (-by - 1))) >> -by; }\n"
         "  if ((bits >> 31) != 0u) { low = ~low + 1u; high = ~high + (low == 0u ? 1u : 0u); }\n"
         "  uint old = atomicAdd(" +
         words +
         ".d[word], low);\n"
         "  atomicAdd(" +
         words +
         ".d[word + 1], high + (old + low < old ? 1u : 0u));\n"
         "}\n";
}

std::string component(const ir::Type& type, const std::string& name, int c) {
  return type.is_scalar() ? name : name + "[" + std::to_string(c) + "]";
}

}  // namespace

void Generator::scatter_pass(const Pass& pass) {
  const ir::Op& op = graph_.op(pass.ops.back());
  Shader s = shader();
  linear_index(s, dim_expression(element_count(pass.domain)));
  place_from_index(s, pass.domain);

  struct Target {
    ValueId value;
    Accumulator accumulator;
    uint32_t words;  // bundle resource
  };
  std::vector<Target> targets;
  std::string finish;
  for (size_t k = 0; k < op.results.size(); ++k) {
    const ValueId value = op.results[k];
    const bool scatters = op.regions.empty() || op.attrs.yields[k] == ir::Yield::Scatter;
    if (!scatters || step_->stored.count(value) == 0) continue;
    const Resource& r = resource(value);
    Target t{value, {std::to_string(targets.size()), r.type, r.extent}, 0};
    const std::string& id = t.accumulator.name;
    const int n = r.type.components();
    std::string body;
    if (r.type.is_float()) {
      const ir::Dim words = element_count(r.extent) * ir::Dim(3 * n) + 2;
      t.words = add_scratch(r.name + "_sums", words.str());
      fill("clear " + r.name, t.words, 0);
      const std::string buffer = s.bind_words(t.words, "sums_" + id, bundle::Access::ReadWrite);
      if (targets.empty()) s.prelude(kFixedShift);
      s.declare("uint largest_" + id + " = 0u, count_" + id + " = 0u;\nint shift_" + id + " = 0;\n");
      s.declare(fixed_add(id, buffer));
      s.body().line("if (pc.a == 1) shift_" + id + " = fixed_shift(" + buffer + ".d[0], " + buffer + ".d[1]);");
      body = "  if (pc.a == 0) {\n    ++count_" + id + ";\n";
      for (int c = 0; c < n; ++c)
        body += "    largest_" + id + " = max(largest_" + id + ", finite_magnitude(" + component(r.type, "value", c) +
                "));\n";
      body += "    return;\n  }\n";
      for (int c = 0; c < n; ++c)
        body += "  fixed_add_" + id + "(2 + (element * " + std::to_string(n) + " + " + std::to_string(c) + ") * 3, " +
                component(r.type, "value", c) + ", shift_" + id + ");\n";
      finish += "  if (pc.a == 0 && count_" + id + " != 0u) { atomicMax(" + buffer + ".d[0], largest_" + id +
                "); atomicAdd(" + buffer + ".d[1], count_" + id + "); }\n";
    } else {
      t.words = resource_index(value);
      const bool maximum = op.kind == OpKind::ScatterMax;
      fill("clear " + r.name, t.words, maximum ? 0x80000000u : 0u);
      const std::string buffer = s.bind(step_->stored.at(value), bundle::Access::ReadWrite);
      body = "  if (pc.a == 0) return;\n";  // integers need no first run
      for (int c = 0; c < n; ++c)
        body += std::string("  ") + (maximum ? "atomicMax(" : "atomicAdd(") + buffer + ".d[element * " +
                std::to_string(n) + " + " + std::to_string(c) + "], " + component(r.type, "value", c) + ");\n";
    }
    s.declare("void scatter_" + id + "(ivec3 place, " + r.type.str() + " value) {\n  if (!(" +
              Shader::in_range(r.extent, "place") +
              ")) return;\n  int element = " + Shader::element_index(r.extent, "place") + ";\n" + body + "}\n");
    s.accumulate_into(value, t.accumulator);
    targets.push_back(std::move(t));
  }
  s.element_ops(pass.ops);
  for (ValueId v : pass.writes)
    if (std::none_of(targets.begin(), targets.end(), [&](const Target& t) { return t.value == v; }))
      s.store(v, "at", s.use(v));
  s.body().line("finish();");
  s.declare("void finish() {\n" + finish + "}\n");

  const bool floats =
      std::any_of(targets.begin(), targets.end(), [](const Target& t) { return t.accumulator.type.is_float(); });
  auto& magnitudes = dispatch(pass, "", s, element_count(pass.domain).str(), {floats ? 0 : 1, 0, 0});
  if (floats) {
    auto& sums = command(bundle::CommandKind::Dispatch, pass.name + " add");
    sums.compute = magnitudes.compute;
    for (const auto& b : magnitudes.bindings) sums.bindings.push_back(std::make_unique<bundle::BindingT>(*b));
    sums.elements = magnitudes.elements;
    sums.push = {1, 0, 0};
  }
  for (const Target& t : targets) scatter_resolve(pass, t.value, t.accumulator, t.words);
}

void Generator::scatter_resolve(const Pass& pass, ValueId value, const Accumulator& accumulator, uint32_t words) {
  const ir::Type& type = accumulator.type;
  const ir::Dim count = element_count(accumulator.extent) * ir::Dim(type.components());
  const ir::Op& op = graph_.op(graph_.value(value).op);
  if (!type.is_float()) {
    if (op.kind != OpKind::ScatterMax) return;
    Shader s = shader();
    linear_index(s, dim_expression(count));
    const std::string buffer = s.bind(step_->stored.at(value), bundle::Access::ReadWrite);
    s.body().line("if (" + buffer + ".d[index] == (-2147483647 - 1)) " + buffer + ".d[index] = 0;");
    dispatch(pass, "_resolve", s, count.str());
    return;
  }
  Shader s = shader();
  linear_index(s, dim_expression(count));
  const std::string sums = s.bind_words(words, "sums", bundle::Access::Read);
  const std::string out = s.bind(step_->stored.at(value), bundle::Access::Write);
  s.prelude(kFixedShift);
  s.prelude(R"(
// 2^e for any e that a float can hold, without a rounding step of its own.
float power_of_two(int e) { return uintBitsToFloat(uint(clamp(e, -126, 127) + 127) << 23); }

// The nearest float of a fixed point number: its top 24 bits, the rest rounded half up.
float fixed_to_float(uint low, uint high, int shift) {
  bool negative = (high >> 31) != 0u;
  if (negative) { low = ~low + 1u; high = ~high + (low == 0u ? 1u : 0u); }
  if ((low | high) == 0u) return 0.0;
  int top = high != 0u ? findMSB(high) + 32 : findMSB(low);
  int drop = max(top - 23, 0);
  uint mantissa;
  if (drop == 0) mantissa = low;
  else {
    int cut = drop - 1;
    uint kept = cut >= 32 ? high >> (cut - 32) : cut == 0 ? low : (low >> cut) | (high << (32 - cut));
    mantissa = (kept + 1u) >> 1;
  }
  int e = drop - shift;
  int half_e = e / 2;
  float value = float(mantissa) * power_of_two(half_e) * power_of_two(e - half_e);
  return negative ? -value : value;
}
)");
  s.body().line("int word = 2 + 3 * index;");
  s.body().line("uint flags = " + sums + ".d[word + 2];");
  s.body().line("float value = fixed_to_float(" + sums + ".d[word], " + sums + ".d[word + 1], fixed_shift(" + sums +
                ".d[0], " + sums + ".d[1]));");
  s.body().line(
      "if (flags != 0u) value = uintBitsToFloat(flags == 1u ? 0x7f800000u : flags == 2u ? 0xff800000u : 0x7fc00000u);");
  s.body().line(out + ".d[index] = value;");
  dispatch(pass, "_resolve", s, count.str());
}

}  // namespace dr::backend
