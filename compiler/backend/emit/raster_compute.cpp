// SPDX-License-Identifier: Apache-2.0
// Raster passes by compute shaders. An invocation walks the box around a face's hull, or, if it is larger, puts the
// face on one of two lists, whose faces are walked by a subgroup or more and by a thousand invocations or more. Each
// pixel keeps its least entries with atomic minima, so that the order of the faces does not matter.
#include <algorithm>
#include <functional>

#include "compiler/backend/analysis/uses.h"
#include "compiler/backend/bundle/entries.h"
#include "compiler/backend/emit/face_lists.h"
#include "compiler/backend/emit/raster_closures.h"

namespace dr::backend {

using glsl::dim_expression;
using glsl::Shader;
using ir::Dim;
using ir::ValueId;

namespace {

struct Walk {
  const ir::Graph& graph;
  const Pass& pass;
  const ir::Op& op;
  RasterParts parts;
  KeptPixels kept;
  uint32_t keys, ids;  // of entries, or listed faces, both the slots
  const FaceLists& lists;
  uint32_t list_words;
  bool epochs;                         // see lowering/clear_by_epochs.h
  bool hidden_stores;                  // and no driver that moves what is one value for a face out of loops
  std::optional<WantedPixels> wanted;  // if no others are looked at
  // The loops of closures are watched; see Generator::Cut.
  bool watched;

  // `leave`: a statement for faces that have none, where there may be such.
  void box(Shader& s, RasterClosures& closures, const std::string& leave) const {
    if (!leave.empty()) s.body().line("if (" + closures.record(parts.cull, "at") + ") " + leave);
    s.body().line("vec2 low = vec2(uintBitsToFloat(0x7f800000u)), high = -low, corner;");
    std::set<ValueId> seen;
    for (const ValueId value : parts.corners) {
      if (!seen.insert(value).second) continue;
      s.body().line("corner = " + closures.record(value, "at") + ";");
      if (!leave.empty()) s.body().line("if (dr_no_number(corner)) " + leave);
      s.body().line("low = min(low, corner);");
      s.body().line("high = max(high, corner);");
    }
    s.body().line("vec2 size = vec2(" + dim_expression(parts.w) + ", " + dim_expression(parts.h) + ");");
    // The pixels whose centres lie in the hull, with a sixteenth of a pixel and some last places more for rounding, of
    // its corners and of what `keep` says there.
    s.body().line("vec2 room = 0.5625 + 9.5367432e-7 * max(abs(low), abs(high));");
    s.body().line("ivec2 first = ivec2(clamp(ceil(low - room), vec2(0.0), size));");
    s.body().line("ivec2 last = ivec2(clamp(floor(high + room), vec2(0.0), size));");
    s.body().line("int across = last.x - first.x, area = across * (last.y - first.y);");
  }

  // The epoch of entries of all that an invocation does, and, once for all faces, the next one.
  void begin_epoch(Shader& s, bool first) const {
    if (!epochs) return;
    const std::string entries = s.bind_words(keys, "slots", bundle::Access::ReadWrite, "uint64_t");
    const ir::Dim behind = element_count(parts.extent()) * Dim(static_cast<int64_t>(parts.count));
    s.body().line("uint64_t epoch = " + entries + ".d[" + dim_expression(behind) + "];");
    if (first)
      s.body().line("if (index == 0) " + entries + ".d[" + dim_expression(behind + Dim(1)) + "] = epoch - 1ul;");
  }

  // Puts the variable `entry` among the least of its pixel.
  void keep_least(Shader& s, const std::string& slots, const std::string& type) const {
    if (parts.count == 1) return s.body().line("atomicMin(" + slots + ".d[pixel], entry);");
    // Each slot keeps the smaller entry and hands the other on, so that the K smallest end up sorted whatever the
    // order. Slots behind the first empty one are empty, too.
    s.body().line("for (int k = 0; k < " + std::to_string(parts.count) + "; ++k) {");
    s.body().line(type + " old = atomicMin(" + slots + ".d[k * " + dim_expression(element_count(parts.extent())) +
                  " + pixel], entry);");
    s.body().line("entry = old > entry ? old : entry;");
    const std::string none = type == "uint" ? "entry == 0xffffffffu"
                             : epochs       ? "entry >> 60 != epoch"
                                            : "entry == 0xfffffffffffffffful";
    s.body().line("if (" + none + ") break;");
    s.body().line("}");
  }

