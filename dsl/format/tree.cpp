// SPDX-License-Identifier: Apache-2.0
// Builds the formatter's tree. The file is known to parse, so this reads no more of the grammar than what decides about
// spaces and lines, and stops at the first token that it cannot place.
#include "dsl/format/tree.h"

#include <algorithm>
#include <utility>

#include "dsl/syntax/parser.h"

namespace dr::dsl {
namespace {

constexpr int kHighestPrecedence = 10;
constexpr int kAdditive = 9;

class TreeBuilder {
 public:
  explicit TreeBuilder(std::vector<LaidToken>& tokens) : tokens_(tokens) {}

  LayoutPtr run() {
    LayoutPtr root = make(LayoutNode::Kind::Block);
    while (!at(TokenKind::End) && !failed_) root->parts.push_back(statement(Place::File));
    if (failed_) return nullptr;
    measure(*root);
    return root;
  }

 private:
  // What a word means at the start of a statement depends on where it stands.
  enum class Place : uint8_t { File, Struct, Optimizer, Raster, Code };
  using Reader = LayoutPtr (TreeBuilder::*)();

  bool at(TokenKind kind) const { return tokens_[position_].kind == kind; }
  bool at_word(std::string_view word) const { return at(TokenKind::Name) && tokens_[position_].text == word; }
  const LaidToken& next() const { return tokens_[std::min(position_ + 1, tokens_.size() - 1)]; }

  static LayoutPtr make(LayoutNode::Kind kind) {
    auto node = std::make_unique<LayoutNode>();
    node->kind = kind;
    return node;
  }

  size_t take() {
    const size_t taken = position_;
    if (at(TokenKind::End)) {
      failed_ = true;
    } else {
      ++position_;
    }
    return taken;
  }

  size_t expect(TokenKind kind) {
    if (!at(kind)) failed_ = true;
    return failed_ ? position_ : take();
  }

  LayoutPtr take_leaf() {
    LayoutPtr node = make(LayoutNode::Kind::Token);
    node->token = take();
    return node;
  }

  static void add(LayoutNode& sequence, LayoutPtr node, bool space = true) {
    LayoutPart part;
    part.node = std::move(node);
    part.space_before = space && !sequence.parts.empty();
    sequence.parts.push_back(std::move(part));
  }
  void add_token(LayoutNode& sequence, bool space = true) { add(sequence, take_leaf(), space); }

  // `, item` in a list, with the comments around an item: those above it, and the one behind it or its comma.
  void add_items(LayoutNode& list, TokenKind close, Reader item) {
    while (!failed_ && !at(close)) {
      LayoutPart part;
      part.break_before = !list.parts.empty() && tokens_[position_].newline_before;
      part.leading = std::exchange(tokens_[position_].leading, {});
      part.node = (this->*item)();
      if (failed_) return;
      if (at(TokenKind::Comma)) part.separator = take();
      part.trailing = std::exchange(tokens_[position_ - 1].trailing, {});
      const bool last = part.separator == kNoToken;
      list.parts.push_back(std::move(part));
      if (last) break;
    }
    // `(a, b,)` is `(a, b)`.
    if (list.parts.empty() || !at(close) || close == TokenKind::End) return;
    LayoutPart& last = list.parts.back();
    if (last.separator != kNoToken && !tokens_[last.separator].has_comments()) last.separator = kNoToken;
  }

  LayoutPtr list(TokenKind close, Reader item) {
    LayoutPtr node = make(LayoutNode::Kind::List);
    node->open = take();
    add_items(*node, close, item);
    split_angle(close);
    node->close = expect(close);
    return node;
  }

  LayoutPtr bare_list(Reader item) {
    LayoutPtr node = make(LayoutNode::Kind::List);
    add_items(*node, TokenKind::End, item);
    return node;
  }

  // `>>` and `>=` are one token each, except where generic arguments end.
  void split_angle(TokenKind close) {
    if (close != TokenKind::Greater || (!at(TokenKind::ShiftRight) && !at(TokenKind::GreaterEqual))) return;
    LaidToken second = tokens_[position_];
    LaidToken& first = tokens_[position_];
    first.trailing.clear();
    first.kind = TokenKind::Greater;
    first.end = first.begin + 1;
    first.text = first.text.substr(0, 1);
    second.leading.clear();
    second.newline_before = second.blank_before = false;
    second.kind = second.kind == TokenKind::ShiftRight ? TokenKind::Greater : TokenKind::Assign;
    second.begin += 1;
    second.text = second.text.substr(1);
    tokens_.insert(tokens_.begin() + static_cast<std::ptrdiff_t>(position_) + 1, std::move(second));
  }

