// SPDX-License-Identifier: Apache-2.0
// The adjoints of all element-wise ops: against central differences at random numbers and close to the points that the
// op table calls singular, finite at these points, their second derivatives likewise, and free of NaN over special
// values.
#include <algorithm>
#include <cmath>
#include <cstdio>

#include "tests/catch.h"
#include "tests/gradient/build.h"
#include "tests/gradient/ops/subject.h"

using namespace dr;
using namespace dr::gradient_test;

namespace {

using Numbers = std::vector<double>;
using Place = Subject::Place;

std::vector<OpKind> differentiable_kinds() {
  std::vector<OpKind> kinds;
  for (const OpKind kind : ops_test::elementwise_kinds()) {
    if (ops::info(kind).differentiable) kinds.push_back(kind);
  }
  return kinds;
}

// Of its name, so that a new op does not give others new numbers.
uint64_t seed_of(OpKind kind) {
  uint64_t seed = 7;
  for (const char c : ir::op_name(kind)) seed = 31 * seed + static_cast<unsigned char>(c);
  return seed;
}

// Whether the derivative is that of the value: half's is 1, as if nothing were rounded.
bool has_differences(OpKind kind) { return kind != OpKind::Half; }

size_t operand_index(const Place& place) { return static_cast<size_t>(std::stoi(place.leaf.substr(1))); }

template <class F>
Numbers generate(size_t count, F f) {
  Numbers numbers(count);
  std::generate(numbers.begin(), numbers.end(), f);
  return numbers;
}

// How far differences reach: less beside a singular point, where the error of a difference grows without bound.
double step_at(OpKind kind, size_t operand, double at) {
  const double most = 2e-3 * std::max(std::abs(at), 0.05);
  double near = most;
  for (const ops::TestPoint& point : ops::info(kind).singular)
    near = std::min(near, 0.05 * std::abs(at - point.operands[operand]));
  return std::max(near, 0.1 * most);
}

void draw_weights(Subject& subject, Random& random, size_t elements) {
  for (const Place& place : subject.weights())
    subject.set(place, generate(elements, [&] { return random.real(0.5, 1.5); }));
  for (const Place& place : subject.directions())
    subject.set(place, generate(elements, [&] { return random.real(0.5, 1.5); }));
  for (const Place& place : subject.conditions())
    subject.set(place, generate(elements, [&] { return random.chance(0.5) ? 1.0 : 0.0; }));
}

void set_weights(Subject& subject, size_t elements) {
  for (const auto& places : {subject.weights(), subject.directions(), subject.conditions()}) {
    for (const Place& place : places) subject.set(place, Numbers(elements, 1.0));
  }
}

// What was compared, what was left out because a kink lies within the differences' reach, what lies where the op is no
// number and has nothing to differentiate, and the largest relative error.
struct Tally {
  size_t compared = 0, skipped = 0, outside = 0;
  double worst = 0;
};

// Compares the derivatives of `value` at `place` with central differences at distances h, h/2 and h/4, of whose errors
// the first two terms are removed. Errors are relative to the element's largest derivative, or to what rounding leaves.
template <class F>
void compare(Subject& subject, const Place& place, const Numbers& steps, const Numbers& derivatives,
             const Numbers& scales, F value, Tally& tally) {
  const Numbers center = subject.get(place);
  const Numbers middle = value();
  std::vector<Numbers> quotients;
  for (const double fraction : {1.0, 0.5, 0.25}) {
    Numbers above = center, below = center;
    for (size_t i = 0; i < center.size(); ++i) {
      above[i] += steps[i] * fraction;
      below[i] -= steps[i] * fraction;
    }
    subject.set(place, above);
    const Numbers high = value();
    subject.set(place, below);
    const Numbers low = value();
    Numbers quotient(center.size());
    for (size_t i = 0; i < center.size(); ++i) quotient[i] = (high[i] - low[i]) / (above[i] - below[i]);
    quotients.push_back(std::move(quotient));
  }
  subject.set(place, center);
  for (size_t i = 0; i < center.size(); ++i) {
    const double coarse = (4 * quotients[1][i] - quotients[0][i]) / 3,
                 fine = (4 * quotients[2][i] - quotients[1][i]) / 3;
    const double expected = (16 * fine - coarse) / 15;
    const double scale = std::max({scales[i], std::abs(expected), 1e-5 * std::abs(middle[i]) / steps[i], 1e-290});
    if (!std::isfinite(middle[i])) {
      ++tally.outside;
      continue;
    }
    if (!std::isfinite(expected) || std::abs(fine - coarse) > 1e-6 * scale) {
      ++tally.skipped;
      continue;
    }
    ++tally.compared;
    tally.worst = std::max(tally.worst, std::abs(derivatives[i] - expected) / scale);
    if (!std::isfinite(derivatives[i])) tally.worst = INFINITY;
  }
}

// The largest derivative of each element.
Numbers largest(const std::vector<Numbers>& derivatives) {
  Numbers result(derivatives[0].size(), 0.0);
  for (const Numbers& plane : derivatives) {
    for (size_t i = 0; i < plane.size(); ++i)
      result[i] = std::max(result[i], std::isfinite(plane[i]) ? std::abs(plane[i]) : 0);
  }
  return result;
}

void compare_first(Subject& subject, const std::vector<Numbers>& steps, Tally& tally) {
  const std::vector<Numbers> derivatives = subject.gradient();
  const Numbers scales = largest(derivatives);
  REQUIRE(derivatives.size() == subject.operands().size());
  for (size_t k = 0; k < derivatives.size(); ++k) {
    compare(
        subject, subject.operands()[k], steps[k], derivatives[k], scales, [&] { return subject.value(); }, tally);
  }
}

void compare_second(Subject& subject, const std::vector<Numbers>& steps, Tally& tally) {
  const std::vector<Numbers> derivatives = subject.second();
  const Numbers scales = largest(derivatives);
  std::vector<Place> places = subject.operands();
  places.insert(places.end(), subject.weights().begin(), subject.weights().end());
  REQUIRE(derivatives.size() == places.size());
  for (size_t k = 0; k < places.size(); ++k) {
    const Numbers& step = k < steps.size() ? steps[k] : Numbers(derivatives[k].size(), 1e-3);
    compare(
        subject, places[k], step, derivatives[k], scales, [&] { return subject.slope(); }, tally);
  }
}

// Scalars, the vectors and matrices of 3: what size has to do with is the same for the others, but for Compose and
// Extract.
bool is_typical(OpKind kind, const Form& form) {
  if (kind == OpKind::Compose || kind == OpKind::Extract || kind == OpKind::Splat) return true;
  return std::all_of(form.operands.begin(), form.operands.end(),
                     [](Type t) { return t.is_scalar() || (t.rows == 3 && t.cols != 4); });
}

}  // namespace

