// SPDX-License-Identifier: Apache-2.0
#include "compiler/language_server/declarations.h"

#include <algorithm>
#include <optional>

namespace dr::language_server {
namespace {

using dsl::Block;
using dsl::Expr;
using dsl::Span;
using Kind = Declaration::Kind;

class Collector {
 public:
  Collector(const dsl::Module& module, const dsl::SourceManager& sources)
      : module_(module), text_(sources.text(module.file)) {}

  std::vector<Declaration> run() {
    for (const dsl::Param& param : module_.params) {
      add(Kind::Parameter, param.name, with_type(param)).type = param.type.get();
      walk(param.default_value.get());
    }
    for (const dsl::Item& item : module_.items) add_item(item);
    return std::move(found_);
  }

 private:
  std::string slice(uint32_t begin, uint32_t end) const {
    if (begin >= end || end > text_.size()) return "";
    std::string_view part = text_.substr(begin, end - begin);
    while (!part.empty() && std::string_view(" \t\r\n").find(part.back()) != std::string_view::npos)
      part.remove_suffix(1);
    return std::string(part);
  }
  // Of a tree with holes, a part may have no place.
  std::string slice(const Span& span) const { return span.valid() ? slice(span.begin, span.end) : ""; }

  std::string with_type(const dsl::Param& param) const {
    return param.name.text + (param.type ? ": " + slice(param.type->span) : "");
  }

  Declaration& add(Kind kind, const dsl::Name& name, std::string signature, const std::string& doc = "") {
    Declaration& declaration = found_.emplace_back();
    declaration.kind = kind;
    declaration.name = name.text;
    declaration.span = name.span;
    declaration.signature = std::move(signature);
    declaration.doc = doc;
    return declaration;
  }

  void add_local(Kind kind, std::string_view word, const dsl::Name& name, const dsl::TypeExpr* type, uint32_t from,
                 uint32_t to, const std::string& doc = "") {
    if (name.text.empty() || name.text == "_") return;
    std::string signature = (word.empty() ? "" : std::string(word) + " ") + name.text;
    if (type) signature += ": " + slice(type->span);
    Declaration& declaration = add(kind, name, std::move(signature), doc);
    declaration.is_local = true;
    declaration.from = from;
    declaration.to = to;
    declaration.type = type;
  }

  void add_item(const dsl::Item& item) {
    const size_t first = found_.size();
    switch (item.kind) {
      case dsl::Item::Kind::Const: {
        const dsl::ConstDecl& decl = *item.constant;
        add(Kind::Const, decl.name, slice(decl.span), decl.doc).type = decl.type.get();
        walk(decl.value.get());
        break;
      }
      case dsl::Item::Kind::Fn: add_fn(Kind::Fn, *item.fn); break;
      case dsl::Item::Kind::Struct: add_struct(*item.structure); break;
      case dsl::Item::Kind::Optimizer: add_optimizer(*item.optimizer); break;
      case dsl::Item::Kind::Leaf: {
        const dsl::LeafDecl& decl = *item.leaf;
        add(Kind::Leaf, decl.name, slice(decl.span), decl.doc).type = decl.type.get();
        break;
      }
      case dsl::Item::Kind::Statement: {
        const dsl::Stmt& let = *item.statement;
        for (const dsl::Name& name : let.pattern.names) {
          if (name.text == "_") continue;
          std::string signature = "let " + name.text;
          if (let.type && !let.pattern.is_tuple) signature += ": " + slice(let.type->span);
          Declaration& declaration = add(Kind::Let, name, std::move(signature), let.doc);
          declaration.type = let.pattern.is_tuple ? nullptr : let.type.get();
        }
        walk(let.a.get());
        break;
      }
      case dsl::Item::Kind::Step: {
        Declaration& step = add(Kind::Step, item.step->name, "step " + item.step->name.text, item.step->doc);
        step.from = step.to;
        walk(item.step->body);
        break;
      }
    }
    if (first < found_.size()) found_[first].is_private = item.is_private;
  }

  void add_fn(Kind kind, const dsl::FnDecl& fn) {
    const uint32_t end = fn.body.span.valid() ? fn.body.span.begin : fn.span.end;
    Declaration& declaration = add(kind, fn.name, slice(fn.span.begin, end), fn.doc);
    declaration.params = &fn.params;
    if (kind == Kind::Method) declaration.from = declaration.to;
    add_inside(fn);
  }

  // The names of a function and those in its body.
  void add_inside(const dsl::FnDecl& fn) {
    for (const dsl::Name& name : fn.generics) add_local(Kind::Generic, "", name, nullptr, fn.span.begin, fn.span.end);
    for (const dsl::Param& param : fn.params) {
      add_local(Kind::Parameter, param.is_const ? "const" : "", param.name, param.type.get(), fn.span.begin,
                fn.span.end);
      walk(param.default_value.get());
    }
    walk(fn.body);
  }

