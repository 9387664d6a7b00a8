// SPDX-License-Identifier: Apache-2.0
// `topology(face)`: tables of how a mesh's faces hang together, made by the host. In the graph each is an input leaf
// that says what it is a table of.
#include "compiler/topology/topology.h"

#include <algorithm>

#include "compiler/lower/elaborator.h"
#include "compiler/ops/emit.h"

namespace dr::lower {

// The leaf that holds the faces, or nothing after a message.
const ir::Leaf* Elaborator::topology_faces(const BuiltinCall& call) {
  const auto* image = call.args[0].get<Image>();
  const ir::ValueInfo* info = image ? &b_.value(image->id) : nullptr;
  const ir::Op* op = info && info->op.valid() ? &b_.graph().op(info->op) : nullptr;
  const auto index = op && op->kind == OpKind::Leaf ? b_.graph().leaf_index(op->attrs.text) : std::nullopt;
  const ir::Leaf* leaf = index ? &b_.graph().leaves[*index] : nullptr;
  if (leaf && leaf->kind == ir::Leaf::Kind::Input && leaf->type == ir::vec(3, Scalar::Int) && leaf->extent.h.is_one() &&
      leaf->extent.l.is_one()) {
    return leaf;
  }
  report(Code::E0617, call.spans[0],
         "expected an input of type ivec3[F], the faces, for 'topology', found " +
             (leaf ? label(call.args[0], "a leaf") + " of type " : std::string()) + describe(call.args[0]),
         leaf ? std::vector<dsl::Note>{{leaf->span, "it is declared here"}} : std::vector<dsl::Note>{});
  return nullptr;
}

// The leaf of one table; calls for one and the same table share it.
Value Elaborator::topology_table(const std::string& faces, const topology::Table& table, const Dim& face_count,
                                 const Dim& vertices) {
  std::string symbol = faces + "_edges";
  std::ranges::replace(symbol, '.', '_');
  const Dim edges = Dim::symbol(symbol);
  Dim count;
  switch (table.count) {
    case topology::Count::Edges: count = edges; break;
    case topology::Count::Faces: count = face_count; break;
    case topology::Count::Corners: count = face_count * Dim(3); break;
    case topology::Count::Starts: count = vertices + Dim(1); break;
    case topology::Count::One: count = Dim(1); break;
  }
  const std::string name = faces + "." + std::string(table.name);
  if (!b_.graph().leaf_index(name)) {
    ir::Leaf leaf{ir::Leaf::Kind::Input, name, ir::vec(table.components, Scalar::Int), {count, {}, {}}, {}, span_};
    leaf.table = std::string(table.name);
    leaf.table_of = faces;
    b_.graph().leaves.push_back(std::move(leaf));
  }
  ir::Attrs attrs;
  attrs.text = name;
  const ValueId id = ops::emit(b_, OpKind::Leaf, {}, std::move(attrs));
  b_.set_name(id, name);
  return Image{id};
}

// topology(face), topology(face, V): a struct with a field for each table; those of vertices need their number.
const StructType& Elaborator::topology_type(bool with_vertices) {
  static const auto make = [](bool all) {
    StructType type{"topology", {}, nullptr, nullptr};
    for (const topology::Table& table : topology::tables()) {
      if (all || !table.of_vertices()) type.fields.emplace_back(table.name);
    }
    return type;
  };
  static const StructType kEdges = make(false), kAll = make(true);
  return with_vertices ? kAll : kEdges;
}

Value Elaborator::builtin_topology(BuiltinCall& call) {
  if (refuse_in_region("'topology'", call.span)) return Error{};
  const ir::Leaf* leaf = topology_faces(call);
  if (!leaf) return Error{};
  const std::string faces = leaf->name;
  const Dim face_count = leaf->extent.w;
  const Dim* vertices = nullptr;
  if (call.args.size() == 2) {
    vertices = call.args[1].get<Dim>();
    if (!vertices) {
      return fail(Code::E0322, call.spans[1],
                  "expected the number of vertices, an extent, for 'topology', found " + describe(call.args[1]));
    }
    if (vertices->is_constant() && vertices->constant() < 1) {
      return fail(Code::E0404, call.spans[1], "expected at least 1 vertex for 'topology', found " + vertices->str());
    }
    const auto made = b_.graph().leaf_index(faces + ".vertex_start");
    if (made && b_.graph().leaves[*made].extent.w != *vertices + Dim(1)) {
      return fail(Code::E0617, call.spans[1],
                  "expected one number of vertices for the topology of '" + faces + "', found " + vertices->str() +
                      " after " + (b_.graph().leaves[*made].extent.w - Dim(1)).str(),
                  {{b_.graph().leaves[*made].span, "the first is here"}});
    }
  }
  StructValue result{&topology_type(vertices != nullptr), {}, {}};
  for (const topology::Table& table : topology::tables()) {
    if (!vertices && table.of_vertices()) continue;
    result.fields.push_back(topology_table(faces, table, face_count, vertices ? *vertices : Dim(1)));
  }
  return result;
}

}  // namespace dr::lower
