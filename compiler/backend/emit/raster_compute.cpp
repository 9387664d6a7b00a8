// SPDX-License-Identifier: Apache-2.0
// Raster passes by compute shaders. An invocation walks the box around a face's hull, or, if it is larger, puts the
// face on one of two lists, whose faces are walked by a subgroup or more and by a thousand invocations or more. Each
// pixel keeps its least entries with atomic minima, so that the order of the faces does not matter.
#include <algorithm>
#include <bit>
#include <functional>

#include "compiler/backend/emit/raster_closures.h"

namespace dr::backend {

using glsl::dim_expression;
using glsl::Shader;
using ir::Dim;
using ir::ValueId;

namespace {

struct Bins {
  // Faces by the pixels of their boxes: up to the first for one invocation, up to the second for subgroups.
  int small_box, middle_box;
  // Invocations that share the faces of a list.
  int middle_invocations, large_invocations;
};
constexpr Bins kCpu{64, 4096, 1 << 13, 1 << 12};

// Those of a GPU, which starts few workgroups faster than many, and has work for more in large pictures.
Bins gpu_bins(const Dim& pixels) {
  constexpr int64_t kLeast = 1 << 15, kUnknown = 1 << 17, kMost = 1 << 19;
  const auto count = pixels.evaluate({});
  const int64_t invocations = count ? std::clamp(*count / 4, kLeast, kMost) : kUnknown;
  const auto middle = static_cast<int>(std::bit_floor(static_cast<uint64_t>(invocations)));
  return {8, 4096, middle, middle / 2};
}
constexpr int kLargeTeam = 1024;  // invocations that share a large face at least

struct Walk {
  const ir::Graph& graph;
  const Pass& pass;
  const ir::Op& op;
  RasterParts parts;
  bool wide;           // 64-bit entries
  uint32_t keys, ids;  // wide: both the slots
  uint32_t lists;      // [0], [1]: how many faces; the middle ones from [2]; the large ones behind them
  uint32_t subgroup_size;
  Bins bins;
  bool lanes_in_turn;

  std::string box(Shader& s, RasterClosures& closures, bool guarded) const {
    std::string area = "int across = last.x - first.x, area = across * (last.y - first.y);";
    if (guarded) s.body().line("if (" + closures.record(parts.cull, "at") + ") return;");
    s.body().line("vec2 low = vec2(uintBitsToFloat(0x7f800000u)), high = -low, corner;");
    for (const ValueId value : parts.corners) {
      s.body().line("corner = " + closures.record(value, "at") + ";");
      if (guarded) s.body().line("if (dr_no_number(corner)) return;");
      s.body().line("low = min(low, corner);");
      s.body().line("high = max(high, corner);");
    }
    s.body().line("vec2 size = vec2(" + dim_expression(parts.w) + ", " + dim_expression(parts.h) + ");");
    // The pixels whose centres lie in the hull, with a sixteenth of a pixel and some last places more for rounding, of
    // its corners and of what `keep` says there.
    s.body().line("vec2 room = 0.5625 + 9.5367432e-7 * max(abs(low), abs(high));");
    s.body().line("ivec2 first = ivec2(clamp(ceil(low - room), vec2(0.0), size));");
    s.body().line("ivec2 last = ivec2(clamp(floor(high + room), vec2(0.0), size));");
    return area;
  }

  // What one pixel of a box takes: `at` is there.
  void pixel(Shader& s, RasterClosures& closures) const {
    const std::string w = dim_expression(parts.w), h = dim_expression(parts.h);
    const std::string n = dim_expression(element_count(parts.extent()));
    s.body().line("vec2 p = vec2(at.xy) + 0.5;");
    closures.captured();
    s.body().line("if (!" + closures.closure(kKeep) + ") continue;");
    closures.key_from_depth();
    s.body().line("if (no_depth) continue;");
    s.body().line("int pixel = (at.z * " + h + " + at.y) * " + w + " + at.x;");
    const std::string key_words =
        s.bind_words(keys, wide ? "slots" : "keys", bundle::Access::ReadWrite, wide ? "uint64_t" : "uint");
    if (wide) {
      s.body().line("uint64_t entry = (uint64_t(key) << 36) | (uint64_t(uint(face)) << 4) | uint64_t(" +
                    closures.closure(kTag) + " & 15);");
      if (lanes_in_turn) s.body().line("entry = pc.c == 0 ? entry : 0ul;");
      // Each slot keeps the smaller entry and hands the other on, so that the K smallest end up sorted whatever the
      // order.
      s.body().line("for (int k = 0; k < " + std::to_string(parts.count) + "; ++k) {");
      s.body().line("uint64_t old = atomicMin(" + key_words + ".d[k * " + n + " + pixel], entry);");
      s.body().line("entry = old > entry ? old : entry;");
      s.body().line("}");
      return;
    }
    // Peeling: pc.a is the rank; first the least key beyond the rank before, then (pc.b) the least face with it.
    const std::string id_words = s.bind_words(ids, "faces", bundle::Access::ReadWrite);
    s.body().line("int slot = pc.a * " + n + " + pixel;");
    s.body().line("if (pc.a > 0) {");
    s.body().line("uint before = " + key_words + ".d[slot - " + n + "];");
    s.body().line("if (key < before || (key == before && uint(face) <= " + id_words + ".d[slot - " + n +
                  "])) continue;");
    s.body().line("}");
    s.body().line("if (pc.b == 0) atomicMin(" + key_words + ".d[slot], key);");
    s.body().line("else if (" + key_words + ".d[slot] == key) atomicMin(" + id_words + ".d[slot], uint(face));");
  }

