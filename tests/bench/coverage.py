# SPDX-License-Identifier: Apache-2.0
"""The gradient of exact area coverage of a convex mesh, in closed form: its silhouette is the hull of its projected vertices, and
moving an edge changes coverage by the integral along it, which is cut at the pixels' borders."""
import numpy as np


def hull(points):
    """Numbers of the points on the convex hull, in order around it (monotone chain)."""
    order = np.lexsort((points[:, 1], points[:, 0]))

    def chain(order):
        done = []
        for k in order:
            while len(done) > 1:
                (ax, ay), (bx, by) = points[done[-1]] - points[done[-2]], points[k] - points[done[-2]]
                if ax * by - ay * bx > 0:
                    break
                done.pop()
            done.append(k)
        return done[:-1]

    return chain(order) + chain(order[::-1])


def true_gradient(points):
    """Of the sum of weight * covered area of each pixel, to each vertex: cut at pixels' borders and integrated."""
    gradient, around = np.zeros_like(points), hull(points)
    for i, j in zip(around, around[1:] + around[:1]):
        a, d = points[i], points[j] - points[i]
        cuts = [0.0, 1.0]
        for axis in (0, 1):
            low, high = sorted((a[axis], a[axis] + d[axis]))
            cuts += [(c - a[axis]) / d[axis] for c in range(int(np.ceil(low)), int(np.floor(high)) + 1) if d[axis] != 0]
        t = np.unique(np.clip(cuts, 0, 1))
        pixel = np.floor(a + d * (0.5 * (t[1:] + t[:-1]))[:, None]) + 0.5
        weight = np.sin(0.09 * pixel[:, 0]) + np.cos(0.06 * pixel[:, 1])
        second = weight @ (t[1:] ** 2 - t[:-1] ** 2) / 2  # how far along, which is the second vertex' share
        outward = np.array([d[1], -d[0]])
        gradient[i] += outward * (weight @ np.diff(t) - second)
        gradient[j] += outward * second
    return gradient


def distance_from(found, true, points, size):
    """Relative L2 of gradients, `bias` vertex by vertex and `bias_whole` of their sums for shifts and growth of the whole."""
    whole = lambda g: np.array([*g.sum(0), np.sum(g * (points - points.mean(0))) / (size / 4)])
    apart = lambda x, y: float(np.linalg.norm(x - y) / np.linalg.norm(y))
    return {"bias": apart(found, true), "bias_whole": apart(whole(found), whole(true))}
