"""Kernels of the map-to-map error: distances to the nearest points of a cloud, by buckets in x and y.

A search starts with a bound on the distance: one of the cloud's points lies in the same cell, and the point before was
near this one. So it visits few buckets, and finds the exact nearest point.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numba
import numpy as np

# no fastmath, which reorders sums: a cell's error must not depend on the thread or process that computes it
_kernel: Any = numba.njit(cache=True, nogil=True, error_model="numpy")
_device: Any = numba.njit(inline="always", error_model="numpy")
_POINTS_PER_BUCKET = 2.0
_RIM, _RIM_M2 = 1.0 + 1e-6, 1e-12  # exceed the rounding of a squared distance: a factor, and square metres


class Buckets(NamedTuple):
    """Clouds in their own frames, each sorted by its buckets; bucket c * rows + r of cloud b begins at starts[...]."""

    points: np.ndarray  # (n, 3) metres, cloud after cloud
    starts: np.ndarray  # (buckets of all clouds + 1 each,) first point of each bucket
    first: np.ndarray  # (k,) where a cloud's buckets begin in `starts`
    shape: np.ndarray  # (k, 2) columns and rows
    corner: np.ndarray  # (k, 3) lowest x and y, and the edge of a bucket, metres


class Placed(NamedTuple):
    """Points in the map, sorted by cell and then by submap."""

    starts: np.ndarray  # (cells + 1,) first point of each cell
    owner: np.ndarray  # (n,) submap of each point
    points: np.ndarray  # (n, 3) metres, in the map frame


class Runs(NamedTuple):
    """Points in the map by runs: a run is the points of one submap in one cell."""

    starts: np.ndarray  # (cells + 1,) first run of each cell
    first: np.ndarray  # (runs + 1,) first point of each run
    owner: np.ndarray  # (runs,) submap of each run
    points: np.ndarray  # (n, 3) metres, in the map frame


def buckets(clouds: Sequence[np.ndarray]) -> Buckets:
    """Return clouds (n_i, 3) sorted by buckets that hold a few points."""
    sorted_, starts, shapes, corners, point = [], [], [], [], 0
    for cloud in clouds:
        low, span = cloud[:, :2].min(axis=0), np.ptp(cloud[:, :2], axis=0)
        per_point = max(span.prod() / len(cloud), (span.max() / len(cloud)) ** 2, 1e-12)  # a line has no area
        edge = math.sqrt(_POINTS_PER_BUCKET * per_point)
        column, row = ((cloud[:, :2] - low) / edge).astype(np.int64).T
        columns, rows = int(column.max()) + 1, int(row.max()) + 1
        bucket = column * rows + row
        sorted_.append(cloud[np.argsort(bucket, kind="stable")])
        counts = np.bincount(bucket, minlength=columns * rows)
        starts.append(point + np.concatenate([[0], np.cumsum(counts)]))
        shapes.append((columns, rows))
        corners.append((*low, edge))
        point += len(cloud)
    first = np.cumsum([0, *(len(of_cloud) for of_cloud in starts[:-1])])
    return Buckets(np.concatenate(sorted_), np.concatenate(starts), first, np.array(shapes), np.array(corners))


@_kernel
def grouped(group, count):  # type: ignore[no-untyped-def]
    """Return the start of each of `count` groups (count + 1,) in a list of members, and that list, ordered by group."""
    starts = np.zeros(count + 1, np.int64)
    for index in group:
        starts[index + 1] += 1
    starts = np.cumsum(starts)
    free, order = starts[:-1].copy(), np.empty(len(group), np.int64)
    for member in range(len(group)):
        order[free[group[member]]] = member
        free[group[member]] += 1
    return starts, order


@_kernel
def worst_pairs(begin, end, placed, T_submap_map, targets, worst):  # type: ignore[no-untyped-def]
    """Fill `worst` of the cells from `begin` to `end` with their worst pair's mean distance; -1: only one submap.

    `placed` are the points that ask (Placed), `targets` all points of all submaps (Buckets).
    """
    starts, owner, points = placed.starts, placed.owner, placed.points
    for cell in range(begin, end):
        worst[cell] = -1.0
        a = starts[cell]
        while a < starts[cell + 1]:
            a_end = _run(a, starts[cell + 1], owner)
            b = starts[cell]
            while b < starts[cell + 1]:
                if owner[b] != owner[a]:
                    mean = _mean_distance(points[a:a_end], points[b], T_submap_map[owner[b]], owner[b], targets)
                    worst[cell] = max(worst[cell], mean)
                b = _run(b, starts[cell + 1], owner)
            a = a_end


@_kernel
def _run(begin, end, owner):  # type: ignore[no-untyped-def]
    last = begin + 1
    while last < end and owner[last] == owner[begin]:
        last += 1
    return last


@_kernel
def _mean_distance(asking, neighbour, T, b, targets):  # type: ignore[no-untyped-def]
    total, near = 0.0, math.inf
    for i in range(len(asking)):
        p = asking[i]
        # two bounds: b's point `neighbour`, and by the triangle inequality the nearest of the point before
        step = math.sqrt(_square(p, asking[i - 1])) if i > 0 else 0.0
        within = min(_square(p, neighbour), (near + step) ** 2) * _RIM + _RIM_M2
        x = T[0, 0] * p[0] + T[0, 1] * p[1] + T[0, 2] * p[2] + T[0, 3]
        y = T[1, 0] * p[0] + T[1, 1] * p[1] + T[1, 2] * p[2] + T[1, 3]
        z = T[2, 0] * p[0] + T[2, 1] * p[1] + T[2, 2] * p[2] + T[2, 3]
        near = math.sqrt(_nearest(x, y, z, b, within, targets))
        total += near
    return total / len(asking)


@_device
def _square(p, q):  # type: ignore[no-untyped-def]
    return (p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2


@_kernel
def _nearest(x, y, z, b, within, targets):  # type: ignore[no-untyped-def]
    # squared metres; by columns of buckets, from the point's own column outwards
    x0, y0, edge = targets.corner[b]
    columns, rows = targets.shape[b]
    own = math.floor((x - x0) / edge)
    for side in range(2):  # its own column and those above, then those below
        column = max(own, 0) if side == 0 else min(own, columns) - 1
        while 0 <= column < columns:
            gap = 0.0 if column == own else abs(x0 + (column + side) * edge - x)
            if gap * gap >= within * _RIM:
                break
            span = math.sqrt(within * _RIM - gap * gap)
            low = max(math.floor((y - span - y0) / edge), 0)
            high = min(math.floor((y + span - y0) / edge), rows - 1)
            if low <= high:
                bucket = targets.first[b] + column * rows
                for j in range(targets.starts[bucket + low], targets.starts[bucket + high + 1]):
                    dx, dy, dz = targets.points[j, 0] - x, targets.points[j, 1] - y, targets.points[j, 2] - z
                    within = min(within, dx * dx + dy * dy + dz * dz)
            column += 1 - 2 * side
    return within


@_kernel
def sampled_pairs(begin, end, side, runs, drawn, error):  # type: ignore[no-untyped-def]
    """Fill `error` of a grid's cells (side * side,), columns `begin` to `end`; -1: fewer than two submaps.

    `drawn` (runs, draws) are random points of each of the Runs. A draw's value is the largest distance from a submap's
    point to another's nearest in the cell and those around it, a cell's the mean of its draws.
    """
    points = runs.points
    largest, around = np.empty(drawn.shape[1]), np.empty((9, 2), np.int64)
    for cell in range(begin * side, end * side):
        error[cell] = -1.0
        if runs.starts[cell + 1] - runs.starts[cell] < 2:
            continue
        largest[:] = 0.0
        for b in range(runs.starts[cell], runs.starts[cell + 1]):
            count = _around(cell, b, side, runs, around)
            for a in range(runs.starts[cell], runs.starts[cell + 1]):
                for draw in range(len(largest)):
                    if a != b:
                        square = _nearest_of(points[drawn[a, draw]], around[:count], points, largest[draw])
                        largest[draw] = max(largest[draw], square)
        error[cell] = np.mean(np.sqrt(largest))


@_kernel
def _around(cell, b, side, runs, around):  # type: ignore[no-untyped-def]
    # the cell itself comes first, because its points are nearer
    column, row, count = cell // side, cell % side, 1
    around[0, 0], around[0, 1] = runs.first[b], runs.first[b + 1]
    for other in range(max(column - 1, 0), min(column + 2, side)):
        for near in range(other * side + max(row - 1, 0), other * side + min(row + 2, side)):
            for run in range(runs.starts[near], runs.starts[near + 1]):
                if runs.owner[run] == runs.owner[b] and run != b:
                    around[count, 0], around[count, 1] = runs.first[run], runs.first[run + 1]
                    count += 1
    return count


@_kernel
def _nearest_of(p, ranges, points, enough):  # type: ignore[no-untyped-def]
    # a square of at most `enough` ends the search, because only the largest counts
    square = math.inf
    for begin, end in ranges:
        for j in range(begin, end):
            square = min(square, _square(p, points[j]))
            if square <= enough:
                return square
    return square