  // Each invocation a face and layer; `binned`: where its box is not small, it goes on a list.
  // `set_up` computes what the face takes, if that is not stored yet, and `store` stores it for those who walk lists.
  void faces(Shader& s, bool binned, const std::function<void()>& set_up, const std::function<void()>& store) const {
    const std::string count = dim_expression(parts.faces);
    RasterClosures closures(s, graph, pass, op);
    s.body().line("int face = index % " + count + ";");
    s.body().line("ivec3 at = ivec3(face, 0, index / " + count + ");");
    set_up();
    closures.set_up();
    const std::string area = box(s, closures, true);
    if (binned) {
      const std::string list = s.bind_words(lists, "lists", bundle::Access::ReadWrite);
      s.body().line(area);
      s.body().line("if (area > " + std::to_string(bins.small_box) + ") {");
      s.body().line("if (pc.a == 0 && pc.b == 0) {");
      store();
      s.body().line("if (area <= " + std::to_string(bins.middle_box) + ") " + list + ".d[2u + atomicAdd(" + list +
                    ".d[0], 1u)] = uint(index);");
      s.body().line("else " + list + ".d[uint(2 + " + dim_expression(parts.faces * parts.l) + ") + atomicAdd(" + list +
                    ".d[1], 1u)] = uint(index);");
      s.body().line("}");
      if (bins.small_box > 0) s.body().line("return;");
      s.body().line("}");
      if (bins.small_box == 0) return;
    }
    closures.load_fields("at");
    s.body().line("for (at.y = first.y; at.y < last.y; ++at.y)");
    s.body().line("for (at.x = first.x; at.x < last.x; ++at.x) {");
    s.push_scope();
    pixel(s, closures);
    s.pop_scope();
    s.body().line("}");
  }

