// SPDX-License-Identifier: Apache-2.0
// Names of element types.
#include "compiler/ir/type.h"

#include "tests/catch.h"

using namespace dr::ir;

TEST_CASE("types have GLSL's names") {
  CHECK(kFloat.str() == "float");
  CHECK(vec(3).str() == "vec3");
  CHECK(vec(2, Scalar::Bool).str() == "bvec2");
  CHECK(vec(4, Scalar::Int).str() == "ivec4");
  CHECK(vec(4, Scalar::Uint).str() == "uvec4");
  CHECK(Type{Scalar::Float, 3, 3}.str() == "mat3");
  CHECK(Type{Scalar::Float, 3, 2}.str() == "mat2x3");
}

TEST_CASE("every type's name parses back") {
  for (Scalar scalar : {Scalar::Bool, Scalar::Int, Scalar::Uint, Scalar::Float}) {
    for (uint8_t rows = 1; rows <= 4; ++rows) {
      for (uint8_t cols = 1; cols <= (scalar == Scalar::Float && rows > 1 ? 4 : 1); ++cols) {
        const Type type{scalar, rows, cols};
        INFO(type.str());
        CHECK(Type::parse(type.str()) == type);
      }
    }
  }
  CHECK(Type::parse("mat3x3") == Type{Scalar::Float, 3, 3});
}

TEST_CASE("other words are no types") {
  for (const char* word : {"", "vec", "vec1", "vec5", "vec33", "mat", "mat1", "mat2x", "mat2y3", "mat2x5", "imat2",
                           "Float", "float2", "double"}) {
    INFO(word);
    CHECK_FALSE(Type::parse(word));
  }
}
