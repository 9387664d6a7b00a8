// SPDX-License-Identifier: Apache-2.0
// A strict reader of Wavefront OBJ: polygons, not free-form surfaces. A line it does not understand is an error with
// the line's number, because a line passed over is a mesh with a hole in it.

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <utility>

#include "compiler/io/file/failure.h"
#include "compiler/io/mesh/mesh_readers.h"

namespace dr::io {
namespace {

constexpr std::string_view kRead[] = {"v", "vt", "vn", "f"};

// Statements that do not change the triangles.
constexpr std::string_view kPassedOver[] = {
    "g",  "o",     "s",   "mg",       "mtllib",   "usemtl", "usemap", "maplib",     "l",        "p",
    "vp", "bevel", "lod", "c_interp", "d_interp", "ctech",  "stech",  "shadow_obj", "trace_obj"};

// Statements that hold geometry which is not polygons.
constexpr std::string_view kFreeForm[] = {"cstype", "deg",  "bmat", "step", "curv", "curv2", "surf",
                                          "parm",   "trim", "hole", "scrv", "sp",   "end",   "con",
                                          "bzp",    "cdc",  "cdp",  "bsp",  "res",  "call",  "csh"};

template <size_t N>
bool contains(const std::string_view (&words)[N], std::string_view word) {
  return std::find(std::begin(words), std::end(words), word) != std::end(words);
}

bool is_blank(char c) { return c == ' ' || c == '\t' || c == '\r' || c == '\v' || c == '\f'; }

// One corner as written: 1-based counted from the start after resolving, 0 where absent.
struct Corner {
  int64_t position = 0;
  int64_t uv = 0;
  int64_t normal = 0;
};

class ObjReader {
 public:
  explicit ObjReader(std::string_view text) : text_(text) {}

  Mesh read(RequiredAttribute required) {
    if (text_.starts_with("\xef\xbb\xbf")) text_.remove_prefix(3);
    while (next_line()) statement();
    return finish(required);
  }

 private:
  template <class... Parts>
  [[noreturn]] void fail_here(const Parts&... parts) const {
    fail("line ", line_, ": ", parts...);
  }

  // Fills words_ with the next logical line: a backslash at the end of a line joins it with the one below.
  bool next_line() {
    words_.clear();
    if (text_.empty()) return false;
    line_ = next_line_number_;
    bool continued = true;
    while (continued && !text_.empty()) {
      const size_t newline = text_.find('\n');
      std::string_view line = text_.substr(0, newline);
      text_.remove_prefix(newline == std::string_view::npos ? text_.size() : newline + 1);
      ++next_line_number_;
      if (line.find('\0') != std::string_view::npos) fail_here("a zero byte: this is not a text file");
      // A comment ends at its own line, whatever its last character.
      line = line.substr(0, line.find('#'));
      while (!line.empty() && is_blank(line.back())) line.remove_suffix(1);
      continued = line.ends_with('\\');
      if (continued) line.remove_suffix(1);
      split(line);
    }
    return true;
  }

  void split(std::string_view line) {
    while (true) {
      while (!line.empty() && is_blank(line.front())) line.remove_prefix(1);
      if (line.empty()) return;
      const auto end = std::find_if(line.begin(), line.end(), is_blank);
      const auto length = static_cast<size_t>(end - line.begin());
      words_.push_back(line.substr(0, length));
      line.remove_prefix(length);
    }
  }

  void statement() {
    if (words_.empty()) return;
    const std::string_view keyword = words_.front();
    if (keyword == "v") {
      vertex();
    } else if (keyword == "vt") {
      texture_coordinate();
    } else if (keyword == "vn") {
      expect_numbers(3, 3);
      check_count(normals_.size() / 3, kMaxVertices, "normals");
      for (size_t i = 1; i <= 3; ++i) normals_.push_back(number(i));
    } else if (keyword == "f") {
      face();
    } else if (contains(kFreeForm, keyword)) {
      fail_here("'", keyword, "' belongs to a free-form surface, only polygons are read");
    } else if (!contains(kPassedOver, keyword)) {
      std::vector<std::string_view> known(std::begin(kRead), std::end(kRead));
      known.insert(known.end(), std::begin(kPassedOver), std::end(kPassedOver));
      fail_here("unknown statement ", in_quotes(keyword), did_you_mean(keyword, known));
    }
  }

  void vertex() {
    const size_t count = words_.size() - 1;
    // x y z, then either a weight for rational curves, which polygons do not use, or a colour, or both.
    if (count != 3 && count != 4 && count != 6 && count != 7) {
      fail_here("'v' needs 3 numbers (or 4, 6 or 7 with weight and colour), found ", count);
    }
    check_count(positions_.size() / 3, kMaxVertices, "vertices");
    for (size_t i = 1; i <= 3; ++i) positions_.push_back(number(i));
    if (count == 4 || count == 7) number(4);
    if (count >= 6) {
      for (size_t i = count - 2; i <= count; ++i) colors_.push_back(number(i));
      colors_.push_back(1);
    }
  }

