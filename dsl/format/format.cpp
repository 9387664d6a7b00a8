// SPDX-License-Identifier: Apache-2.0
// Lays the formatter's tree out on lines. What fits on one line stands on one; else the node decides by its kind.
#include "dsl/format/format.h"

#include <algorithm>
#include <utility>
#include <vector>

#include "dsl/format/tree.h"
#include "dsl/syntax/dump.h"
#include "dsl/syntax/parser.h"

namespace dr::dsl {
namespace {

constexpr size_t kIndent = 2;
constexpr size_t kContinuation = 4;

// Lines under construction. A trailing comment is kept apart from its line's code, so that comments of lines side by
// side can be put in one column.
class Lines {
 public:
  size_t column() const { return text_width(line_.code) + (space_ ? 1 : 0); }
  bool is_empty() const { return line_.code.empty(); }
  bool ends_in_comment() const { return !line_.comment.empty(); }

  // How far the line's first word is from the margin.
  size_t indentation() const {
    const size_t first = line_.code.find_first_not_of(' ');
    return first == std::string::npos ? line_.code.size() : first;
  }

  void space() { space_ = true; }

  void put(std::string_view text) {
    if (space_) line_.code += ' ';
    space_ = false;
    line_.code += text;
  }

  void put_comment(std::string text) { line_.comment = std::move(text); }

  void newline(size_t indentation) {
    flush();
    line_.code.assign(indentation, ' ');
  }

  void blank_line() { lines_.emplace_back(); }

  // Ends the last line, which stays empty unless something is put on it.
  void flush() {
    space_ = false;
    const bool blank = line_.code.find_first_not_of(' ') == std::string::npos && line_.comment.empty();
    if (!blank) lines_.push_back(std::exchange(line_, {}));
    line_ = {};
  }

  std::string text() {
    flush();
    align_comments();
    std::string out;
    for (const Line& line : lines_) {
      out += line.code;
      if (!line.comment.empty()) {
        out.append(line.comment_column - text_width(line.code), ' ');
        out += line.comment;
      }
      out += '\n';
    }
    return out;
  }

 private:
  struct Line {
    std::string code;
    std::string comment;
    size_t comment_column = 0;
  };

  // Comments of adjacent lines start in one column. Lines that are too long for it stand apart.
  void align_comments() {
    for (size_t begin = 0; begin < lines_.size();) {
      size_t end = begin;
      size_t widest = 0;
      for (; end < lines_.size() && !lines_[end].comment.empty(); ++end) {
        widest = std::max(widest, text_width(lines_[end].comment));
      }
      const size_t limit = kFormatWidth - std::min(widest, kFormatWidth);
      size_t column = 0;
      for (size_t i = begin; i < end; ++i) {
        lines_[i].comment_column = text_width(lines_[i].code) + 2;
        if (lines_[i].comment_column <= limit) column = std::max(column, lines_[i].comment_column);
      }
      for (size_t i = begin; i < end; ++i) lines_[i].comment_column = std::max(lines_[i].comment_column, column);
      begin = std::max(end, begin + 1);
    }
  }

  std::vector<Line> lines_;
  Line line_;
  bool space_ = false;
};

class Printer {
 public:
  explicit Printer(const std::vector<LaidToken>& tokens) : tokens_(tokens) {}

  std::string run(const LayoutNode& root) {
    print_statements(root, 0, tokens_.back().leading);
    return lines_.text();
  }

 private:
  bool fits(size_t width) const { return lines_.column() + width <= kFormatWidth; }

  // A token with the comments that no node has a better place for: they break the line wherever they stand.
  void token(size_t index) {
    if (index == kNoToken) return;
    const LaidToken& token = tokens_[index];
    if (lines_.ends_in_comment()) lines_.newline(continuation_);
    for (const Comment& comment : token.leading) {
      if (!lines_.is_empty()) lines_.newline(continuation_);
      lines_.put(comment.text);
      lines_.newline(continuation_);
    }
    lines_.put(token.text);
    if (!token.trailing.empty()) lines_.put_comment(token.trailing);
  }

