// SPDX-License-Identifier: Apache-2.0
// What the elaborator tells an observation.
#include <algorithm>

#include "compiler/lower/elaborator.h"
#include "compiler/lower/program/observation.h"

namespace dr::lower {

namespace {

Member::Kind kind_of(const ModuleItem& item) {
  switch (item.kind) {
    case ModuleItem::Kind::Const: return Member::Kind::Constant;
    case ModuleItem::Kind::Fn: return Member::Kind::Function;
    case ModuleItem::Kind::Struct:
    case ModuleItem::Kind::Optimizer: return Member::Kind::Type;
    case ModuleItem::Kind::Import: return Member::Kind::Module;
    case ModuleItem::Kind::Parameter:
    case ModuleItem::Kind::Leaf:
    case ModuleItem::Kind::Let:
    case ModuleItem::Kind::Symbol: return Member::Kind::Field;
  }
  DR_ICE("an item of no kind");
}

std::vector<Member> members_of(const Type& type) {
  std::vector<Member> members;
  for (int i = 0; type.rows > 1 && !type.is_matrix() && i < type.rows; ++i)
    members.push_back({std::string(1, "xyzw"[i]), Member::Kind::Field, Type{type.scalar}.str(), {}});
  for (const char* name : {"width", "height", "layers"}) members.push_back({name, Member::Kind::Field, "int", {}});
  for (const char* name : {"at", "layer"}) members.push_back({name, Member::Kind::Method, "", {}});
  return members;
}

}  // namespace

std::vector<Member> members_of_type(std::string_view type) {
  const auto parsed = Type::parse(type);
  return parsed ? members_of(*parsed) : std::vector<Member>{};
}

// The words for a value that has some: its type and, of a number known at compile time, the number.
std::string Elaborator::words_for_reader(const Value& value) const {
  if (!value.is_numeric() && !value.is_composite()) return "";
  if (value.is_composite() && contains_error(value)) return "";
  std::string type = describe(value);
  if (const auto* dim = value.get<Dim>()) return type + " = " + dim->str();
  const auto components = known_components(value);
  if (!components || components->size() != 1) return type;
  std::string number = std::to_string(components->front());
  number.erase(std::max(number.find_last_not_of('0') + 1, number.find('.') + 2));
  return type + " = " + (element_type(value).is_bool() ? (components->front() != 0 ? "true" : "false") : number);
}

void Elaborator::observe(const Span& span, const Value& value, const Span& declared) {
  if (!observation_ || !root_ || span.file != root_->syntax->file) return;
  const auto [place, added] = observation_->names.try_emplace(span.begin);
  if (!added && (!place->second.type.empty() || value.is_error())) return;
  place->second.type = words_for_reader(value);
  if (declared.valid()) place->second.declared = declared;
}

// A name behind a dot, and where it is declared.
void Elaborator::observe_field(const Value& base, const std::string& name, const Span& span, const Value& value) {
  if (!observation_ || !root_ || span.file != root_->syntax->file) return;
  const auto length = static_cast<uint32_t>(name.size());
  const Span place{span.file, span.end - std::min(length, span.end - span.begin), span.end};
  if (place.begin == observation_->members_at && observation_->members.empty()) observe_members(base);
  Span declared;
  if (const auto* module = base.get<ModuleValue>()) {
    const auto item = module->module->items.find(name);
    if (item != module->module->items.end()) declared = item->second.span;
  } else if (const auto* s = base.get<StructValue>(); s && s->type->decl) {
    for (const dsl::Param& field : s->type->decl->fields)
      if (field.name.text == name) declared = field.name.span;
    for (const dsl::FnDecl& method : s->type->decl->methods)
      if (method.name.text == name) declared = method.name.span;
  }
  observe(place, value, declared);
}

void Elaborator::observe_members(const Value& base) {
  std::vector<Member>& members = observation_->members;
  if (const auto* module = base.get<ModuleValue>()) {
    for (const auto& [name, item] : module->module->items) {
      if (!item.is_private && item.kind != ModuleItem::Kind::Import)
        members.push_back({name, kind_of(item), "", item.span});
    }
    std::ranges::sort(members, {}, &Member::name);
  } else if (const auto* s = base.get<StructValue>()) {
    for (size_t i = 0; i < s->fields.size(); ++i) {
      const Span declared = s->type->decl ? s->type->decl->fields[i].name.span : Span{};
      members.push_back({s->type->fields[i], Member::Kind::Field, words_for_reader(s->fields[i]), declared});
    }
    if (!s->type->decl) return;
    for (const dsl::FnDecl& method : s->type->decl->methods)
      members.push_back({method.name.text, Member::Kind::Method, "", method.name.span});
  } else if (base.is<ArrayValue>()) {
    members.push_back({"length", Member::Kind::Field, "int", {}});
  } else if (base.is_composite()) {
    for (size_t i = 0; i < parts_of(base).size(); ++i)
      members.push_back({part_name(base, i), Member::Kind::Field, words_for_reader(parts_of(base)[i]), {}});
  } else if (base.is_numeric()) {
    members = members_of(element_type(base));
  }
}

// `step_index of rig.fit`: where the step is declared, and which ones there are.
void Elaborator::observe_step(const Expr& path, const ModuleInfo& module) {
  if (!observation_ || !root_ || path.span.file != root_->syntax->file) return;
  const auto length = static_cast<uint32_t>(path.name.size());
  const Span place{path.span.file, path.span.end - std::min(length, path.span.end - path.span.begin), path.span.end};
  const bool wants_members = place.begin == observation_->members_at && observation_->members.empty();
  for (const dsl::Item& item : module.syntax->items) {
    if (item.kind != dsl::Item::Kind::Step) continue;
    const dsl::Name& step = item.step->name;
    if (step.text == path.name) observe(place, Nothing{}, step.span);
    if (wants_members) observation_->members.push_back({step.text, Member::Kind::Step, "", step.span});
  }
}

// The trees leave the elaborator: nothing of it may be used behind this.
void Elaborator::give_files() {
  std::map<const ModuleInfo*, size_t> places;
  for (const ModuleInfo& module : modules_)
    if (!module.is_instance) places.emplace(&module, places.size());
  for (ModuleInfo& module : modules_) {
    if (module.is_instance) continue;  // its file is there
    Observation::File& file = observation_->files.emplace_back();
    file.file = module.syntax->file;
    file.is_library = module.path.starts_with("library:");
    for (const auto& [name, item] : module.items) {
      const auto* import = item.value.get<ModuleValue>();
      if (item.kind == ModuleItem::Kind::Import && import) file.imports[name] = places.at(import->module);
    }
    file.syntax = std::move(*module.syntax);
  }
}

}  // namespace dr::lower