TEST_CASE("adjoints agree with central differences at random numbers") {
  constexpr size_t kElements = 300;
  Tally all_first, all_second;
  for (const OpKind kind : differentiable_kinds()) {
    if (!has_differences(kind)) continue;
    Random random(seed_of(kind));
    size_t compared = 0;
    for (const Form& form : float_forms(kind)) {
      if (!is_typical(kind, form)) continue;
      Subject subject(kind, form, kElements);
      draw_weights(subject, random, kElements);
      std::vector<Numbers> steps;
      for (const Place& place : subject.operands()) {
        const ops::Domain& domain = ops::info(kind).domains.at(operand_index(place));
        const Numbers x = generate(kElements, [&] { return random.real(domain.low, domain.high); });
        subject.set(place, x);
        Numbers& step = steps.emplace_back();
        for (const double at : x) step.push_back(step_at(kind, operand_index(place), at));
      }
      Tally first, second;
      compare_first(subject, steps, first);
      compare_second(subject, steps, second);
      INFO(ir::op_name(kind) << " of " << form.operands[0].str() << ": " << first.skipped << " and " << second.skipped
                             << " of " << first.compared + first.skipped << " left out");
      CHECK(first.worst <= 1e-8);
      CHECK(second.worst <= 1e-5);
      for (const auto& [sum, part] : {std::pair{&all_first, first}, std::pair{&all_second, second}}) {
        CHECK(static_cast<double>(part.skipped) < 0.02 * static_cast<double>(part.compared));
        sum->compared += part.compared;
        sum->skipped += part.skipped;
        sum->worst = std::max(sum->worst, part.worst);
      }
      compared += std::min(first.compared, second.compared);
    }
    INFO(ir::op_name(kind));
    CHECK(compared >= kElements);
  }
  std::printf("first derivatives: %zu compared, %zu left out, largest relative error %.2g\n", all_first.compared,
              all_first.skipped, all_first.worst);
  std::printf("second derivatives: %zu compared, %zu left out, largest relative error %.2g\n", all_second.compared,
              all_second.skipped, all_second.worst);
}

