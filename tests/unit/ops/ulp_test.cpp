// SPDX-License-Identifier: Apache-2.0
// How far the GLSL of an op is from its float64 evaluation, in last places of float32, at random numbers of its domains
// and at its singular points. The GLSL of scalars is as good as C++: it is compiled as that, with GLSL's functions
// around it, and run on the CPU in float32 without fused operations.
#include <unistd.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <random>
#include <set>

#include "tests/catch.h"
#include "tests/unit/ops/support.h"

using namespace dr;
using namespace dr::ops_test;

namespace {

constexpr size_t kPoints = 200000;

// GLSL's functions that the ops call.
constexpr const char* kShim = R"(#include <bit>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <vector>
namespace glsl {
using uint = uint32_t;
float abs(float x) { return __builtin_fabsf(x); }
int abs(int x) { return x < 0 ? -x : x; }
float sign(float x) { return x > 0 ? 1 : x < 0 ? -1 : 0; }
int sign(int x) { return x > 0 ? 1 : x < 0 ? -1 : 0; }
float floor(float x) { return __builtin_floorf(x); }
float ceil(float x) { return __builtin_ceilf(x); }
float trunc(float x) { return __builtin_truncf(x); }
float roundEven(float x) { return __builtin_nearbyintf(x); }
float sqrt(float x) { return __builtin_sqrtf(x); }
template <class T> T min(T x, T y) { return y < x ? y : x; }
template <class T> T max(T x, T y) { return x < y ? y : x; }
template <class T> T mix(T x, T y, bool second) { return second ? y : x; }
template <class T> T clamp(T x, T low, T high) { return min(max(x, low), high); }
int floatBitsToInt(float x) { return std::bit_cast<int>(x); }
uint floatBitsToUint(float x) { return std::bit_cast<uint>(x); }
float intBitsToFloat(int x) { return std::bit_cast<float>(x); }
float uintBitsToFloat(uint x) { return std::bit_cast<float>(x); }
int bitCount(uint x) { return __builtin_popcount(x); }
int findLSB(uint x) { return __builtin_ffs(static_cast<int>(x)) - 1; }
int findMSB(uint x) { return x == 0 ? -1 : 31 - __builtin_clz(x); }
int findMSB(int x) { return findMSB(static_cast<uint>(x < 0 ? ~x : x)); }
uint bitfieldReverse(uint x) { uint y = 0; for (int k = 0; k < 32; ++k) y = y << 1 | ((x >> k) & 1); return y; }
int bitfieldReverse(int x) { return static_cast<int>(bitfieldReverse(static_cast<uint>(x))); }
void umulExtended(uint x, uint y, uint& high, uint& low) { high = (uint64_t{x} * y) >> 32; low = x * y; }
void imulExtended(int x, int y, int& high, int& low) { high = (int64_t{x} * y) >> 32; low = x * y; }
)";

constexpr const char* kMain = R"(
// Words in, words out: form, operand count, points, then the operands' planes; the result's plane.
int main(int, char** names) {
  FILE* in = std::fopen(names[1], "rb");
  FILE* out = std::fopen(names[2], "wb");
  uint32_t head[3];
  while (std::fread(head, 4, 3, in) == 3) {
    std::vector<uint32_t> words(size_t{head[1]} * head[2]), result(head[2]);
    if (std::fread(words.data(), 4, words.size(), in) != words.size()) return 1;
    for (uint32_t i = 0; i < head[2]; ++i) result[i] = glsl::run(head[0], words.data() + i, head[2]);
    std::fwrite(result.data(), 4, result.size(), out);
  }
  return std::fclose(out);
}
)";

struct Scalars {
  OpKind kind;
  Form form;
};

