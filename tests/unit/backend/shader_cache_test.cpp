// SPDX-License-Identifier: Apache-2.0
// The shader cache gives back what it was given, and nothing else.
#include "compiler/backend/spirv/shader_cache.h"

#include <cstdlib>
#include <fstream>
#include <thread>

#include "tests/catch.h"

using dr::backend::ShaderCache;
namespace fs = std::filesystem;

namespace {

struct Folder {
  fs::path path = fs::temp_directory_path() / ("dr_cache_test_" + std::to_string(std::rand()));
  Folder() { fs::remove_all(path); }
  ~Folder() { fs::remove_all(path); }
};

std::string read(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

}  // namespace

TEST_CASE("what is stored is found by its key alone") {
  const Folder folder;
  const ShaderCache cache(folder.path);
  CHECK_FALSE(cache.find("a"));
  cache.store("a", {1, 2, 3});
  CHECK(cache.find("a") == std::vector<uint32_t>{1, 2, 3});
  CHECK_FALSE(cache.find("b"));
  cache.store("a", {4});
  CHECK(cache.find("a") == std::vector<uint32_t>{4});
  // Another key whose hash is the same finds the entry and refuses it.
  fs::copy_file(cache.file_of("a"), cache.file_of("b"));
  CHECK_FALSE(cache.find("b"));
}

TEST_CASE("an entry that is cut or changed anywhere is not found") {
  const Folder folder;
  const ShaderCache cache(folder.path);
  cache.store("key", {1, 2, 3});
  const std::string whole = read(cache.file_of("key"));
  for (size_t n = 0; n < whole.size(); ++n) {
    std::ofstream(cache.file_of("key"), std::ios::binary) << whole.substr(0, n);
    CHECK_FALSE(cache.find("key"));
    std::string changed = whole;
    changed[n] = static_cast<char>(changed[n] ^ 0x10);
    std::ofstream(cache.file_of("key"), std::ios::binary) << changed;
    CHECK_FALSE(cache.find("key"));
  }
  cache.store("key", {1, 2, 3});
  CHECK(cache.find("key"));
}

TEST_CASE("what was not used for longest goes when the cache is full") {
  const Folder folder;
  const ShaderCache cache(folder.path);
  const auto ago = [&](const char* key, int hours) {
    fs::last_write_time(cache.file_of(key), fs::file_time_type::clock::now() - std::chrono::hours(hours));
  };
  for (const char* key : {"a", "b", "c"}) cache.store(key, std::vector<uint32_t>(100));
  ago("a", 3), ago("b", 2), ago("c", 1);
  CHECK(cache.find("a"));  // used again
  const auto bytes = fs::file_size(cache.file_of("a"));
  cache.trim(3 * bytes);
  CHECK(fs::exists(cache.file_of("b")));
  cache.trim(2 * bytes);
  CHECK_FALSE(fs::exists(cache.file_of("b")));
  CHECK(cache.find("a"));
  CHECK(cache.find("c"));
  cache.trim(0);
  CHECK(fs::is_empty(folder.path));
  ShaderCache({}).trim(0);
}

TEST_CASE("no folder, or one that cannot be made, is no cache") {
  const ShaderCache none{fs::path()};
  none.store("a", {1});
  CHECK_FALSE(none.find("a"));
  const ShaderCache nowhere("/dev/null/cache");
  nowhere.store("a", {1});
  CHECK_FALSE(nowhere.find("a"));
}

TEST_CASE("threads may store at once") {
  const Folder folder;
  const ShaderCache cache(folder.path);
  std::vector<std::thread> threads;
  for (int t = 0; t < 4; ++t)
    threads.emplace_back([&] {
      for (uint32_t k = 0; k < 50; ++k) {
        cache.store(std::to_string(k % 5), {k % 5});
        if (const auto found = cache.find(std::to_string(k % 5))) {
          if (*found != std::vector<uint32_t>{k % 5}) std::abort();
        }
      }
    });
  for (std::thread& t : threads) t.join();
  CHECK(std::distance(fs::directory_iterator(folder.path), {}) == 5);
}

TEST_CASE("the folder comes from the environment") {
  const auto set = [](const char* name, const char* value) { value ? setenv(name, value, 1) : unsetenv(name); };
  set("DRC_CACHE_DIR", "/a");
  set("XDG_CACHE_HOME", "/b");
  set("HOME", "/c");
  CHECK(dr::backend::default_cache_folder() == "/a");
  set("DRC_CACHE_DIR", nullptr);
  CHECK(dr::backend::default_cache_folder() == "/b/dressi");
  set("XDG_CACHE_HOME", "relative");
  CHECK(dr::backend::default_cache_folder() == "/c/.cache/dressi");
  set("HOME", nullptr);
  CHECK(dr::backend::default_cache_folder().empty());
}
