// SPDX-License-Identifier: Apache-2.0
// Small programs of two sizes each: what the larger one takes more is the cost of what it has more. Both are timed in
// turns, and the median of several runs counts: what wakes threads up belongs to a pass as much as what they do.
#include "runtime/jit/measure.h"

#include <algorithm>
#include <chrono>
#include <functional>
#include <utility>

#include "runtime/jit/compile_text.h"

namespace dr::jit {

namespace {

struct Problem {
  std::string message;
};

constexpr int kRuns = 9;
constexpr double kTexel = 16;  // bytes of a vec4

double now_ns() {
  return std::chrono::duration<double, std::nano>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

std::string repeat(int times, const std::function<std::string(int)>& line) {
  std::string out;
  for (int k = 0; k < times; ++k) out += line(k);
  return out;
}

class Measurement {
 public:
  explicit Measurement(const runtime::Device& device) : device_(device) {
    if (!device.state()) throw Problem{"the device is empty: it was moved from"};
    renew();
  }

  uint32_t trips() {
    profile_ = std::get<target::Profile>(target::load_profile("lavapipe"));
    take_limits();
    Options compute;
    compute.lower = compute.raster = "compute";
    return loop_trips(compute);
  }

  target::Profile process() {
    profile_ = std::get<target::Profile>(target::load_profile("lavapipe"));
    const runtime::DeviceInfo info = device_.info();
    profile_.name = info.name;
    profile_.description = "measured on " + info.name + " (" + info.kind + ", driver " + info.driver + ")";
    take_limits();
    target::Costs c = profile_.costs;
    Options compute, fragment, subpasses, compute_raster, hardware_raster;
    compute.lower = compute_raster.lower = compute_raster.raster = "compute";
    fragment.lower = subpasses.lower = hardware_raster.lower = "fragment";
    hardware_raster.raster = "hardware";
    fragment.ablate = {"stages"};
    subpasses.ablate = {"substages", "remat"};
    // Fixed costs from tiny images, traffic from large ones.
    constexpr int kTiny = 4, kLarge = 256;
    const double pixels = double{kLarge} * kLarge;
    profile_.loop_trips = loop_trips(compute);
    profile_.lanes_in_turn = lanes_in_turn(kLarge, compute);
    c.dispatch_ns = a_line(neighbours, kTiny, compute);
    c.pass_ns = a_line(neighbours, kTiny, fragment);
    c.subpass_ns = a_line(elementwise, kTiny, subpasses);
    const double buffers = a_line(neighbours, kLarge, compute) - c.dispatch_ns;
    const double images = a_line(neighbours, kLarge, fragment) - c.pass_ns;
    const double inputs = a_line(elementwise, kLarge, subpasses) - c.subpass_ns;
    c.compute_buffer_bytes_per_ns = rate(2 * kTexel * pixels, buffers);
    c.fragment_image_bytes_per_ns = rate(2 * kTexel * pixels, images);
    c.fragment_input_bytes_per_ns = rate(2 * kTexel * pixels, inputs);
    // A leaf is a buffer; what is written is an image.
    const double leaf = run(leaf_only(), kLarge, fragment) - c.pass_ns;
    c.fragment_buffer_bytes_per_ns = rate(kTexel * pixels, leaf - kTexel * pixels / c.fragment_image_bytes_per_ns);
    // A sum in compute of what a pass before it left in an image or in a buffer.
    const double of_image = run(sum_of_pass(), kLarge, fragment) - c.pass_ns - images;
    const double of_buffer = run(sum_of_pass(), kLarge, compute) - c.dispatch_ns - buffers;
    c.compute_image_bytes_per_ns =
        rate(kTexel * pixels, of_image - of_buffer + kTexel * pixels / c.compute_buffer_bytes_per_ns);
    constexpr int kFew = 16, kMany = 144;
    const double operations = 8.0 * (kMany - kFew) * pixels;
    c.compute_operations_per_ns = rate(operations, beyond(arithmetic(kMany), arithmetic(kFew), kLarge, compute));
    c.fragment_operations_per_ns = rate(operations, beyond(arithmetic(kMany), arithmetic(kFew), kLarge, fragment));
    c.atomic_add_ns = at_least(run(scatter(), kLarge, compute) / (kAtomics * pixels));
    raster(compute_raster, c.compute_triangle_ns, c.compute_pixel_ns);
    raster(hardware_raster, c.hardware_triangle_ns, c.hardware_pixel_ns);
    c.compute_compile_ms = at_least(compile_ns(compute) * 1e-6);
    c.fragment_compile_ms = at_least(compile_ns(fragment) * 1e-6);
    profile_.costs = c;
    profile_.lower = images + c.pass_ns < buffers + c.dispatch_ns ? "fragment" : "compute";
    // A thousand triangles over a tenth of a picture.
    const auto scene = [](double triangle, double pixel) { return 1e3 * triangle + 6.5e3 * pixel; };
    profile_.raster =
        scene(c.hardware_triangle_ns, c.hardware_pixel_ns) < scene(c.compute_triangle_ns, c.compute_pixel_ns)
            ? "hardware"
            : "compute";
    return profile_;
  }

 private:
  static constexpr double kAtomics = 3;  // of one addition: the largest, then two words

  // A number that no shader had before, or the driver would know it already.
  void renew() {
    unique_ = std::to_string(1e-6 * static_cast<double>(static_cast<int64_t>(now_ns() * 1e-3) % 1'000'000));
  }
  // Costs are above zero, whatever noise says.
  static double at_least(double cost) { return std::max(cost, 1e-3); }
  static double rate(double amount, double ns) { return amount / std::max(ns, amount * 1e-4); }

  // ---- Programs: their leaf is `a`, a square of vec4.
  using Chain = std::function<std::string(int)>;
  static std::string wrapped(const std::string& body) {
    return "edition 1;\ninput a : vec4[W, H];\nparam p : float = 1.0;\n" + body;
  }
  // Each line reads its neighbours' finished values: a pass of its own. `p` makes it steady.
  std::string chain(int lines, bool neighbours_too) const {
    return wrapped("let x0 = a * p * " + unique_ + ";\n" +
                   repeat(lines,
                          [&](int k) {
                            const std::string x = "x" + std::to_string(k);
                            return "let x" + std::to_string(k + 1) + " = " +
                                   (neighbours_too ? "shift(" + x + ", 1, 0)" : "sqrt(" + x + ")") + " * (0.9" +
                                   std::to_string(k) + " + " + unique_ + ");\n";
                          }) +
                   "step go { p <- p + 1.0; output y = x" + std::to_string(lines) + "; }\n");
  }
  Chain neighbours = [this](int lines) { return chain(lines, true); };
  Chain elementwise = [this](int lines) { return chain(lines, false); };
  std::string leaf_only() const {
    return wrapped("step go { p <- p + 1.0; output y = shift(a, 1, 0) * p * " + unique_ + "; }\n");
  }
  std::string sum_of_pass() const {
    return wrapped("let x = shift(a, 1, 0) * p * " + unique_ + ";\nstep go { p <- p + 1.0; output y = sum(x), x; }\n");
  }
  std::string arithmetic(int rounds) const {
    return wrapped("let y = { var x = a * p; for k in 0.." + std::to_string(rounds) + " { x = x * " + unique_ +
                   " + a; } x };\nstep go { p <- p + 1.0; output y; }\n");
  }
  std::string scatter() const {
    return wrapped("step go { p <- p + 1.0; output y = scatter_add(coord(W, H).yx, a.x * p, H, W); }\n");
  }
  // Right triangles of `size` pixels, `side` x `side` of them, over 256 x 256 pixels.
  std::string triangles(int side, double size) const {
    const std::string n = std::to_string(side), s = std::to_string(size);
    return wrapped("struct Corner { at: vec2; }\nlet seen = raster(" + std::to_string(side * side) +
                   ", 256, 256, 1, nearest = 1) {\n  setup(f) -> Corner { Corner(vec2(float(f % " + n +
                   "), float(f / " + n + ")) * (256.0 / float(" + n +
                   ")) * min(p, 1.0)) }\n  corner(s, k) -> vec2 { s.at + [vec2(0.0, 0.0), vec2(" + s +
                   ", 0.0), vec2(0.0, " + s +
                   ")][k] }\n  keep(s, q) -> bool { q.x >= s.at.x && q.y >= s.at.y && q.x - s.at.x + q.y - s.at.y < " +
                   s + " }\n  depth(s, q) -> float { 0.5 }\n};\nstep go { p <- p + 1.0; output y = seen[0].face; }\n");
  }

  // ---- Times, in ns.
  runtime::Program load(const std::string& text, int size, const Options& options) {
    auto bundle = compile_text("measurement.dr", text, profile_, options);
    if (!bundle) throw Problem{bundle.error()};
    runtime::Program program = must(runtime::Program::load(device_, *bundle));
    must(program.bind(
        "a", io::Array::from_floats(std::vector<float>(static_cast<size_t>(size) * static_cast<size_t>(size) * 4, 0.5f),
                                    4, size, size)));
    return program;
  }
  // A GPU's own clock, command by command; a processor's commands are timed as they run, without waits between them.
  double once(runtime::Program& program) {
    if (device_.info().kind == "cpu") {
      constexpr int kTogether = 4;
      const double start = now_ns();
      must(program.run("go", kTogether));
      return (now_ns() - start) / kTogether;
    }
    double sum = 0;
    for (const runtime::CommandTime& t : must(program.timed_run("go"))) sum += t.nanoseconds;
    return sum;
  }
  std::vector<double> medians(std::vector<runtime::Program>& programs) {
    for (runtime::Program& program : programs) must(program.run("go", 2));
    std::vector<std::vector<double>> times(programs.size());
    for (int k = 0; k < kRuns; ++k)
      for (size_t p = 0; p < programs.size(); ++p) times[p].push_back(once(programs[p]));
    std::vector<double> out;
    for (auto& t : times) {
      std::nth_element(t.begin(), t.begin() + kRuns / 2, t.end());
      out.push_back(t[kRuns / 2]);
    }
    return out;
  }
  double run(const std::string& text, int size, const Options& options) {
    std::vector<runtime::Program> programs;
    programs.push_back(load(text, size, options));
    return medians(programs)[0];
  }
  // What `more` takes beyond `less`.
  double beyond(const std::string& more, const std::string& less, int size, const Options& options) {
    std::vector<runtime::Program> programs;
    programs.push_back(load(more, size, options));
    programs.push_back(load(less, size, options));
    const std::vector<double> times = medians(programs);
    return times[0] - times[1];
  }
  double a_line(const Chain& program, int size, const Options& options) {
    constexpr int kFew = 2, kMany = 14;
    return at_least(beyond(program(kMany), program(kFew), size, options) / (kMany - kFew));
  }
  // A sum of ones, which is as long as the driver lets a loop run: a limit beyond a million trips is not found.
  uint32_t loop_trips(const Options& options) {
    constexpr int kTrips = 1 << 20;
    const std::string name = std::exchange(profile_.name, device_.profile_name());  // for others the loop is refused
    profile_.loop_trips = 0;
    profile_.lanes_in_turn = false;
    runtime::Program program = load(wrapped("step go { p <- p + 1.0; output y = reduce(sum, i in 0.." +
                                            std::to_string(kTrips) + ") { min(p, 1.0) }; }\n"),
                                    1, options);
    profile_.name = name;
    must(program.run("go"));
    const double trips = must(program.output("go", "y")).to_doubles()[0];
    return trips < kTrips ? static_cast<uint32_t>(trips) : 0;
  }
  bool lanes_in_turn(int size, const Options& options) {
    const auto with = [&](bool in_turn) {
      profile_.lanes_in_turn = in_turn;
      return a_line(neighbours, size, options);
    };
    try {
      return with(true) < with(false);
    } catch (const Problem&) {  // more texels than the device allows
      return false;
    }
  }
  void raster(const Options& options, double& triangle_ns, double& pixel_ns) {
    const std::string one = triangles(1, 1.0);
    triangle_ns = at_least(beyond(triangles(100, 1.5), one, 1, options) / (100 * 100));
    pixel_ns = at_least(beyond(triangles(2, 600.0), one, 1, options) / (256.0 * 256.0 * 2.25));
  }
  // Of one more shader. Drivers compile when pipelines are made, or when they run first.
  double compile_ns(const Options& options) {
    const auto first_run = [&](int lines) {
      runtime::Program program = load(neighbours(lines), 8, options);
      const double start = now_ns();
      must(program.run("go"));
      return now_ns() - start;
    };
    renew();
    const double few = first_run(2);
    renew();
    return (first_run(10) - few) / 8;
  }

  template <class T>
  static T must(io::Result<T> result) {
    if (!result) throw Problem{result.error()};
    if constexpr (!std::is_void_v<T>) return std::move(result).value();
  }

  void take_limits() {
    const runtime::DeviceLimits l = device_.limits();
    target::Profile& p = profile_;
    p.max_color_attachments = l.max_color_attachments;
    p.max_per_stage_descriptor_storage_buffers = l.max_per_stage_descriptor_storage_buffers;
    p.max_per_stage_descriptor_sampled_images = l.max_per_stage_descriptor_sampled_images;
    p.max_per_stage_descriptor_input_attachments = l.max_per_stage_descriptor_input_attachments;
    p.max_per_stage_resources = l.max_per_stage_resources;
    p.max_fragment_combined_output_resources = l.max_fragment_combined_output_resources;
    p.max_push_constants_size = l.max_push_constants_size;
    p.max_image_dimension_2d = l.max_image_dimension_2d;
    p.max_compute_work_group_invocations = l.max_compute_work_group_invocations;
    p.max_compute_work_group_count_x = l.max_compute_work_group_count_x;
    p.max_compute_shared_memory_size = l.max_compute_shared_memory_size;
    p.max_multiview_view_count = l.max_multiview_view_count;
    p.subgroup_size = l.subgroup_size;
    p.max_storage_buffer_range = l.max_storage_buffer_range;
    p.subgroup_arithmetic = l.subgroup_arithmetic;
    p.subgroup_shuffle = l.subgroup_shuffle;
    p.shader_int64 = l.shader_int64;
    p.shader_buffer_int64_atomics = l.shader_buffer_int64_atomics;
    p.shader_buffer_float32_atomic_add = l.shader_buffer_float32_atomic_add;
    p.fragment_stores_and_atomics = l.fragment_stores_and_atomics;
    p.geometry_shader = l.geometry_shader;
  }

  const runtime::Device& device_;
  std::string unique_;
  target::Profile profile_;
};

}  // namespace

io::Result<uint32_t> measure_loop_trips(const runtime::Device& device) {
  try {
    return Measurement(device).trips();
  } catch (const Problem& problem) {
    return io::Error{"cannot measure the device: " + problem.message};
  }
}

io::Result<std::string> measure_profile(const runtime::Device& device) {
  try {
    return target::write_profile(Measurement(device).process());
  } catch (const Problem& problem) {
    return io::Error{"cannot measure the device: " + problem.message};
  }
}

Floor floor_of(const std::string& profile) {
  const auto found = target::load_profile(profile);
  if (!std::holds_alternative<target::Profile>(found)) return {};
  const target::Costs& costs = std::get<target::Profile>(found).costs;
  return {costs.dispatch_ns, costs.compute_buffer_bytes_per_ns};
}

}  // namespace dr::jit
