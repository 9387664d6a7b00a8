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
  kept_.push_back({.type = type, .name = name, .from_zero = from_zero});
  return name;
}

std::string CutLoops::keep_array(const ir::Type& type, std::string name, int64_t count) {
  kept_.push_back({.type = type, .name = name, .count = count});
  return name;
}

std::string CutLoops::item(const std::string& array, const std::string& index) {
  return "item_of_" + array + "(" + index + ")";
}
std::string CutLoops::set_item(const std::string& array, const std::string& index, const std::string& value) {
  return "set_" + array + "(" + index + ", " + value + ");";
}

std::string CutLoops::once(const std::string& statement) {
  const int bit = new_bit();
  return "if (part_trips == 0 || (!paused && (" + word(bit) + " & " + mask(bit) + ") == 0u)) { " + word(bit) +
         " |= " + mask(bit) + "; " + statement + " }";
}

void CutLoops::open(Writer& body, const std::vector<std::string>& enter, const std::string& goes_on,
                    const std::string& advance) {
  if (!open_.empty()) open_.back().has_loops = true;
  const int bit = new_bit();
  body.line("if (part_trips == 0 || (!paused && (" + word(bit) + " & " + mask(bit) + ") == 0u)) {");
  body.line(word(bit) + " |= " + mask(bit) + ";");
  body.line("--left_trips;");
  for (const std::string& statement : enter) body.line(statement);
  body.line("}");
  body.line("for (; " + goes_on + "; " + advance + ") {");
  body.line("if (part_trips != 0) {");
  body.line("if (paused || left_trips <= 0) {");
  body.line("paused = true;");
  body.line("break;");
  body.line("}");
  body.line("--left_trips;");
  body.line("}");
  open_.push_back({.goes_on = goes_on, .bits = {}});
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
  body.line("if (!paused && " + open_.back().goes_on + ") unfinished = true;");
  open_.pop_back();
}

int64_t CutLoops::words() const {
  int64_t words = (bits_ + 31) / 32;
  for (const Variable& v : kept_) words += v.words();
  return words;
}

std::string CutLoops::variables() const {
  // The trips that stand around the one where a dispatch goes on are begun once more.
  std::string out =
      "int left_trips = part_trips + " + std::to_string(loops_) + ";\nbool paused = false, unfinished = false;\n";
  for (int k = 0; k < (bits_ + 31) / 32; ++k) out += "uint " + word(32 * k) + " = 0u;\n";
  for (const Variable& v : kept_)
    out += v.type.str() + " " + v.name + (v.count > 0 ? "[" + std::to_string(v.count) + "]" : "") +
           (v.from_zero ? " = " + zero(v.type) : "") + ";\n";
  return out + "int loop_words = 0;\n";
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

// An array stays where the words are: to copy it would take trips. Where a dispatch takes all trips, it is the
// invocation's own.
std::string CutLoops::array_functions(const Variable& array, int64_t at) const {
  const auto& [type, name, from_zero, count] = array;
  const Conversion c = conversion(type.scalar);
  std::string load, store;
  for (int k = 0; k < type.components(); ++k) {
    const std::string word = state_ + ".d[at" + (k ? " + " + std::to_string(k) : "") + "]";
    load += (k ? ", " : "") + std::string(c.load) + word + c.behind_load;
    store += "    " + word + " = " + c.store + component(type, "value", k) + c.behind_store + ";\n";
  }
  const std::string kind = type.str(), number = std::to_string(at),
                    place =
                        "    int at = loop_words + " + number + " + k * " + std::to_string(type.components()) + ";\n";
  const bool own = state_.empty();
  return kind + " item_of_" + name + "(int k) {\n  " + kind + " value = " + zero(type) + ";\n" +
         (own ? "  value = " + name + "[k];\n"
              : "  if (part_trips == 0) {\n    value = " + name + "[k];\n  } else {\n" + place +
                    "    value = " + (type.is_scalar() ? load : kind + "(" + load + ")") + ";\n  }\n") +
         "  return value;\n}\nvoid set_" + name + "(int k, " + kind + " value) {\n" +
         (own ? "  " + name + "[k] = value;\n"
              : "  if (part_trips == 0) {\n    " + name + "[k] = value;\n  } else {\n" + place + store + "  }\n") +
         "}\n";
}

std::string CutLoops::functions() const {
  std::string clear, load, store, arrays;
  int64_t at = 0;
  const auto next = [&] { return state_ + ".d[first + " + std::to_string(at++) + "]"; };
  for (int k = 0; k < (bits_ + 31) / 32; ++k) {
    const std::string name = word(32 * k), where = next();
    clear += "    " + name + " = 0u;\n";
    load += "  " + name + " = " + where + ";\n";
    store += "  " + where + " = " + name + (k == 0 ? " | (paused ? 0u : 1u)" : "") + ";\n";
    if (k == 0) load += "  if ((" + name + " & 1u) != 0u) return false;\n";
  }
  for (const Variable& v : kept_) {
    if (v.count > 0) {
      arrays += array_functions(v, at);
      at += v.words();
      continue;
    }
    if (v.from_zero) clear += "    " + v.name + " = " + zero(v.type) + ";\n";
    const Conversion c = conversion(v.type.scalar);
    for (int k = 0; k < v.type.components(); ++k) {
      const std::string part = component(v.type, v.name, k), where = next();
      load += "  " + part + " = " + c.load + where + c.behind_load + ";\n";
      store += "  " + where + " = " + c.store + part + c.behind_store + ";\n";
    }
  }
  if (state_.empty()) return arrays;  // they are watched alone
  const std::string first = "  int first = element * " + std::to_string(words()) + ";\n";
  return arrays + "bool resume_loops(int element) {\n  paused = false;\n" + first +
         "  loop_words = first;\n  if (pc.layer == 1) {\n" + clear + "    return true;\n  }\n" + load +
         "  return true;\n}\nvoid keep_loops(int element) {\n" + first + store + "}\n";
}

}  // namespace dr::backend::glsl