  void comment_lines(const std::vector<Comment>& comments, size_t indentation, bool first) {
    for (const Comment& comment : comments) {
      lines_.newline(indentation);
      if (comment.blank_before && !first) lines_.blank_line();
      lines_.put(comment.text);
      first = false;
    }
  }

  // `rest`: columns of what follows on the same line.
  void print(const LayoutNode& node, size_t rest) {
    if (node.width < kNeverFlat && fits(node.width + rest)) return print_flat(node);
    switch (node.kind) {
      case LayoutNode::Kind::Token: return token(node.token);
      case LayoutNode::Kind::Sequence: return print_sequence(node, rest, false);
      case LayoutNode::Kind::List: return print_list(node, rest);
      case LayoutNode::Kind::Block: return print_block(node, lines_.indentation());
      case LayoutNode::Kind::Chain: return fill(node, rest);
      case LayoutNode::Kind::If: return print_if(node, rest);
    }
  }

  void print_flat(const LayoutNode& node) {
    token(node.token);
    token(node.open);
    const bool is_block = node.kind == LayoutNode::Kind::Block;
    for (size_t i = 0; i < node.parts.size(); ++i) {
      const LayoutPart& part = node.parts[i];
      if (node.kind == LayoutNode::Kind::Sequence ? part.space_before : i > 0 || is_block) lines_.space();
      print_flat(*part.node);
      if (part.separator == kNoToken) continue;
      if (node.kind == LayoutNode::Kind::Chain) lines_.space();
      token(part.separator);
    }
    if (is_block && !node.parts.empty()) lines_.space();
    token(node.close);
  }

  // Columns up to the first place where a line may end; `stops` if there is one.
  size_t lead(const LayoutNode& node, bool& stops) const {
    switch (node.kind) {
      case LayoutNode::Kind::Token: return std::min(node.width, kFormatWidth);
      case LayoutNode::Kind::Block: stops = true; return 1;
      case LayoutNode::Kind::List:
        if (node.open == kNoToken) break;
        stops = true;
        return node.parts.empty() ? 2 : 1;
      case LayoutNode::Kind::Chain:
      case LayoutNode::Kind::Sequence:
      case LayoutNode::Kind::If: break;
    }
    size_t width = 0;
    for (const LayoutPart& part : node.parts) {
      width += (part.space_before ? 1 : 0) + lead(*part.node, stops);
      if (node.kind != LayoutNode::Kind::Sequence) stops = true;
      if (stops) break;
    }
    return width;
  }

  size_t rest_after(const LayoutNode& sequence, size_t index, size_t rest) const {
    size_t width = 0;
    for (size_t i = index + 1; i < sequence.parts.size(); ++i) {
      bool stops = false;
      width += (sequence.parts[i].space_before ? 1 : 0) + lead(*sequence.parts[i].node, stops);
      if (stops) return width;
    }
    return width + rest;
  }

  // A block that breaks is indented from the line that the sequence begins on: parameters may have broken between.
  void print_sequence(const LayoutNode& node, size_t rest, bool break_block) {
    const size_t base = lines_.indentation();
    for (size_t i = 0; i < node.parts.size(); ++i) {
      const LayoutPart& part = node.parts[i];
      if (part.space_before) lines_.space();
      const size_t after = rest_after(node, i, rest);
      const bool is_block = part.node->kind == LayoutNode::Kind::Block;
      if (is_block && (break_block || part.node->width >= kNeverFlat || !fits(part.node->width + after))) {
        print_block(*part.node, base);
      } else {
        print(*part.node, after);
      }
    }
  }

  // `[a, b]`: under each other behind the bracket, or, where an item is too wide for that, below the line's start.
  void print_list(const LayoutNode& node, size_t rest) {
    token(node.open);
    const size_t open_column = lines_.column() - (node.open == kNoToken ? 0 : 1);
    const size_t hanging = lines_.indentation() + kContinuation;
    const bool hangs = std::ranges::any_of(node.parts, [&](const LayoutPart& part) {
      const size_t width = part.node->width + 1 + (&part == &node.parts.back() ? rest : 0);
      return part.node->width < kNeverFlat && lines_.column() + width > kFormatWidth && hanging + width <= kFormatWidth;
    });
    if (hangs && node.open != kNoToken) lines_.newline(hanging);
    fill(node, rest + (node.close == kNoToken ? 0 : 1));
    if (node.close != kNoToken && lines_.ends_in_comment()) lines_.newline(open_column);
    token(node.close);
  }

