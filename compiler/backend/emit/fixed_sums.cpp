// SPDX-License-Identifier: Apache-2.0
// Float sums that are independent of order and correct up to one rounding. A first run finds the largest contribution,
// a second adds 64-bit fixed point numbers scaled so that the sum cannot overflow (one 64-bit word, or two 32-bit words
// with carry: the same bits); floats are made of them where they are read. A first run that guesses the scale adds too.
#include <algorithm>
#include <bit>

#include "compiler/backend/analysis/bins.h"
#include "compiler/backend/emit/generator.h"
#include "compiler/backend/glsl/fixed_point.h"
#include "compiler/backend/schedule/limits.h"

namespace dr::backend {

using glsl::component;
using glsl::dim_expression;
using glsl::Shader;
using ir::ValueId;

namespace {

// Words of an accumulator, of 32 bits or of 64 where the schedule says so: 0 the largest finite magnitude,
// 1 the number of contributions where it is counted, or, of emptied sums, whether an element has flags, then two (one)
// for each component, then flags, two bits a component, of several elements in a word: see special_flag.
constexpr int kHead = 2;

// The flags of an element in the words behind all sums: which word, and from which bit on.
struct Flags {
  Flags(const ir::Type& type, const ir::Extent& extent, bool wide)
      : bits(kFlagBits * static_cast<int>(std::bit_ceil(static_cast<unsigned>(type.components())))),
        elements((wide ? 64 : 32) / bits),
        before(element_count(extent) * ir::Dim((wide ? 1 : 2) * type.components()) + ir::Dim(kHead)),
        words((element_count(extent) + ir::Dim(elements - 1)).divided_by(elements)) {}
  std::string word(const std::string& element) const {
    return dim_expression(before) + " + " + element + " / " + std::to_string(elements);
  }
  std::string shift(const std::string& element) const {
    return "(" + element + " % " + std::to_string(elements) + " * " + std::to_string(bits) + ")";
  }
  std::string mask() const { return std::to_string((uint64_t{1} << bits) - 1) + "u"; }

  int bits, elements;
  ir::Dim before, words;
};

// Workgroups of an indirect dispatch, in three dimensions.
constexpr int kDispatchWords = 3;

// Word `k` of the `n` words of an element. Wide ones lie apart, all first words before all second ones: lanes side by
// side mostly add to elements side by side, and a GPU adds what lies together in one go.
std::string word_of(const ir::Extent& extent, const std::string& element, int n, int k, bool wide) {
  const std::string head = std::to_string(kHead) + " + ";
  if (!wide || n == 1) return head + element + " * " + std::to_string(n) + " + " + std::to_string(k);
  const std::string before = k == 0 ? "" : dim_expression(element_count(extent) * ir::Dim(k)) + " + ";
  return head + before + element;
}

std::string part(int c) { return "part_" + std::to_string(c); }

constexpr const char* kCountBits = R"(
int bits_of_count(uint count) { return count <= 1u ? 0 : findMSB(count - 1u) + 1; }
)";

// An upper bound of the logarithm of how many contributions there are: `most` from an element, or, if that is
// negative, as counted.
std::string count_bits(int most, const ir::Extent& domain, const std::string& counted) {
  if (most < 0) return "bits_of_count(uint(" + counted + "))";
  int bits = 1;
  while ((1 << (bits - 1)) < most) ++bits;
  return "findMSB(uint(" + dim_expression(element_count(domain)) + ")) + " + std::to_string(bits);
}

// The exponent that sums have, by the words of their head.
std::string shift_of(const std::string& largest, const std::string& counted, int most, const ir::Extent& domain) {
  return "fixed_shift(uint(" + largest + "), " + count_bits(most, domain, counted) + ")";
}

// Lanes of a subgroup that add to the same element join their parts, and one of them goes on: for kJoinRounds elements,
// those of its first lanes. Lanes left over go on alone, and so do few, whose atomics take less time than a sum over
// the subgroup. The variable `adds_here` says which go on.
template <class Part>
std::string join_lanes(int n, const Part& part) {
  std::string out = "  bool adds_here = true;\n  for (int round = 0; joins && round < " + std::to_string(kJoinRounds) +
                    "; ++round) {\n    bool same = subgroupBroadcastFirst(element) == element;\n"
                    "    uvec4 lanes = subgroupBallot(same);\n    if (same) {\n"
                    "      if (subgroupBallotBitCount(lanes) > 1u) {\n";
  for (int c = 0; c < n; ++c) out += "        " + part(c) + " = fixed_subgroup_add(" + part(c) + ");\n";
  out +=
      "        flags = subgroupOr(flags);\n        adds_here = subgroupElect();\n      }\n      break;\n    }\n  }\n";
  return out;
}

// Of so many lanes, a power of two, those that follow each other and add to the same element are a run. Its first one,
// of which `first` is true, adds what all of them have: each takes what the lane one, two, four beyond it has, while
// all between belong to its run. On a device with other subgroups, too, lanes that are not there are in no run.
template <class Part>
std::string join_run(int n, int lanes, const Part& part, bool flags) {
  const std::string last = std::to_string(lanes - 1) + "u";
  const auto from = [&](const std::string& away) { return "lane & ~" + last + " | lane " + away + " & " + last; };
  std::string out =
      "  uint lane = gl_SubgroupInvocationID, here = subgroupBallot(true).x;\n"
      "  int before = subgroupShuffle(element, " +
      from("- 1u") + "), behind = subgroupShuffle(element, " + from("+ 1u") + ");\n  bool first = (lane & " + last +
      ") == 0u || ((here << 1) >> lane & 1u) == 0u || before != element;\n  uint same = (lane & " + last +
      ") != " + last + " && ((here >> 1) >> lane & 1u) != 0u && behind == element ? 0xffffffffu : 0u;\n";
  for (int away = 1; away < lanes; away *= 2) {
    const std::string lane = from("+ " + std::to_string(away) + "u");
    for (int c = 0; c < n; ++c)
      out += "  " + part(c) + " = fixed_add(" + part(c) + ", subgroupShuffle(" + part(c) + ", " + lane + ") & same);\n";
    if (flags) out += "  flags |= subgroupShuffle(flags, " + lane + ") & same;\n";
    if (2 * away < lanes) out += "  same &= subgroupShuffle(same, " + lane + ");\n";
  }
  return out;
}

}  // namespace

