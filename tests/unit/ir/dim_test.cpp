// SPDX-License-Identifier: Apache-2.0
// Extents: the normal form, its printed form, and agreement with plain integer arithmetic on random expressions.
#include "compiler/ir/dim.h"

#include <cctype>
#include <limits>
#include <random>

#include "tests/catch.h"

using namespace dr::ir;

namespace {

Dim sym(const char* name) { return Dim::symbol(name); }

int64_t floor_div(int64_t a, int64_t b) { return a / b - (a % b < 0 ? 1 : 0); }

// What C and GLSL make of a printed extent: the division truncates.
class TruncatingEvaluator {
 public:
  TruncatingEvaluator(std::string_view text, const SymbolValues& values) : text_(text), values_(values) {}
  int64_t run() { return sum(); }

 private:
  char peek() {
    while (at_ < text_.size() && text_[at_] == ' ') ++at_;
    return at_ < text_.size() ? text_[at_] : '\0';
  }
  int64_t sum() {
    int64_t left = product();
    for (char c = peek(); c == '+' || c == '-'; c = peek()) {
      ++at_;
      const int64_t right = product();
      left = c == '+' ? left + right : left - right;
    }
    return left;
  }
  int64_t product() {
    int64_t left = unary();
    for (char c = peek(); c == '*' || c == '/'; c = peek()) {
      ++at_;
      const int64_t right = unary();
      left = c == '*' ? left * right : left / right;
    }
    return left;
  }
  int64_t unary() {
    const char c = peek();
    if (c == '-' || c == '(') {
      ++at_;
      const int64_t inner = c == '-' ? -unary() : sum();
      if (c == '(') ++at_;
      return inner;
    }
    const size_t begin = at_;
    while (at_ < text_.size() && std::isalnum(static_cast<unsigned char>(text_[at_]))) ++at_;
    const std::string word(text_.substr(begin, at_ - begin));
    return std::isdigit(static_cast<unsigned char>(word[0])) ? std::stoll(word) : values_.find(word)->second;
  }

  std::string_view text_;
  const SymbolValues& values_;
  size_t at_ = 0;
};

// A random expression and its value at each of some points, computed beside it.
struct Sample {
  Dim dim;
  std::vector<int64_t> values;
};

class SampleMaker {
 public:
  explicit SampleMaker(uint64_t seed) : random_(seed) {
    for (int i = 0; i < 4; ++i) {
      points.push_back({{"H", pick(0, 40)}, {"V", pick(0, 40)}, {"W", pick(0, 40)}});
    }
  }

  Sample make(int depth) {
    const int64_t what = depth == 0 ? pick(0, 1) : pick(0, 6);
    Sample s;
    if (what == 0) {
      const int64_t constant = pick(-9, 9);
      s = {Dim(constant), std::vector<int64_t>(points.size(), constant)};
    } else if (what == 1) {
      const std::string name(1, "HVW"[pick(0, 2)]);
      s.dim = Dim::symbol(name);
      for (const SymbolValues& point : points) s.values.push_back(point.at(name));
    } else if (what <= 4) {
      const Sample a = make(depth - 1), b = make(depth - 1);
      s.dim = what == 2 ? a.dim + b.dim : what == 3 ? a.dim - b.dim : a.dim * b.dim;
      for (size_t i = 0; i < points.size(); ++i) {
        s.values.push_back(what == 2   ? a.values[i] + b.values[i]
                           : what == 3 ? a.values[i] - b.values[i]
                                       : a.values[i] * b.values[i]);
      }
    } else {
      const Sample a = make(depth - 1);
      const int64_t divisor = pick(1, 6);
      s.dim = a.dim.divided_by(divisor);
      for (int64_t value : a.values) s.values.push_back(floor_div(value, divisor));
    }
    return s;
  }

  std::vector<SymbolValues> points;

 private:
  int64_t pick(int64_t low, int64_t high) { return std::uniform_int_distribution<int64_t>(low, high)(random_); }
  std::mt19937_64 random_;
};

}  // namespace

