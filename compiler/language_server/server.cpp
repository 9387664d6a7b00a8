// SPDX-License-Identifier: Apache-2.0
// One thread reads, this one answers in the order asked. A text is read anew when it has changed: at once where an
// answer needs it, else when the person pauses, to tell what is wrong. Lowering gives way to what comes in meanwhile.
#include "compiler/language_server/server.h"

#include <algorithm>
#include <chrono>
#include <memory>
#include <optional>
#include <stdexcept>
#include <thread>

#include "compiler/language_server/answers.h"
#include "compiler/language_server/library_files.h"
#include "compiler/language_server/protocol.h"
#include "dsl/format/format.h"

namespace dr::language_server {
namespace {

using Clock = std::chrono::steady_clock;
using std::chrono::milliseconds;

constexpr milliseconds kPause{150};       // after the last change, before texts are checked
constexpr milliseconds kAnswerTime{300};  // that lowering may take for an answer; it then tells what it found so far

struct RequestError : std::runtime_error {
  RequestError(Failure failure, const std::string& message) : std::runtime_error(message), code(failure) {}
  Failure code;
};

struct Document {
  std::string text;
  Json version;
  std::shared_ptr<const Analysis> analysis;  // of this text; null: it has changed
  bool is_checked = false;                   // whether its messages have been told
};

class Server {
 public:
  Server(std::ostream& out, Inbox& inbox, const ServerOptions& options)
      : out_(out), inbox_(inbox), include_dirs_(options.include_dirs), defines_(options.defines), options_(options) {}

  bool run() {
    while (!exit_ && !inbox_.closed()) {
      const bool has_work = !shut_down_ && unchecked() != nullptr;
      const auto message = inbox_.take(has_work ? std::optional(time_left()) : std::nullopt);
      if (message) {
        receive(*message);
      } else if (has_work && time_left() <= milliseconds(0)) {
        check(*unchecked());
      }
    }
    return shut_down_;
  }

 private:
  // ---- messages ----

  void receive(const Json& message) {
    const Json id = message.is_object() ? message.value("id", Json()) : Json();
    const bool is_id = id.is_string() || id.is_number_integer();
    if (!message.is_object()) return fail(nullptr, Failure::ParseError, "expected a JSON object");
    const Json method = message.value("method", Json());
    if (!method.is_string()) {
      // An answer to something that was never asked is nobody's.
      const bool is_answer = message.contains("result") || message.contains("error");
      if (!is_answer) fail(is_id ? id : Json(), Failure::InvalidRequest, "expected a method");
      return;
    }
    const Json params = message.value("params", Json::object());
    const auto& name = method.get_ref<const std::string&>();
    if (!message.contains("id")) return notify(name, params);
    if (!is_id) return fail(nullptr, Failure::InvalidRequest, "expected a number or a string as id");
    if (inbox_.take_cancelled(id)) return fail(id, Failure::RequestCancelled, "cancelled");
    try {
      request_ = id;
      Json result = answer(name, params);
      request_ = nullptr;
      if (inbox_.take_cancelled(id)) return fail(id, Failure::RequestCancelled, "cancelled");
      write_message(out_, {{"jsonrpc", "2.0"}, {"id", id}, {"result", std::move(result)}});
    } catch (const RequestError& error) {
      fail(id, error.code, error.what());
    } catch (const Json::exception& error) {
      fail(id, Failure::InvalidParams, error.what());
    } catch (const std::exception& error) {
      fail(id, Failure::InternalError, error.what());
    }
    request_ = nullptr;
  }

  void fail(const Json& id, Failure code, const std::string& message) {
    write_message(
        out_, {{"jsonrpc", "2.0"}, {"id", id}, {"error", {{"code", static_cast<int>(code)}, {"message", message}}}});
  }

  Json answer(const std::string& method, const Json& params) {
    if (method == "initialize") return initialize(params);
    if (!initialized_)
      throw RequestError(Failure::ServerNotInitialized, "expected 'initialize' before '" + method + "'");
    if (shut_down_) throw RequestError(Failure::InvalidRequest, "the server has been shut down");
    if (method == "shutdown") {
      shut_down_ = true;
      return nullptr;
    }
    if (method == "textDocument/formatting") return format(params);
    const bool is_known =
        method == "textDocument/hover" || method == "textDocument/definition" || method == "textDocument/completion";
    if (!is_known) throw RequestError(Failure::MethodNotFound, "unknown method '" + method + "'");
    const std::string uri = params.at("textDocument").at("uri").get<std::string>();
    const auto analysis = analysed(uri, document(uri));
    const uint32_t offset = analysis->lines().offset(place(params.at("position")));
    if (method == "textDocument/hover") return hover(*analysis, offset);
    if (method == "textDocument/definition") return definition(*analysis, offset, options_.library_folder);
    return complete(uri, *analysis, offset);
  }

