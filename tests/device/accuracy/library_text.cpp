// SPDX-License-Identifier: Apache-2.0
#include "tests/device/accuracy/library_text.h"

#include <algorithm>
#include <cstdio>
#include <cstdlib>

#include "compiler/lower/lower.h"
#include "compiler/passes/passes.h"
#include "dsl/diagnostic/diagnostic.h"

namespace dr::accuracy::library {

namespace {

constexpr const char* kPrelude = R"(edition 1;
import std.camera;
import std.coverage;
import std.environment;
import std.eye;
import std.hair;
import std.hardsoftras;
import std.image;
import std.light;
import std.loss;
import std.material;
import std.mesh;
import std.nn;
import std.nvdiffrast;
import std.optim;
import std.points;
import std.random;
import std.raster;
import std.rig;
import std.shading;
import std.shadow;
import std.skin;
import std.solve;
import std.strands;
import std.splat;
import std.texture;
import std.tiles;
import std.tone;

fn sizes4(m: mat4) -> mat4 { mat4(abs(m[0]), abs(m[1]), abs(m[2]), abs(m[3])) }
fn sizes_together(m: mat4) -> float { sqrt(dot(m[0], m[0]) + dot(m[1], m[1]) + dot(m[2], m[2]) + dot(m[3], m[3])) }
fn sizes_of_nine(c: vec3[9]) -> vec3 {
  var total = vec3(0.0);
  for k in 0..9 { total = total + abs(c.at(k)); }
  total
}
// How much the weights of a face's corners change with a pixel's place, in 64 x 64 pixels; 1 where there is no face.
fn conditions(clip: vec4[V], corner: ivec3) -> float {
  let (p, q, r) = (clip.at(corner.x), clip.at(corner.y), clip.at(corner.z));
  let (a, b, c) = (32.0 * p.xy / p.w, 32.0 * q.xy / q.w, 32.0 * r.xy / r.w);
  let longest = max(max(distance(a, b), distance(b, c)), distance(c, a));
  let area = abs((b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x));
  if corner.x >= 0 && area > 0.0 { longest * (longest + 64.0) / area } else { 1.0 }
}
)";

std::string extent_of(const Operand& o) {
  return o.extent.empty() ? "[" + std::to_string(kSide) + ", " + std::to_string(kSide) + "]" : o.extent;
}

bool only_drawn(const Operand& o) { return o.name.ends_with('_'); }
bool is_float(const Operand& o) { return o.type == "float" || o.type.starts_with("vec") || o.type.starts_with("mat"); }

// `$name` is the leaf's own name.
std::string resolved(std::string text, const Function& f, size_t k) {
  for (const Operand& o : f.operands) {
    const std::string wanted = "$" + o.name;
    for (size_t at = 0; (at = text.find(wanted, at)) != std::string::npos;) {
      const size_t end = at + wanted.size();
      const bool longer =
          end < text.size() && (std::isalnum(static_cast<unsigned char>(text[end])) || text[end] == '_');
      if (longer) {
        at = end;
        continue;
      }
      text.replace(at, wanted.size(), leaf_name(k, o));
    }
  }
  return text;
}

std::string leaves(std::span<const Function> functions, bool drawn) {
  std::string text;
  for (size_t k = 0; k < functions.size(); ++k) {
    for (const Operand& o : functions[k].operands) {
      if ((drawn ? !o.from.empty() : only_drawn(o)) || !o.leaf.empty()) continue;
      text += (is_float(o) ? "param " : "input ") + leaf_name(k, o) + " : " + o.type + extent_of(o) + ";\n";
    }
    const std::string& result = functions[k].result;
    if (!drawn && !result.empty() &&
        (result.starts_with("float") || result.starts_with("vec") || result.starts_with("mat")))
      text += "param " + seed_name(k) + " : " + result +
              (result.ends_with(']') ? "" : "[" + std::to_string(kSide) + ", " + std::to_string(kSide) + "]") + ";\n";
  }
  return text;
}

// Where nothing is compared.
std::string except_of(const Function& f, const Direction& d) {
  std::string text = d.except;
  for (const Operand& o : f.operands)
    if (o.direction) text += (text.empty() ? "" : " || ") + std::string("length(") + o.name + ") == 0.0";
  return text;
}

std::string program(std::span<const Function> functions, bool judge) {
  std::string text = kPrelude + leaves(functions, false);
  for (size_t k = 0; k < functions.size(); ++k) {
    const Function& f = functions[k];
    std::string body;
    for (const Operand& o : f.operands)
      if (!only_drawn(o) && o.leaf.empty() && f.statement.empty()) body += "  let " + o.name + " = $" + o.name + ";\n";
    body += f.before;
    if (!f.value.empty()) body += "  let y = " + f.value + ";\n";
    std::string outputs;
    bool seeded = false;
    for (const Direction& d : f.directions) {
      const std::string name = output_name(d);
      if (is_next(d)) {
        if (judge && !d.scale.empty()) outputs += ", scale_" + name + " = " + d.scale;
        continue;
      }
      if (d.of == "value") {
        outputs += ", value = y";
      } else {
        if (!seeded) body += "  let g = " + seed_name(k) + ";\n";
        seeded = true;
        body += "  let " + name + " = grad(y, " + d.of + ", seed = g);\n";
        outputs += ", " + name;
      }
      if (!judge) continue;
      if (!d.scale.empty()) outputs += ", scale_" + name + " = " + d.scale;
      if (const std::string except = except_of(f, d); !except.empty()) outputs += ", except_" + name + " = " + except;
    }
    text += "step " + step_name(k) + " {\n" + resolved(body, f, k) + resolved(f.statement, f, k);
    if (!outputs.empty()) text += "  output " + resolved(outputs.substr(2), f, k) + ";\n";
    text += "}\n";
  }
  return text;
}

}  // namespace

