#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# A fit by the outlines that several cameras see leaves the same bits where a GPU transforms vertices at the faces and
# adds the views up in loops, and where vertices and sums have dispatches of their own.
# usage: views_test.sh DRC DRUN
set -eu
drc=$(readlink -f "$1") drun=$(readlink -f "$2")
source "$(dirname "${BASH_SOURCE[0]}")/on_lavapipe.sh" "views on lavapipe"
cat > views.dr << 'END'
edition 1;
import std.camera;
import std.coverage;
import std.mesh;
import std.raster;
param position : vec3[V];
input face     : ivec3[F];
input wrong    : ivec3[F];  // with vertices that there are not
input views    : mat4[N];
let drawn = mesh.outset(position, face, topology(face, V));
let view = views.at(coord(1, 1, N).z);
let larger = 1.25 * drawn;
let clip = camera.project(view, larger);
let alpha = coverage.silhouette(clip, face, mesh.neighbours(topology(face, V)), 48, 40);
let seen = raster.rasterize(clip, wrong, 48, 40).face;
let loss = mean(alpha * alpha * vec3(coord(48, 40, N)).x);
step fit {
  position <- position - 4.0 * grad(loss, position);
  output alpha, seen, loss;
}
END
gpu_profile teams.json
python3 - << 'END'
import math
views = 11
faces, vertices = [], []
for i in range(6):
    for j in range(12):
        a, b = math.pi * i / 5, 2 * math.pi * j / 12
        vertices.append((math.sin(a) * math.cos(b), math.cos(a), math.sin(a) * math.sin(b)))
for i in range(5):
    for j in range(12):
        p, q = 12 * i + j, 12 * i + (j + 1) % 12
        faces += [(p, q, p + 12), (q, q + 12, p + 12)]


def csv(name, rows):
    with open(name, "w") as out:
        out.writelines(",".join(str(x) for x in row) + "\n" for row in rows)


csv("position.csv", vertices)
csv("face.csv", faces)
csv("wrong.csv", [(a, -1, c) if k % 7 == 0 else (a, b, 10 ** 9) if k % 11 == 0 else (a, b, c) for k, (a, b, c) in enumerate(faces)])
matrices = []
for k in range(views):
    c, s = math.cos(0.6 * k), math.sin(0.6 * k)
    matrix = [[0.5 * c, 0, 0.5 * s, 0], [0.02 * k, 0.6, 0, 0], [-0.4 * s, 0, 0.4 * c, 0.5], [-0.1 * s, 0, 0.1 * c, 1.5]]
    matrices.append([matrix[row][column] for column in range(4) for row in range(4)])
csv("view.csv", matrices)
END
for profile in lavapipe teams.json; do
  "$drun" views.dr --profile "$profile" --unchecked --bind position=position.csv --bind face=face.csv --bind wrong=wrong.csv \
    --bind views=view.csv --step fit=3 --out "out_$profile" > said 2>&1 || { cat said; exit 1; }
done
"$drc" build views.dr --profile teams.json --emit commands > commands
reads=$(grep -A 2 "dispatch seen_raster_faces" commands | grep reads)
if grep -q "\[V of N\]" commands || [[ $reads != *" larger"* || $reads == *" clip"* ]]; then
  echo "views are not added up in loops, or faces wait for vertices:" && cat commands && exit 1
fi
for name in fit.alpha fit.seen position; do cmp "out_lavapipe/$name.npy" "out_teams.json/$name.npy"; done
echo "views: the same bits"
