// SPDX-License-Identifier: Apache-2.0
// Messages of JSON-RPC 2.0 with the header of the Language Server Protocol, from a stream and to one.
#pragma once

#include <chrono>
#include <condition_variable>
#include <deque>
#include <istream>
#include <mutex>
#include <nlohmann/json.hpp>
#include <optional>
#include <ostream>
#include <set>
#include <string>

namespace dr::language_server {

using Json = nlohmann::json;

// Codes of the protocol.
enum class Failure : int {
  ParseError = -32700,
  InvalidRequest = -32600,
  MethodNotFound = -32601,
  InvalidParams = -32602,
  InternalError = -32603,
  ServerNotInitialized = -32002,
  RequestCancelled = -32800,
};

// The text of the next message; nothing at the end of the stream. What is no header is skipped.
std::optional<std::string> read_message(std::istream& in);
void write_message(std::ostream& out, const Json& message);

// Messages that one thread reads and another one answers.
class Inbox {
 public:
  // Reads until the stream ends or says `exit`. A request that is cancelled is remembered at once.
  void read_all(std::istream& in);

  // The next message, in the order sent; nothing if none comes in time, or none will.
  std::optional<Json> take(std::optional<std::chrono::milliseconds> wait);
  bool closed();                        // no more will come, and none is left
  bool waiting();                       // whether a message is there
  bool take_cancelled(const Json& id);  // and forgets it
  bool cancelled(const Json& id);

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<Json> messages_;
  std::set<std::string> cancelled_;
  bool ended_ = false;
};

}  // namespace dr::language_server
