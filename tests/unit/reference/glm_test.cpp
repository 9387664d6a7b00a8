// SPDX-License-Identifier: Apache-2.0
// GLM as an independent judge of the evaluator: matrices, packing, cameras and rotations.
#include <cmath>
#include <functional>
#include <glm/ext/matrix_clip_space.hpp>
#include <glm/ext/matrix_transform.hpp>
#include <glm/gtc/packing.hpp>
#include <glm/gtc/quaternion.hpp>
#include <glm/gtc/type_ptr.hpp>
#include <glm/matrix.hpp>
#include <glm/packing.hpp>
#include <random>

#include "compiler/lower/lower.h"
#include "compiler/passes/passes.h"
#include "tests/catch.h"
#include "tests/unit/reference/support.h"

namespace dr::reference_test {
namespace {

constexpr size_t kCount = 200;

ir::Graph compiled(const std::string& text) {
  dsl::SourceManager sources;
  dsl::DiagnosticList diagnostics;
  const auto graph = lower::lower(sources, sources.add("glm.dr", "edition 1;\n" + text), {}, diagnostics);
  if (!graph) FAIL(dsl::format(diagnostics, sources));
  return passes::run_passes(*graph, passes::default_passes());
}

class Random {
 public:
  // Near the identity, so that the inverse has digits to compare; every hundredth is mirrored.
  template <class M>
  std::vector<M> matrices() {
    std::vector<M> all(kCount, M(2.0));
    for (size_t i = 0; i < all.size(); ++i) {
      for (int c = 0; c < M::length(); ++c) {
        for (int r = 0; r < M::length(); ++r) all[i][c][r] += between(-1, 1);
      }
      if (i % 100 == 7) all[i][0] = -all[i][0];
    }
    return all;
  }
  template <class V>
  std::vector<V> vectors(double low, double high) {
    std::vector<V> all(kCount);
    for (V& v : all) {
      for (int k = 0; k < V::length(); ++k) v[k] = between(low, high);
    }
    return all;
  }
  double between(double low, double high) { return std::uniform_real_distribution(low, high)(engine_); }