TEST_CASE("like terms are collected") {
  const Dim W = sym("W"), H = sym("H");
  CHECK(W + H == H + W);
  CHECK((W + 1) * (W - 1) == W * W - 1);
  CHECK(W - W == Dim(0));
  CHECK((W - W).is_constant());
  CHECK((W * H).str() == "H * W");
  CHECK((W + W).str() == "2 * W");
  CHECK(W != H);
  CHECK(Dim(3) != W);
}

TEST_CASE("floor division takes out what it can") {
  const Dim W = sym("W"), H = sym("H");
  CHECK(Dim(7).divided_by(2) == Dim(3));
  CHECK(Dim(-7).divided_by(2) == Dim(-4));
  CHECK((W * 6 + H * 4).divided_by(2) == W * 3 + H * 2);
  CHECK((W * 2 + 3).divided_by(2) == W + 1);
  CHECK((W * 3).divided_by(2) == W + W.divided_by(2));
  CHECK((W * 4 + 2).divided_by(6) == (W * 2 + 1).divided_by(3));
  CHECK((W * 2 + 3).divided_by(4) == (W + 1).divided_by(2));
  CHECK((W - 1).divided_by(2) == (W + 1).divided_by(2) - 1);
  // A chain of halvings, as in a mip chain, is one division.
  CHECK(W.divided_by(2).divided_by(2) == W.divided_by(4));
  CHECK(((W + 1).divided_by(2) + 1).divided_by(2) == (W + 3).divided_by(4));
  CHECK(W.divided_by(1) == W);
}

TEST_CASE("extents print as expressions") {
  const Dim W = sym("W"), H = sym("H");
  CHECK(Dim(12).str() == "12");
  CHECK(Dim(-3).str() == "-3");
  CHECK((W + 1).divided_by(2).str() == "(W + 1) / 2");
  CHECK(W.divided_by(2).str() == "W / 2");
  CHECK((W.divided_by(2) * 3 + H).str() == "H + 3 * (W / 2)");
  CHECK((Dim(0) - W.divided_by(2)).str() == "-(W / 2)");
  CHECK((H - W.divided_by(2) - 1).str() == "H - W / 2 - 1");
  CHECK((W * H).divided_by(2).str() == "H * W / 2");
  CHECK((W * H * 2 + W - 5).str() == "2 * H * W + W - 5");
}

TEST_CASE("extents parse") {
  CHECK(Dim::parse("(W + 1) / 2") == (sym("W") + 1).divided_by(2));
  CHECK(Dim::parse("W+1/2") == sym("W"));
  CHECK(Dim::parse(" - ( W ) * 2 ") == sym("W") * -2);
  CHECK(Dim::parse("W / (1 + 1)") == sym("W").divided_by(2));
  CHECK(Dim::parse("a_1") == sym("a_1"));
  for (const char* text :
       {"", "W +", "(W", "W)", "W / 0", "W / -2", "1 / W", "W W", "W % 2", "2W", "W, H", "+", "\xff"}) {
    INFO(text);
    CHECK_FALSE(Dim::parse(text));
  }
}

TEST_CASE("hostile extents are refused or undefined") {
  CHECK_FALSE(Dim::parse(std::string(100000, '(')));
  CHECK_FALSE(Dim::parse(std::string(100000, '-') + "W"));
  std::string sum = "a", product = "a", division = "W";
  for (int i = 0; i < 20000; ++i) {
    sum += " + a" + std::to_string(i);
    product += " * (a + b" + std::to_string(i % 7) + ")";
    division += " / 3 * W";
  }
  for (const std::string& text : {sum, product, division}) {
    const auto d = Dim::parse(text);
    REQUIRE(d);
    CHECK_FALSE(d->evaluate({}));
    CHECK(Dim::parse(d->str()) == *d);
  }
}