// The forms of scalars; those of vectors do the same to each component, or are sums.
std::vector<Scalars> scalar_forms() {
  std::vector<Scalars> all;
  const std::vector<std::string> names{"a", "b", "c", "d"};
  for (const OpKind kind : elementwise_kinds()) {
    for (const Form& form : forms(kind)) {
      if (!std::all_of(form.operands.begin(), form.operands.end(), [](Type t) { return t.is_scalar(); })) continue;
      if (!form.result.is_scalar()) continue;
      bool vectors = false;
      for (const std::string_view text :
           ops::prelude(ops::info(kind), {.operands = std::span(names).first(form.operands.size()),
                                         .operand_types = form.operands,
                                         .attrs = form.attrs,
                                         .result_type = form.result}))
        vectors = vectors || text.find("vec") != std::string_view::npos;
      if (!vectors) all.push_back({kind, form});
    }
  }
  return all;
}

std::string loaded(Type type, size_t k) {
  const std::string word = "w[" + std::to_string(k) + " * n]";
  if (type.is_float()) return "uintBitsToFloat(" + word + ")";
  return type.is_bool() ? word + " != 0" : type.scalar == Scalar::Int ? "int(" + word + ")" : word;
}

std::string source(const std::vector<Scalars>& all) {
  std::string functions, cases;
  std::set<std::string_view> printed;
  for (size_t f = 0; f < all.size(); ++f) {
    const Form& form = all[f].form;
    std::vector<std::string> names;
    cases += "    case " + std::to_string(f) + ": {\n";
    for (size_t k = 0; k < form.operands.size(); ++k) {
      names.push_back("v" + std::to_string(k));
      cases += "      " + form.operands[k].str() + " " + names[k] + " = " + loaded(form.operands[k], k) + ";\n";
    }
    const ops::GlslInput input{
        .operands = names, .operand_types = form.operands, .attrs = form.attrs, .result_type = form.result};
    for (const std::string_view text : ops::prelude(ops::info(all[f].kind), input)) {
      if (printed.insert(text).second) functions += text;
    }
    cases += "      " + form.result.str() + " r = " + ops::info(all[f].kind).glsl(input) + ";\n      return " +
             (form.result.is_float() ? "floatBitsToUint(r)" : "uint(r)") + ";\n    }\n";
  }
  return kShim + functions + "uint run(uint form, const uint* w, uint n) {\n  switch (form) {\n" + cases +
         "  }\n  return 0;\n}\n}\n" + kMain;
}

uint32_t word_of(Type type, double x) {
  if (type.is_float()) return std::bit_cast<uint32_t>(static_cast<float>(x));
  return static_cast<uint32_t>(static_cast<int64_t>(x));
}
double number_of(Type type, uint32_t word) {
  if (type.is_float()) return std::bit_cast<float>(word);
  return type.scalar == Scalar::Int ? static_cast<double>(static_cast<int32_t>(word)) : static_cast<double>(word);
}

// Operand planes in float64 that float32 holds: random ones of the domains, then the singular points.
std::vector<std::vector<double>> operands_of(const Scalars& s, std::mt19937_64& engine) {
  const ops::OpInfo& info = ops::info(s.kind);
  std::vector<std::vector<double>> planes(s.form.operands.size());
  for (size_t k = 0; k < planes.size(); ++k) {
    const Type type = s.form.operands[k];
    for (size_t i = 0; i < kPoints; ++i) {
      double x = 0;
      if (type.is_float()) {
        x = std::uniform_real_distribution(info.domains[k].low, info.domains[k].high)(engine);
        x = std::clamp(static_cast<double>(static_cast<float>(x)), info.domains[k].low, info.domains[k].high);
        x = static_cast<float>(x);
      } else if (type.is_bool()) {
        x = static_cast<double>(engine() & 1);
      } else {
        x = number_of(type, static_cast<uint32_t>(engine()) >> (engine() % 32));
      }
      planes[k].push_back(x);
    }
    if (!type.is_float()) {
      for (const ops::TestPoint& point : info.singular) planes[k].push_back(point.operands.size() > k ? 1 : 0);
      continue;
    }
    for (const ops::TestPoint& point : info.singular) planes[k].push_back(static_cast<float>(point.operands[k]));
  }
  return planes;
}