 private:
  std::mt19937_64 engine_{20260101};  // fixed: a failure repeats
};

// GLM's values as an image, component after component.
template <class V>
Image image_of(std::string_view type, const std::vector<V>& values) {
  constexpr size_t kComponents = sizeof(V) / sizeof(double);
  std::vector<double> data(values.size() * kComponents);
  for (size_t i = 0; i < values.size(); ++i) {
    for (size_t c = 0; c < kComponents; ++c) data[c * values.size() + i] = glm::value_ptr(values[i])[c];
  }
  return image(type, static_cast<int64_t>(values.size()), 1, 1, std::move(data));
}

// Compares each element with GLM's, to `tolerance` of the element's largest component.
template <class V>
void check(const Image& found, const std::string& name, double tolerance, const std::function<V(size_t)>& expected) {
  INFO(name);
  constexpr size_t kComponents = sizeof(V) / sizeof(double);
  const size_t count = found.data.size() / kComponents;
  REQUIRE(count > 0);
  double worst = 0;
  for (size_t i = 0; i < count; ++i) {
    const V value = expected(i);
    const auto* numbers = reinterpret_cast<const double*>(&value);
    double scale = 1e-300;
    for (size_t c = 0; c < kComponents; ++c) scale = std::max(scale, std::abs(numbers[c]));
    for (size_t c = 0; c < kComponents; ++c) {
      worst = std::max(worst, std::abs(found.data[c * count + i] - numbers[c]) / scale);
    }
  }
  CHECK(worst <= tolerance);
}

TEST_CASE("matrix functions agree with GLM's") {
  Random random;
  const auto a = random.matrices<glm::dmat4>();
  const auto b = random.matrices<glm::dmat4>();
  const auto p = random.matrices<glm::dmat3>();
  const auto q = random.matrices<glm::dmat2>();
  const auto v = random.vectors<glm::dvec4>(-3, 3);
  const Images out = run(compiled(R"(
    input a : mat4[N];
    input b : mat4[N];
    input p : mat3[N];
    input q : mat2[N];
    input v : vec4[N];
    step s {
      output product = a * b, turned = a * v, row = v * a, transposed = transpose(a), scaled = matrixCompMult(a, b),
             outer = outerProduct(v, v), inverse4 = inverse(a), inverse3 = inverse(p), inverse2 = inverse(q),
             determinant4 = determinant(a), determinant3 = determinant(p), determinant2 = determinant(q);
    })"),
                         {{"a", image_of("mat4", a)},
                          {"b", image_of("mat4", b)},
                          {"p", image_of("mat3", p)},
                          {"q", image_of("mat2", q)},
                          {"v", image_of("vec4", v)}});
  // Sums of four products: a few units in the last place of the largest.
  constexpr double kSum = 2e-15;
  // Cofactors and a quotient; the matrices' conditions are below a thousand.
  constexpr double kInverse = 1e-12;
  check<glm::dmat4>(out.at("product"), "a * b", kSum, [&](size_t i) { return a[i] * b[i]; });
  check<glm::dvec4>(out.at("turned"), "a * v", kSum * 4, [&](size_t i) { return a[i] * v[i]; });
  check<glm::dvec4>(out.at("row"), "v * a", kSum * 4, [&](size_t i) { return v[i] * a[i]; });
  check<glm::dmat4>(out.at("transposed"), "transpose", 0, [&](size_t i) { return glm::transpose(a[i]); });
  check<glm::dmat4>(out.at("scaled"), "matrixCompMult", 0, [&](size_t i) { return glm::matrixCompMult(a[i], b[i]); });
  check<glm::dmat4>(out.at("outer"), "outerProduct", 0, [&](size_t i) { return glm::outerProduct(v[i], v[i]); });
  check<glm::dmat4>(out.at("inverse4"), "inverse of mat4", kInverse, [&](size_t i) { return glm::inverse(a[i]); });
  check<glm::dmat3>(out.at("inverse3"), "inverse of mat3", kInverse, [&](size_t i) { return glm::inverse(p[i]); });
  check<glm::dmat2>(out.at("inverse2"), "inverse of mat2", kInverse, [&](size_t i) { return glm::inverse(q[i]); });
  check<double>(out.at("determinant4"), "determinant of mat4", kInverse,
                [&](size_t i) { return glm::determinant(a[i]); });
  check<double>(out.at("determinant3"), "determinant of mat3", kInverse,
                [&](size_t i) { return glm::determinant(p[i]); });
  check<double>(out.at("determinant2"), "determinant of mat2", kInverse,
                [&](size_t i) { return glm::determinant(q[i]); });
}

TEST_CASE("packing functions agree with GLM's") {
  Random random;
  // Beyond the ends, too, which are clamped. As floats, since GLM packs no doubles.
  std::vector<glm::dvec4> v = random.vectors<glm::dvec4>(-1.2, 1.2);
  for (glm::dvec4& value : v) value = glm::dvec4(glm::vec4(value));
  const Images out = run(compiled(R"(
    input v : vec4[N];
    step s {
      output unorm2 = packUnorm2x16(v.xy), snorm2 = packSnorm2x16(v.xy), unorm4 = packUnorm4x8(v), snorm4 = packSnorm4x8(v),
             from_unorm2 = unpackUnorm2x16(packUnorm2x16(v.xy)), from_snorm2 = unpackSnorm2x16(packSnorm2x16(v.xy)),
             from_unorm4 = unpackUnorm4x8(packUnorm4x8(v)), from_snorm4 = unpackSnorm4x8(packSnorm4x8(v)),
             halves = half(v * 1000.0);
    })"),
                         {{"v", image_of("vec4", v)}});
  const auto f = [&](size_t i) { return glm::vec4(v[i]); };
  const auto f2 = [&](size_t i) { return glm::vec2(v[i]); };
  check<double>(out.at("unorm2"), "packUnorm2x16", 0, [&](size_t i) { return double(glm::packUnorm2x16(f2(i))); });
  check<double>(out.at("snorm2"), "packSnorm2x16", 0, [&](size_t i) { return double(glm::packSnorm2x16(f2(i))); });
  check<double>(out.at("unorm4"), "packUnorm4x8", 0, [&](size_t i) { return double(glm::packUnorm4x8(f(i))); });
  check<double>(out.at("snorm4"), "packSnorm4x8", 0, [&](size_t i) { return double(glm::packSnorm4x8(f(i))); });
  // GLM multiplies by a float's reciprocal.
  constexpr double kFloat = 3e-7;
  check<glm::dvec2>(out.at("from_unorm2"), "unpackUnorm2x16", kFloat,
                    [&](size_t i) { return glm::dvec2(glm::unpackUnorm2x16(glm::packUnorm2x16(f2(i)))); });
  check<glm::dvec2>(out.at("from_snorm2"), "unpackSnorm2x16", kFloat,
                    [&](size_t i) { return glm::dvec2(glm::unpackSnorm2x16(glm::packSnorm2x16(f2(i)))); });
  check<glm::dvec4>(out.at("from_unorm4"), "unpackUnorm4x8", kFloat,
                    [&](size_t i) { return glm::dvec4(glm::unpackUnorm4x8(glm::packUnorm4x8(f(i)))); });
  check<glm::dvec4>(out.at("from_snorm4"), "unpackSnorm4x8", kFloat,
                    [&](size_t i) { return glm::dvec4(glm::unpackSnorm4x8(glm::packSnorm4x8(f(i)))); });
  check<glm::dvec4>(out.at("halves"), "half", 0, [&](size_t i) {
    glm::dvec4 result;
    for (int k = 0; k < 4; ++k) {
      result[k] = glm::unpackHalf1x16(glm::packHalf1x16(static_cast<float>(v[i][k] * 1000.0)));
    }
    return result;
  });
}

TEST_CASE("cameras and rotations agree with GLM's") {
  Random random;
  const auto eye = random.vectors<glm::dvec3>(1, 5);
  const auto target = random.vectors<glm::dvec3>(-1, 1);
  const auto axis = random.vectors<glm::dvec3>(-2, 2);
  const Images out =
      run(compiled(R"(
    import std.camera;
    input eye : vec3[N];
    input target : vec3[N];
    input axis : vec3[N];
    step s {
      output view = camera.look_at(eye, target), turned = camera.rotate(axis, eye), turn = camera.rotation_matrix(axis),
             projection = camera.perspective(50.0, 1.5, 0.25, 80.0), flat = camera.orthographic(3.0, 1.5, 0.25, 80.0);
    })"),
          {{"eye", image_of("vec3", eye)}, {"target", image_of("vec3", target)}, {"axis", image_of("vec3", axis)}});
  const auto turn = [&](size_t i) { return glm::angleAxis(glm::length(axis[i]), glm::normalize(axis[i])); };
  constexpr double kTolerance = 2e-14;
  check<glm::dmat4>(out.at("view"), "look_at", kTolerance,
                    [&](size_t i) { return glm::lookAtRH(eye[i], target[i], glm::dvec3(0, 1, 0)); });
  check<glm::dvec3>(out.at("turned"), "rotate", kTolerance, [&](size_t i) { return turn(i) * eye[i]; });
  check<glm::dmat3>(out.at("turn"), "rotation_matrix", kTolerance, [&](size_t i) { return glm::mat3_cast(turn(i)); });
  // Vulkan's clip space: GLM's from 0 to 1, with y the other way.
  const glm::dmat4 down = glm::scale(glm::dmat4(1.0), glm::dvec3(1, -1, 1));
  check<glm::dmat4>(out.at("projection"), "perspective", kTolerance,
                    [&](size_t) { return down * glm::perspectiveRH_ZO(glm::radians(50.0), 1.5, 0.25, 80.0); });
  check<glm::dmat4>(out.at("flat"), "orthographic", kTolerance,
                    [&](size_t) { return down * glm::orthoRH_ZO(-2.25, 2.25, -1.5, 1.5, 0.25, 80.0); });
}

}  // namespace
}  // namespace dr::reference_test