  // A notification has no answer, so what is wrong with it cannot be told.
  void notify(const std::string& method, const Json& params) {
    if (method == "exit") {
      exit_ = true;
      return;
    }
    if (!initialized_ || shut_down_) return;
    try {
      const Json text = params.is_object() ? params.value("textDocument", Json::object()) : Json::object();
      if (method == "textDocument/didOpen") {
        const std::string uri = text.at("uri").get<std::string>();
        documents_[uri] = {text.at("text").get<std::string>(), text.value("version", Json()), nullptr, false};
        changed(uri);
      } else if (method == "textDocument/didChange") {
        change(text, params.at("contentChanges"));
      } else if (method == "textDocument/didClose") {
        const std::string uri = text.at("uri").get<std::string>();
        if (documents_.erase(uri) == 0) return;
        write_message(out_, publish(uri, Json(), Json::array()));
        changed(uri);
      } else if (method == "textDocument/didSave" || method == "workspace/didChangeWatchedFiles") {
        for (auto& [uri, document] : documents_) document.analysis = nullptr, document.is_checked = false;
        due_ = Clock::now();
      }
    } catch (const Json::exception&) {  // NOLINT(bugprone-empty-catch)
    } catch (const RequestError&) {     // NOLINT(bugprone-empty-catch)
    }
  }

  Json initialize(const Json& params) {
    if (initialized_) throw RequestError(Failure::InvalidRequest, "expected 'initialize' once");
    initialized_ = true;
    const Json wishes = params.is_object() ? params.value("initializationOptions", Json()) : Json();
    if (wishes.is_object()) {
      const Json folders = wishes.value("includeDirs", Json::array());
      for (const Json& folder : folders)
        if (folder.is_string()) include_dirs_.push_back(folder.get<std::string>());
      const Json defines = wishes.value("defines", Json::object());
      for (const auto& [name, value] : defines.items())
        if (value.is_string() || value.is_number() || value.is_boolean())
          defines_[name] = value.is_string() ? value.get<std::string>() : value.dump();
    }
    return {{"capabilities",
             {{"textDocumentSync", {{"openClose", true}, {"change", 2}, {"save", true}}},
              {"hoverProvider", true},
              {"definitionProvider", true},
              {"completionProvider", {{"triggerCharacters", {"."}}}},
              {"documentFormattingProvider", true},
              {"positionEncoding", "utf-16"}}},
            {"serverInfo", {{"name", "drc"}, {"version", options_.version}}}};
  }

  // ---- texts ----

  static Place place(const Json& json) {
    const auto number = [&](const char* name) {
      const Json& value = json.at(name);
      if (value.is_number_float()) throw RequestError(Failure::InvalidParams, "expected an integer as position");
      return static_cast<uint32_t>(std::clamp<int64_t>(value.get<int64_t>(), 0, UINT32_MAX));
    };
    return {number("line"), number("character")};
  }

  Document& document(const std::string& uri) {
    const auto found = documents_.find(uri);
    if (found == documents_.end()) throw RequestError(Failure::InvalidParams, "no text is open as '" + uri + "'");
    return found->second;
  }

  void change(const Json& id, const Json& changes) {
    const std::string uri = id.at("uri").get<std::string>();
    const auto found = documents_.find(uri);
    if (found == documents_.end()) return;
    Document& document = found->second;
    document.version = id.value("version", Json());
    for (const Json& one : changes) {
      const auto& text = one.at("text").get_ref<const std::string&>();
      if (!one.contains("range") || one["range"].is_null()) {
        document.text = text;
        continue;
      }
      const Lines lines(document.text);
      const uint32_t begin = lines.offset(place(one["range"].at("start")));
      const uint32_t end = std::max(begin, lines.offset(place(one["range"].at("end"))));
      document.text.replace(begin, end - begin, text);
    }
    changed(uri);
  }

  // The texts that have to be read again: this one, and those that read it or would have.
  void changed(const std::string& uri) {
    const std::string path = is_file_uri(uri) ? whole_path(path_of_uri(uri)) : "";
    for (auto& [other, document] : documents_) {
      if (other != uri && document.analysis && !document.analysis->looked_for(path)) continue;
      document.analysis = nullptr;
      document.is_checked = false;
    }
    due_ = Clock::now() + kPause;
  }

