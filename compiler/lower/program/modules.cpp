// SPDX-License-Identifier: Apache-2.0
// Files of the program, and what a name means: local names, then the module's, then the language's.
#include <algorithm>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <sstream>

#include "compiler/lower/elaborator.h"
#include "compiler/ops/emit.h"
#include "dsl/syntax/parser.h"

namespace dr::lower {

// ---- files ----

ModuleInfo* Elaborator::load_module(dsl::FileId file, std::string path, std::string folder) {
  ModuleInfo& module = modules_.emplace_back();
  module.path = std::move(path);
  module.folder = std::move(folder);
  module.is_root = modules_.size() == 1;
  module.scope.module = &module;
  const size_t errors = diagnostics_.error_count();
  const auto start = std::chrono::steady_clock::now();
  module.syntax = std::make_shared<dsl::Module>(dsl::parse(sources_, file, diagnostics_));
  const std::chrono::duration<double, std::milli> elapsed = std::chrono::steady_clock::now() - start;
  if (options_.parse_milliseconds) *options_.parse_milliseconds += elapsed.count();
  parsed_ = parsed_ && diagnostics_.error_count() == errors;
  for (const dsl::ImportDecl& import : module.syntax->imports) load_import(module, import);
  collect_items(module);
  collect_vjps(module);
  module.loading = false;
  return &module;
}

namespace {

std::optional<std::string> read_text(const std::string& path) {
  std::error_code error;
  if (!std::filesystem::is_regular_file(path, error)) return std::nullopt;
  std::ifstream in(path, std::ios::binary);
  if (!in) return std::nullopt;
  std::ostringstream text;
  text << in.rdbuf();
  return text.str();
}

std::string in_folder(const std::string& folder, const std::string& file) {
  if (folder.empty() || folder == ".") return file;
  return folder.back() == '/' ? folder + file : folder + "/" + file;
}

}  // namespace

void Elaborator::load_import(ModuleInfo& importer, const dsl::ImportDecl& import) {
  std::string file;
  for (const dsl::Name& part : import.path) file += (file.empty() ? "" : "/") + part.text;
  file += ".dr";

  // The importing file's folder, the program's, those of -I, the library.
  std::vector<std::string> folders;
  if (!importer.folder.empty()) folders.push_back(importer.folder);
  if (!modules_.front().folder.empty() && importer.folder != modules_.front().folder)
    folders.push_back(modules_.front().folder);
  folders.insert(folders.end(), options_.include_dirs.begin(), options_.include_dirs.end());
  std::string path, folder;
  std::optional<std::string> text;
  for (const std::string& candidate : folders) {
    path = in_folder(candidate, file);
    text = observation_ && observation_->read ? observation_->read(path) : std::nullopt;
    if (!text) text = read_text(path);
    if (!text) continue;
    const size_t slash = path.rfind('/');
    folder = slash == std::string::npos ? "." : path.substr(0, slash + 1);
    break;
  }
  if (!text) {
    const auto library = library_module(file);
    if (library) {
      text = std::string(*library);
      path = file;
    }
  }
  const dsl::Name& bound = import.alias ? *import.alias : import.path.back();
  if (!text) {
    report(Code::E0203, import.span, "expected a module in the file '" + file + "', found none",
           {{Span{}, "looked in the importing file's folder, the folders of -I and the library"}});
    add_item(importer, bound, {.kind = ModuleItem::Kind::Import, .span = bound.span, .value = Error{}});
    return;
  }

  ModuleInfo* module = nullptr;
  std::error_code error;
  const std::string identity =
      folder.empty() ? "library:" + path : std::filesystem::weakly_canonical(path, error).string();
  for (ModuleInfo& other : modules_) {
    const bool same = other.path == identity ||
                      (!folder.empty() && other.is_root && std::filesystem::equivalent(other.path, path, error));
    if (same) module = &other;
  }
  if (module && module->loading) {
    report(Code::E0204, import.span, "expected imports without a cycle, found that '" + file + "' imports itself");
    add_item(importer, bound, {.kind = ModuleItem::Kind::Import, .span = bound.span, .value = Error{}});
    return;
  }
  if (!module) {
    const dsl::FileId added = sources_.add(path, *std::move(text));
    if (folder.empty()) library_files_.insert(added.index);
    module = load_module(added, identity, folder);
  }
  add_item(importer, bound, {.kind = ModuleItem::Kind::Import, .span = bound.span, .value = ModuleValue{module}});
}

namespace {

// Whether a value was emitted although all that it is of is constant: it is not finite.
bool is_of_constants(const ir::Graph& graph, ir::ValueId v) {
  const std::vector<bool> live = ir::live_ops(graph, {&v, 1});
  for (uint32_t k = 0; k < graph.op_count(); ++k) {
    const ir::Op& op = graph.op(ir::OpId{k});
    if (live[k] && op.operands.empty() && op.kind != ir::OpKind::Const) return false;
  }
  return true;
}

// The folder of a module's file, for library modules inside the library.
std::string folder_of(const ModuleInfo& module) {
  if (module.folder.empty()) return module.path.substr(0, module.path.rfind('/') + 1);
  std::error_code error;
  return std::filesystem::weakly_canonical(module.folder, error).string() + "/";
}

// What to write where the name is also that of an import: the module takes another. Nothing where it is not.
std::string import_as(const dsl::Module& module, const std::string& name) {
  for (const dsl::ImportDecl& import : module.imports) {
    if (import.path.empty() || (import.alias ? import.alias->text : import.path.back().text) != name) continue;
    std::string path;
    for (const dsl::Name& part : import.path) path += (path.empty() ? "" : ".") + part.text;
    const bool is_picture = path == "std.image";
    return "give the module another name: 'import " + path + " as " + (is_picture ? "pictures" : name + "_module") +
           ";'";
  }
  return {};
}

}  // namespace

// ---- items ----

void Elaborator::add_item(ModuleInfo& module, const dsl::Name& name, ModuleItem item) {
  const auto [found, added] = module.items.emplace(name.text, std::move(item));
  if (added) return;
  report(Code::E0202, name.span, "expected each name once in a file, found '" + name.text + "' again",
         {{found->second.span, "the first '" + name.text + "' is here"}}, import_as(*module.syntax, name.text));
}

void Elaborator::collect_items(ModuleInfo& module) {
  // What only an instance has waits for one.
  for (const dsl::Param& param : module.syntax->params) {
    add_item(module, param.name,
             {.kind = ModuleItem::Kind::Parameter, .state = ModuleItem::State::Waiting, .span = param.name.span});
  }
  for (const dsl::Item& item : module.syntax->items) {
    switch (item.kind) {
      case dsl::Item::Kind::Const:
        add_item(module, item.constant->name,
                 {.kind = ModuleItem::Kind::Const,
                  .state = ModuleItem::State::Waiting,
                  .span = item.constant->name.span,
                  .constant = item.constant.get(),
                  .is_private = item.is_private});
        break;
      case dsl::Item::Kind::Fn:
        add_item(module, item.fn->name,
                 {.kind = ModuleItem::Kind::Fn,
                  .span = item.fn->name.span,
                  .value = FunctionValue{.decl = item.fn.get(), .scope = &module.scope, .self = {}},
                  .is_private = item.is_private});
        break;
      case dsl::Item::Kind::Struct: {
        StructType& type = module.structs.emplace_back();
        type.name = item.structure->name.text;
        type.decl = item.structure.get();
        type.module = &module;
        for (const dsl::Param& field : item.structure->fields) {
          if (std::ranges::find(type.fields, field.name.text) != type.fields.end()) {
            report(Code::E0202, field.name.span,
                   "expected each field once in a struct, found '" + field.name.text + "' again");
          }
          type.fields.push_back(field.name.text);
        }
        TypeValue value;
        value.kind = TypeValue::Kind::Struct;
        value.structure = &type;
        add_item(module, item.structure->name,
                 {.kind = ModuleItem::Kind::Struct,
                  .span = item.structure->name.span,
                  .value = value,
                  .is_private = item.is_private});
        break;
      }
      case dsl::Item::Kind::Optimizer:
        add_item(module, item.optimizer->name,
                 {.kind = ModuleItem::Kind::Optimizer,
                  .span = item.optimizer->name.span,
                  .value = OptimizerValue{item.optimizer.get(), &module.scope, false},
                  .is_private = item.is_private});
        break;
      case dsl::Item::Kind::Leaf:
        add_item(module, item.leaf->name, {.kind = ModuleItem::Kind::Leaf, .span = item.leaf->name.span});
        break;
      case dsl::Item::Kind::Statement:
        for (const dsl::Name& name : item.statement->pattern.names) {
          if (name.text == "_") continue;
          add_item(module, name,
                   {.kind = ModuleItem::Kind::Let, .state = ModuleItem::State::Waiting, .span = name.span});
        }
        break;
      case dsl::Item::Kind::Step: break;
    }
  }
}

// The value of a top-level name; constants are computed at their first use.
Value Elaborator::item_value(ModuleInfo& module, std::string_view name, ModuleItem& item, const Span& use) {
  const bool waits = item.kind == ModuleItem::Kind::Let || item.kind == ModuleItem::Kind::Parameter;
  if (!module.runs() && (waits || item.kind == ModuleItem::Kind::Leaf)) {
    return fail(Code::E0207, use,
                "expected an instance of the module '" + module.name() + "' before the use of '" + std::string(name) +
                    "', found the module",
                {{item.span, "'" + std::string(name) + "' is declared here"}},
                "write 'let name = " + module.name() + "(...);' at the top level and 'name." + std::string(name) + "'");
  }
  if (waits && item.state != ModuleItem::State::Done) {
    const std::string quoted = "'" + std::string(name) + "'";
    const dsl::Note declared = {item.span, quoted + " is declared here"};
    if (in_initial_)
      return fail(
          Code::E0206, use,
          "expected constants, inputs and functions in an initial value, found " + quoted + ", which is a 'let'",
          {declared},
          "an initial value is made before all lets: write what " + quoted +
              " stands for, or a function that makes it");
    return fail(Code::E0206, use, "expected the use of " + quoted + " after its 'let', found it before", {declared});
  }
  if (item.kind != ModuleItem::Kind::Const || item.state == ModuleItem::State::Done) return item.value;
  if (item.state == ModuleItem::State::Busy) {
    return fail(Code::E0506, use,
                "expected constants without a cycle, found that '" + std::string(name) + "' needs itself",
                {{item.span, "'" + std::string(name) + "' is declared here"}});
  }
  item.state = ModuleItem::State::Busy;
  const dsl::ConstDecl& decl = *item.constant;
  Value value;
  {
    const Switched<Scope*> scope(scope_, &module.scope);
    value = evaluate(*decl.value);
    if (!value.is_error() && decl.type) {
      const auto fitted = declared(value, *decl.type, decl.name.text, decl.value->span);
      value = fitted ? *fitted : Value(Error{});
    }
    std::optional<ir::ValueId> unknown;
    for_each_leaf(value, [&](const Value& leaf) {
      if (const auto* image = leaf.get<Image>(); image && !unknown) unknown = image->id;
    });
    if (unknown) {
      value = fail(Code::E0501, decl.value->span,
                   "expected a value known at compile time for the const '" + decl.name.text + "', found " +
                       (is_of_constants(b_.graph(), *unknown) ? "NaN or Inf, which only a run may make"
                                                              : "one that is computed at run time"));
    }
  }
  item.value = value;
  item.state = ModuleItem::State::Done;
  observe(item.span, value, item.span);
  return value;
}

// ---- names ----

Scope* Elaborator::new_scope(Scope* parent) {
  Scope& scope = scopes_.emplace_back();
  scope.parent = parent;
  scope.module = parent->module;
  return &scope;
}

void Elaborator::define(Scope& scope, const dsl::Name& name, Value value, Binding::Kind kind) {
  if (name.text == "_") return;
  observe(name.span, value, name.span);
  // The top level's names were collected before: here they get their values.
  if (scope.parent == nullptr) {
    const auto found = scope.module->items.find(name.text);
    if (found != scope.module->items.end() && found->second.kind == ModuleItem::Kind::Let &&
        found->second.span == name.span) {
      found->second.value = std::move(value);
      found->second.state = ModuleItem::State::Done;
    }
    return;
  }
  if (const Binding* other = scope.find(name.text)) {
    report(Code::E0202, name.span, "expected each name once in a block, found '" + name.text + "' again",
           {{other->span, "the first '" + name.text + "' is here"}});
    return;
  }
  Binding binding;
  binding.value = std::move(value);
  binding.span = name.span;
  binding.kind = kind;
  binding.frame = frames_.size();
  binding.region = regions_.size();
  scope.names.emplace_back(name.text, std::move(binding));
}

// A name from outside with a value of its own inside, as a branch or a loop has variables: declared where it was.
void Elaborator::define_inner(Scope& scope, std::string_view name, Value value, const Span& declared,
                              Binding::Kind kind) {
  Binding binding;
  binding.value = std::move(value);
  binding.span = declared;
  binding.kind = kind;
  binding.frame = frames_.size();
  binding.region = regions_.size();
  scope.names.emplace_back(name, std::move(binding));
}

const Binding* Elaborator::find_binding(std::string_view name) const {
  for (Scope* scope = scope_; scope; scope = scope->parent) {
    if (const Binding* binding = scope->find(name)) return binding;
  }
  return nullptr;
}

// The leaf that a name stands for here, if it does.
std::optional<uint32_t> Elaborator::find_leaf(std::string_view name) const {
  if (const Binding* binding = find_binding(name)) return binding->leaf;
  const auto found = scope_->module->items.find(name);
  if (found == scope_->module->items.end()) return std::nullopt;
  return found->second.leaf;
}

// Of an instance's too: `studio.light`.
std::optional<uint32_t> Elaborator::find_leaf(const Expr& path) {
  if (path.kind == Expr::Kind::NameRef) return find_leaf(path.name);
  ModuleInfo* const module = path.kind == Expr::Kind::Field ? module_of(*path.a) : nullptr;
  if (!module) return std::nullopt;
  const auto found = module->items.find(path.name);
  const bool is_there = found != module->items.end();
  observe_field(ModuleValue{module}, path.name, path.span, is_there ? found->second.value : Value(Error{}));
  return is_there ? found->second.leaf : std::nullopt;
}

// The module that an expression of names stands for, if it does; says nothing.
ModuleInfo* Elaborator::module_of(const Expr& path) const {
  const ModuleItem* item = nullptr;
  if (path.kind == Expr::Kind::NameRef) {
    if (find_binding(path.name)) return nullptr;
    const auto found = scope_->module->items.find(path.name);
    if (found != scope_->module->items.end()) item = &found->second;
  } else if (path.kind == Expr::Kind::Field) {
    const ModuleInfo* outer = module_of(*path.a);
    const auto found = outer ? outer->items.find(path.name) : ModuleItems::const_iterator{};
    if (outer && found != outer->items.end()) item = &found->second;
  }
  const auto* module = item ? item->value.get<ModuleValue>() : nullptr;
  return module ? module->module : nullptr;
}

Value Elaborator::name_value(const std::string& name, const Span& span) {
  Span declared;
  Value value = found_name(name, span, declared);
  observe(span, value, declared);
  return value;
}

Value Elaborator::found_name(const std::string& name, const Span& span, Span& declared) {
  if (const Binding* binding = find_binding(name)) {
    declared = binding->span;
    return binding->value;
  }
  ModuleInfo& module = *scope_->module;
  if (const auto found = module.items.find(name); found != module.items.end()) {
    declared = found->second.span;
    return item_value(module, name, found->second, span);
  }
  if (name == "seed") return seed_value(span);
  if (name == "step_index") {
    ValueId count;  // one number, which passes read as they read a leaf: never in a branch or a loop
    b_.at_root([&] { count = ops::emit(b_, OpKind::StepIndex, {}); });
    if (!step_ && let_.valid()) counts_.push_back({b_.value(count).op, let_, running_->prefix});
    return Image{count};
  }
  if (const Builtin* builtin = find_builtin(name)) return BuiltinValue{builtin, {}};
  if (const auto type = Type::parse(name)) {
    TypeValue value;
    value.kind = TypeValue::Kind::Element;
    value.element = *type;
    return value;
  }
  return fail(Code::E0201, span, "expected a name that is declared, found '" + name + "'", {}, help_for(name, span));
}

// `seed` is an input, 0 unless the host says otherwise, which is there once something reads it. A leaf of the program
// of that name and type takes its place.
Value Elaborator::seed_value(const Span& span) {
  if (!seed_.is<Nothing>()) return seed_;
  const auto own = root_->items.find("seed");
  if (own != root_->items.end() && own->second.kind == ModuleItem::Kind::Leaf) {
    const Value& value = own->second.value;
    if (value.is_error()) return Error{};
    if (element_type(value) != ir::kUint || !extent_of(value).is_unit()) {
      return fail(Code::E0210, own->second.span, "expected the leaf 'seed' to be one uint, found " + describe(value),
                  {{span, "this module's 'seed' is the built-in one"}}, "give the leaf another name");
    }
    return seed_ = value;
  }
  b_.at_root([&] {
    b_.graph().leaves.push_back({ir::Leaf::Kind::Input, "seed", ir::kUint, {}, {0.0}, span});
    ir::Attrs attrs;
    attrs.text = "seed";
    const ValueId id = ops::emit(b_, OpKind::Leaf, {}, std::move(attrs));
    b_.set_name(id, "seed");
    seed_ = Image{id};
  });
  return seed_;
}

bool Elaborator::is_inside(const ModuleInfo& module) const {
  return folder_of(*scope_->module).starts_with(folder_of(module));
}

Value Elaborator::module_field(ModuleInfo& module, const std::string& name, const Span& span) {
  const bool inside = is_inside(module);
  const auto found = module.items.find(name);
  if (found == module.items.end() || found->second.kind == ModuleItem::Kind::Import) {
    return fail(Code::E0205, span, "expected a name of the module '" + module.name() + "', found '" + name + "'", {},
                help_for(module, name, span));
  }
  if (found->second.is_private && !inside) {
    return fail(Code::E0211, span,
                "expected a name that the module '" + module.name() + "' offers to all, found '" + name +
                    "', which is private to its folder",
                {{found->second.span, "'" + name + "' is declared here"}});
  }
  // After `minimize`, in the projection of the same param, the name means the new value.
  if (projected_.first == &found->second && frames_.empty()) return projected_.second;
  return item_value(module, name, found->second, span);
}

}  // namespace dr::lower
