// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/glsl/cut_loops.h"

#include <map>

namespace dr::backend::glsl {

std::string CutLoops::word(int bit) { return "loop_flags_" + std::to_string(bit / 32); }
std::string CutLoops::mask(int bit) { return std::to_string(1u << static_cast<unsigned>(bit % 32)) + "u"; }

int CutLoops::new_bit() {
  const int bit = bits_++;
  if (!open_.empty()) open_.back().bits.push_back(bit);
  return bit;
}

std::string CutLoops::keep(const ir::Type& type, std::string name, bool from_zero) {
  kept_.push_back({type, name, from_zero});
  return name;
}

std::string CutLoops::once(const std::string& statement) {
  const int bit = new_bit();
  return "if (part_trips == 0 || (!paused && (" + word(bit) + " & " + mask(bit) + ") == 0u)) { " + word(bit) +
         " |= " + mask(bit) + "; " + statement + " }";
}

void CutLoops::open(Writer& body, const std::vector<std::string>& enter, const std::string& trip,
                    const std::string& end) {
  if (!open_.empty()) open_.back().has_loops = true;
  const int bit = new_bit();
  body.line("if (part_trips == 0 || (!paused && (" + word(bit) + " & " + mask(bit) + ") == 0u)) {");
  body.line(word(bit) + " |= " + mask(bit) + ";");
  body.line("--left_trips;");
  for (const std::string& statement : enter) body.line(statement);
  body.line("}");
  body.line("for (; " + trip + " < " + end + "; ++" + trip + ") {");
  body.line("if (part_trips != 0) {");
  body.line("if (paused || left_trips <= 0) {");
  body.line("paused = true;");
  body.line("break;");
  body.line("}");
  body.line("--left_trips;");
  body.line("}");
  open_.push_back({trip, end, {}});
  ++loops_;
}

void CutLoops::finish_trip(Writer& body) {
  const Loop& loop = open_.back();
  if (loop.has_loops) body.line("if (part_trips != 0 && paused) break;");
  std::map<std::string, uint32_t> clear;
  for (const int bit : loop.bits) clear[word(bit)] |= 1u << static_cast<unsigned>(bit % 32);
  for (const auto& [name, bits] : clear)
    body.line("if (part_trips != 0) " + name + " &= " + std::to_string(~bits) + "u;");
}

void CutLoops::close(Writer& body) {
  body.line("}");
  body.line("if (!paused && " + open_.back().trip + " < " + open_.back().end + ") unfinished = true;");
  open_.pop_back();
}

void CutLoops::require_whole(Writer& body, const std::string& unfinished) {
  body.line("if (!paused && " + unfinished + ") unfinished = true;");
}

int CutLoops::words() const {
  int words = (bits_ + 31) / 32;
  for (const Variable& v : kept_) words += v.type.components();
  return words;
}

std::string CutLoops::variables() const {
  // The trips that stand around the one where a dispatch goes on are begun once more.
  std::string out =
      "int left_trips = part_trips + " + std::to_string(loops_) + ";\nbool paused = false, unfinished = false;\n";
  for (int k = 0; k < (bits_ + 31) / 32; ++k) out += "uint " + word(32 * k) + " = 0u;\n";
  for (const Variable& v : kept_)
    out += v.type.str() + " " + v.name + (v.from_zero ? " = " + zero(v.type) : "") + ";\n";
  return out;
}

namespace {

struct Conversion {
  const char *load, *behind_load, *store, *behind_store;
};
Conversion conversion(ir::Scalar scalar) {
  switch (scalar) {
    case ir::Scalar::Float: return {"uintBitsToFloat(", ")", "floatBitsToUint(", ")"};
    case ir::Scalar::Bool: return {"", " != 0u", "uint(", ")"};
    case ir::Scalar::Int: return {"int(", ")", "uint(", ")"};
    case ir::Scalar::Uint: break;
  }
  return {"", "", "", ""};
}

}  // namespace

std::string CutLoops::functions() const {
  if (state_.empty()) return "";  // they are watched alone
  std::string clear, load, store;
  int at = 0;
  const auto next = [&] { return state_ + ".d[first + " + std::to_string(at++) + "]"; };
  for (int k = 0; k < (bits_ + 31) / 32; ++k) {
    const std::string name = word(32 * k), where = next();
    clear += "    " + name + " = 0u;\n";
    load += "  " + name + " = " + where + ";\n";
    store += "  " + where + " = " + name + (k == 0 ? " | (paused ? 0u : 1u)" : "") + ";\n";
    if (k == 0) load += "  if ((" + name + " & 1u) != 0u) return false;\n";
  }
  for (const Variable& v : kept_) {
    if (v.from_zero) clear += "    " + v.name + " = " + zero(v.type) + ";\n";
    const Conversion c = conversion(v.type.scalar);
    for (int k = 0; k < v.type.components(); ++k) {
      const std::string part = component(v.type, v.name, k), where = next();
      load += "  " + part + " = " + c.load + where + c.behind_load + ";\n";
      store += "  " + where + " = " + c.store + part + c.behind_store + ";\n";
    }
  }
  const std::string first = "  int first = element * " + std::to_string(words()) + ";\n";
  return "bool resume_loops(int element) {\n  paused = false;\n  if (pc.layer == 1) {\n" + clear +
         "    return true;\n  }\n" + first + load + "  return true;\n}\nvoid keep_loops(int element) {\n" + first +
         store + "}\n";
}

}  // namespace dr::backend::glsl