namespace {

// The scalar and vec3 forms, for points of the op table.
std::vector<Form> point_forms(OpKind kind) {
  std::vector<Form> result;
  for (const Form& form : float_forms(kind)) {
    const bool fits = std::all_of(form.operands.begin(), form.operands.end(),
                                  [](Type t) { return t.cols == 1 && (t.rows == 1 || t.rows == 3); });
    if (fits && form.operands.size() == ops::info(kind).domains.size()) result.push_back(form);
  }
  return result;
}

}  // namespace

TEST_CASE("adjoints agree with central differences close to singular points") {
  constexpr size_t kElements = 32;
  Tally all;
  for (const OpKind kind : differentiable_kinds()) {
    if (!has_differences(kind)) continue;
    Random random(seed_of(kind) + 1);
    for (const Form& form : point_forms(kind)) {
      Subject subject(kind, form, kElements);
      draw_weights(subject, random, kElements);
      for (const ops::TestPoint& point : ops::info(kind).singular) {
        if (kind == OpKind::Mod && point.operands[1] == 0)
          continue;  // where its jumps have no distance from each other
        for (const double distance : {1e-1, 1e-2, 1e-3}) {
          std::vector<Numbers> steps;
          for (const Place& place : subject.operands()) {
            const double at = point.operands[operand_index(place)];
            const double unit = distance * (at == 0 ? 1.0 : std::abs(at));
            subject.set(place, generate(kElements, [&] {
                          return at + unit * (random.chance(0.5) ? 1 : -1) * random.real(0.5, 1);
                        }));
            steps.push_back(Numbers(kElements, 0.01 * unit));
          }
          Tally tally;
          compare_first(subject, steps, tally);
          INFO(ir::op_name(kind) << " of " << form.operands[0].str() << ", " << distance << " from "
                                 << point.operands[0]);
          CHECK(tally.worst <= 1e-6);
          all.compared += tally.compared;
          all.skipped += tally.skipped;
          all.outside += tally.outside;
          all.worst = std::max(all.worst, tally.worst);
        }
      }
    }
  }
  std::printf(
      "close to singular points: %zu compared, %zu left out, %zu outside the domain, largest relative error %.2g\n",
      all.compared, all.skipped, all.outside, all.worst);
  CHECK(static_cast<double>(all.skipped) < 0.02 * static_cast<double>(all.compared));
}

TEST_CASE("first and second derivatives are finite at singular points") {
  for (const OpKind kind : differentiable_kinds()) {
    for (const Form& form : point_forms(kind)) {
      const std::vector<ops::TestPoint>& points = ops::info(kind).singular;
      if (points.empty()) continue;
      Subject subject(kind, form, points.size());
      // All components at the point, then the first alone.
      for (const bool alone : {false, true}) {
        set_weights(subject, points.size());
        for (const Place& place : subject.operands()) {
          Numbers x;
          for (const ops::TestPoint& point : points) {
            const ops::Domain& domain = ops::info(kind).domains[operand_index(place)];
            x.push_back(alone && place.component > 0 ? 0.25 * domain.low + 0.75 * domain.high
                                                     : point.operands[operand_index(place)]);
          }
          subject.set(place, x);
        }
        std::vector<Numbers> derivatives = subject.gradient();
        for (Numbers& second : subject.second()) derivatives.push_back(std::move(second));
        for (size_t k = 0; k < derivatives.size(); ++k) {
          for (size_t i = 0; i < points.size(); ++i) {
            INFO(ir::op_name(kind) << " of " << form.operands[0].str() << ", point " << i << ", derivative " << k
                                   << " is " << derivatives[k][i]);
            CHECK(std::isfinite(derivatives[k][i]));
          }
        }
      }
    }
  }
}