std::string any_bits(const ir::Type& type, const std::string& value) {
  std::string out;
  for (int c = 0; c < type.components(); ++c)
    out += (c > 0 ? " | " : "") + ("floatBitsToUint(" + component(type, value, c)) + ")";
  return "(" + out + ") & 0x7fffffffu";
}

std::string flag_of(const std::string& number, int c) {
  return "special_flag(" + number + ") << " + std::to_string(kFlagBits * c);
}

std::string flag_at(const std::string& flags, const std::string& shift) {
  return "(" + flags + " >> " + shift + ") & " + std::to_string((1 << kFlagBits) - 1) + "u";
}

ir::Dim words_of_sums(const ir::Type& type, const ir::Extent& extent, bool wide) {
  if (adds_in_bins(extent)) return words_of_bins(type, extent, wide);
  const Flags flags(type, extent, wide);
  const ir::Dim words = flags.before + flags.words;
  return wide ? words * ir::Dim(2) : words;
}

ir::Dim looking_for_guesses(const ir::Extent& domain) {
  constexpr int kAlways = 1024;
  return element_count(domain).divided_by(kElementsOfGuess) + ir::Dim(kAlways);
}

ir::Dim words_of_head(bool wide) { return wide ? 2 * kHead : kHead; }

std::string Generator::anything_added(Shader& s, ValueId sum, const std::string& element) const {
  const Resource& r = resource(sum);
  const bool wide = wide_atomics();
  if (wide) wide_extensions(s);
  const uint32_t words = resource_index(sum);
  const std::string word = s.read_words(words, "sums_" + std::to_string(words), sum_word());
  const Flags flags(r.type, r.extent, wide);
  std::string out =
      "(uint(" + word + "(" + flags.word(element) + ") >> " + flags.shift(element) + ") & " + flags.mask() + ") != 0u";
  const int n = r.type.components() * (wide ? 1 : 2);
  for (int k = 0; k < n; ++k)
    out += " || " + word + "(" + word_of(r.extent, element, n, k, wide) + ") != " + std::string(sum_word()) + "(0)";
  return out;
}

