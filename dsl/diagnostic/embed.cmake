# SPDX-License-Identifier: Apache-2.0
# Makes a text a C++ string literal: cmake -DTEXT=explanations.md -DOUTPUT=explanations.inc -P embed.cmake
file(READ ${TEXT} text)
file(WRITE ${OUTPUT}.new "R\"embedded(${text})embedded\"\n")
file(RENAME ${OUTPUT}.new ${OUTPUT})
