// SPDX-License-Identifier: Apache-2.0
#include "runtime/data/warnings.h"

namespace dr::runtime {

void Warnings::look(const std::string& what, const io::Scalars& read) {
  if (!wanted() || told_.contains(what)) return;
  if (const auto place = io::first_not_finite(read)) once(what, what + " has " + io::describe(*place));
}

void Warnings::look(const std::string& what, const io::Array& read) { look(what, io::scalars_of(read)); }

void Warnings::once(const std::string& of, const std::string& message) {
  if (!wanted() || !told_.insert(of).second) return;
  try {
    warn_(message);
  } catch (...) {  // somebody else's: it must not look like a failure of the program
  }
}

}  // namespace dr::runtime
