// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/emit/face_lists.h"

#include <algorithm>
#include <bit>

namespace dr::backend {

using glsl::dim_expression;
using glsl::Shader;
using ir::Dim;

namespace {

struct Bins {
  // Faces by the pixels of their boxes: up to the first for one invocation, up to the second for subgroups.
  int small_box, middle_box;
  // Invocations that share the faces of a list.
  int middle_invocations, large_invocations;
};
constexpr Bins kCpu{64, 4096, 1 << 13, 1 << 12};

// Those of a GPU, which starts few workgroups faster than many, and has work for more in large pictures.
Bins gpu_bins(const Dim& pixels) {
  constexpr int64_t kLeast = 1 << 15, kUnknown = 1 << 17, kMost = 1 << 19;
  const auto count = pixels.evaluate({});
  const int64_t invocations = count ? std::clamp(*count / 4, kLeast, kMost) : kUnknown;
  const auto middle = static_cast<int>(std::bit_floor(static_cast<uint64_t>(invocations)));
  return {8, 4096, middle, middle / 2};
}

constexpr int kLargeTeam = 1024;    // invocations that share a large face at least
constexpr int kIndirectGroup = 64;  // invocations of a workgroup whose number a buffer says

// Lanes that walk small boxes of different shapes take trips for the rows and columns of them all: for boxes of 64
// pixels the sum over y of 64 / (y + 1).
constexpr int64_t kSmallPixels = 320;

const char* const kListNames[] = {"middle", "large"};

}  // namespace

FaceLists::FaceLists(const target::Profile& profile, const Dim& faces, const Dim& pixels, const WalkTrips& trips)
    : faces_(faces), trips_(trips), limit_(profile.loop_trips), used_(profile.subgroup_size > 1 || limit_ > 0) {
  const Bins bins = profile.subgroup_size >= kWideSubgroup ? gpu_bins(pixels) : kCpu;
  const bool short_ones = trips.pixel.is_constant() && kSmallPixels * (trips.pixel.constant() + 1) < limit_ / 2;
  small_box_ = limit_ == 0 || short_ones ? bins.small_box : 0;
  middle_box_ = bins.middle_box;
  // A power of two, so that teams share the invocations evenly whatever the profile says.
  const auto lanes = static_cast<int>(std::bit_floor(std::clamp(profile.subgroup_size, 1u, 128u)));
  lists_ = {List{lanes, bins.middle_invocations, Dim(bins.middle_box)},
            List{kLargeTeam, bins.large_invocations, pixels}};
}

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
    const std::string pixel = dim_expression(trips_.pixel + Dim(1)), face = dim_expression(trips_.face + Dim(2));
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

std::string FaceLists::append(Shader& s, const std::string& list) const {
  std::string more;
  if (bounded()) {
    declare_teams(s);
    more =
        "  int rows = large ? large_rows(place + 1) - large_rows(place) : middle_rows(place + 1) - "
        "middle_rows(place);\n"
        "  if (place == 0) atomicMax(" +
        list + ".d[0], " + std::to_string(row() / kIndirectGroup) +
        "u);\n"
        "  if (rows > 0) atomicAdd(" +
        list + ".d[1], uint(rows));\n";
  }
  // An atomic each, whose place is known: then drivers add for all lanes of a subgroup at once.
  const std::string one = std::string(", 1u))") + (bounded() ? " - 1" : "") + ";\n";
  s.declare("void list_face(bool large, int index) {\n  int place;\n  if (large) place = int(atomicAdd(" + list +
            ".d[" + count(1) + "]" + one + "  else place = int(atomicAdd(" + list + ".d[" + count(0) + "]" + one +
            "  " + list + ".d[(large ? " + dim_expression(faces_ + Dim(head())) + " : " + std::to_string(head()) +
            ") + place] = uint(index);\n" + more + "}\n");
  return "list_face(area > " + std::to_string(middle_box_) + ", index);";
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
    s.declare("int quotient(int a, int b) { return middle_shares * large_shares > 1 ? a / b : " + by_float + "; }\n");
    // Rows behind the first are those of the middle list, then those of the large one.
    s.body().line("int faces_of[2] = int[2](int(" + list + "(" + count(0) + ")) - 1, int(" + list + "(" + count(1) +
                  ")) - 1);");
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
