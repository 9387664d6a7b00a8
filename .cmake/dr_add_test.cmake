# SPDX-License-Identifier: Apache-2.0
# How a folder under tests/ adds its tests.

# What takes time in a test is the code under test: its own is compiled in 60% of the time of -O2.
add_library(dr_test_options INTERFACE)
target_compile_options(dr_test_options INTERFACE $<$<CONFIG:Release>:-Og> $<$<BOOL:${DR_SANITIZED}>:-O0>)

# A quarter of what is left goes into the same headers in each of them. Builds from scratch parse them once; in a person's
# build, a file that forgets to include what it uses does not compile.
if(CMAKE_UNITY_BUILD)
  file(CONFIGURE OUTPUT ${PROJECT_BINARY_DIR}/precompiled.cpp CONTENT "")
  add_library(dr_precompiled OBJECT ${PROJECT_BINARY_DIR}/precompiled.cpp)
  target_link_libraries(dr_precompiled PRIVATE dr_include dr_test_options Catch2::Catch2)
  # As the executables that use it.
  set_target_properties(dr_precompiled PROPERTIES POSITION_INDEPENDENT_CODE OFF)
  target_precompile_headers(dr_precompiled PRIVATE ${PROJECT_SOURCE_DIR}/tests/catch.h
    <algorithm> <charconv> <cmath> <filesystem> <fstream> <functional> <map> <optional> <random> <ranges> <set> <span> <sstream>
    <string> <string_view> <variant> <vector>)
endif()

# dr_add_test(NAME LABEL unit SOURCES a.cpp ... LINK dr_dsl ...) makes a Catch2 executable of that name and one ctest
# entry, LABEL/NAME. The sources see the tree as DR_SOURCE_DIR and the build folder as DR_BUILD_DIR.
# A test that exits with 77 counts as skipped. SYSTEM_ALLOCATOR is for tests that look at what is allocated; others take
# a tenth less time with the one of the commands, which keeps what is freed.
function(dr_add_test name)
  cmake_parse_arguments(PARSE_ARGV 1 test "SYSTEM_ALLOCATOR" "LABEL" "SOURCES;LINK")
  if(test_UNPARSED_ARGUMENTS OR NOT test_SOURCES OR NOT test_LABEL MATCHES "^(unit|golden|gradient|device|stress|fuzz)$")
    message(FATAL_ERROR "dr_add_test(${name}): LABEL unit|golden|gradient|device|stress|fuzz, SOURCES and LINK are expected")
  endif()
  foreach(library IN LISTS test_LINK)
    if(library MATCHES "^dr_" AND NOT TARGET ${library})
      # Absent on purpose in a partial build; in a whole one a misspelt name must not cost a test.
      if(NOT DR_IS_PARTIAL)
        message(FATAL_ERROR "dr_add_test(${name}): there is no target ${library}")
      endif()
      message(STATUS "${test_LABEL}/${name} is left out: ${library} is not built")
      return()
    endif()
  endforeach()
  add_executable(${name} ${test_SOURCES})
  target_link_libraries(${name} PRIVATE dr_include dr_warnings dr_test_options Catch2::Catch2WithMain ${test_LINK})
  target_compile_definitions(${name} PRIVATE
    DR_SOURCE_DIR="${PROJECT_SOURCE_DIR}"
    DR_BUILD_DIR="${PROJECT_BINARY_DIR}")
  if(NOT test_SYSTEM_ALLOCATOR)
    target_link_libraries(${name} PRIVATE dr_allocator)
  endif()
  if(TARGET dr_precompiled)
    target_precompile_headers(${name} REUSE_FROM dr_precompiled)
  endif()
  set_target_properties(${name} PROPERTIES
    RUNTIME_OUTPUT_DIRECTORY ${PROJECT_BINARY_DIR}/bin/tests POSITION_INDEPENDENT_CODE OFF)
  add_test(NAME ${test_LABEL}/${name} COMMAND ${name} WORKING_DIRECTORY ${PROJECT_BINARY_DIR})
  # Software devices compile shaders at their first draw, which two tests at a time on a cold machine make slow.
  set(timeout 300)
  if(test_LABEL MATCHES "^(device|stress)$")
    set(timeout 1200)
  endif()
  set_tests_properties(${test_LABEL}/${name} PROPERTIES
    LABELS ${test_LABEL} TIMEOUT ${timeout} SKIP_RETURN_CODE 77
    ENVIRONMENT "MIMALLOC_ALLOW_DECOMMIT=0;MIMALLOC_PURGE_DELAY=-1")
endfunction()
