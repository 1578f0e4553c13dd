"""matching.py's search for threads side by side: candidates by number, so that a cloud is read from the nearest cache.

The CPU's table holds a candidate's coordinates for every cell that has it, 16 times the cloud, which a GPU would fetch
from far for every search. Here a cell names its candidates, in ascending order and interleaved with those of the cells
beside it: searches side by side then read numbers, and coordinates, side by side.
"""

import math

import numpy as np

from pointnetkl.registration.gicp import matching
from pointnetkl.registration.gicp.device import device

_f32, _i32, _at = np.float32, np.int32, np.uint64
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
def nearest(x, y, z, to, farthest):  # type: ignore[no-untyped-def]
    """Return the nearest point, -1: none within `farthest`, and the distances of the two nearest, at most that."""
    inverse = _f32(1) / to.cell
    column = min(max(_i32((x - to.x0) * inverse), _i32(0)), _i32(to.columns - 1))
    row = min(max(_i32((y - to.y0) * inverse), _i32(0)), _i32(to.rows - 1))
    cell = _at(column * to.rows + row)
    start = (cell // _at(_TILE)) * _at(matching.CANDIDATES * _TILE) + cell % _at(_TILE)
    first, second = _least_two(x, y, z, to.candidates, to.numbers, start)
    near = to.numbers[start + _at(first & matching.RANK) * _at(_TILE)]
    near_m, other_m = matching.distance(first), matching.distance(second)
    dx = x - (to.x0 + (_f32(column) + _f32(0.5)) * to.cell)
    dy = y - (to.y0 + (_f32(row) + _f32(0.5)) * to.cell)
    if other_m + math.sqrt(dx * dx + dy * dy) > to.reach[cell]:
        within = min(farthest, other_m * _f32(1.00001) + to.margin)
        near, _, near_m, other_m = matching.search(x, y, z, within, _i32(-1), _i32(-1), to)
    if near_m >= farthest:
        near = _i32(-1)
    return _i32(near), min(near_m, farthest), min(other_m, farthest)


@device
def _least_two(x, y, z, points, numbers, start):  # type: ignore[no-untyped-def]
    # matching's keys, each made once
    first = second = matching.NONE
    size = _at(len(points)) // _at(3)
    rank = _i32(0)
    while rank < matching.CANDIDATES:  # unlike a range, unrolled
        j = _at(numbers[start + _at(rank) * _at(_TILE)])
        dx, dy, dz = points[j] - x, points[size + j] - y, points[size + size + j] - z
        square = _f32(dx * dx + dy * dy + dz * dz)
        key = _i32((square.view(np.int32) & ~matching.RANK) | rank)
        second = _i32(min(second, max(first, key)))
        first = _i32(min(first, key))
        rank = _i32(rank + 1)
    return first, second