  LayoutPtr block(Place place) {
    LayoutPtr node = make(LayoutNode::Kind::Block);
    node->open = expect(TokenKind::LeftBrace);
    while (!failed_ && !at(TokenKind::RightBrace)) node->parts.push_back(statement(place));
    node->close = expect(TokenKind::RightBrace);
    return node;
  }

  // ---- statements and items ----

  LayoutPart statement(Place place) {
    LayoutPart part;
    LaidToken& first = tokens_[position_];
    part.leading = std::exchange(first.leading, {});
    part.blank_before = first.blank_before;
    part.break_before = first.newline_before;
    const size_t begin = position_;
    part.node = statement_node(place, part);
    if (position_ == begin) failed_ = true;
    if (!failed_) part.trailing = std::exchange(tokens_[position_ - 1].trailing, {});
    return part;
  }

  LayoutPtr statement_node(Place place, LayoutPart& part) {
    LayoutPtr node = make(LayoutNode::Kind::Sequence);
    LayoutNode& sequence = *node;
    if (place == Place::File && at_word("private")) add_token(sequence);
    const bool at_fn = at(TokenKind::Fn) && next().kind == TokenKind::Name;
    if (place == Place::Raster || (place == Place::Optimizer && at_word("update"))) {
      add_token(sequence);
      add_signature(sequence);
    } else if (place == Place::File && at(TokenKind::At)) {
      // `@vjp(f)` has a line of its own, above its function.
      add_token(sequence);
      add_token(sequence, false);
      add(sequence, list(TokenKind::RightParen, &TreeBuilder::leaf_item), false);
    } else if (at_fn) {
      add_token(sequence);
      add_token(sequence);
      if (at(TokenKind::Less)) add(sequence, list(TokenKind::Greater, &TreeBuilder::leaf_item), false);
      add_signature(sequence);
    } else if (place == Place::File && at_word("struct")) {
      add_token(sequence);
      add_token(sequence);
      if (at(TokenKind::Less)) add(sequence, list(TokenKind::Greater, &TreeBuilder::leaf_item), false);
      add(sequence, block(Place::Struct));
    } else if (place == Place::File && at_word("optimizer")) {
      add_token(sequence);
      add_token(sequence);
      add(sequence, list(TokenKind::RightParen, &TreeBuilder::param), false);
      add(sequence, block(Place::Optimizer));
    } else if (place == Place::File && at_word("step")) {
      add_token(sequence);
      add_token(sequence);
      add(sequence, block(Place::Code));
    } else if (place == Place::File && (at_word("edition") || at_word("import"))) {
      while (!failed_ && !at(TokenKind::Semicolon)) {
        const bool dotted = at(TokenKind::Dot) || (position_ > 0 && tokens_[position_ - 1].kind == TokenKind::Dot);
        add_token(sequence, !dotted);
      }
    } else if (place == Place::File && at_word("parameters")) {
      add_token(sequence);
      add(sequence, list(TokenKind::RightParen, &TreeBuilder::param));
    } else if ((place == Place::File && (at_word("param") || at_word("input") || at_word("state"))) ||
               (place == Place::Optimizer && at_word("state"))) {
      add_token(sequence);
      add_token(sequence);
      if (at(TokenKind::Colon)) part.colon = sequence.parts.size();
      if (at(TokenKind::Colon)) add_type(sequence, true);
      add_value(sequence);
    } else if (at(TokenKind::Let) || at(TokenKind::Var) || (at(TokenKind::Const) && next().kind != TokenKind::If)) {
      add_token(sequence);
      add(sequence, at(TokenKind::LeftParen) ? list(TokenKind::RightParen, &TreeBuilder::leaf_item) : take_leaf());
      add_type(sequence, false);
      add_value(sequence);
    } else if (place == Place::Struct) {
      add_token(sequence);
      add_type(sequence, false);
      add_value(sequence);
    } else {
      add_code(sequence);
    }
    if (at(TokenKind::Semicolon)) add_token(sequence, false);
    return node;
  }