  // Lanes that share the faces of a list and the pixels of each: first those of the middle ones, in teams of a
  // subgroup, then those of the large ones. Where there are fewer faces than teams, several teams share a face.
  // `set_up` computes what is not stored of a face.
  void listed(Shader& s, const std::function<void()>& set_up) const {
    const std::string count = dim_expression(parts.faces), lanes = std::to_string(subgroup_size);
    const std::string list = s.read_words(lists, "lists");
    const std::string middle = std::to_string(bins.middle_invocations);
    s.body().line("bool large = index >= " + middle + ";");
    s.body().line("if (large) index -= " + middle + ";");
    s.body().line("int count = int(" + list + "(large ? 1 : 0)), size = large ? " + std::to_string(kLargeTeam) + " : " +
                  lanes + ", teams = (large ? " + std::to_string(bins.large_invocations) + " : " + middle +
                  ") / size;");
    s.body().line("int together = max(teams / max(count, 1), 1);");
    s.body().line("teams /= together;");
    s.body().line("int lanes = size * together, team = index / lanes, lane = index % lanes;");
    s.body().line("if (team >= teams) return;");
    s.body().line("int begin = large ? 2 + " + dim_expression(parts.faces * parts.l) + " : 2;");
    s.body().line("for (int item = team; item < count; item += teams) {");
    s.push_scope();
    RasterClosures closures(s, graph, pass, op);
    s.body().line("int entry_index = int(" + list + "(begin + item));");
    s.body().line("int face = entry_index % " + count + ";");
    s.body().line("ivec3 at = ivec3(face, 0, entry_index / " + count + ");");
    set_up();
    closures.set_up();
    s.body().line(box(s, closures, false));
    closures.load_fields("at");
    // Floats divide faster, and exactly: a half is more than they are off by for numbers of 2^17.
    s.body().line("int down = int((float(lanes) + 0.5) / float(across)), right = lanes - down * across;");
    s.body().line("int y = int((float(lane) + 0.5) / float(across)), x = lane - y * across;");
    s.body().line("for (int i = lane; i < area; i += lanes, x += right, y += down) {");
    s.push_scope();
    s.body().line("if (x >= across) {");
    s.body().line("x -= across;");
    s.body().line("++y;");
    s.body().line("}");
    s.body().line("at.xy = first + ivec2(x, y);");
    pixel(s, closures);
    s.pop_scope();
    s.body().line("}");
    s.pop_scope();
    s.body().line("}");
  }
};

}  // namespace

void Generator::raster_compute(const Pass& pass, const ir::Op& op) {
  const RasterParts parts = raster_parts(op);
  const Dim pixels = element_count(parts.extent());
  const Dim slots = pixels * Dim(static_cast<int64_t>(parts.count));
  const Dim faces = parts.faces * parts.l;
  const bool wide = wide_atomics();
  const bool binned = profile_.subgroup_size > 1;
  const Bins bins = profile_.subgroup_size >= kWideSubgroup ? gpu_bins(pixels) : kCpu;
  const bool stay = resource(op.results[0]).entries;
  const uint32_t keys =
      stay ? resource_index(op.results[0])
           : add_scratch(pass.name + (wide ? "_slots" : "_keys"), (wide ? slots * Dim(2) : slots).str());
  const uint32_t ids = wide ? keys : add_scratch(pass.name + "_faces", slots.str());
  const uint32_t lists = binned ? add_scratch(pass.name + "_lists", (faces * Dim(2) + Dim(2)).str()) : keys;
  fill("clear " + pass.name, keys, 0xffffffffu);
  if (!wide) fill("clear " + pass.name + " faces", ids, 0xffffffffu);
  if (binned) fill("clear " + pass.name + " lists", lists, 0, "2");

  // A power of two, so that teams share the invocations evenly whatever the profile says.
  const uint32_t lanes = std::bit_floor(std::min(profile_.subgroup_size, 128u));
  const Walk walk{graph_, pass, op, parts, wide, keys, ids, lists, lanes, bins, profile_.lanes_in_turn};
  // Without wide words a rank takes two runs; see Walk::pixel.
  std::vector<size_t> first_run;
  const Pass* const setup = pass.set_up_by < 0 ? nullptr : &step_->passes[static_cast<size_t>(pass.set_up_by)];
  const auto compute = [&](Shader& s) {
    if (setup == nullptr) return;
    s.element_ops(setup->ops);
    store_results(s, *setup);
  };
  const auto store_listed = [&](Shader& s) {
    if (setup == nullptr) return;
    for (const ValueId v : setup->partial) s.store(v, "at", s.use(v));
  };
  const auto run = [&](bool listed, const char* suffix, const Dim& elements) {
    Shader s = strict_shader();
    if (wide) wide_extensions(s);
    s.prelude(kIsNan);
    linear_index(s, dim_expression(elements));
    if (listed)
      walk.listed(s, [&] {
        if (pass.sets_up_again) s.element_ops(setup->ops);
      });
    else
      walk.faces(
          s, binned, [&] { compute(s); }, [&] { store_listed(s); });
    dispatch(pass, suffix, s, elements.str());
    first_run.push_back(out_->commands.size() - 1);
  };
  run(false, "_faces", faces);
  if (binned) run(true, "_listed_faces", Dim(bins.middle_invocations + bins.large_invocations));
  if (!wide)
    for (int rank_run = 1; rank_run < 2 * static_cast<int>(parts.count); ++rank_run)
      for (const size_t index : first_run) {
        const std::string label = out_->commands[index]->label;
        auto& c = command(bundle::CommandKind::Dispatch, label);
        const bundle::CommandT& again = *out_->commands[index];
        c.compute = again.compute;
        for (const auto& b : again.bindings) c.bindings.push_back(std::make_unique<bundle::BindingT>(*b));
        c.elements = again.elements;
        c.push = {rank_run / 2, rank_run % 2, 0};
      }

  if (stay) return;
  Shader r = strict_shader();
  if (wide) wide_extensions(r);
  const std::string n = dim_expression(pixels);
  linear_index(r, n);
  place_from_index(r, parts.extent());
  const std::string in_keys = wide ? r.read_words(keys, "slots", "uint64_t") : std::string();
  if (wide) {
    for (size_t k = 0; k < parts.count; ++k) {
      const std::string rank = std::to_string(k);
      r.body().line("uint64_t entry_" + rank + " = " + in_keys + "(" + rank + " * " + n + " + index);");
      r.body().line("bool none_" + rank + " = entry_" + rank + " == 0xfffffffffffffffful;");
      r.store(op.results[2 * k], "at",
              "(none_" + rank + " ? -1 : int(uint((entry_" + rank + " >> 4) & 0xfffffffful)))");
      r.store(op.results[2 * k + 1], "at", "(none_" + rank + " ? 0 : int(entry_" + rank + " & 15ul))");
    }
  } else {
    const std::string in_ids = r.read_words(ids, "faces");
    r.body().line("vec2 p = vec2(at.xy) + 0.5;");
    for (size_t k = 0; k < parts.count; ++k) {
      const std::string rank = std::to_string(k);
      r.body().line("int face_" + rank + " = int(" + in_ids + "(" + rank + " * " + n + " + index));");
      r.body().line("int tag_" + rank + " = 0;");
      r.body().line("if (face_" + rank + " >= 0) {");
      r.push_scope();
      RasterClosures tags(r, graph_, pass, op);
      tags.load_fields("ivec3(face_" + rank + ", 0, at.z)");
      tags.captured();
      r.body().line("tag_" + rank + " = " + tags.closure(kTag) + " & 15;");
      r.pop_scope();
      r.body().line("}");
      r.store(op.results[2 * k], "at", "face_" + rank);
      r.store(op.results[2 * k + 1], "at", "tag_" + rank);
    }
  }
  dispatch(pass, "_resolve", r, pixels.str());
}

}  // namespace dr::backend
