// SPDX-License-Identifier: Apache-2.0
// Declarations are shown as they stand in the source, without bodies.
#include "dsl/document/document.h"

#include <algorithm>
#include <string_view>

namespace dr::dsl {
namespace {

class Documenter {
 public:
  Documenter(const Module& module, const SourceManager& sources) : module_(module), text_(sources.text(module.file)) {}

  std::string run(const std::string& name) {
    out_ = "# " + name + "\n";
    add_doc(module_.doc);
    for_each("Constants", Item::Kind::Const, [&](const Item& item) {
      add_entry("##", item.constant->name, slice(item.constant->span), item.constant->doc);
    });
    for_each("Leaves", Item::Kind::Leaf,
             [&](const Item& item) { add_entry("##", item.leaf->name, slice(item.leaf->span), item.leaf->doc); });
    for_each("Structs", Item::Kind::Struct, [&](const Item& item) { add_struct(*item.structure); });
    for_each("Functions", Item::Kind::Fn, [&](const Item& item) { add_fn("##", *item.fn); });
    for_each("Optimizers", Item::Kind::Optimizer, [&](const Item& item) {
      const OptimizerDecl& decl = *item.optimizer;
      add_entry("##", decl.name, before_brace(decl.span), decl.doc);
    });
    for_each("Steps", Item::Kind::Step, [&](const Item& item) { add_step(*item.step); });
    return out_;
  }

 private:
  template <class Add>
  void for_each(std::string_view title, Item::Kind kind, Add add) {
    bool first = true;
    for (const Item& item : module_.items) {
      // What `@vjp` declares is called by gradients alone.
      if (item.kind != kind || item.is_private || (item.fn && item.fn->vjp_of)) continue;
      if (first) out_ += "\n## " + std::string(title) + "\n";
      first = false;
      add(item);
    }
  }

  std::string_view slice(const Span& span) const { return text_.substr(span.begin, span.end - span.begin); }

  void add_doc(std::string_view doc) {
    if (!doc.empty()) out_ += '\n' + std::string(doc) + '\n';
  }

  void add_entry(std::string_view level, const Name& name, std::string_view code, std::string_view doc) {
    while (code.ends_with(' ') || code.ends_with('\n')) code.remove_suffix(1);
    out_ += '\n' + std::string(level) + "# " + name.text + "\n\n```\n" + std::string(code) + "\n```\n";
    add_doc(doc);
  }

  // Up to the body: the first `{` that stands in no brackets, as a parameter's default value would.
  std::string_view before_brace(const Span& span) const {
    const std::string_view text = slice(span);
    int depth = 0;
    for (size_t at = 0; at < text.size(); ++at) {
      if (text[at] == '(') ++depth;
      if (text[at] == ')') --depth;
      if (text[at] == '{' && depth == 0) return text.substr(0, at);
    }
    return text;
  }

  void add_fn(std::string_view level, const FnDecl& fn) {
    add_entry(level, fn.name, slice({fn.span.file, fn.span.begin, fn.body.span.begin}), fn.doc);
  }

  // A text as the `///` lines that it was.
  static std::string with_slashes(std::string_view doc, std::string_view indent) {
    std::string lines;
    while (!doc.empty()) {
      const std::string_view line = doc.substr(0, doc.find('\n'));
      doc.remove_prefix(std::min(line.size() + 1, doc.size()));
      lines += std::string(indent) + "///" + (line.empty() ? "" : " ") + std::string(line) + "\n";
    }
    return lines;
  }

  // The fields as written; methods follow on their own.
  void add_struct(const StructDecl& decl) {
    std::string code(slice(decl.span));
    if (!decl.methods.empty()) {
      code = std::string(before_brace(decl.span)) + "{\n";
      for (const Param& field : decl.fields) {
        code += with_slashes(field.doc, "  ") + "  " + field.name.text + ": " + std::string(slice(field.type->span));
        if (field.default_value) code += " = " + std::string(slice(field.default_value->span));
        code += ";\n";
      }
      code += '}';
    }
    add_entry("##", decl.name, code, decl.doc);
    for (const FnDecl& method : decl.methods) add_fn("###", method);
  }

  void add_step(const StepDecl& step) {
    add_entry("##", step.name, "step " + step.name.text, step.doc);
    std::string outputs;
    for (const StmtPtr& stmt : step.body.statements) {
      for (const OutputItem& item : stmt->outputs) outputs += (outputs.empty() ? "`" : ", `") + item.name.text + '`';
    }
    if (!outputs.empty()) out_ += "\nOutputs: " + outputs + ".\n";
  }

  const Module& module_;
  std::string_view text_;
  std::string out_;
};

}  // namespace

std::string document(const Module& module, const SourceManager& sources, const std::string& name) {
  return Documenter(module, sources).run(name);
}

}  // namespace dr::dsl