namespace {

// The gradient of one scalar op at one point.
Numbers gradient_at(OpKind kind, const Numbers& x, double w = 1) {
  const Form form{.operands = std::vector<Type>(x.size(), ir::kFloat), .attrs = {}, .result = ir::kFloat};
  Subject subject(kind, form, 1);
  for (size_t k = 0; k < x.size(); ++k) subject.set(subject.operands()[k], {x[k]});
  subject.set(subject.weights()[0], {w});
  Numbers result;
  for (const Numbers& plane : subject.gradient()) result.push_back(plane[0]);
  return result;
}

}  // namespace

TEST_CASE("derivatives at singular points are the documented ones") {
  using V = Numbers;
  CHECK(gradient_at(OpKind::Min, {1, 1}) == V{0.5, 0.5});
  CHECK(gradient_at(OpKind::Max, {1, 1}) == V{0.5, 0.5});
  CHECK(gradient_at(OpKind::Min, {1, 2}) == V{1, 0});
  CHECK(gradient_at(OpKind::Max, {std::nan(""), 2}) == V{0, 1});
  CHECK(gradient_at(OpKind::Min, {2, std::nan("")}) == V{1, 0});
  CHECK(gradient_at(OpKind::Clamp, {-1, -1, 1}) == V{1, 0, 0});
  CHECK(gradient_at(OpKind::Clamp, {1, -1, 1}) == V{1, 0, 0});
  CHECK(gradient_at(OpKind::Clamp, {2, -1, 1}) == V{0, 0, 1});
  CHECK(gradient_at(OpKind::Clamp, {-2, -1, 1}) == V{0, 1, 0});
  CHECK(gradient_at(OpKind::Clamp, {0, 1, -1}) == V{0, 0, 1});
  CHECK(gradient_at(OpKind::Abs, {0}) == V{0});
  CHECK(gradient_at(OpKind::Sqrt, {0}) == V{0});
  CHECK(gradient_at(OpKind::Log, {0}) == V{0});
  CHECK(gradient_at(OpKind::Log, {-1}) == V{0});
  CHECK(gradient_at(OpKind::Asin, {1}) == V{0});
  CHECK(gradient_at(OpKind::Acos, {-2}) == V{0});
  CHECK(gradient_at(OpKind::Atan2, {0, 0}) == V{0, 0});
  CHECK(gradient_at(OpKind::Div, {3, 0}) == V{0, 0});
  CHECK(gradient_at(OpKind::Div, {0, 0}) == V{0, 0});
  CHECK(gradient_at(OpKind::Fract, {2}) == V{1});
  for (const double x : {0.0, 1e-30, 0.1, -3.0, 65487.0, -65487.0}) CHECK(gradient_at(OpKind::Half, {x}) == V{1});
  for (const double x : {65504.0, 65489.0, -1e30, std::nan("")}) CHECK(gradient_at(OpKind::Half, {x}) == V{0});
  CHECK(gradient_at(OpKind::Mod, {7.5, 2}) == V{1, -3});
  CHECK(gradient_at(OpKind::Mod, {7.5, 0}) == V{1, 0});
  CHECK(gradient_at(OpKind::Pow, {0, 0}) == V{0, 0});
  CHECK(gradient_at(OpKind::Pow, {0, 0.5}) == V{0, 0});
  CHECK(gradient_at(OpKind::Pow, {0, 1}) == V{1, 0});
  CHECK(gradient_at(OpKind::Pow, {0, 2}) == V{0, 0});
  CHECK(gradient_at(OpKind::Pow, {-2, 3}) == V{12, 0});
  CHECK(gradient_at(OpKind::Pow, {1e-7, 1 / 2.4})[0] == Approx(std::pow(1e-7, 1 / 2.4 - 1) / 2.4).epsilon(1e-13));
}