  // A statement that begins with no word of a declaration.
  void add_code(LayoutNode& sequence) {
    if (at(TokenKind::For)) {
      for (int i = 0; i < 3; ++i) add_token(sequence);  // for k in
      add_range(sequence);
      if (at(TokenKind::Comma)) {
        add_token(sequence, false);
        add(sequence, argument());
      }
      add(sequence, block(Place::Code));
    } else if (at(TokenKind::Minimize)) {
      add_token(sequence);
      add(sequence, expression());
      add_token(sequence);  // over
      add(sequence, bare_list(&TreeBuilder::expression));
      add_token(sequence);  // with
      add(sequence, expression());
    } else if (at(TokenKind::Return)) {
      add_token(sequence);
      add(sequence, expression());
    } else if (at_word("output") && next().kind == TokenKind::Name) {
      add_token(sequence);
      add(sequence, bare_list(&TreeBuilder::argument));
    } else if (starts_update()) {
      add(sequence, unary());
      add_token(sequence);
      add_token(sequence, false);
      add(sequence, expression());
    } else if (at_word("break") && (next().kind == TokenKind::If || next().kind == TokenKind::Semicolon)) {
      add_token(sequence);
      if (at(TokenKind::If)) {
        add_token(sequence);
        add(sequence, expression());
      }
    } else {
      add(sequence, expression());
      if (at_compound_assignment()) {
        add_token(sequence);
        add_token(sequence, false);
        return add(sequence, expression());
      }
      add_value(sequence);
    }
  }

  // `path.of.names <-`, which may stand in parentheses.
  bool starts_update() const {
    size_t at = position_;
    while (tokens_[at].kind == TokenKind::LeftParen) ++at;
    if (tokens_[at].kind != TokenKind::Name) return false;
    for (++at; at + 1 < tokens_.size();) {
      if (tokens_[at].kind == TokenKind::RightParen) {
        ++at;
      } else if (tokens_[at].kind == TokenKind::Dot && tokens_[at + 1].kind == TokenKind::Name) {
        at += 2;
      } else {
        break;
      }
    }
    return at + 1 < tokens_.size() && tokens_[at].kind == TokenKind::Less && tokens_[at + 1].kind == TokenKind::Minus &&
           tokens_[at + 1].begin == tokens_[at].end;
  }

  // `(params) -> type { body }`
  void add_signature(LayoutNode& sequence) {
    add(sequence, list(TokenKind::RightParen, &TreeBuilder::param), false);
    if (at(TokenKind::Arrow)) {
      add_token(sequence);
      add(sequence, type());
    }
    add(sequence, block(Place::Code));
  }

  // `: type`
  void add_type(LayoutNode& sequence, bool space) {
    if (!at(TokenKind::Colon)) return;
    add_token(sequence, space);
    add(sequence, type());
  }

  // `= expression`
  void add_value(LayoutNode& sequence) {
    if (!at(TokenKind::Assign)) return;
    add_token(sequence);
    add(sequence, expression());
  }

  // `a..b`
  void add_range(LayoutNode& sequence) {
    add(sequence, expression());
    add(sequence, expect_leaf(TokenKind::DotDot), false);
    add(sequence, expression(), false);
  }

  LayoutPtr expect_leaf(TokenKind kind) {
    if (!at(kind)) failed_ = true;
    return take_leaf();
  }

  // ---- items of lists ----

  LayoutPtr leaf_item() { return take_leaf(); }

  LayoutPtr param() {
    LayoutPtr node = make(LayoutNode::Kind::Sequence);
    if (at(TokenKind::Const)) add_token(*node);
    add_token(*node);
    add_type(*node, false);
    add_value(*node);
    return node;
  }

  LayoutPtr argument() {
    if (!at(TokenKind::Name) || next().kind != TokenKind::Assign) return expression();
    LayoutPtr node = make(LayoutNode::Kind::Sequence);
    add_token(*node);
    add_value(*node);
    return node;
  }

  // `sum`, `i in a..b` or `max = c`
  LayoutPtr reduce_item() {
    if (!at(TokenKind::Name) || next().text != "in") return argument();
    LayoutPtr node = make(LayoutNode::Kind::Sequence);
    add_token(*node);
    add_token(*node);
    add_range(*node);
    return node;
  }

  // ---- types ----

