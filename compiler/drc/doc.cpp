// SPDX-License-Identifier: Apache-2.0
// `drc doc`: modules, or the op table, as Markdown; or names.
#include <algorithm>
#include <filesystem>

#include "compiler/drc/command.h"
#include "compiler/drc/input.h"
#include "compiler/drc/output.h"
#include "compiler/lower/lower.h"
#include "compiler/ops/document.h"
#include "dsl/document/document.h"
#include "dsl/syntax/parser.h"

namespace dr::drc {
namespace {

std::string functions() {
  std::vector<std::string> names = lower::builtin_names();
  names.insert(names.end(), {"at", "layer"});  // called as x.at(i)
  std::ranges::sort(names);
  std::string text;
  for (const std::string& name : names) text += name + "\n";
  return text;
}

}  // namespace

int doc(const DocOptions& options) {
  if (options.ops + options.functions + !options.files.empty() != 1) {
    print_error("expected a file, or --ops for the table of ops, or --functions");
    return kBadUsage;
  }
  std::string text = options.ops ? ops::document_ops() : "";
  if (options.functions) text = functions();
  for (const std::string& file : options.files) {
    const auto source = read_text(file);
    if (!source) return kUserError;
    dsl::SourceManager sources;
    dsl::DiagnosticList diagnostics;
    const dsl::Module module = dsl::parse(sources, sources.add(shown_name(file), *source), diagnostics);
    report(diagnostics, sources);
    if (diagnostics.has_errors()) return kUserError;
    if (!text.empty()) text += '\n';
    text += dsl::document(module, sources, file == "-" ? "stdin" : std::filesystem::path(file).stem().string());
  }
  return write_product(options.output, text) ? kOk : kUserError;
}

}  // namespace dr::drc