  // Columns of a node up to the `{` of the block that makes it need several lines, if only that block does.
  size_t head(const LayoutNode& node) const {
    if (node.kind == LayoutNode::Kind::Block) return 1;
    if (node.kind == LayoutNode::Kind::Token || node.kind == LayoutNode::Kind::Chain) return kNeverFlat;
    size_t width = node.open == kNoToken ? 0 : 1;
    for (const LayoutPart& part : node.parts) {
      if (!part.leading.empty() || (part.break_before && node.kind == LayoutNode::Kind::List)) return kNeverFlat;
      width += part.space_before ? 1 : 0;
      if (part.node->width >= kNeverFlat) return width + head(*part.node);
      width += part.node->width + (node.kind == LayoutNode::Kind::List ? 2 : 0);
    }
    return kNeverFlat;
  }

  // The parts of a list or chain, as many on a line as fit; line breaks of the source are kept.
  void fill(const LayoutNode& node, size_t rest) {
    const bool is_chain = node.kind == LayoutNode::Kind::Chain;
    const size_t align = lines_.column();
    const size_t outer = std::exchange(continuation_, align);
    for (size_t i = 0; i < node.parts.size(); ++i) {
      const LayoutPart& part = node.parts[i];
      size_t tail = i + 1 == node.parts.size() ? rest : 0;
      if (part.separator != kNoToken) tail += is_chain ? 1 + text_width(tokens_[part.separator].text) : 1;
      comment_lines(part.leading, align, true);
      if (!part.leading.empty() || lines_.ends_in_comment()) {
        lines_.newline(align);
      } else if (i > 0) {
        const size_t width = part.node->width;
        const bool here = fits(1 + width + tail);
        const bool below = width < kNeverFlat && align + width + tail <= kFormatWidth;
        // What breaks anyway may as well begin here: an operand, and an item that only its block breaks.
        const bool hugs = !below && (is_chain || fits(1 + head(*part.node)));
        if (part.break_before || (!here && !hugs)) {
          lines_.newline(align);
        } else {
          lines_.space();
        }
      }
      print(*part.node, tail);
      if (part.separator != kNoToken) {
        if (is_chain) lines_.space();
        token(part.separator);
      }
      if (!part.trailing.empty()) lines_.put_comment(part.trailing);
    }
    continuation_ = outer;
  }

  void print_if(const LayoutNode& node, size_t rest) {
    const size_t align = lines_.column();
    bool all_flat = true;
    bool one_line_each = node.parts.size() > 1 && node.parts[1].break_before;
    for (size_t i = 0; i < node.parts.size(); ++i) {
      const size_t width = node.parts[i].node->width;
      all_flat = all_flat && width < kNeverFlat;
      one_line_each = one_line_each && align + width + (i + 1 < node.parts.size() ? 0 : rest) <= kFormatWidth;
    }
    const size_t outer = std::exchange(continuation_, one_line_each ? align : lines_.indentation());
    for (size_t i = 0; i < node.parts.size(); ++i) {
      const LayoutNode& branch = *node.parts[i].node;
      if (one_line_each) {
        if (i > 0) lines_.newline(align);
        print_flat(branch);
        continue;
      }
      if (i > 0) lines_.space();
      bool stops = false;
      const bool last = i + 1 == node.parts.size();
      print_sequence(branch, last ? rest : 1 + lead(*node.parts[i + 1].node, stops), all_flat);
    }
    continuation_ = outer;
  }

  void print_block(const LayoutNode& node, size_t base) {
    token(node.open);
    const LaidToken& close = tokens_[node.close];
    if (node.parts.empty() && close.leading.empty() && !lines_.ends_in_comment()) return token(node.close);
    print_statements(node, base + kIndent, close.leading);
    lines_.newline(base);
    lines_.put(close.text);
    if (!close.trailing.empty()) lines_.put_comment(close.trailing);
  }

