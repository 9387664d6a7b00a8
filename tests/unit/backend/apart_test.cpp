// SPDX-License-Identifier: Apache-2.0
// How far integers are apart at most, against all elements of extents from 1 to 9, for random integers.
#include "compiler/backend/analysis/apart.h"

#include <algorithm>
#include <functional>
#include <random>
#include <string>
#include <vector>

#include "compiler/ir/parse.h"
#include "tests/catch.h"

namespace {

using namespace dr;

int64_t floor_mod(int64_t a, int64_t b) { return ((a % b) + b) % b; }

// Ops as text, and what each gives for an extent and an element.
class Program {
 public:
  using Number = std::function<int64_t(int64_t extent, int64_t x)>;

  Program() {
    add("coord ints [0] dims [W, 1, 1]", [](int64_t, int64_t x) { return x; });
    add_number("dim dims [W]", [](int64_t extent, int64_t) { return extent; });
    add_number("dim dims [(W + 1) / 2]", [](int64_t extent, int64_t) { return (extent + 1) / 2; });
    for (const int n : {-1, 0, 1, 2, 3, 1 << 30})
      add_number("const floats [" + std::to_string(n) + "]", [n](int64_t, int64_t) { return n; });
  }

  size_t add(const std::string& text, Number number) { return append("int[W]", text, std::move(number)); }
  size_t add_number(const std::string& text, Number number) { return append("int", text, std::move(number)); }
  size_t binary(const std::string& op, size_t a, size_t b, const std::function<int64_t(int64_t, int64_t)>& f) {
    return add(op + " " + name(a) + ", " + name(b),
               [a = numbers_[a], b = numbers_[b], f](int64_t w, int64_t x) { return f(a(w, x), b(w, x)); });
  }
  // The text alone, for what nobody asks the value of.
  size_t text(const std::string& op, size_t a, size_t b) {
    return append("int[W]", op + " " + name(a) + ", " + name(b), nullptr);
  }
  size_t condition(const std::string& op, size_t a, size_t b) {
    return append("bool[W]", op + " " + name(a) + ", " + name(b), nullptr);
  }
  size_t choice(size_t condition, size_t yes, size_t no) {
    return append("int[W]", "select " + name(condition) + ", " + name(yes) + ", " + name(no), nullptr);
  }
  // floor(a / b), as the compiler writes it.
  size_t floored(size_t a, size_t b) {
    const size_t rest = binary("mod", a, b, floor_mod), whole = binary("sub", a, rest, std::minus<int64_t>());
    return binary("div", whole, b, [](int64_t x, int64_t y) { return x / y; });
  }
  size_t select(const std::string& op, size_t a, size_t b, size_t yes, size_t no) {
    const bool less = op == "lt";
    return add("select " + name(condition(op, a, b)) + ", " + name(yes) + ", " + name(no),
               [=, a = numbers_[a], b = numbers_[b], yes = numbers_[yes], no = numbers_[no]](int64_t w, int64_t x) {
                 return (less ? a(w, x) < b(w, x) : a(w, x) <= b(w, x)) ? yes(w, x) : no(w, x);
               });
  }

  // Any of those so far that is a number, but for conditions.
  size_t any(std::mt19937& random) const {
    for (;;)
      if (const size_t k = random() % numbers_.size(); numbers_[k]) return k;
  }

  std::optional<int64_t> bound(size_t high, size_t low) const {
    auto parsed = ir::parse(text_);
    REQUIRE(std::holds_alternative<ir::Graph>(parsed));
    const auto& graph = std::get<ir::Graph>(parsed);
    return backend::most_apart(graph, value(graph, high), value(graph, low));
  }

  // The bound, if there is one; fails if it is too small.
  std::optional<int64_t> check(size_t high, size_t low) const {
    const auto found = bound(high, low);
    for (int64_t extent = 1; found && extent < 10; ++extent)
      for (int64_t x = 0; x < extent; ++x) {
        INFO(text_ << name(high) << " above " << name(low) << ", W = " << extent << ", x = " << x);
        const int64_t apart = numbers_[high](extent, x) - numbers_[low](extent, x);
        if (apart > *found) CHECK(apart <= *found);
      }
    return found;
  }