void Generator::clear_listed(Shader& s, const Pass& map, const Pass& scatter) {
  const bool wide = wide_atomics();
  for (const ValueId v : sums_where_listed(schedule_.resources, *step_, scatter)) {
    const Resource& r = resource(v);
    if (wide) wide_extensions(s);
    const std::string words = s.bind_words(resource_index(v), "cleared_" + std::to_string(resource_index(v)),
                                           bundle::Access::Write, sum_word()),
                      element = Shader::element_index(map.domain, "at");
    const int n = r.type.components() * (wide ? 1 : 2);
    for (int k = 0; k < n; ++k)
      s.body().line(words + ".d[" + word_of(r.extent, element, n, k, wide) + "] = " + std::string(sum_word()) + "(0);");
    s.body().line(words + ".d[" + Flags(r.type, r.extent, wide).word(element) + "] = " + std::string(sum_word()) +
                  "(0);");
  }
}

Generator::Adding Generator::fixed_adding(Shader& s, const Pass& pass, const Target& t, Runs runs, bool lists) {
  const bool joins_lanes = pass.get<ScatterPass>().joins_lanes(), guesses = t.guess != 0;
  const std::string& id = t.accumulator.name;
  const std::string buffer = s.bind_words(t.words, "sums_" + id, bundle::Access::ReadWrite, sum_word());
  if (wide_atomics()) wide_extensions(s);
  if (joins_lanes) subgroup_extensions(s);
  s.prelude(glsl::kFixedShift);
  Adding out;
  const bool groups = runs == Runs::First && pass.get<ScatterPass>().joins_groups();
  if (runs != Runs::Second) {
    if (runs == Runs::Both) out.body += "  if (pc.a == 0) {\n";
    out.body += groups ? keep_for_group(s, t, lists) : find_largest(s, pass, t, lists);
    if (runs == Runs::Both) out.body += guesses ? "  }\n" : "  } else {\n";
    const std::string guard = runs == Runs::Both ? "pc.a == 0 && " : "",
                      elect = joins_lanes ? " && subgroupElect()" : "";
    if (joins_lanes) out.finish += "  largest_" + id + " = subgroupMax(largest_" + id + ");\n";
    // The largest only grows: what an invocation reads late is too small, and the atomic decides.
    const std::string larger = "  if (" + guard + "largest_" + id + " > uint(" + buffer + ".d[0])" + elect + ") ",
                      take = "atomicMax(" + buffer + ".d[0], " + sum_word() + "(largest_" + id + "));\n";
    out.finish += larger + take;
    if (t.most < 0)
      out.finish += "  if (" + guard + "count_" + id + " != 0u) atomicAdd(" + buffer + ".d[1], " +
                    std::string(sum_word()) + "(count_" + id + "));\n";
  }
  if (runs == Runs::First && !guesses) return out;
  s.prelude(glsl::kFixedFromFloat);
  // Where a map adds, few lanes of a subgroup do: none to join.
  const bool joins_parts = pass.get<ScatterPass>().joins_parts() && runs != Runs::First;
  s.prelude(joins_parts ? glsl::kFixedSubgroup : "");
  choose_shift(s, pass, t, runs, buffer);
  if (groups) {
    s.body().line("without_limbs_" + id + " = least_without_limbs(shift_" + id + ", " + limb_bits(t) + ");");
    return out;
  }
  out.body += add_fixed(s, t, runs, joins_parts, buffer);
  if (runs == Runs::Both && !guesses) out.body += "  }\n";
  return out;
}

uint32_t Generator::ask_for_guesses(const Pass& pass, const std::vector<Target>& targets, const ir::Dim& invocations) {
  const uint32_t groups = add_scratch(pass.name + "_groups", std::to_string(kDispatchWords));
  Shader s = shader();
  linear_index(s, "1");
  s.prelude(glsl::kFixedShift);
  if (wide_atomics()) wide_extensions(s);
  std::string right = s.read_words(targets.front().special, "special") + "(0) == 0u";
  for (const Target& t : targets) {
    const std::string& id = t.accumulator.name;
    const std::string sums = s.read_words(t.words, "sums_" + id, sum_word());
    s.prelude(t.most < 0 ? kCountBits : "");
    right += " && " + shift_of(sums + "(0)", sums + "(1)", t.most, pass.domain) + " == int(" +
             s.read_words(t.guess, "guess_" + id) + "(0))";
  }
  const std::string words = s.bind_words(groups, "groups", bundle::Access::Write);
  // They go over all elements, however few they are.
  s.body().line(words + ".d[0] = " + right + " ? 0u : min(uint(" +
                dim_expression(invocations.divided_by(bundle::kIndirectGroup) + ir::Dim(1)) + "), 65535u);");
  s.body().line(words + ".d[1] = 1u;");
  s.body().line(words + ".d[2] = 1u;");
  dispatch(pass, " asked", s, "1");
  return groups;
}