  void load_fields(RasterClosures& closures) const {
    if (has_depths(graph, op, kept))
      closures.load_fields("at", {kDepth, kKeep, kTag});
    else
      closures.load_fields("at", {kKeep, kTag});
  }

  // A pixel of a box is left that the face has no part of: `at` is there.
  void leave_pixel_unless_seen(Shader& s, RasterClosures& closures) const {
    s.body().line("vec2 p = vec2(at.xy) + 0.5;");
    closures.captured();
    closures.leave_unless_kept("continue", wanted ? std::optional(wanted->is_set) : std::nullopt);
    if (has_depths(graph, op, kept)) closures.key_from_depth("continue");
  }

  // Sets `bits` of the word `word` of the row `at`.
  void set_bits(Shader& s, const std::string& word, const std::string& bits) const {
    const ir::Extent extent = bits_extent(parts.extent());
    const std::string words = s.bind_words(keys, "words", bundle::Access::ReadWrite);
    const std::string place =
        "(at.z * " + dim_expression(extent.h) + " + at.y) * " + dim_expression(extent.w) + " + " + word;
    s.body().line("int place = " + s.at_once(ir::kInt, place) + ";");
    s.body().line("atomicOr(" + words + ".d[place], " + bits + ");");
  }

  // What one pixel of a box takes: `at` is there.
  void pixel(Shader& s, RasterClosures& closures) const {
    leave_pixel_unless_seen(s, closures);
    if (kept == KeptPixels::Bits) {
      set_bits(s, "(at.x >> 5)", "1u << uint(at.x & 31)");
      closures.end_of_candidates();
      return;
    }
    const std::string w = dim_expression(parts.w), h = dim_expression(parts.h);
    const std::string n = dim_expression(element_count(parts.extent()));
    s.body().line("int pixel = " + s.at_once(ir::kInt, "(at.z * " + h + " + at.y) * " + w + " + at.x") + ";");
    const bool wide = kept == KeptPixels::WideWords, words = !wide;
    const std::string type = words ? "uint" : "uint64_t", suffix = words ? "u" : "ul";
    const std::string key_words =
        s.bind_words(keys, parts.listed || wide ? "slots" : "keys", bundle::Access::ReadWrite, type.c_str());
    if (parts.listed || wide) {
      const std::string number = type + "(" + (words ? "" : "uint(") + "face" + (words ? "" : ")") + ")";
      s.body().line(type + " entry = " + (words ? "" : "(uint64_t(key) << 36) | ") + "(" + number + " << 4) | " + type +
                    "(" + closures.closure(kTag) + " & 15);");
      if (epochs) s.body().line("entry |= epoch << 60;");
      if (hidden_stores) s.body().line("entry = pushed_zero == 0 ? entry : 0" + suffix + ";");
      keep_least(s, key_words, type);
      closures.end_of_candidates();
      return;
    }
    closures.end_of_candidates();
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

  // Each invocation a face and layer; where its box is not small, it goes on a list.
  // `set_up` computes what the face takes, if that is not stored yet, and `store` stores it for those who walk lists.
  void faces(Shader& s, const std::function<void()>& set_up, const std::function<void()>& store) const {
    face(s, set_up, store, "return;", false);
  }

  // Each invocation several; with `shown`, those for which it gives true: it computes that for the element at `at`.
  // With `later` they are put on lists together, behind all of them.
  void faces_in_turn(Shader& s, const std::function<void()>& set_up, const std::function<void()>& store,
                     const std::function<std::string()>& shown, bool later) const {
    const std::string count = dim_expression(parts.faces), all = dim_expression(parts.faces * parts.l);
    // Lanes take faces that follow each other, and then the next ones: memory is read and written in order.
    s.body().line("const int lanes = " + std::to_string(lists.lanes()) + ";");
    s.body().line("int invocations = int(gl_WorkGroupSize.x * gl_NumWorkGroups.x * gl_NumWorkGroups.y);");
    s.body().line("int part = ((" + all + " - 1) / invocations + 1) * lanes, chunk = index / lanes * part;");
    s.body().line("int begin = chunk + index % lanes, end = min(chunk + part, " + all + ");");
    if (later) s.body().line("uint listed = 0u, listed_large = 0u;");
    if (shown) {
      find_shown(s, shown, count, all);
      s.body().line("for (; left != 0u; left &= left - 1u) {");
      s.push_scope();
      if (later) s.body().line("uint turn = left & (0u - left);");
      s.body().line("index = begin + findLSB(left) * lanes;");
    } else {
      s.body().line("uint turn = 1u;");
      s.body().line("for (index = begin; index < end; index += lanes, turn += turn) {");
      s.push_scope();
    }
    face(s, set_up, store, "continue;", later);
    s.pop_scope();
    s.body().line("}");
    if (!later) return;
    s.body().line("for (; listed != 0u; listed &= listed - 1u) {");
    s.push_scope();
    s.body().line("int k = findLSB(listed);");
    s.body().line(lists.append(s, s.bind_words(list_words, "lists", bundle::Access::ReadWrite),
                               "(listed_large >> k & 1u) != 0u", "begin + k * lanes"));
    s.pop_scope();
    s.body().line("}");
  }

  // The turns of faces that are shown: bits of `left`.
  static void find_shown(Shader& s, const std::function<std::string()>& shown, const std::string& count,
                         const std::string& all) {
    s.body().line("uint left = begin < end ? 1u : 0u;");
    // So few have an invocation each, which need not look twice.
    s.body().line("if (" + all + " >= " + std::to_string(2 * bundle::kLeastInvocations) + ") {");
    s.body().line("left = 0u;");
    s.body().line("for (int k = 0; begin + k * lanes < end; ++k) {");
    s.push_scope();
    s.body().line("index = begin + k * lanes;");
    s.body().line("ivec3 at = ivec3(index % " + count + ", 0, index / " + count + ");");
    s.body().line("if (" + shown() + ") left |= 1u << uint(k);");
    s.pop_scope();
    s.body().line("}");
    s.body().line("}");
  }

  // The one at `index`; `leave` goes on behind it. `later`: if it belongs on a list, its bit `turn` says so.
  void face(Shader& s, const std::function<void()>& set_up, const std::function<void()>& store,
            const std::string& leave, bool later) const {
    const std::string count = dim_expression(parts.faces);
    RasterClosures closures(s, graph, pass, op);
    s.body().line("int face = index % " + count + ";");
    s.body().line("ivec3 at = ivec3(face, 0, index / " + count + ");");
    set_up();
    closures.set_up();
    box(s, closures, leave);
    if (lists.used()) {
      s.body().line("if (area > " + lists.small_box() + ") {");
      s.body().line("if (pc.a == 0 && pc.b == 0) {");
      store();
      if (later) {
        s.body().line("listed |= turn;");
        s.body().line("listed_large |= " + lists.is_large() + " ? turn : 0u;");
      } else {
        s.body().line(
            lists.append(s, s.bind_words(list_words, "lists", bundle::Access::ReadWrite), lists.is_large(), "index"));
      }
      s.body().line("}");
      if (lists.walks_alone()) s.body().line(leave);
      s.body().line("}");
      if (!lists.walks_alone()) return;
    }
    load_fields(closures);
    closures.begin_candidates(false);
    if (wanted) return wanted_of_box(s, closures);
    if (kept == KeptPixels::Bits && lists.walks_alone()) return bits_of_box(s, closures);
    pixels_of_box(s, "", [&] { pixel(s, closures); });
  }

  // One loop over all rows: lanes whose boxes have other widths would wait for each other at the end of each row.
  static void pixels_of_box(Shader& s, const std::string& behind, const std::function<void()>& pixel) {
    s.body().line("at.xy = ivec2(first.x - 1, first.y);");
    s.body().line("for (; area > 0; --area" + behind + ") {");
    s.push_scope();
    s.body().line("bool next_row = ++at.x == last.x;");
    s.body().line("at.xy = next_row ? ivec2(first.x, at.y + 1) : at.xy;");
    pixel();
    s.pop_scope();
    s.body().line("}");
  }

  // The pixels of a small box, whose bits are collected in a register: then a word of a row takes one atomic. Where
  // faces are tiny, that takes longer than an atomic for each pixel.
  void bits_of_box(Shader& s, RasterClosures& closures) const {
    s.body().line("const bool tiny = " + lists.tiny() + ";");
    s.body().line("uint64_t seen = 0ul, bit = 1ul;");
    pixels_of_box(s, ", bit += bit", [&] {
      leave_pixel_unless_seen(s, closures);
      s.body().line("if (tiny) {");
      set_bits(s, "(at.x >> 5)", "1u << uint(at.x & 31)");
      s.body().line("} else {");
      s.body().line("seen |= bit;");
      s.body().line("}");
      closures.end_of_candidates();
    });
    s.body().line("uint64_t row = 0ul, of_row = 0xfffffffffffffffful >> ((64 - across) & 63);");
    s.body().line("int word = 0, skipped = 0;");
    s.body().line("at.y = first.y - 1;");
    s.body().line("while (!tiny && (seen != 0ul || row != 0ul)) {");
    s.push_scope();
    s.body().line("if (row == 0ul) {");
    s.body().line("row = seen & of_row;");
    s.body().line("seen = (seen >> ((across - 1) & 63)) >> 1;");
    s.body().line("++at.y;");
    s.body().line("word = first.x >> 5;");
    s.body().line("skipped = first.x & 31;");
    s.body().line("}");
    s.body().line("uint bits = uint(row << skipped);");
    s.body().line("row >>= 32 - skipped;");
    s.body().line("skipped = 0;");
    s.body().line("++word;");
    s.body().line("if (bits == 0u) continue;");
    set_bits(s, "word - 1", "bits");
    s.pop_scope();
    s.body().line("}");
  }

  // The bits of the word `word` of the row `at` that are wanted, of those of the box.
  std::string wanted_of_word(Shader& s) const {
    return s.load(wanted->bits, "ivec3(word, at.yz)") + " & 0xffffffffu << (begin & 31) & 0xffffffffu >> (-end & 31)";
  }

  // The wanted pixels of a box. In one loop, so that lanes whose boxes have other rows need not wait for each other.
  void wanted_of_box(Shader& s, RasterClosures& closures) const {
    s.body().line("uint wanted = 0u;");
    s.body().line(
        "int left = first.x >> 5, right = (last.x + 31) >> 5, word = left, row = area > 0 ? first.y : last.y;");
    s.body().line("for (;;) {");
    s.push_scope();
    s.body().line("while (wanted == 0u && row < last.y) {");
    s.push_scope();
    s.body().line("int begin = max(first.x, 32 * word), end = min(last.x, 32 * word + 32);");
    s.body().line("at.xy = ivec2(begin, row);");
    s.body().line("wanted = " + wanted_of_word(s) + ";");
    s.body().line("bool next_row = ++word >= right;");
    s.body().line("word = next_row ? left : word;");
    s.body().line("row += next_row ? 1 : 0;");
    s.pop_scope();
    s.body().line("}");
    s.body().line("if (wanted == 0u) break;");
    s.body().line("at.x = (at.x & ~31) + findLSB(wanted);");
    s.body().line("wanted &= wanted - 1u;");
    pixel(s, closures);
    s.pop_scope();
    s.body().line("}");
  }

  // The pixels of a row that have their bits in one word. So few lanes have them to share, but each pixel takes less:
  // it stores nothing.
  void word_of_row(Shader& s, RasterClosures& closures) const {
    s.body().line("int word = left + x, begin = max(first.x, 32 * word), end = min(last.x, 32 * word + 32);");
    s.body().line("at.xy = ivec2(begin, first.y + y);");
    if (wanted) {
      s.body().line("uint wanted = " + wanted_of_word(s) + ";");
      s.body().line("for (; wanted != 0u; wanted &= wanted - 1u) {");
      s.push_scope();
      s.body().line("at.x = 32 * word + findLSB(wanted);");
      pixel(s, closures);
      s.pop_scope();
      s.body().line("}");
      if (watched) s.body().line("if (wanted != 0u) unfinished = true;");
      return;
    }
    s.body().line("uint bits = 0u;");
    s.body().line("for (; at.x < end; ++at.x) {");
    s.push_scope();
    leave_pixel_unless_seen(s, closures);
    s.body().line("bits |= 1u << uint(at.x & 31);");
    closures.end_of_candidates();
    s.pop_scope();
    s.body().line("}");
    if (watched) s.body().line("if (at.x < end) unfinished = true;");
    s.body().line("if (bits == 0u) continue;");
    set_bits(s, "word", "bits");
  }

  // Lanes that share the faces of a list and the pixels of each. `set_up` computes what is not stored of a face.
  void listed(Shader& s, const std::function<void()>& set_up) const {
    const std::string count = dim_expression(parts.faces);
    lists.open_items(s, s.read_words(list_words, "lists"));
    RasterClosures closures(s, graph, pass, op);
    s.body().line("int face = entry_index % " + count + ";");
    s.body().line("ivec3 at = ivec3(face, 0, entry_index / " + count + ");");
    set_up();
    closures.set_up();
    box(s, closures, "");
    load_fields(closures);
    closures.begin_candidates(hidden_stores);
    const bool in_words = kept == KeptPixels::Bits || wanted;
    if (in_words) {
      s.body().line("int left = first.x >> 5;");
      s.body().line("across = ((last.x + 31) >> 5) - left;");
      s.body().line("area = across * (last.y - first.y);");
    }
    s.body().line("int down = quotient(stride, across), right = stride - down * across;");
    s.body().line("int y = quotient(lane, across), x = lane - y * across, i = lane;");
    s.body().line("for (; i < area; i += stride, x += right, y += down) {");
    s.push_scope();
    s.body().line("if (x >= across) {");
    s.body().line("x -= across;");
    s.body().line("++y;");
    s.body().line("}");
    if (in_words) {
      word_of_row(s, closures);
    } else {
      s.body().line("at.xy = first + ivec2(x, y);");
      pixel(s, closures);
    }
    s.pop_scope();
    s.body().line("}");
    if (watched) s.body().line("if (i < area) unfinished = true;");
    s.pop_scope();
    s.body().line("}");
    if (watched) s.body().line("if (item < count) unfinished = true;");
  }
};

}  // namespace

void Generator::tell_unfinished(Shader& s, uint32_t watch) {
  const std::string word = s.bind_words(watch, "unfinished_loops", bundle::Access::ReadWrite);
  s.body().line("if (unfinished) " + word + ".d[0] = 1u;");
}

void Generator::set_walk_trips(bundle::CommandT& c, const WalkTrips& trips, std::optional<uint32_t> watch) const {
  const uint32_t limit = schedule_.code.loop_trips;
  if (limit == 0) return;
  const Dim most = trips.listed + trips.face + Dim(16);
  if (most.is_constant() && most.constant() <= limit && !watch) return;
  c.trips = most.str();
  c.most_trips = limit;
  if (watch) c.watch = static_cast<int>(*watch);
}

void Generator::raster_compute(const Pass& pass, const RasterPass& raster, const ir::Op& op) {
  const RasterParts parts = raster_parts(op);
  const Dim pixels = element_count(parts.extent());
  const Dim slots = pixels * Dim(static_cast<int64_t>(parts.count));
  const Dim faces = parts.faces * parts.l;
  const KeptPixels kept = kept_pixels(schedule_, *step_, op);
  const bool words = parts.listed || kept == KeptPixels::Bits;  // are all that there is
  const bool wide = kept == KeptPixels::WideWords, at_once = wide || words;
  const bool stay = words || resource(op.results[0]).is_entries();
  const uint32_t keys =
      at_once && stay ? resource_index(op.results[0])
                      : add_scratch(pass.name + (wide ? "_slots" : "_keys"), (wide ? slots * Dim(2) : slots).str());
  const uint32_t ids = at_once ? keys : add_scratch(pass.name + "_faces", slots.str());
  fill("clear " + pass.name, keys, kept == KeptPixels::Bits ? 0u : 0xffffffffu);
  if (!at_once) fill("clear " + pass.name + " faces", ids, 0xffffffffu);
  const Pass* const setup = raster.setup ? &step_->pass(raster.setup->pass) : nullptr;
  const WalkTrips trips =
      walk_trips(graph_, pass, op, setup, kept, kept == KeptPixels::Bits || raster.walk.wanted.has_value());
  const FaceLists lists(raster.walk.lists, schedule_.code.loop_trips, parts, trips);
  const bool watched = raster.walk.watched;
  const uint32_t list_words = lists.used() ? add_scratch(pass.name + "_lists", lists.words().str()) : keys;
  if (lists.used()) fill("clear " + pass.name + " lists", list_words, 0, std::to_string(lists.cleared()));
  const Walk walk{graph_,
                  pass,
                  op,
                  parts,
                  kept,
                  keys,
                  ids,
                  lists,
                  list_words,
                  resource(op.results[0]).is(Resource::Storage::EpochEntries),
                  schedule_.code.hidden_stores,
                  raster.walk.wanted ? wanted_pixels(graph_, op) : std::nullopt,
                  watched};
  // Without wide words a rank of entries takes two runs; see Walk::pixel.
  std::vector<size_t> first_run;
  // A face whose loops the device ends may look empty and leave the shader at once.
  const auto set_up = [&](Shader& s, const std::optional<uint32_t>& watch) {
    s.element_ops(setup->ops);
    if (watch && trips_of(graph_, setup->ops).loops > 0) tell_unfinished(s, *watch);
  };
  const auto compute = [&](Shader& s, const std::optional<uint32_t>& watch) {
    if (setup == nullptr) return;
    set_up(s, watch);
    store_results(s, *setup);
  };
  const auto store_listed = [&](Shader& s) {
    if (setup == nullptr) return;
    for (const ValueId v : setup->get<MapPass>().partial) s.store(v, "at", s.use(v));
  };
  const auto shown = [&](Shader& s) {
    s.element_ops(ops_of(graph_, setup->ops, raster.walk.in_turn->shown));
    std::string all;
    for (const ValueId v : raster.walk.in_turn->shown) all += (all.empty() ? "" : " && ") + s.use(v);
    return all;
  };
  const auto run = [&](bool listed, const char* suffix, const Dim& elements) {
    Shader s = strict_shader();
    if (wide || kept == KeptPixels::Bits) wide_extensions(s);
    s.prelude(kIsNan);
    const bool in_rows = listed && lists.bounded(), in_turn = !listed && raster.walk.in_turn;
    linear_index(s, in_rows || in_turn ? std::string() : dim_expression(elements));
    if (watched) s.cut_loops();
    std::optional<uint32_t> watch;
    if (watched) watch = add_watch(pass.name + "_unfinished_" + std::to_string(bundle_->resources.size()));
    walk.begin_epoch(s, !listed);
    if (listed)
      walk.listed(s, [&] {
        const std::vector<ir::OpId> ops = set_up_again(graph_, pass, setup, kept);
        s.element_ops(ops);
        if (watch && trips_of(graph_, ops).loops > 0) tell_unfinished(s, *watch);
      });
    else if (in_turn)
      walk.faces_in_turn(
          s, [&] { compute(s, watch); }, [&] { store_listed(s); },
          raster.walk.in_turn->shown.empty() ? std::function<std::string()>() : [&] { return shown(s); },
          lists.used() && (setup == nullptr || setup->get<MapPass>().partial.empty()));
    else
      walk.faces(
          s, [&] { compute(s, watch); }, [&] { store_listed(s); });
    if (watch) tell_unfinished(s, *watch);
    bundle::CommandT& c = dispatch(pass, suffix, s, elements.str());
    if (in_turn) c.each = static_cast<uint32_t>(raster.walk.in_turn->each);
    if (in_rows) c.indirect = static_cast<int>(list_words);
    set_walk_trips(c, trips, watch);
    first_run.push_back(out_->commands.size() - 1);
  };
  run(false, "_faces", faces);
  if (parts.listed) out_->commands.back()->faces = parts.faces.str();
  if (lists.used()) run(true, "_listed_faces", lists.invocations());
  if (!at_once)
    for (int rank_run = 1; rank_run < 2 * static_cast<int>(parts.count); ++rank_run)
      for (const size_t index : first_run) {
        const std::string label = out_->commands[index]->label;
        auto& c = command(bundle::CommandKind::Dispatch, label);
        const bundle::CommandT& again = *out_->commands[index];
        c.compute = again.compute;
        for (const auto& b : again.bindings) c.bindings.push_back(std::make_unique<bundle::BindingT>(*b));
        c.elements = again.elements;
        c.indirect = again.indirect;
        c.trips = again.trips;
        c.most_trips = again.most_trips;
        c.watch = again.watch;
        c.push = {rank_run / 2, rank_run % 2, 0};
      }

  if (wide && !stay) take_out(pass, op, keys);
  if (!at_once) resolve(pass, op, keys, ids, stay);
}

}  // namespace dr::backend