 private:
  static ir::ValueId value(const ir::Graph& graph, size_t k) {
    return graph.op(graph.region(graph.root()).ops[k]).results[0];
  }
  static std::string name(size_t k) { return "%" + std::to_string(k); }
  size_t append(const std::string& type, const std::string& text, Number number) {
    text_ += name(numbers_.size()) + " : " + type + " = " + text + "\n";
    numbers_.push_back(std::move(number));
    return numbers_.size() - 1;
  }

  std::string text_;
  std::vector<Number> numbers_;
};

enum : size_t { kX, kW, kHalf, kMinusOne, kZero, kOne, kTwo, kThree, kHuge };

}  // namespace

TEST_CASE("what gathers from a halved image is one element") {
  // Those q with min(2 q + 1, W - 1) = x, from the program of a pyramid's gradient.
  Program p;
  const size_t last = p.add_number("dim dims [W - 1]", [](int64_t extent, int64_t) { return extent - 1; }),
               past = p.select("le", last, kX, kHuge, kX),
               first = p.binary("max", p.floored(kX, kTwo), kZero, [](int64_t a, int64_t b) { return std::max(a, b); }),
               half = p.floored(p.binary("sub", past, kOne, std::minus<int64_t>()), kTwo),
               end = p.binary("min", p.binary("add", half, kOne, std::plus<int64_t>()), kHalf,
                              [](int64_t a, int64_t b) { return std::min(a, b); }),
               some = p.select("le", kX, last, end, first);
  CHECK(p.check(some, first).value_or(100) <= 1);
  // An extent lies above a place by more than any number.
  CHECK(!p.check(kW, kX));
  CHECK(p.check(kX, kW) == -1);
}

TEST_CASE("bounds of random integers hold") {
  std::mt19937 random(7);
  size_t known = 0;
  constexpr size_t kPrograms = 4000;
  for (size_t program = 0; program < kPrograms; ++program) {
    Program p;
    for (int k = 0; k < 8; ++k) {
      const size_t a = p.any(random), b = p.any(random), by = kOne + random() % 3;
      switch (random() % 8) {
        case 0: p.binary("add", a, kMinusOne + random() % 4, std::plus<int64_t>()); break;
        case 1: p.binary("sub", a, b == kHuge ? kOne : b, std::minus<int64_t>()); break;
        case 2: p.binary("min", a, b, [](int64_t x, int64_t y) { return std::min(x, y); }); break;
        case 3: p.binary("max", a, b, [](int64_t x, int64_t y) { return std::max(x, y); }); break;
        case 4: p.binary("div", a, by, [](int64_t x, int64_t y) { return x / y; }); break;
        case 5: p.binary("mod", a, by, floor_mod); break;
        case 6: p.floored(a, by); break;
        case 7: p.select(random() % 2 == 0 ? "le" : "lt", a, b, p.any(random), p.any(random)); break;
      }
    }
    for (int pair = 0; pair < 8; ++pair) known += p.check(p.any(random), p.any(random)) ? 1 : 0;
  }
  CHECK(known > kPrograms);  // one in eight
}

TEST_CASE("sums of sums of themselves take no time") {
  Program p;
  size_t v = kX;
  for (int k = 0; k < 200; ++k) v = p.text(k % 3 == 0 ? "min" : "add", v, v);
  CHECK(!p.bound(v, kZero));
  CHECK(p.bound(p.text("mod", v, kThree), kZero) == 2);
  // Divided by 2^75.
  const size_t many = p.add_number("const floats [32768]", [](int64_t, int64_t) { return 32768; });
  size_t few = kX;
  for (int k = 0; k < 5; ++k) few = p.floored(few, many);
  CHECK(!p.bound(few, kZero));
  size_t condition = p.condition("le", kX, kThree);
  for (int k = 0; k < 200; ++k) condition = p.condition("land", condition, condition);
  CHECK(p.bound(p.choice(condition, kOne, kTwo), kZero) == 2);
}