  void add_struct(const dsl::StructDecl& decl) {
    std::string signature = "struct " + decl.name.text + " {";
    for (const dsl::Param& field : decl.fields)
      signature += "\n  " + field.name.text + ": " + (field.type ? slice(field.type->span) : "?") + ";";
    Declaration& structure = add(Kind::Struct, decl.name, signature + (decl.fields.empty() ? "}" : "\n}"), decl.doc);
    structure.structure = &decl;
    structure.params = &decl.fields;
    for (const dsl::Param& field : decl.fields) {
      Declaration& declaration = add(Kind::Field, field.name,
                                     field.name.text + ": " + (field.type ? slice(field.type->span) : "?"), field.doc);
      declaration.from = declaration.to;
      declaration.type = field.type.get();
    }
    for (const dsl::FnDecl& method : decl.methods) add_fn(Kind::Method, method);
  }

  void add_optimizer(const dsl::OptimizerDecl& decl) {
    const uint32_t end = static_cast<uint32_t>(std::min(text_.find('{', decl.name.span.end), text_.size()));
    const std::string signature = "optimizer " + slice(decl.name.span.begin, end);
    add(Kind::Optimizer, decl.name, signature, decl.doc).params = &decl.params;
    const uint32_t begin = decl.name.span.end;
    const uint32_t last = decl.span.valid() ? decl.span.end : static_cast<uint32_t>(text_.size());
    for (const dsl::Param& param : decl.params)
      add_local(Kind::Parameter, "", param.name, param.type.get(), begin, last);
    for (const dsl::LeafDecl& state : decl.states)
      add_local(Kind::Leaf, "state", state.name, state.type.get(), begin, last, state.doc);
    add_inside(decl.update);
  }

  void walk(const Block& block) {
    for (const dsl::StmtPtr& stmt : block.statements) walk(*stmt, block.span.end);
    walk(block.value.get());
  }

  void walk(const dsl::Stmt& stmt, uint32_t block_end) {
    const bool is_var = stmt.kind == dsl::Stmt::Kind::Var;
    for (const dsl::Name& name : stmt.pattern.names) {
      add_local(is_var ? Kind::Var : Kind::Let, is_var ? "var" : "let", name,
                stmt.pattern.is_tuple ? nullptr : stmt.type.get(), stmt.span.end, block_end, stmt.doc);
    }
    if (stmt.kind == dsl::Stmt::Kind::For)
      add_local(Kind::Loop, "for", stmt.loop_var, nullptr, stmt.body.span.begin, stmt.body.span.end);
    walk(stmt.a.get());
    walk(stmt.b.get());
    walk(stmt.c.get());
    walk(stmt.body);
    if (stmt.else_body) walk(*stmt.else_body);
    for (const dsl::OutputItem& item : stmt.outputs) walk(item.value.get());
  }

  // Trees are not deep: dsl::kMaxHeight.
  void walk(const Expr* expr) {
    if (!expr) return;
    for (const Expr* part : {expr->a.get(), expr->b.get(), expr->c.get()}) walk(part);
    for (const dsl::Arg& arg : expr->args) walk(arg.value.get());
    for (const dsl::ExprPtr& item : expr->items) walk(item.get());
    if (!expr->inner) return;
    const Expr::Inner& inner = *expr->inner;
    const Span& body = inner.then_block.span;
    if (expr->kind == Expr::Kind::Reduce || expr->kind == Expr::Kind::Fold)
      add_local(Kind::Loop, expr->kind == Expr::Kind::Fold ? std::string_view(expr->name) : "reduce", inner.loop_var,
                nullptr, body.begin, body.end);
    if (expr->kind == Expr::Kind::Fold) {
      for (const dsl::Arg& arg : expr->args)
        if (arg.name) add_local(Kind::Loop, expr->name, *arg.name, nullptr, body.begin, body.end);
    }
    walk(inner.then_block);
    if (inner.else_block) walk(*inner.else_block);
    if (expr->kind == Expr::Kind::Lambda) add_inside(inner.fn);
    for (const dsl::FnDecl& fn : inner.raster_fns) add_inside(fn);
  }

  const dsl::Module& module_;
  std::string_view text_;
  std::vector<Declaration> found_;
};

}  // namespace

std::vector<Declaration> declarations(const dsl::Module& module, const dsl::SourceManager& sources) {
  return Collector(module, sources).run();
}

const Declaration* find_visible(const std::vector<Declaration>& all, std::string_view name, uint32_t offset) {
  const Declaration* found = nullptr;
  for (const Declaration& one : all) {
    if (one.name != name || offset < one.from || offset >= one.to) continue;
    if (!found || !found->is_local || (one.is_local && one.from >= found->from)) found = &one;
  }
  return found;
}

const Declaration* find_declared(const std::vector<Declaration>& all, const dsl::Span& name) {
  for (const Declaration& one : all)
    if (one.span == name) return &one;
  return nullptr;
}

}  // namespace dr::language_server
