// SPDX-License-Identifier: Apache-2.0
// Verification of bundles, what FlatBuffers cannot know: texts, types, leaves, resources, steps.
#include <algorithm>
#include <cstring>
#include <map>
#include <utility>

#include "compiler/backend/bundle/checker.h"
#include "compiler/ir/dim.h"

namespace dr::bundle {

namespace {

constexpr size_t kMaxName = 400, kMaxTitle = 4096;

bool is_alphanumeric(char c) {
  return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '_';
}

bool same(const TypeT& a, const TypeT& b) { return a.scalar == b.scalar && a.rows == b.rows && a.cols == b.cols; }
bool same(const ExtentT& a, const ExtentT& b) { return a.w == b.w && a.h == b.h && a.l == b.l; }

// A text that may be anything, for a message.
std::string quoted(const std::string& text) {
  std::string out = "'";
  for (const char c : text.substr(0, 64)) out += c >= ' ' && c <= '~' ? c : '?';
  return out + "'";
}

}  // namespace

bool Checker::fail(const std::string& what) {
  if (problem_.empty()) problem_ = what;
  return false;
}

bool Checker::name(const std::string& text, const std::string& what) {
  const bool well = !text.empty() && text.size() <= kMaxName && text[0] != '.' &&
                    std::ranges::all_of(text, [](char c) { return is_alphanumeric(c) || c == '.'; });
  return well || fail(what + " is named " + quoted(text) + ", which is no name: letters, digits, _ and . make one");
}

bool Checker::title(const std::string& text, const std::string& what) {
  const bool well = !text.empty() && text.size() <= kMaxTitle && std::ranges::all_of(text, [](char c) {
    return is_alphanumeric(c) || std::strchr(" .,:+-*/()", c) != nullptr;
  });
  return well || fail(what + " is called " + quoted(text) + ", which holds characters that no name has");
}

bool Checker::text(const std::string& text, const std::string& what) {
  for (size_t k = 0; k < text.size(); ++k) {
    const auto c = static_cast<unsigned char>(text[k]);
    // Controls of a terminal: below a space, and, as UTF-8 has them, from C2 80 to C2 9F.
    const bool wide = c == 0xc2 && k + 1 < text.size() && (static_cast<unsigned char>(text[k + 1]) & 0xe0) == 0x80;
    if ((c < ' ' && c != '\n' && c != '\t') || c == 0x7f || wide) return fail(what + " holds control characters");
  }
  return true;
}

bool Checker::unique(std::set<std::string>& known, const std::string& name, const std::string& what) {
  return known.insert(name).second || fail(what + " '" + name + "' is there twice");
}

bool Checker::expression(const std::string& text, const std::string& where) {
  if (text.size() > 4096) return fail(where + " has an extent of over 4096 characters");
  const auto dim = ir::Dim::parse(text);
  if (!dim) return fail(where + " has the extent " + quoted(text) + ", which is no expression");
  for (const std::string& symbol : dim->symbols())
    if (std::ranges::find(b_.symbols, symbol) == b_.symbols.end())
      return fail(where + " uses the unknown symbol " + quoted(symbol));
  return true;
}

bool Checker::extent(const std::unique_ptr<ExtentT>& e, const std::string& where) {
  if (!e) return fail(where + " has no extent");
  return expression(e->w, where) && expression(e->h, where) && expression(e->l, where);
}

bool Checker::type(const std::unique_ptr<TypeT>& t, const std::string& where) {
  if (!t) return fail(where + " has no type");
  if (t->scalar > Scalar::MAX) return fail(where + " has an unknown scalar type");
  if (t->rows < 1 || t->rows > 4 || t->cols < 1 || t->cols > 4)
    return fail(where + " has a type of " + std::to_string(t->rows) + " rows");
  const bool matrix = t->cols > 1;
  return !matrix || (t->scalar == Scalar::Float && t->rows > 1) || fail(where + " has a matrix of what is no float");
}

bool Checker::resource(int64_t index, const std::string& where) {
  return (index >= 0 && index < static_cast<int64_t>(b_.resources.size())) ||
         fail(where + " names resource " + std::to_string(index));
}

bool Checker::storage(int64_t index, Storage wanted, const std::string& where) {
  return resource(index, where) && (b_.resources[static_cast<size_t>(index)]->storage == wanted ||
                                    fail(where + " names a resource of the wrong storage"));
}

bool Checker::kept(int64_t index, const std::string& where) {
  if (!resource(index, where)) return false;
  const ResourceT& r = *b_.resources[static_cast<size_t>(index)];
  return r.storage != Storage::Tile || fail(where + " names '" + r.name + "', which lives in a render pass alone");
}

bool Checker::shader(int64_t index, Stage stage, const std::string& where) {
  if (index < 0 || index >= static_cast<int64_t>(b_.shaders.size()))
    return fail(where + " names shader " + std::to_string(index));
  return b_.shaders[static_cast<size_t>(index)]->stage == stage || fail(where + " uses a shader of another stage");
}

bool Checker::indices(const std::vector<uint32_t>& all, size_t count, const std::string& what,
                      const std::string& where) {
  for (size_t k = 0; k < all.size(); ++k) {
    if (all[k] >= count) return fail(where + " names a " + what + " that is not there");
    if (k > 0 && all[k] <= all[k - 1]) return fail(where + " names its " + what + "s out of order");
  }
  return true;
}

bool Checker::line(const Line& line, const std::string& where) {
  return (line.file() < b_.files.size() && line.line() != 0) ||
         fail(where + " comes from line " + std::to_string(line.line()) + " of file " + std::to_string(line.file()));
}

bool Checker::header() {
  if (!title(b_.profile, "the profile")) return false;
  if (b_.float_profile > FloatProfile::MAX) return fail("the float profile is unknown");
  if (b_.packing > Packing::MAX || b_.lowering > Lowering::MAX || b_.raster > RasterLowering::MAX)
    return fail("the lowering is unknown");
  for (size_t k = 0; k < b_.features.size(); ++k) {
    if (b_.features[k] > Feature::MAX)
      return fail("the bundle needs feature " + std::to_string(static_cast<int>(b_.features[k])) +
                  ", which is unknown");
    if (k > 0 && b_.features[k] <= b_.features[k - 1]) return fail("features stand out of order");
  }
  for (const std::string& file : b_.files)
    if (file.find_first_of("\n\t") != std::string::npos || !text(file, "a file's name"))
      return fail("a file's name holds control characters");
  std::set<std::string> known;
  for (const std::string& symbol : b_.symbols)
    if (!name(symbol, "a symbol") || !unique(known, symbol, "symbol")) return false;
  for (const std::string& number : b_.numbers)
    if (!expression(number, "a number")) return false;
  if (!text(b_.graph, "the graph")) return false;
  for (const Line& op : b_.op_lines)
    if (op.line() != 0 && op.file() >= b_.files.size()) return fail("an op comes from a file that there is not");
  return true;
}

bool Checker::resources() {
  std::map<uint32_t, Storage> slots;
  for (const auto& r : b_.resources) {
    if (!r) return fail("a resource is empty");
    // Steps that keep the old value of one leaf have resources of one name.
    if (!title(r->name, "a resource")) return false;
    const std::string where = "resource '" + r->name + "'";
    if (r->storage > Storage::MAX || r->role > Role::MAX) return fail(where + " is of an unknown kind");
    if (r->list > ListKind::MAX) return fail(where + " is an unknown list");
    if (r->list != ListKind::None && r->role != Role::Scratch)
      return fail(where + " is a list, and yet no scratch buffer");
    if (!type(r->type, where) || !extent(r->extent, where)) return false;
    if (!r->room.empty() && (r->role != Role::Scratch || !expression(r->room, where)))
      return fail(where + " does without room that it needs");
    if (slots.try_emplace(r->slot, r->storage).first->second != r->storage)
      return fail(where + " shares memory with one of another storage");
    const bool buffer = r->storage == Storage::Buffer;
    if (!buffer && r->type->cols != 1) return fail(where + " is an image of matrices");
    if (!buffer && r->role != Role::Value) return fail(where + " is an image of what lives in buffers");
    if (!buffer && r->partial) return fail(where + " is an image with elements that hold nothing");
  }
  return true;
}

bool Checker::leaf(size_t index) {
  const LeafT& l = *b_.leaves[index];
  // The host makes tables, and writes none to a file: their names say what of.
  const bool table = l.table_of >= 0;
  if (!(table ? title(l.name, "a leaf") : name(l.name, "a leaf"))) return false;
  const std::string where = "leaf '" + l.name + "'";
  if (l.kind > LeafKind::MAX) return fail(where + " is of an unknown kind");
  if (!type(l.type, where) || !extent(l.extent, where) || !storage(l.resource, Storage::Buffer, where)) return false;
  const ResourceT& r = *b_.resources[l.resource];
  if (r.role != Role::Leaf || !same(*r.type, *l.type) || !same(*r.extent, *l.extent))
    return fail(where + " has a resource of another type or extent");
  if (std::exchange(leaf_of_[l.resource], static_cast<int>(index)) >= 0)
    return fail(where + " has the resource of another leaf");
  const size_t components = static_cast<size_t>(l.type->rows) * l.type->cols;
  if (!l.initial.empty() && l.initial.size() != components)
    return fail(where + " has an initial value of the wrong size");
  if (l.is_fixed && (l.kind != LeafKind::Input || l.initial.empty()))
    return fail(where + " keeps a value that it does not have");
  return true;
}

// Tables are whole numbers that the host makes of whole numbers.
bool Checker::tables_of_leaves() {
  const auto whole = [](const LeafT& l) { return l.type->scalar == Scalar::Int && l.type->cols == 1; };
  for (const auto& l : b_.leaves) {
    const std::string where = "leaf '" + l->name + "'";
    if (l->table_of < 0) {
      if (l->table_of != -1 || !l->table.empty()) return fail(where + " is a table of nothing");
      continue;
    }
    if (static_cast<size_t>(l->table_of) >= b_.leaves.size())
      return fail(where + " is a table of a leaf that there is not");
    const LeafT& of = *b_.leaves[static_cast<size_t>(l->table_of)];
    if (l->kind != LeafKind::Input || of.kind != LeafKind::Input || !whole(*l) || !whole(of) || !l->initial.empty())
      return fail(where + " is a table, but not of whole numbers that are bound");
    if (!title(l->table, where)) return false;
    // No longer a way than there are leaves.
    const LeafT* at = l.get();
    for (size_t k = 0; at->table_of >= 0; ++k) {
      if (k == b_.leaves.size() || static_cast<size_t>(at->table_of) >= b_.leaves.size())
        return fail(where + " is a table of itself");
      at = b_.leaves[static_cast<size_t>(at->table_of)].get();
    }
  }
  return true;
}

bool Checker::leaves() {
  leaf_of_.assign(b_.resources.size(), -1);
  std::set<std::string> known;
  for (size_t k = 0; k < b_.leaves.size(); ++k) {
    if (!b_.leaves[k]) return fail("a leaf is empty");
    if (!leaf(k) || !unique(known, b_.leaves[k]->name, "leaf")) return false;
  }
  std::map<uint32_t, uint32_t> slots;
  for (const auto& r : b_.resources) ++slots[r->slot];
  for (size_t k = 0; k < b_.resources.size(); ++k) {
    const ResourceT& r = *b_.resources[k];
    if ((r.role == Role::Leaf) != (leaf_of_[k] >= 0)) return fail("resource '" + r.name + "' belongs to no leaf");
    const bool is_word = r.type->rows == 1 && r.type->cols == 1 && r.extent->w == "1" && r.extent->h == "1" &&
                         r.extent->l == "1" && r.storage == Storage::Buffer;
    if ((r.role == Role::Watch || r.role == Role::Guess) && !is_word)
      return fail("resource '" + r.name + "' is a watch or a guess, and no word");
    if (r.role == Role::Zeros && r.storage != Storage::Buffer)
      return fail("resource '" + r.name + "' is words of zeros, and no buffer");
    if (r.role == Role::EpochEntries && (r.type->rows != 2 || r.type->cols != 1 || r.type->scalar != Scalar::Uint))
      return fail("resource '" + r.name + "' has epochs, and is no entries");
    if (stays(r) && slots[r.slot] > 1) return fail("resource '" + r.name + "' shares memory, but stays");
  }
  return tables_of_leaves();
}

bool Checker::shaders() {
  for (const auto& s : b_.shaders) {
    if (!s) return fail("a shader is empty");
    if (!title(s->name, "a shader")) return false;
    if (s->stage > Stage::MAX) return fail("shader '" + s->name + "' is of an unknown stage");
    if (s->spirv.size() < 5 || s->spirv[0] != 0x07230203u) return fail("shader '" + s->name + "' is not SPIR-V");
  }
  return true;
}

bool Checker::counter(const StepT& s, const std::string& where) {
  if (s.step_index < 0) return s.step_index == -1 || fail(where + " counts in no resource");
  if (!storage(s.step_index, Storage::Buffer, where)) return false;
  const ResourceT& r = *b_.resources[static_cast<size_t>(s.step_index)];
  const bool well = r.role == Role::StepIndex && r.type->scalar == Scalar::Int && r.type->rows == 1 &&
                    r.type->cols == 1 && r.extent->w == "1" && r.extent->h == "1" && r.extent->l == "1";
  return well || fail(where + " counts in a resource that is no counter");
}

bool Checker::raster(const RasterResultsT& raster, const std::string& where) {
  const auto& all = raster.resources;
  // One resource alone lists faces and tags together.
  if (all.empty() || (all.size() > 1 && all.size() % 2 != 0)) return fail(where + " has no tag for each face");
  for (const uint32_t index : all)
    if (!kept(index, where)) return false;
  const TypeT& first = *b_.resources[all[0]]->type;
  const bool entries = first.rows == 2 && first.scalar == Scalar::Uint;
  const bool bits = first.rows == 1 && first.scalar == Scalar::Uint && all.size() == 2;
  if (bits != !raster.width.empty()) return fail(where + " has a width, or bits without one");
  if (bits && !expression(raster.width, where)) return false;
  for (const uint32_t index : all) {
    const ResourceT& r = *b_.resources[index];
    const bool well =
        (r.role == Role::Value || (r.role == Role::EpochEntries && entries)) && r.storage != Storage::Depth &&
        r.type->cols == 1 &&
        (entries || bits ? index == all[0] && all.size() > 1 : r.type->rows == 1 && r.type->scalar == Scalar::Int);
    if (!well) return fail(where + " has '" + r.name + "', which holds neither faces nor entries");
  }
  return true;
}

bool Checker::results(const StepT& s, const std::string& where) {
  const auto named = [&](const std::vector<std::unique_ptr<OutputT>>& all, const std::string& what) {
    std::set<std::string> known;
    for (const auto& o : all) {
      if (!o) return fail("a " + what + " of " + where + " is empty");
      if (!name(o->name, "a " + what + " of " + where) || !unique(known, o->name, what)) return false;
      const std::string own = what + " '" + o->name + "'";
      if (!kept(o->resource, own)) return false;
      const ResourceT& r = *b_.resources[o->resource];
      if (!is_value(r) || r.storage == Storage::Depth) return fail(own + " names '" + r.name + "', no value");
    }
    return true;
  };
  if (!named(s.outputs, "output") || !named(s.pins, "pinned value")) return false;
  for (const auto& r : s.rasters)
    if (!r || !raster(*r, "a raster of " + where)) return fail("a raster of " + where + " is empty");
  // Values hold nothing until they are written, and leaves nothing that the step does not need.
  std::vector<uint32_t> all;
  for (const auto& o : s.outputs) all.push_back(o->resource);
  for (const auto& o : s.pins) all.push_back(o->resource);
  for (const auto& r : s.rasters) all.insert(all.end(), r->resources.begin(), r->resources.end());
  for (const uint32_t index : all) {
    const ResourceT& r = *b_.resources[index];
    if (!holds(index)) return fail(where + " gives '" + r.name + "', which none of its commands writes");
    if (r.role == Role::Leaf && !std::ranges::binary_search(s.leaves, static_cast<uint32_t>(leaf_of_[index])))
      return fail(where + " gives leaf '" + r.name + "', but does not name it among its own");
  }
  return true;
}

bool Checker::step(const StepT& s) {
  const std::string where = "step '" + s.name + "'";
  if (!counter(s, where)) return false;
  if (!indices(s.leaves, b_.leaves.size(), "leaf", where)) return false;
  if (!indices(s.changes, b_.leaves.size(), "leaf", where)) return false;
  for (const uint32_t leaf : s.changes)
    if (!std::ranges::binary_search(s.leaves, leaf)) return fail(where + " changes a leaf that it does not name");
  std::set<std::string> known;
  for (const std::string& symbol : s.symbols) {
    if (std::ranges::find(b_.symbols, symbol) == b_.symbols.end())
      return fail(where + " needs the unknown symbol " + quoted(symbol));
    if (!unique(known, symbol, "symbol")) return false;
  }
  return commands(s) && results(s, where);
}

std::string Checker::process() {
  if (!header() || !resources() || !leaves() || !shaders()) return problem_;
  std::set<std::string> known;
  for (const auto& s : b_.steps)
    if (!s || !name(s->name, "a step") || !unique(known, s->name, "step") || !step(*s)) {
      fail("a step is empty");
      break;
    }
  return problem_;
}

std::string check(const BundleT& bundle) { return Checker(bundle).process(); }

}  // namespace dr::bundle