TEST_CASE("tails of derivatives keep their relative accuracy") {
  for (double x = -300; x <= 300; x += 7.3) {
    const double z = std::exp(-std::abs(x)), z2 = std::exp(-2 * std::abs(x));
    CHECK(gradient_at(OpKind::Sigmoid, {x})[0] == Approx(z / ((1 + z) * (1 + z))).epsilon(1e-13).margin(0));
    CHECK(gradient_at(OpKind::Tanh, {x})[0] == Approx(4 * z2 / ((1 + z2) * (1 + z2))).epsilon(1e-13).margin(0));
    CHECK(gradient_at(OpKind::Softplus, {x})[0] == Approx((x < 0 ? z : 1) / (1 + z)).epsilon(1e-13).margin(0));
  }
}

TEST_CASE("an adjoint of zero stays zero, whatever it meets") {
  const double inf = INFINITY, nan = std::nan("");
  for (const OpKind kind : differentiable_kinds()) {
    for (const Form& form : point_forms(kind)) {
      std::vector<Numbers> cases;
      for (const double x : {0.0, 1.0, -1.0, 2.5, 1e300, inf, -inf, nan}) {
        for (const double y : {0.0, 1.0, -1.0, 1e-300, inf, nan}) cases.push_back({x, y, 1});
      }
      Subject subject(kind, form, cases.size());
      set_weights(subject, cases.size());
      for (const Place& place : subject.operands()) {
        Numbers x;
        for (const Numbers& numbers : cases)
          x.push_back(numbers[(operand_index(place) + static_cast<size_t>(place.component)) % 3]);
        subject.set(place, x);
      }
      for (const Place& place : subject.weights()) subject.set(place, Numbers(cases.size(), 0.0));
      const std::vector<Numbers> derivatives = subject.gradient();
      for (const Numbers& plane : derivatives) {
        for (size_t i = 0; i < plane.size(); ++i) {
          INFO(ir::op_name(kind) << " of " << form.operands[0].str() << " at " << cases[i][0] << ", " << cases[i][1]);
          CHECK(plane[i] == 0);
        }
      }
    }
  }
}

TEST_CASE("no derivative is NaN where the value is a number") {
  Numbers specials = ops_test::finite_special_values();
  // What the largest and smallest numbers of float32 do to float32, these do to float64.
  for (const double x : {1e300, 1e-300, 5e-324, 1.7e308, 0.5, 3.0}) {
    specials.push_back(x);
    specials.push_back(-x);
  }
  for (const OpKind kind : differentiable_kinds()) {
    for (const Form& form : point_forms(kind)) {
      const size_t arity = form.operands.size();
      std::vector<Numbers> cases;
      for (const double x : specials) {
        for (const double y : specials) cases.push_back({x, y, -1});
      }
      Subject subject(kind, form, cases.size());
      set_weights(subject, cases.size());
      for (const Place& place : subject.operands()) {
        Numbers x;
        for (const Numbers& numbers : cases) {
          x.push_back(numbers[(operand_index(place) + (arity == 1 ? static_cast<size_t>(place.component) : 0)) % 3]);
        }
        subject.set(place, x);
      }
      const Numbers value = subject.value();
      const std::vector<Numbers> derivatives = subject.gradient();
      size_t wrong = 0;
      std::string where;
      for (const Numbers& plane : derivatives) {
        for (size_t i = 0; i < plane.size(); ++i) {
          if (!std::isfinite(value[i]) || !std::isnan(plane[i])) continue;
          ++wrong;
          where = std::to_string(cases[i][0]) + ", " + std::to_string(cases[i][1]);
        }
      }
      INFO(ir::op_name(kind) << " of " << form.operands[0].str() << ", last at " << where);
      CHECK(wrong == 0);
    }
  }
}
