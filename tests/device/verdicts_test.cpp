// SPDX-License-Identifier: Apache-2.0
// The verdicts of a batch are judge_one's, bit by bit: on numbers at and beside every limit it knows, in all
// combinations of a random draw.
#include "tests/device/accuracy/verdicts.h"

#include <limits>
#include <memory>
#include <random>
#include <utility>
#include <vector>

#include "tests/catch.h"

using namespace dr::accuracy;

namespace {

constexpr size_t kBatch = Verdicts::kBatch;
constexpr double kInf = std::numeric_limits<double>::infinity(), kNan = std::numeric_limits<double>::quiet_NaN();

class Draw {
 public:
  explicit Draw(uint32_t seed) : random_(seed) {}
  size_t below(size_t n) { return std::uniform_int_distribution<size_t>(0, n - 1)(random_); }
  bool one_in(size_t n) { return below(n) == 0; }

  // A limit, a neighbour of one, or anything.
  double number() {
    static const double limits[] = {
        0,       1,       0x1p-149, 0x1p-126,       0x1p-125, 0x1p-124, 0x1p-119,  0x1p120, 0x1p121,
        0x1p127, 0x1p128, FLT_MAX,  0x1.ffffffp127, kInf,     FLT_MIN,  0x1p-1022, 0x1p300, 0x1p-300,
        0.1,     3.5,     kNan};
    double x = limits[below(std::size(limits))];
    if (one_in(3))
      x = std::ldexp(1 + static_cast<double>(below(1 << 20)) * 0x1p-20, static_cast<int>(below(300)) - 160);
    if (one_in(3)) x = std::nextafter(x, one_in(2) ? kInf : -kInf);
    return one_in(2) ? -x : x;
  }
  // Near `x`, or anything.
  float float_near(double x) {
    float f = static_cast<float>(one_in(3) ? number() : x);
    for (size_t k = below(4); k > 0; --k) f = std::nextafter(f, one_in(2) ? HUGE_VALF : -HUGE_VALF);
    return f;
  }

 private:
  std::mt19937 random_;
};

}  // namespace

TEST_CASE("verdicts of a batch are those of its elements") {
  Draw draw(5);
  const auto verdicts = std::make_unique<Verdicts>();
  std::vector<float> found(kBatch);
  std::vector<uint64_t> inside(kBatch);
  std::vector<double> expected(kBatch), value(kBatch), scale(kBatch), bound(kBatch), except(kBatch);
  uint64_t all[4] = {};
  for (int round = 0; round < 400; ++round) {
    const Asked asked{.is_float = true,
                      .derivative = draw.one_in(2),
                      .exact = draw.one_in(3),
                      .promised = draw.one_in(2),
                      .has_scale = draw.one_in(2)};
    const double one_bound = asked.exact ? 0 : 2.5;
    for (size_t i = 0; i < kBatch; ++i) {
      expected[i] = draw.number();
      value[i] = asked.derivative ? draw.number() : expected[i];
      found[i] = draw.float_near(expected[i]);
      inside[i] = draw.one_in(4) ? 0 : 1;
      scale[i] = asked.has_scale ? draw.number() : 0;
      bound[i] = asked.promised ? std::abs(draw.number()) : one_bound;
      except[i] = draw.one_in(8) ? 1 : 0;
    }
    verdicts->judge(asked, {.found = found.data(),
                            .inside = inside.data(),
                            .expected = expected.data(),
                            .value = value.data(),
                            .scale = scale.data(),
                            .bound = bound.data(),
                            .except = except.data()});
    uint64_t count = 0, special = 0, left_out = 0, not_finite = 0;
    double worst = 0, worst_share = 0, at_share = 0;
    for (size_t i = 0; i < kBatch; ++i) {
      const Expected e{.value = expected[i],
                       .scale = scale[i],
                       .bound = bound[i],
                       .except = except[i] != 0,
                       .value_infinite = asked.derivative && !finite_float(value[i]),
                       .value_subnormal = asked.derivative && is_subnormal(value[i])};
      const Verdict v = judge_one(asked, static_cast<double>(found[i]), inside[i] != 0, &e, 1);
      special += v.special, left_out += v.left_out, not_finite += v.not_finite;
      const bool counts = !v.special && !v.left_out;
      const double error = !counts ? 0 : v.not_finite ? HUGE_VAL : v.error;
      const double share = !counts ? 0 : v.not_finite ? HUGE_VAL : v.share;
      if (verdicts->counted[i] != (counts ? 1 : 0) || verdicts->error[i] != error || verdicts->share[i] != share) {
        CAPTURE(asked.derivative, asked.exact, asked.promised, asked.has_scale, found[i], expected[i], value[i],
                scale[i], bound[i], inside[i], except[i]);
        REQUIRE(verdicts->counted[i] == (counts ? 1 : 0));
        REQUIRE(verdicts->error[i] == error);
        REQUIRE(verdicts->share[i] == share);
      }
      count += counts;
      worst = std::max(worst, error);
      if (std::pair(share, error) > std::pair(worst_share, at_share)) worst_share = share, at_share = error;
    }
    CHECK(verdicts->count == count);
    CHECK(verdicts->special == special);
    CHECK(verdicts->left_out == left_out);
    CHECK(verdicts->not_finite == not_finite);
    CHECK(verdicts->worst == worst);
    CHECK(verdicts->worst_share == worst_share);
    CHECK(verdicts->at_share == at_share);
    all[0] += count, all[1] += special, all[2] += left_out, all[3] += not_finite;
  }
  for (const uint64_t n : all) CHECK(n > 1000);
}