std::string Generator::find_largest(Shader& s, const Pass& pass, const Target& t, bool lists) {
  const std::string& id = t.accumulator.name;
  const ir::Type& type = t.accumulator.type;
  s.declare("uint largest_" + id + " = 0u" + (t.most < 0 ? ", count_" + id + " = 0u" : "") + ";\n");
  std::string out;
  // A zero is none, so that the exponent does not depend on which elements run that add nothing.
  if (t.most < 0) out += "    if ((" + any_bits(type, "value") + ") != 0u) ++count_" + id + ";\n";
  for (int c = 0; c < type.components(); ++c)
    out += "    largest_" + id + " = max(largest_" + id + ", finite_magnitude(" + component(type, "value", c) + "));\n";
  if (t.special != 0)
    for (int c = 0; c < type.components(); ++c)
      out += "    special" + t.list + " = max(special" + t.list + ", floatBitsToUint(" + component(type, "value", c) +
             ") & 0x7fffffffu);\n";
  if (t.terms != 0) out += keep_term(s, pass, t);
  if (lists) out += "    adds" + t.list + " |= " + any_bits(type, "value") + ";\n";
  return out;
}

void Generator::choose_shift(Shader& s, const Pass& pass, const Target& t, Runs runs, const std::string& buffer) {
  const std::string& id = t.accumulator.name;
  const std::string where = runs == Runs::Both ? "if (pc.a == 1) " : "";
  s.declare("int shift_" + id + " = 0;\n");
  if (t.guess != 0) {
    const std::string guess = s.read_words(t.guess, "guess_" + id);
    s.declare("int guessed_" + id + " = 0;\n");
    s.body().line("guessed_" + id + " = int(" + guess + "(0));");
    s.body().line("shift_" + id + " = guessed_" + id + ";");
  }
  if (runs == Runs::First) return;
  s.prelude(t.most < 0 ? kCountBits : "");
  s.body().line(where + "shift_" + id + " = " + shift_of(buffer + ".d[0]", buffer + ".d[1]", t.most, pass.domain) +
                ";");
  // The first run may have computed a contribution with other roundings, even one that is all rounding error: larger
  // ones would overflow the sum.
  if (s.native()) {
    s.declare("float limit_" + id + " = 0.0;\n");
    s.body().line(where + "limit_" + id + " = uintBitsToFloat(uint(" + buffer + ".d[0]));");
  }
}

std::string Generator::fixed(Shader& s, const Target& t, int c, const std::string& shift) {
  std::string x = component(t.accumulator.type, "value", c);
  if (s.native()) x = "clamp(" + x + ", -limit_" + t.accumulator.name + ", limit_" + t.accumulator.name + ")";
  return s.at_once(ir::vec(2, ir::Scalar::Uint), "fixed_from_float(" + x + ", " + shift + ")");
}

std::string Generator::fixed_parts(Shader& s, const Target& t, bool flags) {
  const std::string& id = t.accumulator.name;
  const ir::Type& type = t.accumulator.type;
  std::string out = flags ? "  uint flags = 0u;\n" : "";
  for (int c = 0; c < type.components(); ++c) {
    if (flags) out += "  flags |= " + flag_of(component(type, "value", c), c) + ";\n";
    out += "  uvec2 " + part(c) + " = " + fixed(s, t, c, "shift_" + id) + ";\n";
  }
  return out;
}

std::string Generator::add_to_memory(const Target& t, int c, const std::string& part, const std::string& element,
                                     const std::string& buffer) const {
  const int n = t.accumulator.type.components();
  if (wide_atomics())
    return "  if (" + part + " != uvec2(0u)) atomicAdd(" + buffer + ".d[" +
           word_of(t.accumulator.extent, element, n, c, true) + "], wide_of(" + part + "));\n";
  return "  if (" + part + " != uvec2(0u)) {\n    uint old = atomicAdd(" + buffer + ".d[" +
         word_of(t.accumulator.extent, element, 2 * n, 2 * c, false) + "], " + part + ".x);\n    atomicAdd(" + buffer +
         ".d[" + word_of(t.accumulator.extent, element, 2 * n, 2 * c + 1, false) + "], " + part + ".y + (old + " +
         part + ".x < old ? 1u : 0u));\n  }\n";
}

