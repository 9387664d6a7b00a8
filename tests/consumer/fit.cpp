// SPDX-License-Identifier: Apache-2.0
// Compiles fit.dr, runs it on a device and on the reference, and compares. usage: fit DEVICE PROGRAM
#include <runtime/jit/jit.h>
#include <runtime/jit/reference_program.h>
#include <runtime/runtime.h>

#include <array>
#include <cmath>
#include <cstdio>

using namespace dr;

template <class T>
T must(io::Result<T> result) {
  if (!result) {
    std::fprintf(stderr, "fit: %s\n", result.error().c_str());
    std::exit(1);
  }
  if constexpr (!std::is_void_v<T>) return std::move(result).value();
}

// The error that the fourth run starts from.
template <class P>
double error_of(P& program) {
  const std::array<float, 4> start{0, 0, 0, 0}, goal{8, -16, 32, 1};
  must(program.bind("x", io::Array::from_floats(start, 2)));
  must(program.bind("goal", io::Array::from_floats(goal, 2)));
  must(program.run("fit", 4));
  return must(program.output("fit", "error")).to_doubles().at(0);
}

int main(int argc, char** argv) {
  if (argc != 3) return 2;
  const runtime::Device device = must(runtime::Device::open({.name = argv[1]}));
  jit::Options options;
  options.profile = device.profile_name();
  const auto bundle = jit::compile_file(argv[2], options);
  if (!bundle) {
    std::fputs(bundle.error().c_str(), stderr);
    return 1;
  }
  auto program = must(runtime::Program::load(device, *bundle));
  auto reference = must(jit::ReferenceProgram::load(*bundle));
  const double found = error_of(program), expected = error_of(reference);
  std::printf("error = %g, of the reference %g\n", found, expected);
  // (8² + 16² + 32² + 1²) / 2, a 64th after three halvings of the way.
  if (std::fabs(expected - 1345.0 / 128) > 1e-9 || std::fabs(found - expected) > 1e-5 * expected) return 1;
}
