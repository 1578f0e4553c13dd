"""The search of `gicp.matching` for neighbouring threads: candidates by number, so that a cloud stays in the cache.

The CPU's table holds the coordinates of a candidate in every cell that has it, 16 times the cloud: too much for a GPU's
cache. Here a cell holds the numbers of its candidates, in ascending order and interleaved with those of its neighbours,
so that neighbouring threads read neighbouring numbers and coordinates.
"""

import math

import numpy as np

from pointnetkl.registration.gicp import matching
from pointnetkl.registration.gicp.device import device

_f32, _i32, _u64 = np.float32, np.int32, np.uint64
_TILE = 32  # cells, a power of two, whose candidates stand interleaved


def interleaved(target: matching.Target) -> matching.Target:
    """Return a Target with other contents in two fields, for `nearest` alone.

    Its `candidates` are x, y and z of the n points and a far one, (3, n + 1), flat; its `numbers` the candidates of 32
    cells each, (tiles, 16, 32), flat, where the far point stands for a missing one.
    """
    n = len(target.points) // 3
    points = np.full((3, n + 1), matching.FAR_M, np.float32)
    points[:, :n] = target.points.reshape(n, 3).T
    numbers = np.sort(np.where(target.numbers < 0, n, target.numbers).reshape(-1, matching.CANDIDATES), axis=1)
    cells = np.zeros((-(-len(numbers) // _TILE) * _TILE, matching.CANDIDATES), np.uint32)
    cells[: len(numbers)] = numbers
    tiles = cells.reshape(-1, _TILE, matching.CANDIDATES).transpose(0, 2, 1)
    return target._replace(candidates=points.reshape(-1), numbers=tiles.reshape(-1))


@device
def nearest(x, y, z, target, max_distance):  # type: ignore[no-untyped-def]
    """Return the nearest point, -1: none within max_distance, and the distances of the two nearest, at most that."""
    inverse = _f32(1) / target.cell
    column = min(max(_i32((x - target.x0) * inverse), _i32(0)), _i32(target.columns - 1))
    row = min(max(_i32((y - target.y0) * inverse), _i32(0)), _i32(target.rows - 1))
    cell = _u64(column * target.rows + row)
    start = (cell // _u64(_TILE)) * _u64(matching.CANDIDATES * _TILE) + cell % _u64(_TILE)
    first, second = _least_two(x, y, z, target.candidates, target.numbers, start)
    near = target.numbers[start + _u64(first & matching.RANK) * _u64(_TILE)]
    near_m, other_m = matching.distance(first), matching.distance(second)
    dx = x - (target.x0 + (_f32(column) + _f32(0.5)) * target.cell)
    dy = y - (target.y0 + (_f32(row) + _f32(0.5)) * target.cell)
    if other_m + math.sqrt(dx * dx + dy * dy) > target.reach[cell]:
        within = min(max_distance, other_m * _f32(1.00001) + target.margin)
        near, _, near_m, other_m = matching.search(x, y, z, within, _i32(-1), _i32(-1), target)
    if near_m >= max_distance:
        near = _i32(-1)
    return _i32(near), min(near_m, max_distance), min(other_m, max_distance)


@device
def _least_two(x, y, z, points, numbers, start):  # type: ignore[no-untyped-def]
    # matching's keys, each made once
    first = second = matching.NONE
    size = _u64(len(points)) // _u64(3)
    rank = _i32(0)
    while rank < matching.CANDIDATES:  # unlike a range, unrolled
        j = _u64(numbers[start + _u64(rank) * _u64(_TILE)])
        dx, dy, dz = points[j] - x, points[size + j] - y, points[size + size + j] - z
        square = _f32(dx * dx + dy * dy + dz * dz)
        key = _i32((square.view(np.int32) & ~matching.RANK) | rank)
        second = _i32(min(second, max(first, key)))
        first = _i32(min(first, key))
        rank = _i32(rank + 1)
    return first, second