std::string Generator::set_flags(const Target& t, const std::string& buffer) const {
  const Flags flags(t.accumulator.type, t.accumulator.extent, wide_atomics());
  const std::string word = sum_word();
  const std::string set = "atomicOr(" + buffer + ".d[" + flags.word("element") + "], " + word + "(flags) << " +
                          flags.shift("element") + ");";
  if (!t.emptied) return "  if (flags != 0u) " + set + "\n";
  return "  if (flags != 0u) {\n    " + set + "\n    atomicOr(" + buffer + ".d[1], " + word + "(1u));\n  }\n";
}

std::string Generator::add_fixed(Shader& s, const Target& t, Runs runs, bool joins_lanes, const std::string& buffer) {
  const std::string& id = t.accumulator.name;
  const int n = t.accumulator.type.components();
  const bool flags = runs != Runs::First || t.special == 0;
  std::string out = fixed_parts(s, t, flags);
  if (t.guess != 0 && runs != Runs::First) {
    s.prelude(glsl::kFixedMinus);
    if (runs == Runs::Both) out += "  if (pc.a == 1) {\n";
    for (int c = 0; c < n; ++c)
      out += "  " + part(c) + " = fixed_minus(" + part(c) + ", " + fixed(s, t, c, "guessed_" + id) + ");\n";
    if (runs == Runs::Both) out += "  }\n";
  }
  if (joins_lanes) out += join_lanes(n, part) + "  if (adds_here) {\n";
  if (t.run > 0) {
    subgroup_extensions(s);
    s.extension("GL_KHR_shader_subgroup_shuffle");
    s.prelude(glsl::kFixedAdd);
    out += join_run(n, t.run, part, flags) + "  if (first) {\n";
  }
  out += add_parts(s, t, buffer, flags);
  if (joins_lanes || t.run > 0) out += "  }\n";
  return out;
}

std::string Generator::add_parts(Shader& s, const Target& t, const std::string& buffer, bool flags) {
  std::string out, added = flags ? "flags" : "0u";
  for (int c = 0; c < t.accumulator.type.components(); ++c) {
    out += add_to_memory(t, c, part(c), "element", buffer);
    added += " | " + part(c) + ".x | " + part(c) + ".y";
  }
  if (flags) out += set_flags(t, buffer);
  return t.update == nullptr ? out : out + wake(s, t, added);
}

std::string Generator::guessed_right(const std::vector<Target>& targets) {
  std::string out = "pc.a == 1";
  for (const Target& t : targets) out += " && shift_" + t.accumulator.name + " == guessed_" + t.accumulator.name;
  return out;
}

Generator::FloatSums Generator::float_sums(Shader& s, const ir::Type& type, const ir::Extent& extent, uint32_t words,
                                           int most, const ir::Extent& domain, bool empties) const {
  if (adds_in_bins(extent)) return floats_of_bins(s, type, extent, words);
  const bool wide = wide_atomics();
  if (wide) wide_extensions(s);
  const std::string name = "sums_" + std::to_string(words);
  const std::string sums = empties ? s.bind_words(words, name, bundle::Access::ReadWrite, sum_word())
                                   : s.read_words(words, name, sum_word());
  const auto word = [&](const std::string& at) { return empties ? sums + ".d[" + at + "]" : sums + "(" + at + ")"; };
  s.prelude(glsl::kFixedShift);
  s.prelude(glsl::kFixedToFloat);
  s.prelude(most < 0 ? kCountBits : "");
  const int n = type.components(), each = wide ? 1 : 2;
  const Flags place(type, extent, wide);
  const std::string flags = word(place.word("index")), shift = place.shift("index");
  const std::string own = "uint(" + flags + " >> " + shift + ") & " + place.mask();
  FloatSums out;
  std::string& text = out.statements;
  text = "int shift = " + shift_of(word("0"), word("1"), most, domain) + ";";
  if (guesses_.contains(words)) text += " if (index == 0) " + leave_guess(s, words, "shift");
  std::string any, zeros;
  for (int c = 0; c < n; ++c) {
    std::string parts;
    for (int k = c * each; k < (c + 1) * each; ++k) {
      std::string part = word(word_of(extent, "index", each * n, k, wide));
      if (empties) {
        const std::string taken = "taken_" + std::to_string(k);
        text += " " + std::string(sum_word()) + " " + taken + " = " + part + ";";
        any += (any.empty() ? "" : " | ") + taken;
        zeros += " " + part + " = 0u;";
        part = taken;
      }
      parts += (parts.empty() ? "" : ", ") + part;
    }
    const std::string number = wide ? "words_of(" + parts + ")" : "uvec2(" + parts + ")";
    out.components.push_back("fixed_to_float(" + number + ", shift, " +
                             flag_at("flags", std::to_string(kFlagBits * c)) + ")");
  }
  // Behind the loads of the sums, which then wait for nothing.
  if (empties)
    text += " uint flags = 0u; if (" + word("1") + " != 0u) { flags = " + own + "; if (flags != 0u) atomicAnd(" +
            flags + ", ~(" + sum_word() + "(" + place.mask() + ") << " + shift + ")); }";
  else
    text += " uint flags = " + own + ";";
  // What nothing was added to is zeros already.
  if (empties) text += " if ((" + any + ") != 0u) {" + zeros + " }";
  return out;
}

