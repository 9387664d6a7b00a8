// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/emit/element_lists.h"

#include <algorithm>

#include "compiler/backend/emit/generator.h"

namespace dr::backend {

using glsl::dim_expression;
using glsl::Shader;

namespace {

constexpr int kRun = kListedRun;  // a bit each

// Squares of 16 x 16, in bands over the whole width. Where they do not fit, what is left of a band at its right comes
// behind its squares, and the rows below the last band at the end, one row after the other.
constexpr const char* kInTiles = R"(
ivec2 in_tile(int lane) { return ivec2((lane & 7) + ((lane >> 2) & 8), ((lane >> 3) & 3) + ((lane >> 4) & 12)); }

int in_tiles(int index, int w, int rows) {
  int across = w / 16;
  ivec2 at = in_tile(index & 255);
  if (w % 16 == 0 && rows % 16 == 0) {
    int tile = index / 256;
    return (tile / across * 16 + at.y) * w + tile % across * 16 + at.x;
  }
  int band = index / (16 * w), within = index - band * 16 * w, rest = within - across * 256, left = max(w - across * 16, 1);
  if (band >= rows / 16) return index;
  at = in_tile(within & 255) + ivec2(within / 256 * 16, 0);
  if (rest >= 0) at = ivec2(across * 16 + rest % left, rest / left);
  return (band * 16 + at.y) * w + at.x;
}
)";

std::string members(const std::string& list) { return "members_of_" + list; }

// Variables that hold a value of the element before, the element and the next one.
struct Beside {
  const ReadsBeside* read;
  std::string before, own, after;
};

std::vector<Beside> begin_beside(Shader& s, const std::vector<ReadsBeside>& reads) {
  std::vector<Beside> out;
  for (const ReadsBeside& read : reads) {
    const std::string type = s.graph().value(read.value).type.str();
    Beside& b = out.emplace_back(&read, s.unique("before"), s.unique("own"), s.unique("after"));
    s.body().line(type + " " + b.before + ", " + b.own + " = " + s.load(read.value, "ivec3(max(at.x - 1, 0), at.yz)") +
                  ", " + b.after + " = " + s.load(read.value, "at") + ";");
  }
  return out;
}

void read_beside(Shader& s, const std::vector<Beside>& beside) {
  for (const Beside& b : beside) {
    const std::string last = dim_expression(s.graph().value(b.read->value).extent.w - ir::Dim(1));
    s.body().line(b.before + " = " + b.own + ";");
    s.body().line(b.own + " = " + b.after + ";");
    s.body().line(b.after + " = " + s.load(b.read->value, "ivec3(min(at.x + 1, " + last + "), at.yz)") + ";");
    s.define(b.read->value, b.own);
    if (b.read->before) s.define(s.graph().op(*b.read->before).results[0], b.before);
    if (b.read->after) s.define(s.graph().op(*b.read->after).results[0], b.after);
  }
}

// A statement that counts the rows of workgroups, of `each` elements and one at least; none where all elements of an
// extent take no more than one row, with some workgroups to spare.
std::string count_rows(const ir::Extent& extent, int each, const std::string& list, const std::string& rows) {
  constexpr int64_t kRow = 65535;
  const auto most = element_count(extent).evaluate({});
  return most && *most / each + 16 <= kRow ? std::string() : "    atomicMax(" + list + ".d[1], " + rows + ");\n";
}

}  // namespace

ir::Dim runs_of(const ir::Dim& elements) { return (elements + ir::Dim(kRun - 1)).divided_by(kRun); }

std::string append(Shader& s, const std::string& list, const std::string& element, const ir::Extent& extent,
                   bool together, int shares) {
  const std::string end = list + ".d[" + std::to_string(kListEnd) + "]";
  // All atomics of a list wait for each other. Workgroups that find nothing to do end at once on a GPU.
  const std::string each = std::to_string(64 / shares) + "u",
                    step = together ? std::to_string(1024 / shares) + "u" : each,
                    last = together ? "(place / " + each + " + 15u)" : "place / " + each;
  s.prelude("uint append_to_" + list + "(int element) {\n" +
            (together ? "  uvec4 lanes = subgroupBallot(true);\n  uint place = 0u;\n"
                        "  if (subgroupElect()) place = atomicAdd(" +
                            end +
                            ", subgroupBallotBitCount(lanes));\n"
                            "  place = subgroupBroadcastFirst(place) + subgroupBallotExclusiveBitCount(lanes) - 1u;\n"
                      : "  uint place = atomicAdd(" + end + ", 1u) - 1u;\n") +
            "  " + list + ".d[" + std::to_string(kListHead) + "u + place] = uint(element);\n  if (place % " + step +
            " == 0u) {\n    atomicMax(" + list + ".d[0], min(" + last + " + 1u, 65535u));\n" +
            count_rows(extent, 64 / shares, list, last + " / 65535u + 1u") + "  }\n  return place;\n}\n");
  return "append_to_" + list + "(" + element + ")";
}

