#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# A loop that carries values cannot go on in a later dispatch: where a device ends it, the run is an error with its line,
# and below that it is right. usage: long_folds_test.sh DRUN
set -eu  # `yes` ends by a closed pipe
drun=$(readlink -f "$1")
source "$(dirname "${BASH_SOURCE[0]}")/on_lavapipe.sh" "long folds on lavapipe"
cat > data.dr << 'END'
edition 1;
input n : int[V];
let y = fold(k in 0..n, x = 0.0) { x + 1.0 };
step count { output total = sum(y); }
END
cat > extent.dr << 'END'
edition 1;
input a : float[W];
let y = fold(k in 0..W, x = 0.0) { x + a.at(k) };
step count { output y; }
END
for count in 60000 100000; do yes 1 | head -n $count > $count.csv; done
cat > promise.dr << 'END'
edition 1;
param g : float = 0.5;
input n : int[V];
let y = sum(fold(k in 0..n, x = 0.0, max = 20000) { x * 0.5 + g });
step fit { output y;  output slope = grad(y, g); }
END
expect 0 'total = 1005' data.dr --bind 'n=[5, 1000]'
expect 0 'total = 60005' data.dr --bind 'n=[5, 60000]'
expect 1 'data.dr:3' data.dr --bind 'n=[5, 200000]'
expect 0 'y = 60000' extent.dr --bind a=60000.csv
expect 1 'may take 100001 trips' extent.dr --bind a=100000.csv
expect 0 'slope = 3.9375' promise.dr --bind 'n=[5, 1000]'
exit $failed
