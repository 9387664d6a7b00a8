// SPDX-License-Identifier: Apache-2.0
// Runs a bundle that drc made of fit.dr: each step halves the way to the goal. usage: play DEVICE BUNDLE
#include <runtime/runtime.h>

#include <array>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <iterator>

using namespace dr;

template <class T>
T must(io::Result<T> result) {
  if (!result) {
    std::fprintf(stderr, "play: %s\n", result.error().c_str());
    std::exit(1);
  }
  if constexpr (!std::is_void_v<T>) return std::move(result).value();
}

int main(int argc, char** argv) {
  if (argc != 3) return 2;
  std::ifstream file(argv[2], std::ios::binary);
  const std::vector<uint8_t> bundle{std::istreambuf_iterator<char>(file), {}};
  const runtime::Device device = must(runtime::Device::open({.name = argv[1]}));
  runtime::Program program = must(runtime::Program::load(device, bundle));
  const std::array<float, 6> start{0, 0, 0, 0, 0, 0}, goal{8, -16, 32, 0, 2, 4};
  must(program.bind("x", io::Array::from_floats(start, 2)));
  must(program.bind("goal", io::Array::from_floats(goal, 2)));
  must(program.run("fit", 4));
  const io::Array x = must(program.leaf("x"));
  for (size_t k = 0; k < goal.size(); ++k)
    if (const float found = x.as<float>()[k], expected = goal[k] * 15 / 16; std::fabs(found - expected) > 1e-5f) {
      std::fprintf(stderr, "play: x[%zu] is %g, not %g\n", k, static_cast<double>(found),
                   static_cast<double>(expected));
      return 1;
    }
  if (program.bind("nothing", x)) {
    std::fprintf(stderr, "play: a leaf that does not exist was bound\n");
    return 1;
  }
}