void index_in_tiles(Shader& s, const ir::Extent& extent) {
  if (extent.h.is_one()) return;
  s.prelude(kInTiles);
  s.body().line("index = in_tiles(index, " + dim_expression(extent.w) + ", " + dim_expression(extent.h * extent.l) +
                ");");
}

ListingLoop::ListingLoop(Shader& shader, const ir::Extent& extent, bool runs, bool tiles, const RunReads& shared)
    : shader_(shader), extent_(extent), runs_(runs) {
  const ir::Dim count = element_count(extent);
  if (!runs_) {
    linear_index(shader_, dim_expression(count));
    if (tiles) index_in_tiles(shader_, extent);
    place_from_index(shader_, extent);
    return;
  }
  const std::string run = std::to_string(kRun);
  linear_index(shader_, dim_expression(runs_of(count)));
  shader_.body().line("int begin = index * " + run + ", end = min(begin + " + run + ", " + dim_expression(count) +
                      ");");
  if (!shared.same.empty() || !shared.beside.empty()) place_from_index(shader_, extent, "begin");
  shader_.element_ops(shared.same);
  const std::vector<Beside> beside = begin_beside(shader_, shared.beside);
  shader_.body().line("for (int element = begin; element < end; ++element) {");
  shader_.push_scope();
  place_from_index(shader_, extent, "element");
  read_beside(shader_, beside);
}

ListingLoop::ListingLoop(Shader& shader, const ir::Extent& extent, const std::string& listed)
    : shader_(shader), extent_(extent), runs_(true), listed_(listed) {
  const std::string run = std::to_string(kRun);
  linear_index(shader_,
               "(int(" + listed + "(" + std::to_string(kListEnd) + ")) + " + std::to_string(kRun - 2) + ") / " + run);
  shader_.body().line("int begin = index * " + run + ", end = min(begin + " + run + ", int(" + listed + "(" +
                      std::to_string(kListEnd) + ")) - 1);");
  shader_.body().line("for (int item = begin; item < end; ++item) {");
  shader_.push_scope();
  shader_.body().line("int element = int(" + listed + "(" + std::to_string(kListHead) + " + item));");
  place_from_index(shader_, extent, "element");
}

int ListingLoop::each() const { return runs_ ? kRun : 1; }

void ListingLoop::add(const std::string& list, bool together, int shares) {
  if (!runs_) {
    shader_.body().line(append(shader_, list, "index", extent_, together, shares) + ";");
    return;
  }
  if (std::ranges::find(lists_, list) == lists_.end()) {
    lists_.push_back(list);
    shader_.declare("uint " + members(list) + " = 0u;\n");
  }
  shader_.body().line(members(list) + " |= 1u << uint(" + (listed_.empty() ? "element" : "item") + " - begin);");
}

std::string ListingLoop::close() {
  if (!runs_) return element_count(extent_).str();
  shader_.pop_scope();
  shader_.body().line("}");
  const std::string item = "begin + findLSB(members)",
                    element = listed_.empty() ? "uint(" + item + ")"
                                              : listed_ + "(" + std::to_string(kListHead) + " + " + item + ")";
  for (const std::string& list : lists_) {
    const std::string end = std::to_string(kListEnd), head = std::to_string(kListHead);
    shader_.declare("void append_run_to_" + list + "(int begin, uint members) {\n" +
                    "  if (members != 0u) {\n"
                    "  uint place = atomicAdd(" +
                    list + ".d[" + end +
                    "], uint(bitCount(members))) - 1u;\n"
                    "  for (; members != 0u; members &= members - 1u) " +
                    list + ".d[" + head + "u + place++] = " + element +
                    ";\n"
                    "  atomicMax(" +
                    list + ".d[0], min((place + 63u) / 64u, 65535u));\n" +
                    count_rows(extent_, 64, list, "((place + 63u) / 64u + 65534u) / 65535u") + "  }\n}\n");
    shader_.body().line("append_run_to_" + list + "(begin, " + members(list) + ");");
  }
  return runs_of(element_count(extent_)).str();
}

}  // namespace dr::backend
