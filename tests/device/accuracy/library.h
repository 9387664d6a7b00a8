// SPDX-License-Identifier: Apache-2.0
// The accuracy of library functions on a device: one row a function and direction, the value or the gradient to an
// operand. Each function is one entry of a table; the program that a device runs, the one that judges it and the one
// that draws operands are made of the entries' text. The judge is the float64 evaluator on the same expressions, given
// the same float32 operands and, for rasters, the device's discrete decisions.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <span>
#include <string>
#include <vector>

#include "runtime/runtime.h"

namespace dr::accuracy::library {

// The rounding error of float32.
inline constexpr double u = 0x1p-24;
// Operands are images of this width and height unless they say otherwise.
inline constexpr int64_t kSide = 64;

// What a function is called with. Random ones have half of their components with a uniform exponent between `least` and
// the larger bound, half uniform between -8 and 8, within [low, high] and among them the bounds, 0, 1 and their
// neighbours. Others are made `from` an expression of operands before them, which is rounded to float32. An operand
// whose name ends in `_` is there for such expressions alone. `input` has no gradient. In all text `$name` is the leaf
// itself, as `topology` needs it.
struct Operand {
  std::string name, type;
  double low = 0, high = 0, least = 0;
  std::string from = {};
  std::string extent = {};  // "[40, 1, 2]"
  std::string leaf = {};    // the leaf's name, where the language gives it
  bool direction = false;   // of length 1; where a drawn one is 0, the result must be finite and no more
};

enum class Metric : uint8_t {
  Relative,     // the error over the size of the exact result
  Scaled,       // over `scale`, an expression
  Conditioned,  // over the size of the result and what a relative change of 1 of the operands makes of it
  L2,           // the root of the sum of squares over an image, over that of the exact one
  Equal,        // bound 0
};

struct Direction {
  std::string of;  // "value", an operand whose gradient is meant, or "next NAME": a leaf after the step
  double bound = 0;
  Metric metric = Metric::Relative;
  // Expressions of operands, the value `y`, its adjoint `g` and the gradients `d_NAME`. Where `except` holds nothing is
  // compared but that the result is finite.
  std::string scale = {}, scale_text = {};
  std::string except = {}, except_text = {};
  std::string why = {};  // the bound set beforehand, or why it is another
  // In the profile of floats `native`, where more than the built-ins is further off there; 0: the same.
  double native = 0;
  std::string native_why = {};
  // The scale in `native` where it is another: drivers' sines are off by parts of 1, however small they are.
  std::string native_scale = {}, native_scale_text = {};
};

struct Function {
  std::string name;    // "camera.rotate"
  std::string part;    // which of several rows of the function; may be empty
  std::string result;  // type and extent of the value, "vec3"
  std::vector<Operand> operands;
  std::string value;  // an expression of the operands' names
  std::vector<Direction> directions;
  std::string before = {};  // statements before the value
  std::string domain = {};  // in words, beyond the operands' ranges
  // Elements of the result depend on many of the operands': no search for worse operands, and seeds of all components.
  bool whole = false;
  std::string statement = {};  // of the step, instead of a value
  // Takes seconds to compile: left to `./dr bench accuracy`.
  bool slow = false;
  // Operands whose gradient has no row here; `library_jvp_test` holds it against jvp in the evaluator.
  std::vector<std::string> transposed = {};
};

std::vector<Function> functions();
// Functions of the library without a row, as "module.name", and why.
struct Elsewhere {
  std::string function, where;
};
std::vector<Elsewhere> elsewhere();

// The parts of functions(), a file each.
std::vector<Function> point_functions();     // camera, light, shading
std::vector<Function> number_functions();    // optim, random, loss of elements
std::vector<Function> image_functions();     // loss, texture
std::vector<Function> mesh_functions();      // mesh
std::vector<Function> material_functions();  // material, lamps of light
std::vector<Function> environment_functions();
std::vector<Function> shadow_functions();
std::vector<Function> hair_functions();
std::vector<Function> rig_functions();
std::vector<Function> strand_functions();
std::vector<Function> skin_functions();     // skin, eye
std::vector<Function> picture_functions();  // hardsoftras, raster, nvdiffrast
std::vector<Function> filter_functions();   // image, solve
std::vector<Function> network_functions();  // nn, points, splat; rays and lenses of camera

// One function and direction on one device.
struct Row {
  std::string function, part, direction, formula, domain, metric, why, profile, except;
  int64_t samples = 0, excepted = 0, not_finite = 0;
  double bound = 0, worst = 0, p999 = 0;
  double drawn = 0;              // the largest error of random operands, before the search
  std::string worst_input = {};  // float32 bits of the operands' components, or the element
  double expected = 0, found = 0;
  bool passes() const { return worst <= bound && not_finite == 0; }
};

struct Options {
  std::string profile;             // of the device
  std::string numbers = "strict";  // the profile of floats, for the rows
  int batches = 16;                // of kSide * kSide random elements
  int rounds = 8;                  // of the search from the worst ones
  uint64_t seed = 1;
};

// Errors of the device or the compiler end the process with a message.
std::vector<Row> measure(const runtime::Device& device, std::span<const Function> functions, const Options& options);

// Rows as JSON, and the sections of docs/results/accuracy.md about those of a profile of floats on stdout; `devices`
// has "library" rows by name.
nlohmann::json to_json(std::span<const Row> rows);
void document(const nlohmann::json& devices, const std::string& numbers);

}  // namespace dr::accuracy::library
