// SPDX-License-Identifier: Apache-2.0
#include "runtime/watch/board.h"

#include <algorithm>
#include <cmath>
#include <ctime>
#include <nlohmann/json.hpp>
#include <random>

namespace dr::watch {
namespace {

using Json = nlohmann::ordered_json;
using Clock = std::chrono::steady_clock;
using std::chrono::milliseconds;

constexpr std::string_view kPage =
#include "page.inc"
    ;
constexpr int kMostSteps = 1000;             // that pressing a button asks for ahead
constexpr milliseconds kStillWatched{6000};  // after the last look; pages look more often

int64_t now_ms() { return std::chrono::duration_cast<milliseconds>(Clock::now().time_since_epoch()).count(); }

std::string random_token() {
  std::random_device random;  // the system's, which nobody predicts
  std::string token;
  for (int i = 0; i < 4; ++i) {
    for (uint32_t bits = random(), k = 0; k < 8; ++k, bits >>= 4) token += "0123456789abcdef"[bits & 15];
  }
  return token;
}

// In a time that does not tell how much of it is right.
bool is_same(std::string_view a, std::string_view b) {
  if (a.size() != b.size()) return false;
  unsigned difference = 0;
  for (size_t i = 0; i < a.size(); ++i) difference |= static_cast<unsigned>(a[i] ^ b[i]);
  return difference == 0;
}

double thread_seconds() {
  timespec time{};
  ::clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
  return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
}

std::string_view word_of(Board::Wish wish) {
  switch (wish) {
    case Board::Wish::Run:
    case Board::Wish::Step: return "running";
    case Board::Wish::Pause: return "paused";
    case Board::Wish::Stop: return "stopping";
  }
  return "";
}

Response json_response(const Json& json) {
  return {.type = "application/json", .body = json.dump(-1, ' ', false, Json::error_handler_t::replace)};
}

}  // namespace

Board::Board() : token_(random_token()) {}

bool Board::is_watched() const { return now_ms() - last_look_ < kStillWatched.count(); }

bool Board::is_allowed(const Request& request) const {
  const auto header = request.headers.find("x-token");
  if (header != request.headers.end()) return is_same(header->second, token_);
  // A link can carry no header, and no button is pressed by one.
  const auto query = request.query.find("token");
  return request.method == "GET" && query != request.query.end() && is_same(query->second, token_);
}

Response Board::answer(const Request& request) {
  Response response = [&]() -> Response {
    if (!is_allowed(request)) return {.status = 403, .body = "open the address that the run printed: it has a token\n"};
    if (request.method == "POST") return act(request);
    last_look_ = now_ms();
    if (request.path == "/") {
      // Nothing of another server is loaded, and nothing is sent to one.
      return {.type = "text/html; charset=utf-8",
              .body = std::string(kPage),
              .headers =
                  "Content-Security-Policy: default-src 'none'; script-src 'unsafe-inline'; style-src "
                  "'unsafe-inline'; connect-src 'self'; base-uri 'none'; form-action 'none'\r\n"};
    }
    if (request.path == "/state") return state_of_run();
    if (request.path != "/picture") return {.status = 404, .body = "there is no such page\n"};
    const std::lock_guard lock(mutex_);
    const auto name = request.query.find("name");
    const auto found = name == request.query.end() ? pictures_.end() : pictures_.find(name->second);
    if (found == pictures_.end()) return {.status = 404, .body = "there is no such picture\n"};
    return {.type = "application/octet-stream", .body = found->second.first.pixels};
  }();
  seconds_ = thread_seconds();
  return response;
}

Response Board::act(const Request& request) {
  const auto wish = [&](Wish next) -> Response {
    const std::lock_guard lock(mutex_);
    if (wish_ == Wish::Stop) return {.body = "ok\n"};
    steps_ = next == Wish::Step ? std::min(steps_ + 1, kMostSteps) : 0;
    wish_ = next;
    changed_.notify_all();
    return {.body = "ok\n"};
  };
  if (request.path == "/pause") return wish(Wish::Pause);
  if (request.path == "/resume") return wish(Wish::Run);
  if (request.path == "/step") return wish(Wish::Step);
  if (request.path == "/stop") return wish(Wish::Stop);
  const auto number = request.query.find("number");
  if (request.path != "/layer" || number == request.query.end() || number->second.empty() ||
      number->second.size() > 6 || number->second.find_first_not_of("0123456789") != std::string::npos)
    return {.status = 404, .body = "there is no such button\n"};
  layer_ = std::stoi(number->second);
  return {.body = "ok\n"};
}

Response Board::state_of_run() {
  const std::lock_guard lock(mutex_);
  Json curves = Json::object(), pictures = Json::array(), left = Json::array();
  for (const auto& [name, curve] : curves_) {
    Json points = Json::array();
    for (const auto& [run, value] : curve.points())
      points.push_back({run, std::isfinite(value) ? Json(value) : Json(nullptr)});
    curves[name] = std::move(points);
  }
  for (const auto& [name, entry] : pictures_) {
    const Picture& picture = entry.first;
    pictures.push_back({{"name", name},
                        {"number", entry.second},
                        {"width", picture.width},
                        {"height", picture.height},
                        {"layer", picture.layer},
                        {"layers", picture.layers},
                        {"note", picture.note}});
  }
  for (const Left& one : left_) left.push_back({{"what", one.what}, {"done", one.done}, {"left_out", one.left_out}});
  saw_end_ = is_over_;
  changed_.notify_all();
  return json_response({{"status", is_over_ ? "ended" : word_of(wish_)},
                        {"step", step_},
                        {"done", done_},
                        {"runs_per_second", runs_per_second_},
                        {"curves", std::move(curves)},
                        {"pictures", std::move(pictures)},
                        {"left_out", std::move(left)},
                        {"look_after", poll_.load()}});
}

Board::Wish Board::wait(milliseconds patience) {
  std::unique_lock lock(mutex_);
  changed_.wait_for(lock, patience, [&] { return wish_ != Wish::Pause; });
  return wish_;
}

void Board::stepped() {
  const std::lock_guard lock(mutex_);
  if (wish_ == Wish::Step && --steps_ < 1) wish_ = Wish::Pause;
}

// With the mutex: a page never sees points of a run that is not counted yet.
void Board::count(const std::string& step, int64_t done, const std::vector<std::pair<std::string, double>>& numbers) {
  step_ = step;
  done_ = done;
  for (const auto& [name, value] : numbers) curves_[name].add(done, value);
}

void Board::add(const std::string& step, int64_t done, const std::vector<std::pair<std::string, double>>& numbers) {
  const std::lock_guard lock(mutex_);
  count(step, done, numbers);
}

void Board::show(Look look) {
  const std::lock_guard lock(mutex_);
  count(look.step, look.done, look.numbers);
  runs_per_second_ = look.runs_per_second;
  left_ = std::move(look.left_out);
  for (auto& [name, picture] : look.pictures) pictures_[name] = {std::move(picture), ++numbers_};
}

void Board::end() {
  std::unique_lock lock(mutex_);
  is_over_ = true;
  constexpr milliseconds kLastLook{1500};
  if (is_watched()) changed_.wait_for(lock, kLastLook, [&] { return saw_end_; });
}

}  // namespace dr::watch