  AnalysisOptions analysis_options(std::function<bool()> stop) {
    AnalysisOptions options;
    options.include_dirs = include_dirs_;
    options.defines = defines_;
    options.stop = std::move(stop);
    options.read = [this](const std::string& path) -> std::optional<std::string> {
      for (const auto& [uri, document] : documents_)
        if (is_file_uri(uri) && whole_path(path_of_uri(uri)) == path) return document.text;
      return std::nullopt;
    };
    return options;
  }

  std::function<bool()> until_answer_is_due() {
    return [this, end = Clock::now() + kAnswerTime] { return Clock::now() > end || inbox_.cancelled(request_); };
  }

  std::shared_ptr<const Analysis> analysed(const std::string& uri, Document& document) {
    if (!document.analysis)
      document.analysis = std::make_shared<Analysis>(uri, document.text, analysis_options(until_answer_is_due()));
    return document.analysis;
  }

  // ---- messages about texts ----

  std::pair<const std::string, Document>* unchecked() {
    const auto found = std::ranges::find_if(documents_, [](const auto& one) { return !one.second.is_checked; });
    return found == documents_.end() ? nullptr : &*found;
  }

  milliseconds time_left() const {
    return std::max(milliseconds(0), std::chrono::duration_cast<milliseconds>(due_ - Clock::now()));
  }

  static Json publish(const std::string& uri, const Json& version, Json found) {
    Json params = {{"uri", uri}, {"diagnostics", std::move(found)}};
    if (version.is_number_integer()) params["version"] = version;
    return {{"jsonrpc", "2.0"}, {"method", "textDocument/publishDiagnostics"}, {"params", std::move(params)}};
  }

  void check(std::pair<const std::string, Document>& entry) {
    auto& [uri, document] = entry;
    const std::string path = path_of_uri(uri);
    // The library's own texts may say what no program may, and nobody can change them.
    const bool is_library = module_of_file(options_.library_folder, path).has_value();
    if (!document.analysis || !document.analysis->is_whole()) {
      document.analysis =
          std::make_shared<Analysis>(uri, document.text, analysis_options([this] { return inbox_.waiting(); }));
    }
    // Something came in: it goes first, and this again when nothing comes.
    if (!document.analysis->is_whole()) {
      due_ = Clock::now() + kPause;
      return;
    }
    document.is_checked = true;
    const Json found = is_library ? Json::array() : diagnostics(*document.analysis, options_.library_folder);
    write_message(out_, publish(uri, document.version, found));
  }

  // ---- answers ----

  Json complete(const std::string& uri, const Analysis& analysis, uint32_t offset) {
    std::vector<std::string> folders = include_dirs_;
    const std::string own = std::filesystem::path(path_of_uri(uri)).parent_path().string();
    folders.insert(folders.begin(), own.empty() ? "." : own);
    return completion(analysis, offset, folders, [&](std::string text, uint32_t members_at) {
      AnalysisOptions options = analysis_options(until_answer_is_due());
      options.members_at = members_at;
      return Analysis(uri, std::move(text), options);
    });
  }

  // One edit for the whole text, none if nothing changes. A text that does not parse stays as it is.
  Json format(const Json& params) {
    const std::string uri = params.at("textDocument").at("uri").get<std::string>();
    const Document& document = this->document(uri);
    dsl::SourceManager sources;
    dsl::DiagnosticList found;
    const dsl::FormatResult result = dsl::format_source(sources, sources.add(path_of_uri(uri), document.text), found);
    if (!result.internal_error.empty()) throw std::runtime_error(result.internal_error);
    if (result.has_errors || result.text == document.text) return Json::array();
    const Lines lines(document.text);
    const Json range = range_json(lines, 0, static_cast<uint32_t>(document.text.size()));
    return Json::array({{{"range", range}, {"newText", result.text}}});
  }

  std::ostream& out_;
  Inbox& inbox_;
  std::vector<std::string> include_dirs_;
  std::map<std::string, std::string, std::less<>> defines_;
  const ServerOptions& options_;
  std::map<std::string, Document> documents_;  // by URI
  Clock::time_point due_;                      // when texts are to be checked
  Json request_;                               // that is being answered
  bool initialized_ = false, shut_down_ = false, exit_ = false;
};

}  // namespace

bool serve(std::istream& in, std::ostream& out, const ServerOptions& options) {
  Inbox inbox;
  std::thread reader([&] { inbox.read_all(in); });
  const bool shut_down = Server(out, inbox, options).run();
  reader.join();
  return shut_down;
}

}  // namespace dr::language_server
