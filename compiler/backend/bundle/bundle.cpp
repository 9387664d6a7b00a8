// SPDX-License-Identifier: Apache-2.0
// Verification of bundles: what FlatBuffers cannot know.
#include "compiler/backend/bundle/bundle.h"

#include <algorithm>
#include <cstring>
#include <map>
#include <set>

#include "compiler/ir/dim.h"

namespace dr::bundle {

std::vector<uint8_t> write(const BundleT& bundle) {
  // Room for all that is large, so that it is not copied while the buffer grows.
  size_t large = bundle.graph.size() + (size_t{1} << 18);
  for (const auto& shader : bundle.shaders) large += shader->spirv.size() * sizeof(uint32_t);
  flatbuffers::FlatBufferBuilder builder(large);
  builder.FinishSizePrefixed(Bundle::Pack(builder, &bundle), BundleIdentifier());
  return {builder.GetBufferPointer(), builder.GetBufferPointer() + builder.GetSize()};
}

std::variant<BundleT, std::string> read(std::span<const uint8_t> bytes) {
  // Four bytes of length stand before the buffer, so that a file cut within its padding is told too.
  constexpr size_t kPrefix = sizeof(uint32_t), kSmallest = kPrefix + 8, kLargest = size_t{1} << 30;
  if (bytes.size() < kSmallest || !BundleBufferHasIdentifier(bytes.data() + kPrefix))
    return "not a bundle: the file does not start with DRB1";
  if (bytes.size() > kLargest) return "the bundle is larger than 1 GiB";
  // The tables are read in place and want alignment, which a caller's bytes need not have.
  std::vector<uint64_t> aligned((bytes.size() + 7) / 8);
  std::memcpy(aligned.data(), bytes.data(), bytes.size());
  const auto* data = reinterpret_cast<const uint8_t*>(aligned.data());
  if (flatbuffers::ReadScalar<uint32_t>(data) != bytes.size() - kPrefix) return "the bundle is damaged or cut off";
  flatbuffers::Verifier verifier(data, bytes.size(), 64, 1'000'000);
  if (!VerifySizePrefixedBundleBuffer(verifier)) return "the bundle is damaged or cut off";
  const Bundle* root = GetSizePrefixedBundle(data);
  if (root->version() != kVersion)
    return "the bundle has version " + std::to_string(root->version()) + ", this program reads version " +
           std::to_string(kVersion) + "; build it again";
  // FlatBuffers checks the place of a vector's length, not that of elements that are wider.
  for (const Leaf* leaf : *root->leaves())
    if (leaf->initial() != nullptr && reinterpret_cast<uintptr_t>(leaf->initial()->data()) % alignof(double) != 0)
      return "the bundle is damaged or cut off";
  BundleT bundle;
  root->UnPackTo(&bundle);
  if (std::string problem = check(bundle); !problem.empty()) return "the bundle is not sound: " + problem;
  return bundle;
}

namespace {

struct Checker {
  const BundleT& b;
  std::string problem;