  void texture_coordinate() {
    expect_numbers(1, 3);
    check_count(uv_.size() / 2, kMaxVertices, "texture coordinates");
    uv_.push_back(number(1));
    // The file counts v from the bottom; in double, so that writing it back gives the same bits.
    const double v = words_.size() > 2 ? exact_number(2) : 0.0;
    uv_.push_back(static_cast<float>(1.0 - v));
    if (words_.size() > 3) number(3);
  }

  void expect_numbers(size_t least, size_t most) const {
    const size_t count = words_.size() - 1;
    if (count >= least && count <= most) return;
    const std::string expected = least == most ? cat(least) : cat(least, " to ", most);
    fail_here("'", words_.front(), "' needs ", expected, " numbers, found ", count);
  }

  void check_count(size_t have, int64_t limit, std::string_view what) const {
    if (static_cast<int64_t>(have) >= limit) fail_here("more than ", limit, " ", what);
  }

  float number(size_t index) const { return static_cast<float>(exact_number(index)); }

  // A finite number that a float can hold.
  double exact_number(size_t index) const {
    const std::string_view word = words_[index];
    std::string_view digits = word;
    if (digits.starts_with('+')) {
      digits.remove_prefix(1);
      if (digits.starts_with('-')) fail_here(in_quotes(word), " is not a number");
    }
    double value = 0;
    const auto [end, error] = std::from_chars(digits.data(), digits.data() + digits.size(), value);
    if (error == std::errc::invalid_argument || end != digits.data() + digits.size()) {
      fail_here(in_quotes(word), " is not a number");
    }
    if (error == std::errc::result_out_of_range) {
      // Too small is zero, too large is an error; only the text can tell which of them it was.
      const bool small = digits.find("e-") != std::string_view::npos || digits.find("E-") != std::string_view::npos;
      if (small) return 0;
    }
    if (error != std::errc() || !std::isfinite(static_cast<float>(value))) {
      const bool overflow = error != std::errc() || std::isfinite(value);
      fail_here(in_quotes(word), overflow ? " does not fit a float" : " is not a finite number");
    }
    return value;
  }

  // An index as a 1-based count from the start; negative ones count back from the last entry so far.
  int64_t index(std::string_view part, std::string_view word, size_t count, std::string_view what) const {
    int64_t value = 0;
    const auto [end, error] = std::from_chars(part.data(), part.data() + part.size(), value);
    if (error == std::errc::invalid_argument || end != part.data() + part.size() || part.empty()) {
      fail_here(in_quotes(word), " is not a face corner (expected v, v/vt, v//vn or v/vt/vn)");
    }
    const auto have = static_cast<int64_t>(count);
    if (error != std::errc() || value > kMaxVertices || value < -have) {
      fail_here(what, " index ", in_quotes(part), " is out of range, there are ", have, " so far");
    }
    if (value == 0) fail_here(what, " index 0 is not allowed, indices start at 1");
    return value > 0 ? value : have + value + 1;
  }

  Corner corner(std::string_view word) const {
    Corner result;
    const size_t first = word.find('/');
    result.position = index(word.substr(0, first), word, positions_.size() / 3, "vertex");
    if (first == std::string_view::npos) return result;
    const std::string_view rest = word.substr(first + 1);
    const size_t second = rest.find('/');
    const std::string_view uv = rest.substr(0, second);
    if (!uv.empty() || second == std::string_view::npos) {
      result.uv = index(uv, word, uv_.size() / 2, "texture coordinate");
    }
    if (second != std::string_view::npos) {
      result.normal = index(rest.substr(second + 1), word, normals_.size() / 3, "normal");
    }
    return result;
  }

  void face() {
    const size_t corners = words_.size() - 1;
    if (corners < 3) fail_here("a face needs 3 corners, found ", corners);
    if (static_cast<int64_t>(indices_.size() / 3 + corners - 2) > kMaxTriangles) {
      fail_here("more than ", kMaxTriangles, " triangles");
    }
    Corner first;
    Corner last;
    for (size_t i = 1; i <= corners; ++i) {
      const Corner next = corner(words_[i]);
      if (i > 1 && ((next.uv == 0) != (first.uv == 0) || (next.normal == 0) != (first.normal == 0))) {
        fail_here("corner ", in_quotes(words_[i]), " is written unlike ", in_quotes(words_[1]),
                  ", all corners of a face have the same parts");
      }
      if (i == 1) first = next;
      if (i >= 3) {
        triangle(first, last, next);
      }
      last = next;
    }
    if (first.uv == 0 && line_without_uv_ == 0) line_without_uv_ = line_;
    if (first.normal == 0 && line_without_normal_ == 0) line_without_normal_ = line_;
  }

