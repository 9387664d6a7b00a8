// SPDX-License-Identifier: Apache-2.0
// What to write instead of a name that is not known: one like it, the module that has it, the import that is missing.
#include <algorithm>

#include "compiler/lower/elaborator.h"
#include "compiler/lower/lower.h"
#include "dsl/diagnostic/foreign_words.h"

namespace dr::lower {

namespace {

// The library's modules by the names that their imports give them.
std::vector<std::string> library_names() {
  std::vector<std::string> names;
  for (const std::string_view path : library_modules()) {
    const std::string_view file = path.substr(path.rfind('/') + 1);
    names.emplace_back(file.substr(0, file.rfind('.')));
  }
  return names;
}

// The first module of the library that offers a function or an optimizer of this name.
std::string library_with(const std::string& name) {
  for (const std::string_view path : library_modules()) {
    const std::string text = "\n" + std::string(library_module(path).value_or(""));
    for (const char* kind : {"\nfn ", "\noptimizer "})
      for (const char* after : {"(", "<"}) {
        if (text.find(kind + name + after) == std::string::npos) continue;
        const std::string_view file = path.substr(path.rfind('/') + 1);
        return std::string(file.substr(0, file.rfind('.')));
      }
  }
  return "";
}

bool is_offered(const ModuleItem& item) { return item.kind != ModuleItem::Kind::Import && !item.is_private; }
bool is_optimizer(const ModuleItem& item) { return item.kind == ModuleItem::Kind::Optimizer && !item.is_private; }

// Names that begin as this one does: `rotate` and `rotation_matrix` for `rotation`.
std::vector<std::string> alike(const std::string& name, std::vector<std::string> names) {
  constexpr size_t kSame = 4, kMost = 8;
  std::erase_if(names, [&](const std::string& other) {
    const size_t same = std::min({name.size(), other.size(), kSame});
    return same < 3 || name.compare(0, same, other, 0, same) != 0;
  });
  std::ranges::sort(names);
  if (names.size() > kMost) names.resize(kMost);
  return names;
}

// The modules that a file imports, with the names that it gives them.
std::vector<std::pair<std::string, const ModuleInfo*>> imports_of(const ModuleInfo& module) {
  std::vector<std::pair<std::string, const ModuleInfo*>> imports;
  for (const auto& [name, item] : module.items)
    if (const auto* value = item.value.get<ModuleValue>(); value && item.kind == ModuleItem::Kind::Import)
      imports.emplace_back(name, value->module);
  return imports;
}

}  // namespace

std::vector<std::string> Elaborator::visible_names() const {
  std::vector<std::string> names;
  for (const Scope* scope = scope_; scope; scope = scope->parent) {
    for (const auto& [name, binding] : scope->names) names.push_back(name);
  }
  const std::vector<std::string> items = names_of(scope_->module->items, [](const ModuleItem&) { return true; });
  names.insert(names.end(), items.begin(), items.end());
  std::vector<std::string> builtins = builtin_names();
  names.insert(names.end(), builtins.begin(), builtins.end());
  names.insert(names.end(), {"step_index", "seed"});
  const std::vector<std::string> types = type_names();
  names.insert(names.end(), types.begin(), types.end());
  return names;
}

std::string Elaborator::optimizers_here() const {
  std::vector<std::string> names = names_of(scope_->module->items, is_optimizer);
  for (const auto& [name, module] : imports_of(*scope_->module))
    for (const std::string& optimizer : names_of(module->items, is_optimizer)) names.push_back(name + "." + optimizer);
  std::ranges::sort(names);
  if (names.empty()) return "write 'import std.optim;' and, say, 'with optim.adam(rate = 0.01)'";
  return "there " + std::string(names.size() == 1 ? "is " : "are ") + listed(names);
}

std::string Elaborator::help_for(const std::string& name, const Span& span) const {
  const char* const foreign = dsl::instead_of_name(name);
  if (span == before_dot_) {
    const std::vector<std::string> modules = library_names();
    if (std::ranges::find(modules, name) != modules.end()) return "write 'import std." + name + ";' above";
    if (foreign) return foreign;
    if (const std::string near = suggestion(name, visible_names()); !near.empty()) return near;
    const auto nearest = dsl::nearest_name(name, modules);
    return nearest ? "did you mean '" + *nearest + "', which 'import std." + *nearest + ";' brings?" : "";
  }
  for (const auto& [import, module] : imports_of(*scope_->module)) {
    const auto found = module->items.find(name);
    if (found != module->items.end() && is_offered(found->second)) return "write '" + import + "." + name + "'";
  }
  if (foreign) return foreign;
  const std::string near = suggestion(name, visible_names());
  if (!near.empty()) return near;
  if (span == optimizer_at_) return optimizers_here();
  const std::string module = library_with(name);
  return module.empty() ? "" : "write 'import std." + module + ";' above, and '" + module + "." + name + "'";
}

std::string Elaborator::help_for(const ModuleInfo& module, const std::string& name, const Span& span) const {
  const bool inside = is_inside(module);
  const std::vector<std::string> names = names_of(module.items, [&](const ModuleItem& item) {
    return inside ? item.kind != ModuleItem::Kind::Import : is_offered(item);
  });
  const std::string near = suggestion(name, names);
  if (!near.empty()) return near;
  if (span == optimizer_at_) return optimizers_here();
  const std::vector<std::string> like = alike(name, names);
  return like.empty() ? "" : "there " + std::string(like.size() == 1 ? "is " : "are ") + listed(like);
}

}  // namespace dr::lower
