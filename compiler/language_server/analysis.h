// SPDX-License-Identifier: Apache-2.0
// One text, read and lowered as far as it goes: what the answers to an editor are made of.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "compiler/language_server/declarations.h"
#include "compiler/language_server/positions.h"
#include "compiler/language_server/roles.h"
#include "compiler/lower/program/observation.h"
#include "dsl/diagnostic/diagnostic.h"
#include "dsl/source/source.h"
#include "dsl/syntax/lexer.h"

namespace dr::language_server {

struct AnalysisOptions {
  std::vector<std::string> include_dirs;
  std::map<std::string, std::string, std::less<>> defines;
  // Texts that are open in the editor, by the whole path.
  std::function<std::optional<std::string>(const std::string& path)> read;
  std::function<bool()> stop;
  uint32_t members_at = UINT32_MAX;  // see lower::Observation
};

class Analysis {
 public:
  Analysis(std::string uri, std::string text, const AnalysisOptions& options);

  const std::string& uri() const { return uri_; }
  std::string_view text() const { return sources_.text(root_); }
  const Lines& lines() const { return *lines_; }
  dsl::FileId root() const { return root_; }
  const dsl::SourceManager& sources() const { return sources_; }
  const dsl::DiagnosticList& diagnostics() const { return diagnostics_; }
  // Of the diagnostics, those that are to be shown are the first.
  size_t shown_diagnostics() const { return shown_; }
  const lower::Observation& observation() const { return observation_; }
  bool is_whole() const { return !observation_.stopped; }
  const std::string& internal_error() const { return internal_error_; }
  // Whether a file of this whole path was looked for, and so would be read.
  bool looked_for(const std::string& path) const { return looked_for_.contains(path); }

  const std::vector<dsl::Token>& tokens() const { return tokens_; }
  std::string_view text(const dsl::Token& token) const { return text().substr(token.begin, token.end - token.begin); }
  // The token that an offset is in or, where there are two, the name or number that ends there. `tokens().size()`
  // where there is none.
  size_t token_at(uint32_t offset) const;

  // Null where the place of a name says nothing of what it is.
  const Role* role_of(size_t token) const;

  const std::vector<Declaration>& declared(size_t file) const { return declared_[file]; }
  // The place in `observation().files`; nothing for a file that is not there.
  std::optional<size_t> place_of(dsl::FileId file) const;

  // What the name at a token stands for: where it is declared. Behind dots, what the lowering found, or what the syntax
  // alone tells. Not valid if nobody knows.
  dsl::Span declaration_of(size_t token) const;
  const Declaration* find(const dsl::Span& name) const;
  // The struct that a declaration's type names, as it is written. Null if it names none.
  const Declaration* struct_of(const Declaration& declaration) const;
  // What stands before the dot before a token: the module's place in files, or a declaration.
  std::optional<size_t> module_before(size_t token) const;

 private:
  void lower_text(const AnalysisOptions& options);
  void tokenize();
  dsl::Span declared_as_argument(size_t token, const Role& role) const;

  std::string uri_;
  dsl::SourceManager sources_;
  dsl::FileId root_;
  dsl::DiagnosticList diagnostics_;
  size_t shown_ = 0;
  lower::Observation observation_;
  std::string internal_error_;
  std::vector<dsl::Token> tokens_;
  std::vector<std::vector<Declaration>> declared_;
  std::unique_ptr<Lines> lines_;
  std::map<size_t, Role> roles_;  // by the token
  std::set<std::string> looked_for_;
};

}  // namespace dr::language_server