// In last places of `expected`, or of `scale` where that is larger.
double distance(Type type, double found, double expected, double scale) {
  if (std::isnan(expected) || std::isnan(found)) return std::isnan(expected) && std::isnan(found) ? 0 : INFINITY;
  if (!type.is_float()) return found == expected ? 0 : INFINITY;
  if (static_cast<double>(static_cast<float>(expected)) == found) return 0;
  const double size = std::max({std::abs(expected), scale, 0x1p-126});
  return std::abs(found - expected) / std::exp2(std::floor(std::log2(size)) - 23);
}

}  // namespace

TEST_CASE("the GLSL of scalars is as close to float64 as the op table says") {
  std::string pattern = (std::filesystem::temp_directory_path() / "dr-ulp-XXXXXX").string();
  REQUIRE(mkdtemp(pattern.data()) != nullptr);
  const std::filesystem::path folder = pattern;
  const std::string program = (folder / "ops").string(), text = program + ".cpp", in = program + ".in",
                    out = program + ".out";
  const std::vector<Scalars> all = scalar_forms();
  CHECK(all.size() > 100);
  std::ofstream(text) << source(all);
  // Literals are floats, products are not fused, integers wrap.
  REQUIRE(
      std::system((std::string(DR_CXX) + " -std=c++20 -O1 -w -ffp-contract=off -fsingle-precision-constant -fwrapv '" +
                   text + "' -o '" + program + "'")
                      .c_str()) == 0);
  std::mt19937_64 engine(11);
  std::vector<std::vector<std::vector<double>>> operands;
  {
    std::ofstream stream(in, std::ios::binary);
    const auto put = [&](uint32_t word) { stream.write(reinterpret_cast<const char*>(&word), 4); };
    for (size_t f = 0; f < all.size(); ++f) {
      operands.push_back(operands_of(all[f], engine));
      put(static_cast<uint32_t>(f));
      put(static_cast<uint32_t>(operands[f].size()));
      put(static_cast<uint32_t>(operands[f][0].size()));
      for (size_t k = 0; k < operands[f].size(); ++k) {
        for (const double x : operands[f][k]) put(word_of(all[f].form.operands[k], x));
      }
    }
  }
  REQUIRE(std::system(("'" + program + "' '" + in + "' '" + out + "'").c_str()) == 0);
  std::ifstream stream(out, std::ios::binary);
  for (size_t f = 0; f < all.size(); ++f) {
    const auto& [kind, form] = all[f];
    std::vector<Value> values;
    for (size_t k = 0; k < operands[f].size(); ++k) values.push_back(value(form.operands[k], operands[f][k]));
    const Value expected = evaluate(kind, values, form.attrs);
    double worst = 0;
    size_t at = 0;
    for (size_t i = 0; i < operands[f][0].size(); ++i) {
      uint32_t word = 0;
      stream.read(reinterpret_cast<char*>(&word), 4);
      const double found = number_of(form.result, word);
      double scale = 0;
      if (kind == OpKind::Mod && form.result.is_float()) {
        scale = std::max(std::abs(operands[f][0][i]), std::abs(operands[f][1][i]));
        // At a jump either side is right.
        if (std::abs(std::abs(found - expected.planes[i]) - std::abs(operands[f][1][i])) < 1e-5) continue;
      }
      const double error = distance(form.result, found, expected.planes[i], scale);
      if (!(error <= worst)) worst = error, at = i;
    }
    REQUIRE(stream.good());
    std::string where;
    for (const auto& plane : operands[f]) where += " " + std::to_string(plane[at]);
    INFO(ir::op_name(kind) << " of " << form.operands[0].str() << " at" << where);
    CHECK(worst <= ops::info(kind).ulp_bound);
    if (form.operands[0].is_float() && form.result.is_float())
      std::printf("%-12s %.2f of %.2f\n", std::string(ir::op_name(kind)).c_str(), worst, ops::info(kind).ulp_bound);
  }
  std::filesystem::remove_all(folder);
}
