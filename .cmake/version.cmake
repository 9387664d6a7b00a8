# SPDX-License-Identifier: Apache-2.0
# dr_version: what --version says, "0.2.0 (commit 1a2b3c4d5, 2026-01-31)". The commit is looked up when the head moves, in a
# file of its own, so that a commit costs one small compilation and the links of the commands. A tree without git has what
# `git archive` wrote into .cmake/commit.txt, or no commit.
find_package(Git QUIET)
set(version_cpp ${CMAKE_CURRENT_BINARY_DIR}/version.cpp)
set(head)
if(GIT_FOUND)
  # Of a worktree, too. The log of the head grows with each commit and checkout.
  execute_process(COMMAND ${GIT_EXECUTABLE} rev-parse --git-path logs/HEAD WORKING_DIRECTORY ${PROJECT_SOURCE_DIR}
    OUTPUT_VARIABLE head OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET)
  if(head)
    cmake_path(ABSOLUTE_PATH head BASE_DIRECTORY ${PROJECT_SOURCE_DIR} NORMALIZE)
  endif()
  if(NOT EXISTS "${head}")
    set(head)
  endif()
endif()
add_custom_command(
  OUTPUT ${version_cpp}
  COMMAND ${CMAKE_COMMAND} -DVERSION=${PROJECT_VERSION} -DSOURCE=${PROJECT_SOURCE_DIR} -DGIT=${GIT_EXECUTABLE}
    -DOUTPUT=${version_cpp} -P ${PROJECT_SOURCE_DIR}/.cmake/write_version.cmake
  DEPENDS ${head} ${PROJECT_SOURCE_DIR}/.cmake/write_version.cmake ${PROJECT_SOURCE_DIR}/.cmake/commit.txt
    ${PROJECT_SOURCE_DIR}/CMakeLists.txt
  COMMENT "Looking up the commit"
  VERBATIM)
add_library(dr_version STATIC ${version_cpp})
file(CONFIGURE OUTPUT ${CMAKE_CURRENT_BINARY_DIR}/version/version_generated.h CONTENT
  "// Made by .cmake/version.cmake.\n#pragma once\nnamespace dr {\nconst char* version();\n}\n")
target_include_directories(dr_version PUBLIC ${CMAKE_CURRENT_BINARY_DIR}/version)
