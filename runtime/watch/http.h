// SPDX-License-Identifier: Apache-2.0
// As much of HTTP/1.1 as a page on this machine needs: a server on the loopback address, one thread that sleeps until
// somebody asks, an answer for each connection. A library would bring a pool of threads, TLS and a shared library that
// the Python package would then need wherever it goes.
#pragma once

#include <functional>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <thread>

#include "compiler/io/file/result.h"

namespace dr::watch {

struct Request {
  std::string method, path;
  std::map<std::string, std::string, std::less<>> query;
  std::map<std::string, std::string, std::less<>> headers;  // by names in lower case
};

struct Response {
  int status = 200;
  std::string type = "text/plain; charset=utf-8";
  std::string body = {};
  std::string headers = {};  // more of them, each line ended
};

class LoopbackServer {
 public:
  using Answer = std::function<Response(const Request&)>;
  // `answer` is called by the server's thread, for requests to this host alone: a page of another name that a name
  // server leads here is refused. Port 0 is any that is free.
  static io::Result<std::unique_ptr<LoopbackServer>> open(int port, Answer answer);
  ~LoopbackServer();
  LoopbackServer(const LoopbackServer&) = delete;
  LoopbackServer& operator=(const LoopbackServer&) = delete;
  int port() const { return port_; }

 private:
  LoopbackServer(int listener, int wake, int port, Answer answer);
  void serve();
  Response answer_to(const std::string& head) const;
  bool is_our_host(std::string_view host) const;

  int listener_, wake_, port_;
  Answer answer_;
  std::thread thread_;
};

}  // namespace dr::watch