std::string step_name(size_t function) { return "f" + std::to_string(function); }
std::string leaf_name(size_t function, const Operand& operand) {
  if (operand.leaf.empty()) return "x" + std::to_string(function) + "_" + operand.name;
  std::string name = operand.leaf;
  if (const size_t at = name.find('#'); at != std::string::npos) name.replace(at, 1, std::to_string(function));
  if (const size_t at = name.find('#'); at != std::string::npos) name.replace(at, 1, std::to_string(function));
  return name;
}
std::string seed_name(size_t function) { return "x" + std::to_string(function) + "_g"; }
std::string along_name(size_t function, const std::string& operand) {
  return "x" + std::to_string(function) + "_along_" + operand;
}
bool is_next(const Direction& direction) { return direction.of.starts_with("next "); }
std::string output_name(const Direction& direction) {
  if (direction.of == "value") return "value";
  return is_next(direction) ? "next_" + direction.of.substr(5) : "d_" + direction.of;
}

std::string device_text(std::span<const Function> functions) { return program(functions, false); }
std::string judge_text(std::span<const Function> functions) { return program(functions, true); }

std::vector<std::string> moved_operands(const Function& f) {
  std::vector<std::string> out;
  for (const Direction& d : f.directions)
    if (d.of != "value" && !is_next(d)) out.push_back(d.of);
  out.insert(out.end(), f.transposed.begin(), f.transposed.end());
  return out;
}

std::string transpose_text(std::span<const Function> functions) {
  std::string text = kPrelude + leaves(functions, false);
  for (size_t k = 0; k < functions.size(); ++k) {
    const Function& f = functions[k];
    std::string body, outputs;
    for (const Operand& o : f.operands)
      if (!only_drawn(o) && o.leaf.empty()) body += "  let " + o.name + " = $" + o.name + ";\n";
    body += f.before + "  let y = " + f.value + ";\n  let g = " + seed_name(k) + ";\n";
    for (const std::string& x : moved_operands(f)) {
      const auto o = std::ranges::find(f.operands, x, &Operand::name);
      text += "param " + along_name(k, x) + " : " + o->type + extent_of(*o) + ";\n";
      outputs +=
          ", j_" + x + " = jvp(y, " + x + ", " + along_name(k, x) + "), d_" + x + " = grad(y, " + x + ", seed = g)";
    }
    if (outputs.empty()) continue;
    text += "step " + step_name(k) + " {\n" + resolved(body, f, k) + "  output " + outputs.substr(2) + ";\n}\n";
  }
  return text;
}

std::string draw_text(std::span<const Function> functions) {
  std::string text = kPrelude + leaves(functions, true);
  for (size_t k = 0; k < functions.size(); ++k) {
    std::string outputs, body;
    for (const Operand& o : functions[k].operands) {
      if (o.from.empty()) {
        if (o.leaf.empty()) body += "  let " + o.name + " = $" + o.name + ";\n";
        continue;
      }
      body += "  let " + o.name + " : " + o.type + extent_of(o) + " = " + o.from + ";\n";
      if (!only_drawn(o)) outputs += ", " + o.name;
    }
    if (!outputs.empty())
      text += "step " + step_name(k) + " {\n" + resolved(body, functions[k], k) + "  output " + outputs.substr(2) +
              ";\n}\n";
  }
  return text;
}

ir::Graph graph_of(const std::string& text) {
  dsl::SourceManager sources;
  dsl::DiagnosticList diagnostics;
  const auto graph = lower::lower(sources, sources.add("accuracy.dr", text), {}, diagnostics);
  if (!graph) {
    std::fprintf(stderr, "%s\n%s\n", text.c_str(), dsl::format(diagnostics, sources).c_str());
    std::exit(1);
  }
  passes::PipelineOptions options;
  options.verify_each = false;
  return passes::run_passes(*graph, passes::default_passes(), options);
}

}  // namespace dr::accuracy::library