TEST_CASE("arithmetic that does not fit is undefined") {
  constexpr int64_t kMax = std::numeric_limits<int64_t>::max();
  const Dim big(kMax), W = sym("W");
  for (const Dim& d : {big + 1, big * 2, Dim(0) - big - 1 - 1, Dim(std::numeric_limits<int64_t>::min()), W * kMax * 2,
                       W * big + W, Dim::parse("99999999999999999999").value()}) {
    INFO(d.str());
    CHECK_FALSE(d.is_constant());
    CHECK_FALSE(d.evaluate({{"W", 1}}));
    CHECK(d == big + 1);
    CHECK(Dim::parse(d.str()) == d);
    CHECK((d + W) * 0 == d);
    CHECK(d != W);
  }
  CHECK((W * kMax).evaluate({{"W", 1}}) == kMax);
  CHECK_FALSE((W * kMax).evaluate({{"W", 2}}));
  CHECK_FALSE((W * W).evaluate({{"W", int64_t{1} << 32}}));
}

TEST_CASE("symbols, evaluation, substitution") {
  const Dim d = (sym("W") + sym("H")).divided_by(2) * sym("V");
  CHECK(d.symbols() == std::vector<std::string>{"H", "V", "W"});
  CHECK(Dim(4).symbols().empty());
  CHECK(sym("W").as_symbol() == "W");
  CHECK_FALSE((sym("W") * 2).as_symbol());
  CHECK_FALSE(sym("W").divided_by(2).as_symbol());
  CHECK_FALSE(Dim(1).as_symbol());
  CHECK(d.evaluate({{"H", 3}, {"V", 10}, {"W", 4}}) == 30);
  CHECK_FALSE(d.evaluate({{"H", 3}, {"W", 4}}));
  CHECK(d.substitute({{"H", sym("W")}, {"V", Dim(2)}}) == sym("W") * 2);
  CHECK(d.substitute({}) == d);
}

TEST_CASE("extents of values") {
  const Dim W = sym("W"), H = sym("H");
  CHECK(Extent{}.is_unit());
  CHECK(Extent{}.str() == "");
  CHECK(Extent{W, 1, 1}.str() == "[W]");
  CHECK(Extent{1, H, 1}.str() == "[1, H]");
  CHECK(Extent{1, 1, 4}.str() == "[1, 1, 4]");
  CHECK(broadcast({W, 1, 1}, {1, H, 1}) == Extent{W, H, 1});
  CHECK(broadcast({W, H, 1}, {W, H, 3}) == Extent{W, H, 3});
  CHECK_FALSE(broadcast({W, 1, 1}, {H, 1, 1}));
  CHECK_FALSE(broadcast({2, 1, 1}, {3, 1, 1}));
}

TEST_CASE("random extents agree with integer arithmetic") {
  for (uint64_t seed = 0; seed < 20000; ++seed) {
    SampleMaker maker(seed);
    const Sample s = maker.make(3);
    CAPTURE(seed, s.dim.str());
    for (size_t i = 0; i < maker.points.size(); ++i) {
      REQUIRE(s.dim.evaluate(maker.points[i]) == s.values[i]);
      REQUIRE(TruncatingEvaluator(s.dim.str(), maker.points[i]).run() == s.values[i]);
    }
    REQUIRE(Dim::parse(s.dim.str()) == s.dim);
    // Substituting values is evaluating.
    std::map<std::string, Dim, std::less<>> numbers;
    for (const auto& [name, value] : maker.points[0]) numbers.emplace(name, Dim(value));
    REQUIRE(s.dim.substitute(numbers) == Dim(s.values[0]));
  }
}

TEST_CASE("the order of extents is total") {
  std::vector<Dim> dims;
  for (uint64_t seed = 0; seed < 40; ++seed) dims.push_back(SampleMaker(seed).make(3).dim);
  for (const Dim& a : dims) {
    for (const Dim& b : dims) {
      CHECK(((a <=> b) == 0) == (a == b));
      CHECK((a < b) == (b > a));
      for (const Dim& c : dims) {
        if (a < b && b < c) CHECK(a < c);
      }
    }
  }
}
