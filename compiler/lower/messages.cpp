// SPDX-License-Identifier: Apache-2.0
// Messages of lowering, with their chain of calls.
#include "compiler/lower/elaborator.h"

namespace dr::lower {

// A mistake that shows itself inside of the library is its caller's: the message stands at the first call in a file
// that is not the library's, and notes lead from there to the place itself, and on to how that call was reached.
void Elaborator::report(Code code, const Span& span, std::string message, std::vector<dsl::Note> notes,
                        std::string help) {
  ++mistakes_;
  std::vector<const Frame*> calls;  // from the inside out
  for (auto frame = frames_.rbegin(); frame != frames_.rend(); ++frame)
    if (frame->call.valid() && !frame->name.empty()) calls.push_back(&*frame);
  size_t own = 0;  // calls that the library makes, and the one that calls it
  if (is_of_library(span))
    for (size_t k = 0; k < calls.size() && own == 0; ++k)
      if (!is_of_library(calls[k]->call)) own = k + 1;
  const Span& place = own == 0 ? span : calls[own - 1]->call;
  if (!reported_.emplace(place.file.index, place.begin, place.end, code).second) return;
  dsl::Diagnostic& diagnostic = diagnostics_.error(code, place, std::move(message));
  diagnostic.notes = std::move(notes);
  size_t told = 0;
  for (size_t k = own; k-- > 0 && told < kMaxCallNotes; ++told)
    diagnostic.notes.push_back({k == 0 ? span : calls[k - 1]->call, "in '" + calls[k]->name + "', here"});
  for (size_t k = own; k < calls.size() && told < kMaxCallNotes; ++k, ++told)
    diagnostic.notes.push_back({calls[k]->call, "in the call of '" + calls[k]->name + "' here"});
  for (auto instance = instances_.rbegin(); instance != instances_.rend() && told++ < kMaxCallNotes; ++instance)
    diagnostic.notes.push_back({instance->second, "in the instance of '" + instance->first + "' here"});
  diagnostic.help = std::move(help);
}

Error Elaborator::fail(Code code, const Span& span, std::string message, std::vector<dsl::Note> notes,
                       std::string help) {
  report(code, span, std::move(message), std::move(notes), std::move(help));
  return Error{};
}

std::string Elaborator::suggestion(std::string_view name, const std::vector<std::string>& known) {
  const auto nearest = dsl::nearest_name(name, known);
  return nearest ? "did you mean '" + *nearest + "'?" : "";
}

std::string Elaborator::one_of(const std::vector<std::string>& words) {
  std::string all;
  for (size_t i = 0; i < words.size(); ++i) all += (i == 0 ? "" : i + 1 == words.size() ? " or " : ", ") + words[i];
  return all;
}

std::string Elaborator::no_field(const StructType& type, const std::string& found) {
  constexpr size_t kMost = 12;  // that a message names
  const bool named = !type.fields.empty() && type.fields.size() <= kMost;
  return "expected a field of " + type.name + (named ? " (" + one_of(type.fields) + ")" : "") + ", found '" + found +
         "'";
}

}  // namespace dr::lower
