// SPDX-License-Identifier: Apache-2.0
// The one place that includes Catch2: its headers move between versions 2 and 3. `main` comes from the library.
#pragma once

#include <catch2/catch.hpp>
