# SPDX-License-Identifier: Apache-2.0
# Writes OUTPUT from VERSION and the commit of SOURCE; run by cmake -P (see version.cmake).
set(commit "")
if(GIT AND EXISTS ${SOURCE}/.git)
  execute_process(COMMAND ${GIT} log -1 --format=%h\ %cs WORKING_DIRECTORY ${SOURCE}
    OUTPUT_VARIABLE commit OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET)
endif()
if(NOT commit)
  file(STRINGS ${SOURCE}/.cmake/commit.txt commit LIMIT_COUNT 1)
  if(commit MATCHES "^.Format")  # as it stands in the tree
    set(commit "")
  endif()
endif()
if(commit)
  string(REPLACE " " ", " commit "${commit}")
  set(text "${VERSION} (commit ${commit})")
else()
  set(text "${VERSION} (no commit known)")
endif()
file(WRITE ${OUTPUT} "#include \"version_generated.h\"\nnamespace dr {\nconst char* version() { return \"${text}\"; }\n}\n")