  bool fail(const std::string& what) {
    if (problem.empty()) problem = what;
    return false;
  }
  bool expression(const std::string& text, const std::string& where) {
    if (text.size() > 4096) return fail(where + " has an extent of over 4096 characters");
    const auto dim = ir::Dim::parse(text);
    if (!dim) return fail(where + " has the extent '" + text.substr(0, 64) + "', which is no expression");
    for (const std::string& s : dim->symbols()) {
      bool known = false;
      for (const std::string& k : b.symbols) known = known || k == s;
      if (!known) return fail(where + " uses the unknown symbol '" + s + "'");
    }
    return true;
  }
  bool extent(const std::unique_ptr<ExtentT>& e, const std::string& where) {
    if (!e) return fail(where + " has no extent");
    return expression(e->w, where) && expression(e->h, where) && expression(e->l, where);
  }
  bool type(const std::unique_ptr<TypeT>& t, const std::string& where) {
    if (!t) return fail(where + " has no type");
    if (t->scalar > Scalar::MAX) return fail(where + " has an unknown scalar type");
    if (t->rows < 1 || t->rows > 4 || t->cols < 1 || t->cols > 4)
      return fail(where + " has a type of " + std::to_string(t->rows) + " rows");
    return true;
  }
  bool resource(int64_t index, const std::string& where) {
    if (index < 0 || index >= static_cast<int64_t>(b.resources.size()))
      return fail(where + " names resource " + std::to_string(index));
    return true;
  }
  bool storage(int64_t index, Storage wanted, const std::string& where) {
    if (!resource(index, where)) return false;
    if (b.resources[static_cast<size_t>(index)]->storage != wanted)
      return fail(where + " names a resource of the wrong storage");
    return true;
  }
  // What is there when its command has run.
  bool kept(int64_t index, const std::string& where) {
    if (!resource(index, where)) return false;
    const ResourceT& r = *b.resources[static_cast<size_t>(index)];
    return r.storage != Storage::Tile || fail(where + " names '" + r.name + "', which lives in a render pass alone");
  }
  bool shader(int64_t index, Stage stage, const std::string& where) {
    if (index < 0 || index >= static_cast<int64_t>(b.shaders.size()))
      return fail(where + " names shader " + std::to_string(index));
    if (b.shaders[static_cast<size_t>(index)]->stage != stage) return fail(where + " uses a shader of another stage");
    return true;
  }

  // A subpass belongs to the render pass of the draw before it and reads what that render pass wrote.
  bool subpass(const StepT& step, size_t index, const std::string& where) {
    const CommandT& c = *step.commands[index];
    for (const auto& bound : c.bindings)
      if (std::find(c.inputs.begin(), c.inputs.end(), bound->resource) == c.inputs.end() &&
          !kept(bound->resource, where))
        return false;
    if (!c.joins) return c.inputs.empty() || fail(where + " has input attachments, but no subpass before it");
    std::set<uint32_t> written;
    for (size_t k = index; k-- > 0;) {
      const CommandT& before = *step.commands[k];
      const bool alike = c.kind == CommandKind::Draw && before.kind == CommandKind::Draw && c.depth < 0 &&
                         before.depth < 0 && before.extent->w == c.extent->w && before.extent->h == c.extent->h &&
                         before.extent->l == c.extent->l;
      if (!alike) return fail(where + " joins a render pass of another kind");
      if (before.steady != c.steady || before.leaves != c.leaves)
        return fail(where + " depends on other leaves than the render pass that it joins");
      written.insert(before.colors.begin(), before.colors.end());
      if (!before.joins) break;
      if (k == 0) return fail(where + " joins no render pass");
    }
    if (index == 0) return fail(where + " joins no render pass");
    for (uint32_t input : c.inputs) {
      const bool bound =
          std::any_of(c.bindings.begin(), c.bindings.end(), [&](const auto& own) { return own->resource == input; });
      if (written.count(input) == 0 || !bound) return fail(where + " has an input attachment that no subpass wrote");
    }
    for (const auto& bound : c.bindings)
      if (written.count(bound->resource) != 0 &&
          std::find(c.inputs.begin(), c.inputs.end(), bound->resource) == c.inputs.end())
        return fail(where + " samples an attachment of its render pass");
    for (uint32_t color : c.colors)
      if (written.count(color) != 0) return fail(where + " writes an attachment a second time");
    return true;
  }

  bool leaves(const std::vector<uint32_t>& indices, const std::string& where) {
    for (const uint32_t index : indices)
      if (index >= b.leaves.size()) return fail(where + " names a leaf that is not there");
    return true;
  }

  // Numbers of workgroups come from scratch memory that the command binds, so that its use is known.
  bool bound_scratch(const CommandT& c, const std::string& where) {
    for (const auto& binding : c.bindings)
      if (binding->resource == static_cast<uint32_t>(c.indirect))
        return b.resources[binding->resource]->role == Role::Scratch || fail(where + " is as large as a value says");
    return fail(where + " is as large as a resource says that it does not bind");
  }