  void print_statements(const LayoutNode& block, size_t indentation, const std::vector<Comment>& closing) {
    const size_t outer = std::exchange(continuation_, indentation + kContinuation);
    for (size_t i = 0; i < block.parts.size(); ++i) {
      const LayoutPart& part = block.parts[i];
      comment_lines(part.leading, indentation, i == 0);
      lines_.newline(indentation);
      if (part.blank_before && (i > 0 || !part.leading.empty())) lines_.blank_line();
      if (part.colon > 0) {
        print_leaf(part, colon_column(block, i));
      } else {
        print(*part.node, 0);
      }
      if (!part.trailing.empty()) lines_.put_comment(part.trailing);
    }
    comment_lines(closing, indentation, block.parts.empty());
    continuation_ = outer;
  }

  // Leaves side by side have their colons in one column: this is where, from their indentation.
  static size_t colon_column(const LayoutNode& block, size_t index) {
    size_t begin = index;
    while (begin > 0 && block.parts[begin - 1].colon > 0 && is_tight(block.parts[begin])) --begin;
    size_t column = 0;
    for (size_t i = begin; i < block.parts.size() && block.parts[i].colon > 0; ++i) {
      if (i > begin && !is_tight(block.parts[i])) break;
      column = std::max(column, before_colon(block.parts[i]));
    }
    return column + 1;
  }

  static bool is_tight(const LayoutPart& part) { return part.leading.empty() && !part.blank_before; }

  static size_t before_colon(const LayoutPart& leaf) {
    size_t width = 0;
    for (size_t i = 0; i < leaf.colon; ++i) {
      width += leaf.node->parts[i].node->width + (leaf.node->parts[i].space_before ? 1 : 0);
    }
    return std::min(width, kFormatWidth / 2);
  }

  void print_leaf(const LayoutPart& leaf, size_t column) {
    const LayoutNode& node = *leaf.node;
    const size_t begin = lines_.column();
    for (size_t i = 0; i < node.parts.size(); ++i) {
      if (node.parts[i].space_before) lines_.space();
      if (i == leaf.colon && lines_.column() < begin + column) {
        lines_.put(std::string(begin + column - lines_.column() - 1, ' '));
        lines_.space();
      }
      print(*node.parts[i].node, rest_after(node, i, 0));
    }
  }

  const std::vector<LaidToken>& tokens_;
  Lines lines_;
  size_t continuation_ = 0;  // where a line goes on that a comment ends
};

std::string all_comments(const SourceManager& sources, FileId file) {
  std::string out;
  for (const LaidToken& token : laid_tokens(sources, file)) {
    for (const Comment& comment : token.leading) out += comment.text + '\n';
    if (!token.trailing.empty()) out += token.trailing + '\n';
  }
  return out;
}

// What formatting changed that it must not, or nothing.
std::string changed_meaning(const SourceManager& sources, FileId file, const Module& before, const std::string& text) {
  SourceManager made;
  DiagnosticList diagnostics;
  const FileId made_file = made.add(std::string(sources.name(file)), text);
  const Module after = parse(made, made_file, diagnostics);
  if (diagnostics.has_errors()) return "the formatted text does not parse:\n" + format(diagnostics, made);
  if (dump(before) != dump(after)) return "formatting changes the syntax tree";
  if (all_comments(sources, file) != all_comments(made, made_file)) return "formatting changes the comments";
  return "";
}

}  // namespace

FormatResult format_source(const SourceManager& sources, FileId file, DiagnosticList& diagnostics) {
  FormatResult result;
  const Module module = parse(sources, file, diagnostics);
  result.has_errors = diagnostics.has_errors();
  if (result.has_errors) return result;
  std::vector<LaidToken> tokens = laid_tokens(sources, file);
  const LayoutPtr tree = layout_tree(tokens);
  if (!tree) {
    result.internal_error = "the formatter does not know the grammar of this file";
    return result;
  }
  result.text = Printer(tokens).run(*tree);
  result.internal_error = changed_meaning(sources, file, module, result.text);
  return result;
}

}  // namespace dr::dsl