  void triangle(const Corner& a, const Corner& b, const Corner& c) {
    for (const Corner& corner : {a, b, c}) {
      // A vertex may come after the face that names it, so the upper end is checked when all are read; until then it is
      // enough to know the line of the largest.
      note_largest(largest_position_, corner.position);
      note_largest(largest_uv_, corner.uv);
      note_largest(largest_normal_, corner.normal);
      indices_.push_back(static_cast<int32_t>(corner.position - 1));
      uv_indices_.push_back(static_cast<int32_t>(corner.uv - 1));
      normal_indices_.push_back(static_cast<int32_t>(corner.normal - 1));
    }
  }

  struct Largest {
    int64_t index = 0;
    int64_t line = 0;
  };
  void note_largest(Largest& largest, int64_t index) const {
    if (index > largest.index) largest = {index, line_};
  }

  static void check_largest(const Largest& largest, size_t count, std::string_view what) {
    if (largest.index > static_cast<int64_t>(count)) {
      fail("line ", largest.line, ": ", what, " index ", largest.index, " is out of range, the file has ", count);
    }
  }

  Mesh finish(RequiredAttribute required) {
    const size_t vertices = positions_.size() / 3;
    if (vertices == 0) fail("there are no vertices ('v' lines)");
    check_largest(largest_position_, vertices, "vertex");
    check_largest(largest_uv_, uv_.size() / 2, "texture coordinate");
    check_largest(largest_normal_, normals_.size() / 3, "normal");

    const auto need = [&](MeshAttribute attribute, bool present, const std::string& message) {
      if (required == attribute && !present) throw Failure(message);
    };
    // A cloud of points has positions only.
    if (required != MeshAttribute::Position && indices_.empty()) fail("there are no faces ('f' lines)");

    Mesh mesh;
    const bool has_uv = !uv_.empty() && line_without_uv_ == 0 && !indices_.empty();
    need(MeshAttribute::Uv, !uv_.empty(), "there are no texture coordinates ('vt' lines)");
    need(MeshAttribute::UvIndices, has_uv,
         uv_.empty() ? "there are no texture coordinates ('vt' lines)"
                     : cat("line ", line_without_uv_, ": this face has no texture coordinates"));
    // The array itself is well defined even when some face does not use it.
    if (has_uv || required == MeshAttribute::Uv) mesh.uv = std::move(uv_);
    if (has_uv) mesh.uv_indices = std::move(uv_indices_);

    const bool has_normals = !normals_.empty() && line_without_normal_ == 0 && !indices_.empty();
    need(MeshAttribute::Normal, has_normals,
         normals_.empty() ? "there are no normals ('vn' lines)"
                          : cat("line ", line_without_normal_, ": this face has no normals"));
    if (has_normals) mesh.normals = normals_of_vertices();

    const bool has_colors = colors_.size() == vertices * 4;
    need(MeshAttribute::Color, has_colors, "not every vertex has a colour ('v x y z r g b')");
    if (has_colors) mesh.colors = std::move(colors_);

    mesh.positions = std::move(positions_);
    mesh.indices = std::move(indices_);
    return mesh;
  }

  // The mean of the different normals that a vertex is used with. How often a corner names one does not matter: that
  // would depend on how polygons were cut.
  std::vector<float> normals_of_vertices() const {
    std::vector<std::pair<int32_t, int32_t>> uses(indices_.size());
    for (size_t i = 0; i < uses.size(); ++i) uses[i] = {indices_[i], normal_indices_[i]};
    std::sort(uses.begin(), uses.end());
    uses.erase(std::unique(uses.begin(), uses.end()), uses.end());

    std::vector<std::array<double, 3>> sums(positions_.size() / 3);
    for (const auto& [vertex, normal] : uses) {
      const float* n = &normals_[static_cast<size_t>(normal) * 3];
      const double length = std::hypot(double{n[0]}, double{n[1]}, double{n[2]});
      if (length == 0) continue;
      for (size_t k = 0; k < 3; ++k) sums[static_cast<size_t>(vertex)][k] += n[k] / length;
    }
    // Where opposite normals cancel, the geometry decides.
    std::vector<float> result = smooth_normals(positions_, indices_);
    for (size_t i = 0; i < sums.size(); ++i) {
      const double length = std::hypot(sums[i][0], sums[i][1], sums[i][2]);
      if (length < 1e-6) continue;
      for (size_t k = 0; k < 3; ++k) result[i * 3 + k] = static_cast<float>(sums[i][k] / length);
    }
    return result;
  }

  std::string_view text_;
  std::vector<std::string_view> words_;  // of the current logical line
  int64_t line_ = 0;                     // its first line, 1-based
  int64_t next_line_number_ = 1;

  std::vector<float> positions_;
  std::vector<float> colors_;
  std::vector<float> uv_;
  std::vector<float> normals_;
  std::vector<int32_t> indices_;
  std::vector<int32_t> uv_indices_;
  std::vector<int32_t> normal_indices_;
  Largest largest_position_;
  Largest largest_uv_;
  Largest largest_normal_;
  int64_t line_without_uv_ = 0;  // the first face that lacks it, 0: none
  int64_t line_without_normal_ = 0;
};

}  // namespace

Mesh parse_obj(std::string_view text, RequiredAttribute required) { return ObjReader(text).read(required); }

}  // namespace dr::io
