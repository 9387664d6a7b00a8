// SPDX-License-Identifier: Apache-2.0
#include "dsl/diagnostic/foreign_words.h"

#include <span>
#include <utility>

namespace dr::dsl {

namespace {

using Row = std::pair<std::string_view, const char*>;

const char* find(std::span<const Row> rows, std::string_view word) {
  for (const auto& [known, help] : rows)
    if (known == word) return help;
  return nullptr;
}

constexpr const char* kLoop =
    "write 'for k in 0..N { ...; break if !condition; }', where N is the most trips that there can be";
constexpr const char* kChoice = "write 'if a { } else if b { } else { }'";
constexpr const char* kFunction = "write 'fn f(x) { ... }' outside of functions";
constexpr const char* kVariable = "write 'let' or 'var' and the name";
constexpr const char* kPrint = "write 'output name = value;' in a step: numbers and vectors are printed";

constexpr Row kStatements[] = {
    {"while", kLoop},
    {"loop", "write 'for k in 0..N { ...; break if condition; }', where N is the most trips that there can be"},
    {"do", kLoop},
    {"switch", kChoice},
    {"match", kChoice},
    {"elif", "write 'else if'"},
    {"continue", "write what is left out as the block of an 'if'"},
    {"def", kFunction},
    {"function", kFunction},
    {"func", kFunction},
    {"float", kVariable},
    {"int", kVariable},
    {"bool", kVariable},
    {"vec2", kVariable},
    {"vec3", kVariable},
    {"vec4", kVariable},
    {"auto", kVariable},
    {"print", kPrint},
    {"printf", kPrint}};

constexpr const char* kInStep = "statements stand in a function or a step: write 'step fit { ... }'";
constexpr const char* kItem = "write 'let name = value;', or 'param name : float;' for what is sought";
constexpr const char* kData = "write 'input name : vec3[W, H];' for what the host binds";
constexpr const char* kImport = "write 'import std.name;'";

constexpr Row kDeclarations[] = {{"def", "write 'fn f(x) { ... }'"},
                                 {"function", "write 'fn f(x) { ... }'"},
                                 {"func", "write 'fn f(x) { ... }'"},
                                 {"void", "write 'fn f(x) { ... }'"},
                                 {"class", "write 'struct Name { field: vec3; }'"},
                                 {"type", "write 'struct Name { field: vec3; }'"},
                                 {"include", kImport},
                                 {"from", kImport},
                                 {"use", kImport},
                                 {"using", kImport},
                                 {"float", kItem},
                                 {"int", kItem},
                                 {"bool", kItem},
                                 {"vec2", kItem},
                                 {"vec3", kItem},
                                 {"vec4", kItem},
                                 {"mat3", kItem},
                                 {"mat4", kItem},
                                 {"auto", kItem},
                                 {"uniform", kData},
                                 {"attribute", kData},
                                 {"varying", kData},
                                 {"in", kData},
                                 {"out", "write 'output name = value;' in a step"},
                                 {"print", kPrint},
                                 {"while", kInStep}};

constexpr Row kOperators[] = {
    {"and", "write '&&'"}, {"or", "write '||'"}, {"not", "write '!'"}, {"is", "write '=='"}, {"mod", "write '%'"}};

constexpr const char* kFill =
    "write the number: it stretches to the extents beside it, as in 'param x : float[N] = 0.0;'";
constexpr const char* kPlaces = "write coord(N).x for the numbers 0, 1, …, as an image, and 'for k in 0..N' for a loop";
constexpr const char* kChoose =
    "write 'if condition { a } else { b }', or select(condition, a, b), which computes both";
constexpr const char* kTexture = "write sample(image, uv), or image.at(ivec2(x, y)) for one element";
constexpr const char* kPlain = "functions stand by themselves here: write sum(x), sqrt(x), grad(y, x)";
constexpr const char* kSize = "write x.width, x.height and x.layers";
constexpr const char* kJoin = "choose by place: let i = coord(A + B).x; if i < A { a.at(i) } else { b.at(i - A) }";
constexpr const char* kRandom = "write 'import std.random;' above and random.uniform(coord(N), 1u), or random.normal";
constexpr const char* kTurn = "read it at turned places: let p = coord(H, W); x.at(ivec2(p.y, p.x))";

constexpr Row kForeignNames[] = {
    {"zeros", kFill},
    {"zeros_like", kFill},
    {"ones", kFill},
    {"ones_like", kFill},
    {"full", kFill},
    {"arange", kPlaces},
    {"range", kPlaces},
    {"linspace", kPlaces},
    {"meshgrid", "write coord(W, H), the column and row of each element"},
    {"len", kSize},
    {"shape", kSize},
    {"size", kSize},
    {"norm", "write length(v) for vectors, and sqrt(sum(x * x)) for the elements of an image"},
    {"where", kChoose},
    {"lerp", "write mix(a, b, t)"},
    {"clip", "write clamp(x, low, high)"},
    {"rsqrt", "write inversesqrt(x)"},
    {"atan2", "write atan(y, x)"},
    {"frac", "write fract(x)"},
    {"mul", "write a * b"},
    {"matvec", "write m * v"},
    {"einsum", "write reduce(sum, k in 0..K) { ... }, or nn.matmul of std.nn"},
    {"argmax", "write reduce(argmin, k in 0..N) { -x.at(k) }"},
    {"cumsum", "write scan(k in 0..N, s = 0.0) { s + x.at(k) }"},
    {"concat", kJoin},
    {"concatenate", kJoin},
    {"cat", kJoin},
    {"stack", kJoin},
    {"ddx", "write shift(x, 1, 0) - x, the difference to the element on the right"},
    {"dFdx", "write shift(x, 1, 0) - x, the difference to the element on the right"},
    {"ddy", "write shift(x, 0, 1) - x, the difference to the element below"},
    {"dFdy", "write shift(x, 0, 1) - x, the difference to the element below"},
    {"texture", kTexture},
    {"textureLod", kTexture},
    {"texelFetch", kTexture},
    {"tex2D", kTexture},
    {"rand", kRandom},
    {"randn", kRandom},
    {"stop_gradient", "write detach(x)"},
    {"gradient", "write grad(y, x)"},
    {"backward", "write grad(y, x)"},
    {"lambda", "write fn(x) { ... }"},
    {"float2", "write vec2"},
    {"float3", "write vec3"},
    {"float4", "write vec4"},
    {"float4x4", "write mat4"},
    {"float3x3", "write mat3"},
    {"int2", "write ivec2"},
    {"int3", "write ivec3"},
    {"double", "write float: 32 bits on devices, 64 in 'drc eval'"},
    {"True", "write true"},
    {"False", "write false"},
    {"print", kPrint},
    {"np", kPlain},
    {"numpy", kPlain},
    {"jnp", kPlain},
    {"torch", kPlain},
    {"math", kPlain},
    {"std", "write 'import std.image;' above, and then image.blur(...)"}};

constexpr Row kFields[] = {{"shape", kSize},        {"size", kSize},        {"length", kSize},
                           {"W", "write x.width"},  {"w", "write x.width"}, {"H", "write x.height"},
                           {"h", "write x.height"}, {"T", kTurn},           {"get", "write x.at(i)"}};

}  // namespace

const char* instead_of_statement(std::string_view word) { return find(kStatements, word); }
const char* instead_of_declaration(std::string_view word) { return find(kDeclarations, word); }
const char* instead_of_operator(std::string_view word) { return find(kOperators, word); }
const char* instead_of_name(std::string_view word) { return find(kForeignNames, word); }
const char* instead_of_field(std::string_view word) { return find(kFields, word); }

}  // namespace dr::dsl
