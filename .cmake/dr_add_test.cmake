# SPDX-License-Identifier: Apache-2.0
# How a folder under tests/ adds its tests.

# dr_add_test(NAME LABEL unit SOURCES a.cpp ... LINK dr_dsl ...) makes a Catch2 executable of that name and one ctest
# entry, LABEL/NAME. The sources see the tree as DR_SOURCE_DIR and the build folder as DR_BUILD_DIR.
# A test that exits with 77 counts as skipped.
function(dr_add_test name)
  cmake_parse_arguments(PARSE_ARGV 1 test "" "LABEL" "SOURCES;LINK")
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
  target_link_libraries(${name} PRIVATE dr_include dr_warnings Catch2::Catch2WithMain ${test_LINK})
  target_compile_definitions(${name} PRIVATE
    DR_SOURCE_DIR="${PROJECT_SOURCE_DIR}"
    DR_BUILD_DIR="${PROJECT_BINARY_DIR}")
  set_target_properties(${name} PROPERTIES RUNTIME_OUTPUT_DIRECTORY ${PROJECT_BINARY_DIR}/bin/tests)
  add_test(NAME ${test_LABEL}/${name} COMMAND ${name} WORKING_DIRECTORY ${PROJECT_BINARY_DIR})
  # Software devices compile shaders at their first draw, which two tests at a time on a cold machine make slow.
  set(timeout 300)
  if(test_LABEL MATCHES "^(device|stress)$")
    set(timeout 1200)
  endif()
  set_tests_properties(${test_LABEL}/${name} PROPERTIES
    LABELS ${test_LABEL} TIMEOUT ${timeout} SKIP_RETURN_CODE 77)
endfunction()