  bool command(const CommandT& c, const std::string& where) {
    if (!leaves(c.leaves, where)) return false;
    for (const auto& binding : c.bindings) {
      if (!binding || !resource(binding->resource, where)) return fail(where + " has an empty binding");
      if (binding->access > Access::MAX) return fail(where + " has an unknown access");
      const Storage s = b.resources[binding->resource]->storage;
      if (s == Storage::Depth || (s != Storage::Buffer && binding->access != Access::Read))
        return fail(where + " binds an attachment for writing");
      if (binding->texel > 4 || (binding->texel != 0 && (s != Storage::Buffer || binding->access != Access::Read)))
        return fail(where + " binds as texels what cannot be");
    }
    for (const Line& line : c.lines)
      if (line.file() >= b.files.size() || line.line() == 0)
        return fail(where + " comes from line " + std::to_string(line.line()) + " of file " +
                    std::to_string(line.file()));
    if (c.push.size() > 3) return fail(where + " pushes more than three constants");
    switch (c.kind) {
      case CommandKind::Dispatch:
        if (!c.trips.empty() && (!expression(c.trips, where) || c.part_trips == 0))
          return fail(where + " takes no trips at a time");
        if (c.watch >= 0 && (!resource(c.watch, where) || b.resources[static_cast<size_t>(c.watch)]->role != Role::Watch))
          return fail(where + " is watched in a resource of another role");
        return shader(c.compute, Stage::Compute, where) && expression(c.elements, where) &&
               (c.indirect < 0 || bound_scratch(c, where));
      case CommandKind::Draw: {
        if (!shader(c.vertex, Stage::Vertex, where) || !shader(c.fragment, Stage::Fragment, where)) return false;
        if (!expression(c.elements, where) || !extent(c.extent, where)) return false;
        if (c.colors.empty() || c.colors.size() != c.clear.size())
          return fail(where + " has no clear value for each colour attachment");
        for (uint32_t color : c.colors) {
          const bool tile = color < b.resources.size() && b.resources[color]->storage == Storage::Tile;
          if (!tile && !storage(color, Storage::Image, where)) return false;
        }
        return c.depth < 0 || storage(c.depth, Storage::Depth, where);
      }
      case CommandKind::Fill:
        return storage(c.target, Storage::Buffer, where) && (c.elements.empty() || expression(c.elements, where));
      case CommandKind::Copy: {
        if (!kept(c.source, where) || !storage(c.target, Storage::Buffer, where)) return false;
        const ResourceT &from = *b.resources[static_cast<size_t>(c.source)],
                        &to = *b.resources[static_cast<size_t>(c.target)];
        if (from.storage == Storage::Depth) return fail(where + " copies a depth image");
        if (from.role == Role::Scratch || to.role == Role::Scratch || from.type->rows != to.type->rows ||
            from.type->cols != to.type->cols || from.extent->w != to.extent->w || from.extent->h != to.extent->h ||
            from.extent->l != to.extent->l)
          return fail(where + " copies between unlike resources");
        return true;
      }
      case CommandKind::Reduce:
        return shader(c.compute, Stage::Compute, where) && shader(c.next, Stage::Compute, where) &&
               storage(c.target, Storage::Buffer, where) && storage(c.scratch_a, Storage::Buffer, where) &&
               storage(c.scratch_b, Storage::Buffer, where) && expression(c.outs, where) && expression(c.count, where);
    }
    return fail(where + " is of an unknown kind");
  }