  LayoutPtr type() {
    if (at(TokenKind::LeftParen)) return list(TokenKind::RightParen, &TreeBuilder::type);
    LayoutPtr node = make(LayoutNode::Kind::Sequence);
    add_token(*node);
    while (at(TokenKind::Dot)) {
      add_token(*node, false);
      add_token(*node, false);
    }
    if (at(TokenKind::Less)) add(*node, generic_arguments(), false);
    if (at(TokenKind::LeftBracket)) add(*node, list(TokenKind::RightBracket, &TreeBuilder::expression), false);
    return node;
  }

  LayoutPtr generic_arguments() { return list(TokenKind::Greater, &TreeBuilder::generic_argument); }

  // A type or a value. Only at its start may a `<` behind a name begin generic arguments; elsewhere it compares.
  LayoutPtr generic_argument() { return generic_chain(kAdditive); }
  LayoutPtr generic_in_brackets() { return generic_chain(1); }

  LayoutPtr generic_chain(int level) {
    starts_generic_ = true;
    return chain(level);
  }

  // At `path.of.names <`.
  bool at_generic_type() const {
    size_t at = position_;
    while (tokens_[at].kind == TokenKind::Name && tokens_[at + 1].kind == TokenKind::Dot) at += 2;
    return tokens_[at].kind == TokenKind::Name && tokens_[at + 1].kind == TokenKind::Less;
  }

  // ---- expressions ----

  LayoutPtr expression() { return chain(1); }

  LayoutPtr chain(int level) {
    if (level > kHighestPrecedence) return unary();
    LayoutPtr first = chain(level + 1);
    if (failed_ || !at_operator(level)) return first;
    LayoutPtr node = make(LayoutNode::Kind::Chain);
    add(*node, std::move(first));
    while (!failed_ && at_operator(level)) {
      LayoutPart& left = node->parts.back();
      const bool breaks = tokens_[position_].newline_before;
      left.separator = take();
      left.trailing = std::exchange(tokens_[left.separator].trailing, {});
      LayoutPart right;
      right.break_before = breaks || tokens_[position_].newline_before;
      right.leading = std::exchange(tokens_[position_].leading, {});
      right.node = chain(level + 1);
      node->parts.push_back(std::move(right));
    }
    return node;
  }

  // The operator of `+=` ends what it changes.
  bool at_operator(int level) const {
    return precedence(tokens_[position_].kind) == level && !at_compound_assignment();
  }
  bool at_compound_assignment() const {
    return next().kind == TokenKind::Assign && next().begin == tokens_[position_].end &&
           precedence(tokens_[position_].kind) > 0;
  }

  LayoutPtr unary() {
    LayoutPtr node = make(LayoutNode::Kind::Sequence);
    while (at(TokenKind::Minus) || at(TokenKind::Not) || at(TokenKind::Tilde)) add_token(*node, false);
    add_primary(*node);
    add_postfix(*node);
    if (node->parts.size() == 1) return std::move(node->parts.front().node);
    return node;
  }

  void add_postfix(LayoutNode& sequence) {
    while (!failed_) {
      if (at(TokenKind::Dot)) {
        add_token(sequence, at_field_of_number());
        add_token(sequence, false);
      } else if (at(TokenKind::LeftBracket)) {
        add(sequence, list(TokenKind::RightBracket, &TreeBuilder::expression), false);
      } else if (at_fold()) {
        add(sequence, list(TokenKind::RightParen, &TreeBuilder::reduce_item), false);
        add(sequence, block(Place::Code));
      } else if (at(TokenKind::LeftParen)) {
        add(sequence, list(TokenKind::RightParen, &TreeBuilder::argument), false);
      } else {
        return;
      }
    }
  }

  // `(k in` behind the word `fold` or `scan`
  bool at_fold() const {
    if (!at(TokenKind::LeftParen) || position_ == 0) return false;
    const std::string_view word = tokens_[position_ - 1].text;
    return (word == "fold" || word == "scan") && next().kind == TokenKind::Name && position_ + 2 < tokens_.size() &&
           tokens_[position_ + 2].text == "in";
  }

  // `0 .5` is a field of 0, if a senseless one; without the blank it is a number. So is `3. // ...` with `px` below.
  bool at_field_of_number() const {
    const bool ends_line = !tokens_[position_].trailing.empty() || !next().leading.empty();
    return position_ > 0 && tokens_[position_ - 1].kind == TokenKind::Int &&
           (next().kind == TokenKind::Int || ends_line) &&
           (position_ < 2 || tokens_[position_ - 2].kind != TokenKind::Dot);
  }

