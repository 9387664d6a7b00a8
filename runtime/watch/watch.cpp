// SPDX-License-Identifier: Apache-2.0
#include "runtime/watch/watch.h"

#include <algorithm>
#include <ctime>

namespace dr::watch {
namespace {

using std::chrono::milliseconds;

constexpr int kMostPixels = 320;          // of a picture's side
constexpr double kShare = 100;            // of what the run takes, the page takes one part in so many
constexpr milliseconds kBetween{250};     // looks, at least
constexpr int kSoon = 500, kLate = 4000;  // milliseconds between two looks of a page

using Numbers = std::vector<std::pair<std::string, double>>;

// Those of a vector by their places: "fit.pair.0".
void add_numbers(const std::string& name, const std::vector<double>& numbers, Numbers& to) {
  for (size_t i = 0; i < numbers.size(); ++i)
    to.emplace_back(name + (numbers.size() > 1 ? "." + std::to_string(i) : ""), numbers[i]);
}

double process_seconds() {
  timespec time{};
  ::clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &time);
  return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
}

}  // namespace

io::Result<std::unique_ptr<Watch>> Watch::open(int port, Reader reader) {
  std::unique_ptr<Watch> watch(new Watch(std::move(reader)));
  auto server =
      LoopbackServer::open(port, [&board = watch->board_](const Request& request) { return board.answer(request); });
  if (!server) return io::Error{server.error()};
  watch->server_ = std::move(server).value();
  return watch;
}

Watch::~Watch() = default;

std::string Watch::url() const {
  return "http://127.0.0.1:" + std::to_string(server_->port()) + "/?token=" + board_.token();
}

int Watch::allow(const std::string& step, int64_t done, int wanted, milliseconds patience) {
  Board::Wish wish = board_.wish();
  if (wish == Board::Wish::Run && !board_.is_watched()) return wanted;
  if (wish == Board::Wish::Pause) {
    if (shown_ != done || shown_step_ != step || shown_layer_ != board_.layer()) look(step, done);
    wish = board_.wait(patience);
  }
  switch (wish) {
    case Board::Wish::Pause:
    case Board::Wish::Stop: return 0;
    case Board::Wish::Step: board_.stepped(); return 1;
    case Board::Wish::Run: break;
  }
  look_if_due(step, done);
  return wanted;
}

void Watch::look_if_due(const std::string& step, int64_t done) {
  const double all = process_seconds(), spent = seconds_ + board_.seconds();
  // Where answering alone takes more than its share, pages look less often.
  board_.set_pause_between_looks(spent * kShare / 2 > all ? kLate : kSoon);
  constexpr double kFirst = 0.05;  // seconds that a short run may take for its first pictures
  if (Clock::now() < next_ || (spent > kFirst && spent * kShare / 2 > all) || done == 0) return;
  look(step, done);
}

void Watch::look(const std::string& step, int64_t done) {
  const auto begin = Clock::now();
  shown_ = done;
  shown_step_ = step;
  shown_layer_ = board_.layer();
  Look found{.step = step, .done = done};
  // Before its first run a step has given nothing yet.
  for (const std::string& name : done > 0 ? reader_.outputs(step) : std::vector<std::string>()) {
    const std::string full = step + "." + name;
    if (large_.contains(full)) continue;
    const auto array = reader_.output(step, name);
    if (!array) continue;
    if (array.value().size() == 1 && array.value().components <= 4) {
      add_numbers(full, array.value().to_doubles(), found.numbers);
    } else if (is_picture(array.value())) {
      found.pictures.emplace_back(full, picture_of(array.value(), shown_layer_, kMostPixels));
    } else {
      large_.insert(full);
    }
  }
  found.runs_per_second = pace(step, done);
  if (reader_.left_out) found.left_out = reader_.left_out(step);
  board_.show(std::move(found));
  const std::chrono::duration<double> took = Clock::now() - begin;
  seconds_ += took.count();
  next_ =
      Clock::now() + std::max<Clock::duration>(kBetween, std::chrono::duration_cast<Clock::duration>(kShare * took));
}

// Runs a second, between this look and one at least a moment ago.
double Watch::pace(const std::string& step, int64_t done) {
  const auto now = Clock::now();
  const std::chrono::duration<double> elapsed = now - paced_at_;
  if (paced_step_ != step || done < paced_) {
    runs_per_second_ = 0;
  } else if (elapsed.count() < 0.05) {
    return runs_per_second_;
  } else {
    runs_per_second_ = static_cast<double>(done - paced_) / elapsed.count();
  }
  paced_step_ = step;
  paced_ = done;
  paced_at_ = now;
  return runs_per_second_;
}

void Watch::add(const std::string& step, const std::string& name, int64_t run, const std::vector<double>& numbers) {
  Numbers named;
  add_numbers(step + "." + name, numbers, named);
  board_.add(step, run, named);
}

void Watch::end(const std::string& step, int64_t done) {
  if (board_.is_watched()) look(step, done);
  board_.end();
}

}  // namespace dr::watch
