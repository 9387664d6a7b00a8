// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/emit/face_lists.h"

#include <cmath>
#include <numeric>

namespace dr::backend {

using glsl::dim_expression;
using glsl::Shader;
using ir::Dim;

namespace {

using bundle::kIndirectGroup;

const char* const kListNames[] = {"middle", "large"};

// A step through `groups` places that reaches all of them, and of which any few in a row lie evenly: by the golden
// ratio.
int even_step(int groups) {
  int step = static_cast<int>(std::lround(0.618 * groups));
  while (std::gcd(step, groups) != 1) ++step;
  return step;
}

}  // namespace

FaceLists::FaceLists(const std::optional<FaceBins>& bins, uint32_t loop_trips, const RasterParts& parts,
                     const WalkTrips& trips)
    : parts_(parts),
      faces_(parts.faces * parts.l),
      trips_(trips),
      limit_(loop_trips),
      used_(bins.has_value()),
      bins_(bins.value_or(FaceBins{})),
      lists_{List{bins_.team, bins_.middle_invocations, Dim(bins_.middle_box)},
             List{kLargeTeam, bins_.large_invocations, parts.w * parts.h}} {}

// Of each list: teams that share a face, faces or parts of them that a team may walk, and the rows of workgroups that
// so many faces need beyond the first.
void FaceLists::declare_teams(Shader& s) const {
  const std::string free = std::to_string(limit_ - 8);
  for (size_t k = 0; k < 2; ++k) {
    const List& list = lists_[k];
    const std::string name = kListNames[k], steps = name + "_steps", shares = name + "_shares", each = name + "_each";
    const std::string row_teams = std::to_string(row() / list.team),
                      teams = std::to_string(list.invocations / list.team);
    const std::string all = dim_expression((list.area + Dim(list.team - 1)).divided_by(list.team));
    const std::string pixel = dim_expression(trips_.listed + Dim(1)), face = dim_expression(trips_.face + Dim(2));
    // No functions, as these are specialization constants.
    const auto constant = [&](const std::string& what, const std::string& value, bool positive) {
      s.declare("const int " + what + (positive ? "_or_less" : "") + " = " + value + ";\n");
      if (positive) s.declare("const int " + what + " = " + what + "_or_less > 1 ? " + what + "_or_less : 1;\n");
    };
    constant(steps, "(" + free + " - " + face + ") / " + pixel, true);
    constant(shares, "(" + all + " + " + steps + " - 1) / " + steps, false);
    constant(each, free + " / (" + face + " + (" + all + " + " + shares + " - 1) / " + shares + " * " + pixel + ")",
             true);
    s.declare("int " + name + "_rows(int faces) {\n  int left = faces * " + shares + " - " + teams + " * " + each +
              ";\n  return left <= 0 ? 0 : (left - 1) / (" + row_teams + " * " + each + ") + 1;\n}\n");
  }
}

std::string FaceLists::is_large() const { return "area > " + std::to_string(bins_.middle_box); }

std::string FaceLists::append(Shader& s, const std::string& list, const std::string& large,
                              const std::string& index) const {
  std::string more;
  if (bounded()) {
    declare_teams(s);
    more =
        "  int rows = large ? large_rows(place + 1) - large_rows(place) : middle_rows(place + 1) - "
        "middle_rows(place);\n"
        // The first face of both lists asks for the first row: without any, no workgroup starts.
        "  if (place == 0 && atomicMax(" +
        list + ".d[2], 1u) == 0u) {\n    " + list + ".d[0] = " + std::to_string(row() / kIndirectGroup) +
        "u;\n    ++rows;\n  }\n  if (rows > 0) atomicAdd(" + list + ".d[1], uint(rows));\n";
  }
  // An atomic each, whose place is known: then drivers add for all lanes of a subgroup at once.
  s.declare("void list_face(bool large, int index) {\n  int place;\n  if (large) place = int(atomicAdd(" + list +
            ".d[" + count(1) + "], 1u));\n  else place = int(atomicAdd(" + list + ".d[" + count(0) + "], 1u));\n  " +
            list + ".d[(large ? " + dim_expression(faces_ + Dim(head())) + " : " + std::to_string(head()) +
            ") + place] = uint(index);\n" + more + "}\n");
  return "list_face(" + large + ", " + index + ");";
}

std::string FaceLists::tiny() const {
  return dim_expression(parts_.faces) + " > " + dim_expression(parts_.w * parts_.h);
}

std::string FaceLists::small_box() const {
  std::string box = std::to_string(bins_.small_box);
  if (bins_.few_box == 0) return box;
  return "(" + dim_expression(parts_.w * parts_.h) + " / " + std::to_string(kPixelsOfFew) + " > " +
         dim_expression(parts_.faces) + " ? " + std::to_string(bins_.few_box) + " : " + box + ")";
}

std::string FaceLists::quotient(const std::string& a, const std::string& b) { return "quotient(" + a + ", " + b + ")"; }

void FaceLists::open_items(Shader& s, const std::string& list) const {
  const std::string row = std::to_string(this->row());
  const std::string first[] = {std::to_string(lists_[0].invocations), std::to_string(lists_[1].invocations)};
  const std::string team[] = {std::to_string(lists_[0].team), std::to_string(lists_[1].team)};
  // Floats divide faster, and exactly: a half is more than they are off by for numbers of 2^17.
  const std::string by_float = "int((float(a) + 0.5) / float(b))";
  if (!bounded()) {
    s.declare("int quotient(int a, int b) { return " + by_float + "; }\n");
    s.body().line("bool large = index >= " + first[0] + ";");
    s.body().line("if (large) index -= " + first[0] + ";");
    s.body().line("int count = int(" + list + "(large ? 1 : 0)), shares = 1;");
    s.body().line("int invocations = large ? " + first[1] + " : " + first[0] + ";");
  } else {
    declare_teams(s);
    // A processor's cores each take workgroups that follow each other, so that those of the first row with much to do
    // are dealt out evenly.
    const std::string group = std::to_string(kIndirectGroup), groups = std::to_string(this->row() / kIndirectGroup);
    s.body().line("if (index < " + row + ") index = index / " + group + " * " +
                  std::to_string(even_step(this->row() / kIndirectGroup)) + " % " + groups + " * " + group +
                  " + index % " + group + ";");
    s.declare("int quotient(int a, int b) { return middle_shares * large_shares > 1 ? a / b : " + by_float + "; }\n");
    // Rows behind the first are those of the middle list, then those of the large one.
    s.body().line("int faces_of[2] = int[2](int(" + list + "(" + count(0) + ")), int(" + list + "(" + count(1) +
                  ")));");
    s.body().line("int more = " + row + " * middle_rows(faces_of[0]);");
    s.body().line("bool in_first = index < " + row + ", large = in_first ? index >= " + first[0] +
                  " : index >= " + row + " + more;");
    s.body().line("index -= large ? " + first[0] + " + (in_first ? 0 : more) : in_first ? 0 : " + first[1] + ";");
    s.body().line("int shares = large ? large_shares : middle_shares;");
    s.body().line("int count = (large ? faces_of[1] : faces_of[0]) * shares;");
    s.body().line("int invocations = large ? " + first[1] + " + " + row + " * large_rows(faces_of[1]) : " + first[0] +
                  " + more;");
  }
  s.body().line("int size = large ? " + team[1] + " : " + team[0] + ", teams = invocations / size;");
  // Where there are fewer faces than teams, several teams share a face.
  s.body().line("int together = max(teams / max(count, 1), 1);");
  s.body().line("teams /= together;");
  s.body().line("int lanes = size * together, team = index / lanes, first_lane = index % lanes;");
  s.body().line("if (team >= teams) return;");
  s.body().line("int begin = large ? " + dim_expression(faces_ + Dim(head())) + " : " + std::to_string(head()) +
                ", item = team;");
  s.body().line("for (; item < count; item += teams) {");
  s.push_scope();
  s.body().line("int entry_index = int(" + list + "(begin + item / shares));");
  s.body().line("int lane = first_lane + item % shares * lanes, stride = lanes * shares;");
}

}  // namespace dr::backend