  void add_primary(LayoutNode& sequence) {
    const bool generic = std::exchange(starts_generic_, false) && sequence.parts.empty();
    if (generic && at_generic_type()) return add(sequence, type(), false);
    switch (tokens_[position_].kind) {
      case TokenKind::Name:
        add_token(sequence, false);
        if (tokens_[position_ - 1].text != "step_index" || !at_word("of") || next().kind != TokenKind::Name) return;
        add_token(sequence);
        return add_token(sequence);
      case TokenKind::Int:
      case TokenKind::Float:
      case TokenKind::String:
      case TokenKind::True:
      case TokenKind::False: return add_token(sequence, false);
      case TokenKind::LeftParen:
        return add(sequence,
                   list(TokenKind::RightParen, generic ? &TreeBuilder::generic_in_brackets : &TreeBuilder::expression),
                   false);
      case TokenKind::LeftBracket: return add(sequence, list(TokenKind::RightBracket, &TreeBuilder::expression), false);
      case TokenKind::LeftBrace: return add(sequence, block(Place::Code), false);
      case TokenKind::If:
      case TokenKind::Const: return add(sequence, branches(), false);
      case TokenKind::Fn:
        add_token(sequence, false);
        if (at(TokenKind::LeftParen)) add_signature(sequence);  // alone it is the type
        return;
      case TokenKind::Reduce:
        add_token(sequence, false);
        add(sequence, list(TokenKind::RightParen, &TreeBuilder::reduce_item), false);
        return add(sequence, block(Place::Code));
      case TokenKind::Raster:
        add_token(sequence, false);
        add(sequence, list(TokenKind::RightParen, &TreeBuilder::argument), false);
        return add(sequence, block(Place::Raster));
      default: failed_ = true;
    }
  }

  // [const] if a { } else if b { } else { }
  LayoutPtr branches() {
    LayoutPtr node = make(LayoutNode::Kind::If);
    for (bool more = true; more && !failed_;) {
      LayoutPart part;
      part.break_before = !node->parts.empty() && tokens_[position_].newline_before;
      part.node = make(LayoutNode::Kind::Sequence);
      LayoutNode& branch = *part.node;
      if (at(TokenKind::Else)) add_token(branch);
      if (at(TokenKind::Const)) add_token(branch);
      if (at(TokenKind::If)) {
        add_token(branch);
        add(branch, expression());
      } else {
        more = false;
      }
      add(branch, block(Place::Code));
      node->parts.push_back(std::move(part));
      more = more && at(TokenKind::Else);
    }
    return node;
  }

  // ---- widths ----

  size_t token_width(size_t token) const {
    if (token == kNoToken) return 0;
    return tokens_[token].has_comments() ? kNeverFlat : text_width(tokens_[token].text);
  }

  void measure(LayoutNode& node) {
    node.width = token_width(node.token) + token_width(node.open) + token_width(node.close);
    bool breaks = false;
    for (size_t i = 0; i < node.parts.size(); ++i) {
      LayoutPart& part = node.parts[i];
      measure(*part.node);
      node.width += part.node->width + token_width(part.separator);
      if (!part.leading.empty() || !part.trailing.empty()) node.width = kNeverFlat;
      breaks = breaks || part.break_before;
      switch (node.kind) {
        case LayoutNode::Kind::Token: break;
        case LayoutNode::Kind::Sequence: node.width += part.space_before ? 1 : 0; break;
        case LayoutNode::Kind::List:
        case LayoutNode::Kind::If: node.width += i > 0 ? 1 : 0; break;
        case LayoutNode::Kind::Block: node.width += 1; break;
        case LayoutNode::Kind::Chain: node.width += i > 0 ? 2 : 0; break;
      }
    }
    // A block that was written on several lines stays so.
    if (node.kind == LayoutNode::Kind::Block && !node.parts.empty()) {
      node.width += 1;
      breaks = breaks || (node.close != kNoToken && tokens_[node.close].newline_before);
      if (breaks) node.width = kNeverFlat;
    }
    node.width = std::min(node.width, kNeverFlat);
  }

  std::vector<LaidToken>& tokens_;
  size_t position_ = 0;
  bool failed_ = false;
  bool starts_generic_ = false;  // the next operand begins a generic argument
};

}  // namespace

LayoutPtr layout_tree(std::vector<LaidToken>& tokens) { return TreeBuilder(tokens).run(); }

}  // namespace dr::dsl
