// SPDX-License-Identifier: Apache-2.0
// The dump is made in two steps: the tree becomes nested lists of words, and the lists become text. Only
// the second step knows about lines.
#include "dsl/syntax/dump.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <string_view>
#include <utility>
#include <vector>

namespace dr::dsl {
namespace {

constexpr size_t kMaxWidth = 100;
constexpr size_t kMaxIndent = 40;  // deeper lists stay there, or a long chain would be mostly blanks

// A word, or a list whose `items` start with one.
struct List {
  std::string word;
  std::vector<List> items;
  size_t width = 0;     // in one line
  bool breaks = false;  // holds a block of several statements: each has a line of its own

  List(std::string text) : word(std::move(text)), width(word.size()) {}
  List(const char* text) : List(std::string(text)) {}
  // Moves its parts, where an initializer list would copy whole trees at each level.
  template <class First, class Second, class... Rest>
  List(First&& first, Second&& second, Rest&&... rest) : width(1) {
    items.reserve(2 + sizeof...(rest));
    add(List(std::forward<First>(first)));
    add(List(std::forward<Second>(second)));
    (add(List(std::forward<Rest>(rest))), ...);
  }
  // A list that has only its head so far.
  static List of(List head) {
    List list("");
    list.width = 1;
    list.add(std::move(head));
    return list;
  }
  void add(List item) {
    width += item.width + 1;
    breaks = breaks || item.breaks;
    items.push_back(std::move(item));
  }
  bool is_word() const { return items.empty(); }
};

void print_flat(std::string& out, const List& list) {
  if (list.is_word()) {
    out += list.word;
    return;
  }
  out += '(';
  for (size_t i = 0; i < list.items.size(); ++i) {
    if (i > 0) out += ' ';
    print_flat(out, list.items[i]);
  }
  out += ')';
}

void print(std::string& out, const List& list, size_t indent) {
  if (list.is_word() || (!list.breaks && indent + list.width <= kMaxWidth)) {
    print_flat(out, list);
    return;
  }
  out += '(';
  print(out, list.items.front(), indent + 1);
  // Words stay on the first line, up to the first list.
  size_t next = 1;
  for (; next < list.items.size() && list.items[next].is_word(); ++next) {
    out += ' ' + list.items[next].word;
  }
  const size_t inner = std::min(indent + 2, kMaxIndent);
  for (; next < list.items.size(); ++next) {
    out += '\n';
    out.append(inner, ' ');
    print(out, list.items[next], inner);
  }
  out += ')';
}

std::string quote(std::string_view text) {
  std::string out = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') out += '\\';
    if (c == '\n') {
      out += "\\n";
    } else if (c == '\t') {
      out += "\\t";
    } else {
      out += c;
    }
  }
  return out + '"';
}

std::string float_text(double value) {
  std::array<char, 40> digits{};
  const auto result = std::to_chars(digits.data(), digits.data() + digits.size(), value);
  std::string text(digits.data(), result.ptr);
  if (text.find_first_of(".e") == std::string::npos) text += ".0";
  return text;
}

std::string path_text(const std::vector<Name>& path) {
  std::string text;
  for (const Name& name : path) {
    if (!text.empty()) text += '.';
    text += name.text;
  }
  return text.empty() ? "<error>" : text;
}

List expr_list(const Expr& expr);
List type_list(const TypeExpr& type);
List fn_list(const FnDecl& fn, const char* head);

// Missing parts print as `_`.
List expr_list(const ExprPtr& expr) { return expr ? expr_list(*expr) : List("_"); }
List type_list(const TypePtr& type) { return type ? type_list(*type) : List("_"); }

List type_list(const TypeExpr& type) {
  switch (type.kind) {
    case TypeExpr::Kind::Function: return "fn";
    case TypeExpr::Kind::Tuple: {
      List list = List::of("tuple");
      for (const TypePtr& element : type.elements) list.add(type_list(element));
      return list;
    }
    case TypeExpr::Kind::Named: break;
  }
  if (type.type_args.empty() && !type.has_extents) return path_text(type.path);
  List list{"type", path_text(type.path)};
  if (!type.type_args.empty()) {
    List args = List::of("of");
    for (size_t i = 0; i < type.type_args.size(); ++i) {
      args.add(type.type_args[i] ? type_list(type.type_args[i]) : List{"value", expr_list(type.value_args[i])});
    }
    list.add(std::move(args));
  }
  if (type.has_extents) {
    List extents = List::of("extents");
    for (const ExprPtr& extent : type.extents) extents.add(expr_list(extent));
    list.add(std::move(extents));
  }
  return list;
}

List stmt_list(const Stmt& stmt);

List block_list(const Block& block) {
  List list = List::of("block");
  for (const StmtPtr& stmt : block.statements) list.add(stmt_list(*stmt));
  if (block.value) list.add({"value", expr_list(block.value)});
  if (list.items.size() > 2) list.breaks = true;
  return list;
}

void add_doc(List& list, const std::string& doc) {
  if (!doc.empty()) list.add({"doc", quote(doc)});
}

void add_args(List& list, const std::vector<Arg>& args) {
  for (const Arg& arg : args) {
    list.add(arg.name ? List{"named", arg.name->text, expr_list(arg.value)} : expr_list(arg.value));
  }
}

List expr_list(const Expr& expr) {
  switch (expr.kind) {
    case Expr::Kind::Int: return std::to_string(expr.int_value) + (expr.unsigned_suffix ? "u" : "");
    case Expr::Kind::Float: return float_text(expr.float_value);
    case Expr::Kind::Bool: return expr.bool_value ? "true" : "false";
    case Expr::Kind::String: return quote(expr.name);
    case Expr::Kind::NameRef: return expr.name;
    case Expr::Kind::StepCount: return {"step_index", expr_list(expr.a)};
    case Expr::Kind::Unary: return {std::string(expr.op), expr_list(expr.a)};
    case Expr::Kind::Binary: return {std::string(expr.op), expr_list(expr.a), expr_list(expr.b)};
    case Expr::Kind::Field: return {".", expr_list(expr.a), expr.name.empty() ? "_" : expr.name};
    case Expr::Kind::Index: return {"index", expr_list(expr.a), expr_list(expr.b)};
    case Expr::Kind::Call: {
      List list{"call", expr_list(expr.a)};
      add_args(list, expr.args);
      return list;
    }
    case Expr::Kind::Lambda: return fn_list(expr.inner->fn, "lambda");
    case Expr::Kind::If: {
      List list{expr.is_const ? "const-if" : "if", expr_list(expr.a), block_list(expr.inner->then_block)};
      if (expr.inner->else_block) list.add(block_list(*expr.inner->else_block));
      return list;
    }
    case Expr::Kind::Reduce: {
      List list{"reduce", expr.name, expr.inner->loop_var.text, expr_list(expr.a), expr_list(expr.b)};
      if (expr.c) list.add({"max", expr_list(expr.c)});
      list.add(block_list(expr.inner->then_block));
      return list;
    }
    case Expr::Kind::Fold: {
      List list{expr.name, expr.inner->loop_var.text, expr_list(expr.a), expr_list(expr.b)};
      add_args(list, expr.args);
      if (expr.c) list.add({"max", expr_list(expr.c)});
      list.add(block_list(expr.inner->then_block));
      return list;
    }
    case Expr::Kind::Tuple:
    case Expr::Kind::Array: {
      List list = List::of(expr.kind == Expr::Kind::Tuple ? "tuple" : "array");
      for (const ExprPtr& item : expr.items) list.add(expr_list(item));
      return list;
    }
    case Expr::Kind::Raster: {
      List args = List::of("args");
      add_args(args, expr.args);
      List list{"raster", std::move(args)};
      for (const FnDecl& fn : expr.inner->raster_fns) list.add(fn_list(fn, "fn"));
      return list;
    }
    case Expr::Kind::BlockExpr: return block_list(expr.inner->then_block);
    case Expr::Kind::Error: return "<error>";
  }
  return "<error>";
}

List pattern_list(const Pattern& pattern) {
  if (!pattern.is_tuple) return path_text(pattern.names);
  List list = List::of("tuple");
  for (const Name& name : pattern.names) list.add(name.text);
  return list;
}

List stmt_list(const Stmt& stmt) {
  switch (stmt.kind) {
    case Stmt::Kind::Let:
    case Stmt::Kind::Var: {
      List list{stmt.kind == Stmt::Kind::Let ? "let" : "var", pattern_list(stmt.pattern)};
      add_doc(list, stmt.doc);
      if (stmt.type) list.add({":", type_list(stmt.type)});
      list.add(expr_list(stmt.a));
      return list;
    }
    case Stmt::Kind::Assign: return {std::string(stmt.op) + "=", expr_list(stmt.target), expr_list(stmt.a)};
    case Stmt::Kind::Update: return {"<-", expr_list(stmt.target), expr_list(stmt.a)};
    case Stmt::Kind::Expr: return {"expr", expr_list(stmt.a)};
    case Stmt::Kind::For: {
      List list{"for", stmt.loop_var.text, expr_list(stmt.a), expr_list(stmt.b)};
      if (stmt.c) list.add({"max", expr_list(stmt.c)});
      list.add(block_list(stmt.body));
      return list;
    }
    case Stmt::Kind::Break: {
      List list = List::of("break");
      if (stmt.a) list.add(expr_list(stmt.a));
      return list;
    }
    case Stmt::Kind::If:
    case Stmt::Kind::ConstIf: {
      List list{stmt.kind == Stmt::Kind::If ? "if" : "const-if", expr_list(stmt.a), block_list(stmt.body)};
      if (stmt.else_body) list.add(block_list(*stmt.else_body));
      return list;
    }
    case Stmt::Kind::Minimize: {
      List targets = List::of("over");
      for (const ExprPtr& target : stmt.targets) targets.add(expr_list(target));
      return {"minimize", expr_list(stmt.a), std::move(targets), List{"with", expr_list(stmt.b)}};
    }
    case Stmt::Kind::Output: {
      List list = List::of("output");
      for (const OutputItem& item : stmt.outputs) {
        list.add(item.value ? List{item.name.text, expr_list(item.value)} : List(item.name.text));
      }
      return list;
    }
    case Stmt::Kind::Return: return {"return", expr_list(stmt.a)};
  }
  return "<error>";
}

List param_list(const Param& param) {
  if (!param.type && !param.default_value && !param.is_const) return param.name.text;
  List list = List::of(param.name.text);
  if (param.is_const) list.add("const");
  if (param.type) list.add({":", type_list(param.type)});
  if (param.default_value) list.add({"=", expr_list(param.default_value)});
  return list;
}

List params_list(const std::vector<Param>& params) {
  List list = List::of("params");
  for (const Param& param : params) list.add(param_list(param));
  return list;
}

void add_generics(List& list, const std::vector<Name>& generics) {
  if (generics.empty()) return;
  List names = List::of("generics");
  for (const Name& name : generics) names.add(name.text);
  list.add(std::move(names));
}

List fn_list(const FnDecl& fn, const char* head) {
  List list = List::of(head);
  if (!fn.name.text.empty()) list.add(fn.name.text);
  if (fn.vjp_of) list.add({"vjp", fn.vjp_of->text});
  add_doc(list, fn.doc);
  add_generics(list, fn.generics);
  list.add(params_list(fn.params));
  if (fn.result) list.add({"->", type_list(fn.result)});
  list.add(block_list(fn.body));
  return list;
}

const char* leaf_word(LeafDecl::Kind kind) {
  switch (kind) {
    case LeafDecl::Kind::Param: return "param";
    case LeafDecl::Kind::Input: return "input";
    case LeafDecl::Kind::State: return "state";
  }
  return "<error>";
}

List leaf_list(const LeafDecl& leaf) {
  List list{leaf_word(leaf.kind), leaf.name.text};
  add_doc(list, leaf.doc);
  list.add({":", type_list(leaf.type)});
  if (leaf.initial) list.add({"=", expr_list(leaf.initial)});
  return list;
}

List struct_list(const StructDecl& decl) {
  List list{"struct", decl.name.text};
  add_doc(list, decl.doc);
  add_generics(list, decl.generics);
  List fields = List::of("fields");
  for (const Param& field : decl.fields) fields.add(param_list(field));
  list.add(std::move(fields));
  for (const FnDecl& method : decl.methods) list.add(fn_list(method, "fn"));
  return list;
}

List optimizer_list(const OptimizerDecl& decl) {
  List list{"optimizer", decl.name.text};
  add_doc(list, decl.doc);
  list.add(params_list(decl.params));
  for (const LeafDecl& state : decl.states) list.add(leaf_list(state));
  list.add(fn_list(decl.update, "fn"));
  return list;
}

List item_list(const Item& item) {
  switch (item.kind) {
    case Item::Kind::Const: {
      List list{"const", item.constant->name.text};
      add_doc(list, item.constant->doc);
      if (item.constant->type) list.add({":", type_list(item.constant->type)});
      list.add(expr_list(item.constant->value));
      return list;
    }
    case Item::Kind::Fn: return fn_list(*item.fn, "fn");
    case Item::Kind::Struct: return struct_list(*item.structure);
    case Item::Kind::Optimizer: return optimizer_list(*item.optimizer);
    case Item::Kind::Leaf: return leaf_list(*item.leaf);
    case Item::Kind::Statement: return stmt_list(*item.statement);
    case Item::Kind::Step: {
      List list{"step", item.step->name.text};
      add_doc(list, item.step->doc);
      list.add(block_list(item.step->body));
      return list;
    }
  }
  return "<error>";
}

}  // namespace

std::string dump(const Module& module) {
  std::string out = "(edition " + std::to_string(module.edition) + ")\n";
  if (!module.doc.empty()) out += "(doc " + quote(module.doc) + ")\n";
  for (const ImportDecl& import : module.imports) {
    out += "(import " + path_text(import.path);
    if (import.alias) out += " as " + import.alias->text;
    out += ")\n";
  }
  if (module.params_span.valid()) {
    print(out, params_list(module.params), 0);
    out += '\n';
  }
  for (const Item& item : module.items) {
    print(out, item.is_private ? List{"private", item_list(item)} : item_list(item), 0);
    out += '\n';
  }
  return out;
}

std::string dump(const Expr& expr) {
  std::string out;
  print(out, expr_list(expr), 0);
  return out;
}

}  // namespace dr::dsl
