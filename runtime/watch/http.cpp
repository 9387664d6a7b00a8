// SPDX-License-Identifier: Apache-2.0
#include "runtime/watch/http.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <chrono>
#include <cstring>
#include <list>
#include <vector>

namespace dr::watch {
namespace {

using Clock = std::chrono::steady_clock;

constexpr size_t kMaxHead = 8192;
constexpr size_t kMaxConnections = 64;
constexpr std::chrono::seconds kPatience{5};  // with a client that does not go on

struct Connection {
  int socket = -1;
  std::string in, out;
  size_t sent = 0;
  bool is_read = false;
  Clock::time_point since = Clock::now();
};

std::string_view status_text(int status) {
  switch (status) {
    case 200: return "OK";
    case 400: return "Bad Request";
    case 403: return "Forbidden";
    case 404: return "Not Found";
    case 405: return "Method Not Allowed";
    case 431: return "Request Header Fields Too Large";
    default: return "Internal Server Error";
  }
}

std::string wire(const Response& response) {
  std::string out = "HTTP/1.1 " + std::to_string(response.status) + " ";
  out += status_text(response.status);
  out += "\r\nContent-Type: " + response.type + "\r\nContent-Length: " + std::to_string(response.body.size()) +
         "\r\nConnection: close\r\nCache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\n"
         "Referrer-Policy: no-referrer\r\nCross-Origin-Resource-Policy: same-origin\r\n" +
         response.headers + "\r\n" + response.body;
  return out;
}

std::string decoded(std::string_view text) {
  std::string out;
  for (size_t i = 0; i < text.size(); ++i) {
    unsigned byte = 0;
    if (text[i] == '%' && i + 2 < text.size() &&
        std::from_chars(text.data() + i + 1, text.data() + i + 3, byte, 16).ptr == text.data() + i + 3) {
      out += static_cast<char>(byte);
      i += 2;
    } else {
      out += text[i] == '+' ? ' ' : text[i];
    }
  }
  return out;
}

std::string_view trimmed(std::string_view text) {
  while (!text.empty() && (text.front() == ' ' || text.front() == '\t')) text.remove_prefix(1);
  while (!text.empty() && (text.back() == ' ' || text.back() == '\t' || text.back() == '\r')) text.remove_suffix(1);
  return text;
}

std::string_view take_until(std::string_view& rest, char end) {
  const std::string_view part = rest.substr(0, rest.find(end));
  rest.remove_prefix(std::min(part.size() + 1, rest.size()));
  return part;
}

// Whether the head was one.
bool parse_head(std::string_view head, Request& request) {
  std::string_view line = trimmed(take_until(head, '\n'));
  request.method = take_until(line, ' ');
  std::string_view target = take_until(line, ' ');
  if (!line.starts_with("HTTP/1.") || !target.starts_with('/')) return false;
  request.path = decoded(take_until(target, '?'));
  while (!target.empty()) {
    std::string_view pair = take_until(target, '&');
    const std::string name = decoded(take_until(pair, '='));
    request.query[name] = decoded(pair);
  }
  while (!head.empty()) {
    line = take_until(head, '\n');
    if (trimmed(line).empty()) break;
    std::string name(take_until(line, ':'));
    std::ranges::transform(name, name.begin(), [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
    // Of two Host lines nobody knows which one counts.
    if (!request.headers.emplace(name, trimmed(line)).second && name == "host") return false;
  }
  return true;
}

}  // namespace

io::Result<std::unique_ptr<LoopbackServer>> LoopbackServer::open(int port, Answer answer) {
  const auto failed = [&](const char* what) {
    return io::Error{std::string(what) + " port " + std::to_string(port) + " of 127.0.0.1: " + std::strerror(errno)};
  };
  const int listener = ::socket(AF_INET, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
  if (listener < 0) return failed("cannot open");
  const int yes = 1;
  ::setsockopt(listener, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<uint16_t>(port));
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t size = sizeof address;
  const int wake = ::eventfd(0, EFD_CLOEXEC);
  if (::bind(listener, reinterpret_cast<const sockaddr*>(&address), size) < 0 || ::listen(listener, 16) < 0 ||
      ::getsockname(listener, reinterpret_cast<sockaddr*>(&address), &size) < 0 || wake < 0) {
    const auto error = errno == EADDRINUSE
                           ? io::Error{"port " + std::to_string(port) + " of 127.0.0.1 is taken: give another, or none"}
                           : failed("cannot listen on");
    ::close(listener);
    if (wake >= 0) ::close(wake);
    return error;
  }
  return std::unique_ptr<LoopbackServer>(
      new LoopbackServer(listener, wake, ntohs(address.sin_port), std::move(answer)));
}

LoopbackServer::LoopbackServer(int listener, int wake, int port, Answer answer)
    : listener_(listener), wake_(wake), port_(port), answer_(std::move(answer)), thread_([this] { serve(); }) {}

LoopbackServer::~LoopbackServer() {
  const uint64_t one = 1;
  while (::write(wake_, &one, sizeof one) < 0 && errno == EINTR) continue;
  thread_.join();
  ::close(listener_);
  ::close(wake_);
}

bool LoopbackServer::is_our_host(std::string_view host) const {
  const std::string port = ":" + std::to_string(port_);
  const auto is = [&](const std::string& name) { return host == name + port || (port_ == 80 && host == name); };
  return is("127.0.0.1") || is("localhost");
}

Response LoopbackServer::answer_to(const std::string& head) const {
  Request request;
  if (!parse_head(head, request)) return {.status = 400, .body = "this is no HTTP\n"};
  const auto host = request.headers.find("host");
  if (host == request.headers.end() || !is_our_host(host->second))
    return {.status = 403, .body = "this server is for 127.0.0.1 alone\n"};
  const auto origin = request.headers.find("origin");
  constexpr std::string_view kScheme = "http://";
  if (origin != request.headers.end() && (!std::string_view(origin->second).starts_with(kScheme) ||
                                          !is_our_host(std::string_view(origin->second).substr(kScheme.size()))))
    return {.status = 403, .body = "another page's requests are not answered\n"};
  if (request.method != "GET" && request.method != "POST") return {.status = 405, .body = "GET or POST\n"};
  try {
    return answer_(request);
  } catch (const std::exception& error) {
    return {.status = 500, .body = std::string(error.what()) + "\n"};
  }
}

void LoopbackServer::serve() {
  std::list<Connection> connections;
  const auto close_all = [&] {
    for (const Connection& c : connections) ::close(c.socket);
  };
  while (true) {
    std::vector<pollfd> waits{{wake_, POLLIN, 0}, {listener_, POLLIN, 0}};
    for (const Connection& c : connections)
      waits.push_back({c.socket, static_cast<short>(c.is_read ? POLLOUT : POLLIN), 0});
    // Where nobody is connected, nothing is to be done until somebody is.
    const int ready = ::poll(waits.data(), waits.size(), connections.empty() ? -1 : 1000);
    if (ready < 0 && errno != EINTR) return close_all();
    if ((waits[0].revents & POLLIN) != 0) return close_all();
    size_t k = 2;
    for (auto c = connections.begin(); c != connections.end(); ++k) {
      bool over = Clock::now() - c->since > kPatience;
      const short events = waits[k].revents;
      if (!over && !c->is_read && events != 0) {
        char part[4096];
        const ssize_t count = ::recv(c->socket, part, sizeof part, 0);
        if (count > 0) c->in.append(part, static_cast<size_t>(count));
        over = count == 0 || (count < 0 && errno != EAGAIN && errno != EINTR);
        const size_t end = c->in.find("\r\n\r\n");
        c->is_read = end != std::string::npos || c->in.size() > kMaxHead;
        // What follows the head is not looked at: no request here has a body that says anything.
        if (c->is_read)
          c->out = wire(end < kMaxHead ? answer_to(c->in.substr(0, end + 2))
                                       : Response{.status = 431, .body = "the request is too long\n"});
      }
      if (!over && c->is_read) {
        const ssize_t count = ::send(c->socket, c->out.data() + c->sent, c->out.size() - c->sent, MSG_NOSIGNAL);
        if (count > 0) c->sent += static_cast<size_t>(count), c->since = Clock::now();
        over = c->sent == c->out.size() || (count < 0 && errno != EAGAIN && errno != EINTR);
      }
      if (over) {
        ::shutdown(c->socket, SHUT_WR);
        ::close(c->socket);
        c = connections.erase(c);
      } else {
        ++c;
      }
    }
    if ((waits[1].revents & POLLIN) == 0) continue;
    const int socket = ::accept4(listener_, nullptr, nullptr, SOCK_NONBLOCK | SOCK_CLOEXEC);
    if (socket < 0) continue;
    if (connections.size() < kMaxConnections) {
      connections.emplace_back().socket = socket;
    } else {
      ::close(socket);
    }
  }
}

}  // namespace dr::watch