std::string Generator::sums_reader(Shader& s, ValueId value, const std::string& function) const {
  const ir::ValueInfo& info = graph_.value(value);
  if (resource(value).is(Resource::Storage::Emptied)) return floats_reader(s, value, function);
  const bool empties = resource(value).is(Resource::Storage::EmptiedSums);
  const auto [most, domain] = added_to(value);
  const FloatSums floats = float_sums(s, info.type, info.extent, resource_index(value), most, domain, empties);
  std::string components;
  for (const std::string& c : floats.components) components += (components.empty() ? "" : ", ") + c;
  const std::string type = info.type.str(), open = "(ivec3 at) {\n  ",
                    body = "int index = " + Shader::element_index(info.extent, "at") + ";\n  " + floats.statements +
                           "\n  ",
                    result = type + "(" + components + ")";
  if (!empties) return type + " " + function + open + body + "return " + result + ";\n}\n";
  return type + " taken_" + function + ";\nvoid take_" + function + open + body + "taken_" + function + " = " + result +
         ";\n}\n" + type + " " + function + open + "return taken_" + function + ";\n}\n";
}

std::pair<int, ir::Extent> Generator::added_to(ValueId value) const {
  for (const Pass& pass : step_->passes)
    if (const auto* scatter = pass.as<ScatterPass>())
      if (const auto sum = std::ranges::find(scatter->sums, value, &ScatterSum::value); sum != scatter->sums.end())
        return {contributions(*sum), pass.domain};
  DR_ICE("sums that no pass of the step adds up");
}

std::string Generator::leave_guess(Shader& s, uint32_t words, const std::string& shift) const {
  return s.bind_words(guesses_.at(words), "guess_" + std::to_string(words), bundle::Access::Write) + ".d[0] = uint(" +
         shift + ");";
}

void Generator::leave_guesses(Shader& s, const Pass& pass) const {
  for (const ValueId v : pass.reads) {
    const uint32_t words = resource_index(v);
    if (!resource(v).is_sums() || !guesses_.contains(words)) continue;
    const std::string sums = s.read_words(words, "sums_" + std::to_string(words), sum_word());
    const auto [most, domain] = added_to(v);
    s.prelude(glsl::kFixedShift);
    s.prelude(most < 0 ? kCountBits : "");
    s.body().line("if (index == 0) " + leave_guess(s, words, shift_of(sums + "(0)", sums + "(1)", most, domain)));
  }
}

void Generator::take_sums(Shader& s, const Pass& pass) const {
  for (const ValueId v : pass.reads)
    if (resource(v).is_emptied()) s.body().line("take_" + s.load(v, "at") + ";");
}

std::string Generator::floats_reader(Shader& s, ValueId value, const std::string& function) const {
  const ir::ValueInfo& info = graph_.value(value);
  const int n = info.type.components();
  const std::string sums = s.bind_words(resource_index(value), "floats_" + std::to_string(resource_index(value)),
                                        bundle::Access::ReadWrite, "float"),
                    type = info.type.str(), taken = "taken_" + function;
  std::string components, zeros;
  for (int c = 0; c < n; ++c) {
    const std::string word = sums + ".d[base + " + std::to_string(c) + "]";
    components += (c == 0 ? "" : ", ") + word;
    zeros += " " + word + " = 0.0;";
  }
  return type + " " + taken + ";\nvoid take_" + function +
         "(ivec3 at) {\n  int base = " + Shader::element_index(info.extent, "at") + " * " + std::to_string(n) +
         ";\n  " + taken + " = " + type + "(" + components + ");\n  if ((" + any_bits(info.type, taken) + ") != 0u) {" +
         zeros + " }\n}\n" + type + " " + function + "(ivec3 at) { return " + taken + "; }\n";
}

}  // namespace dr::backend
