// SPDX-License-Identifier: Apache-2.0
#include "compiler/language_server/roles.h"

#include <optional>

namespace dr::language_server {
namespace {

using dsl::TokenKind;

constexpr size_t kNone = Role::kNone;

// What stands between two brackets, or the whole text.
struct Frame {
  TokenKind open = TokenKind::LeftBrace;
  size_t callee = kNone;     // of parentheses: the name before them
  bool takes_names = false;  // whether its arguments may have names
  bool of_words = false;     // all in it are words: the parentheses of `over = (x, y)`
  bool in_words = false;     // as is what stands up to the next comma
  size_t head = kNone;       // of the statement that is being read: its first token
};

class Reader {
 public:
  Reader(const Tokens& tokens, const std::function<bool(size_t)>& is_builtin)
      : tokens_(tokens), is_builtin_(is_builtin) {}

  std::map<size_t, Role> run() {
    for (at_ = 0; at_ < tokens_.all.size(); ++at_) {
      if (top().open == TokenKind::LeftBrace && top().head == kNone) top().head = at_;
      switch (kind(at_)) {
        case TokenKind::LeftParen:
        case TokenKind::LeftBracket:
        case TokenKind::LeftBrace: open(); break;
        case TokenKind::RightParen:
        case TokenKind::RightBracket:
        case TokenKind::RightBrace: close(); break;
        case TokenKind::Semicolon: top().head = kNone; break;
        case TokenKind::Comma: top().in_words = false; break;
        case TokenKind::Name:
          if (const auto role = role_of_name()) found_.emplace(at_, *role);
          break;
        default: break;
      }
    }
    return std::move(found_);
  }

 private:
  Frame& top() { return frames_.back(); }
  TokenKind kind(size_t token) const { return token < tokens_.all.size() ? tokens_.all[token].kind : TokenKind::End; }
  TokenKind before() const { return at_ > 0 ? kind(at_ - 1) : TokenKind::End; }
  bool is_word(size_t token, std::string_view word) const {
    return token < tokens_.all.size() && tokens_[token] == word;
  }

  void open() {
    Frame frame;
    frame.open = kind(at_);
    if (frame.open == TokenKind::LeftParen) {
      const bool is_declared = at_ >= 2 && (kind(at_ - 2) == TokenKind::Fn || is_word(at_ - 2, "optimizer") ||
                                            is_word(at_ - 1, "parameters"));
      frame.of_words = top().of_words || top().in_words;
      const bool is_called =
          before() == TokenKind::Name || before() == TokenKind::Reduce || before() == TokenKind::Raster;
      if (is_called && !is_declared) frame.callee = at_ - 1;
      // Of `Camera<float>(…)`, the name is not at hand.
      frame.takes_names = frame.callee != kNone || before() == TokenKind::Greater;
    }
    frames_.push_back(frame);
  }

  void close() {
    const bool was_block = top().open == TokenKind::LeftBrace;
    if (frames_.size() > 1) frames_.pop_back();
    // An output may go on behind the block of an `if`.
    if (was_block && !is_word(top().head, "output")) top().head = kNone;
  }

  std::optional<Role> role_of_name() {
    Frame& frame = top();
    if (before() == TokenKind::Dot) return std::nullopt;
    if (frame.of_words || frame.in_words) return Role{};
    if (at_ > 0 && is_word(at_ - 1, "step_index") && is_word(at_, "of")) return Role{.help = "of"};
    if (at_ > 1 && is_word(at_ - 1, "of") && is_word(at_ - 2, "step_index") && kind(at_ + 1) != TokenKind::Dot)
      return Role{.kind = Role::Kind::Step, .help = {}};
    if (frame.head == at_ && is_word(at_, "step") && kind(at_ + 1) == TokenKind::Name)
      return Role{.kind = Role::Kind::Keyword, .help = "step"};
    if (frame.callee != kNone && frame.callee + 2 == at_ && is_word(frame.callee, "reduce"))
      return Role{.help = "reduce"};
    return kind(at_ + 1) == TokenKind::Assign ? role_before_assign() : std::nullopt;
  }

  std::optional<Role> role_before_assign() {
    Frame& frame = top();
    const bool starts = before() == TokenKind::Comma || before() == TokenKind::LeftParen;
    if (frame.open == TokenKind::LeftParen) return starts && frame.takes_names ? role_of_argument() : std::nullopt;
    if (is_word(frame.head, "output") && (before() == TokenKind::Comma || frame.head + 1 == at_))
      return Role{.kind = Role::Kind::Output, .help = {}};
    if (is_word(frame.head, "for") && is_word(at_, "max")) return Role{.help = "for"};
    return std::nullopt;
  }

  std::optional<Role> role_of_argument() {
    Frame& frame = top();
    const std::string_view callee = frame.callee == kNone ? std::string_view() : tokens_[frame.callee];
    if (callee == "reduce" || callee == "fold" || callee == "scan") {
      // Other names are what the loop carries: they are declared here.
      return is_word(at_, "max") ? std::optional(Role{.help = callee}) : std::nullopt;
    }
    if (frame.callee == kNone || !is_builtin_(frame.callee))
      return Role{.kind = Role::Kind::Argument, .callee = frame.callee, .help = {}};
    frame.in_words = is_word(at_, "over") || is_word(at_, "filter") || is_word(at_, "wrap");
    return Role{.help = callee};
  }

  const Tokens& tokens_;
  const std::function<bool(size_t)>& is_builtin_;
  std::vector<Frame> frames_{Frame{}};
  size_t at_ = 0;
  std::map<size_t, Role> found_;
};

}  // namespace

std::map<size_t, Role> roles(const Tokens& tokens, const std::function<bool(size_t token)>& is_builtin) {
  return Reader(tokens, is_builtin).run();
}

}  // namespace dr::language_server