  void run() {
    std::map<uint32_t, Storage> slots;
    for (const auto& r : b.resources) {
      if (!r) {
        fail("a resource is empty");
        return;
      }
      const std::string where = "resource '" + r->name + "'";
      if (r->storage > Storage::MAX || r->role > Role::MAX) {
        fail(where + " is of an unknown kind");
        return;
      }
      if (!type(r->type, where) || !extent(r->extent, where)) return;
      if (!r->room.empty() && !expression(r->room, where)) return;
      if (slots.try_emplace(r->slot, r->storage).first->second != r->storage) {
        fail(where + " shares memory with one of another storage");
        return;
      }
      if (r->storage != Storage::Buffer && r->type->cols != 1) {
        fail(where + " is an image of matrices");
        return;
      }
    }
    for (const auto& l : b.leaves) {
      if (!l) {
        fail("a leaf is empty");
        return;
      }
      const std::string where = "leaf '" + l->name + "'";
      if (l->kind > LeafKind::MAX) {
        fail(where + " is of an unknown kind");
        return;
      }
      if (!type(l->type, where) || !extent(l->extent, where) || !storage(l->resource, Storage::Buffer, where)) return;
      const ResourceT& r = *b.resources[l->resource];
      if (r.role != Role::Leaf || r.type->scalar != l->type->scalar || r.type->rows != l->type->rows ||
          r.type->cols != l->type->cols || r.extent->w != l->extent->w || r.extent->h != l->extent->h ||
          r.extent->l != l->extent->l) {
        fail(where + " has a resource of another type or extent");
        return;
      }
      const size_t components = static_cast<size_t>(l->type->rows) * l->type->cols;
      if (!l->initial.empty() && l->initial.size() != components) {
        fail(where + " has an initial value of the wrong size");
        return;
      }
      if (l->table_of >= 0 && (static_cast<size_t>(l->table_of) >= b.leaves.size())) {
        fail(where + " is a table of a leaf that there is not");
        return;
      }
    }
    for (const Line& line : b.op_lines)
      if (line.line() != 0 && line.file() >= b.files.size()) {
        fail("an op comes from a file that there is not");
        return;
      }
    for (const auto& s : b.shaders) {
      if (!s || s->stage > Stage::MAX) {
        fail("a shader is of an unknown stage");
        return;
      }
      if (s->spirv.size() < 5 || s->spirv[0] != 0x07230203u) {
        fail("shader '" + s->name + "' is not SPIR-V");
        return;
      }
    }
    for (const auto& s : b.steps) {
      if (!s) {
        fail("a step is empty");
        return;
      }
      if (s->step_index >= 0) {
        if (!storage(s->step_index, Storage::Buffer, "step '" + s->name + "'")) return;
        const ResourceT& r = *b.resources[static_cast<size_t>(s->step_index)];
        if (r.role != Role::StepIndex || r.type->rows != 1 || r.type->cols != 1 || r.extent->w != "1" ||
            r.extent->h != "1" || r.extent->l != "1") {
          fail("step '" + s->name + "' counts in a resource that is no counter");
          return;
        }
      }
      for (size_t k = 0; k < s->commands.size(); ++k) {
        if (!s->commands[k]) {
          fail("a command is empty");
          return;
        }
        const std::string where = "command '" + s->commands[k]->label + "'";
        if (!command(*s->commands[k], where) || !subpass(*s, k, where)) return;
      }
      for (const auto& r : s->rasters) {
        if (!r) {
          fail("a raster is empty");
          return;
        }
        for (uint32_t index : r->resources)
          if (!kept(index, "a raster of step '" + s->name + "'")) return;
      }
      const std::string where = "step '" + s->name + "'";
      if (!leaves(s->leaves, where) || !leaves(s->changes, where)) return;
      for (const auto& p : s->pins) {
        if (!p) {
          fail("a pinned value is empty");
          return;
        }
        if (!kept(p->resource, "pinned value '" + p->name + "'")) return;
      }
      for (const auto& o : s->outputs) {
        if (!o) {
          fail("an output is empty");
          return;
        }
        if (!kept(o->resource, "output '" + o->name + "'")) return;
      }
    }
  }
};

}  // namespace

std::string check(const BundleT& bundle) {
  Checker checker{bundle, {}};
  checker.run();
  return checker.problem;
}

}  // namespace dr::bundle
