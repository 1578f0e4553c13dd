"""Exact nearest and second nearest points, from a table of candidates for every cell or, failing that, a search."""

import math
from typing import NamedTuple

import numpy as np

from pointnetkl.registration.gicp.device import device, kernel
from pointnetkl.registration.gicp.neighbours import Grid

_f32, _i32, _u64 = np.float32, np.int32, np.uint64
CANDIDATES = 16  # of a cell: what one instruction compares
RANK = _i32(CANDIDATES - 1)  # the last bits of a key say which candidate
NONE = _i32(0x7FFFFFFF)
FAR_M = _f32(1e15)  # where a missing candidate stands: its square is still a number
_WINDOW = 2  # columns and rows on each side of a cell that are searched for its candidates


class Target(NamedTuple):
    """A cloud sorted by its grid, to match points to."""

    points: np.ndarray  # (3 n,) float32 metres, x, y, z of point after point
    normals: np.ndarray  # (3 n,) float32, unit
    starts: np.ndarray  # of the Grid, as the next five
    x0: np.float32
    y0: np.float32
    cell: np.float32
    columns: int
    rows: int
    candidates: np.ndarray  # (cells 48,) float32 metres: 16 x, 16 y, 16 z of the points nearest to each cell's centre
    numbers: np.ndarray  # (cells 16,) int32: the points' numbers, -1: none
    reach: np.ndarray  # (cells,) float32 metres: any other point is farther than this from the centre, in x and y
    margin: np.float32  # metres: more than what rounding moves a distance by


def build_target(points: np.ndarray, normals: np.ndarray, grid: Grid) -> Target:
    """Return points and normals (n, 3) float32, sorted by their grid, with the table of candidates of every cell."""
    cells = grid.columns * grid.rows
    candidates = np.full((cells, 3, CANDIDATES), FAR_M, np.float32)
    numbers = np.full((cells, CANDIDATES), -1, np.int32)
    reach = np.empty(cells, np.float32)
    flat = points.reshape(-1)
    margin = _f32(2e-6) * grid.cell * _f32(max(grid.columns, grid.rows))
    _fill(flat, grid, candidates, numbers, reach)
    return Target(flat, normals.reshape(-1), *grid, candidates.reshape(-1), numbers.reshape(-1), reach - margin, margin)


@kernel
def _fill(points, grid, candidates, numbers, reach):  # type: ignore[no-untyped-def]
    near, squares = np.empty(CANDIDATES + 1, np.int32), np.empty(CANDIDATES + 1, np.float32)
    for cell in range(len(reach)):
        column, row = cell // grid.rows, cell % grid.rows
        x = grid.x0 + (_f32(column) + _f32(0.5)) * grid.cell
        y = grid.y0 + (_f32(row) + _f32(0.5)) * grid.cell
        squares[:] = (_f32(_WINDOW + 0.5) * grid.cell) ** 2  # what lies beyond the window is farther than this
        near[:] = -1
        low, high = max(row - _WINDOW, 0), min(row + _WINDOW, grid.rows - 1)
        for other in range(max(column - _WINDOW, 0), min(column + _WINDOW, grid.columns - 1) + 1):
            for j in range(grid.starts[other * grid.rows + low], grid.starts[other * grid.rows + high + 1]):
                _insert(j, (points[3 * j] - x) ** 2 + (points[3 * j + 1] - y) ** 2, near, squares)
        reach[cell] = math.sqrt(squares[CANDIDATES])
        for rank in range(CANDIDATES):
            if near[rank] >= 0:
                numbers[cell, rank] = near[rank]
                for axis in range(3):
                    candidates[cell, axis, rank] = points[3 * near[rank] + axis]


@kernel
def _insert(j, square, near, squares):  # type: ignore[no-untyped-def]
    rank = CANDIDATES
    if square >= squares[rank]:
        return
    while rank > 0 and squares[rank - 1] > square:
        near[rank], squares[rank] = near[rank - 1], squares[rank - 1]
        rank -= 1
    near[rank], squares[rank] = j, square


@device
def look_up(x, y, z, target):  # type: ignore[no-untyped-def]
    """Return the two nearest candidates of a point's cell, their distances, and whether no other point is nearer.

    Of two points whose distances differ by less than a millionth part, either may come first. The function has no
    branches, and no variable that holds an array: each would cost more than the search.
    """
    inverse = _f32(1) / target.cell
    column = min(max(int((x - target.x0) * inverse), 0), target.columns - 1)
    row = min(max(int((y - target.y0) * inverse), 0), target.rows - 1)
    cell = column * target.rows + row
    first, second = _least_two(x, y, z, target.candidates, 3 * CANDIDATES * cell)
    near_m, other_m = distance(first), distance(second)
    dx = x - (target.x0 + (_f32(column) + _f32(0.5)) * target.cell)
    dy = y - (target.y0 + (_f32(row) + _f32(0.5)) * target.cell)
    return (
        target.numbers[_u64(CANDIDATES * cell + (first & RANK))],
        target.numbers[_u64(CANDIDATES * cell + (second & RANK))],
        near_m,
        other_m,
        other_m + math.sqrt(dx * dx + dy * dy) <= target.reach[_u64(cell)],
    )


@device
def _least_two(x, y, z, candidates, start):  # type: ignore[no-untyped-def]
    # a key is the squared distance, in whose last bits stands the candidate: their order is that of whole numbers
    first = NONE
    for rank in range(CANDIDATES):
        first = min(first, _key(x, y, z, candidates, start, rank))
    second = NONE
    for rank in range(CANDIDATES):
        key = _key(x, y, z, candidates, start, rank)
        second = min(second, key if key != first else NONE)
    return first, second


@device
def _key(x, y, z, candidates, start, rank):  # type: ignore[no-untyped-def]
    dx = candidates[_u64(start + rank)] - x
    dy = candidates[_u64(start + CANDIDATES + rank)] - y
    dz = candidates[_u64(start + 2 * CANDIDATES + rank)] - z
    square = _f32(dx * dx + dy * dy + dz * dz)
    return _i32((square.view(np.int32) & ~RANK) | _i32(rank))


@device
def distance(key):  # type: ignore[no-untyped-def]
    """Return the distance of a key of a candidate, metres."""
    return math.sqrt(_i32(key & ~RANK).view(np.float32))


@device
def _square(x, y, z, points, j):  # type: ignore[no-untyped-def]
    dx, dy, dz = points[3 * j] - x, points[3 * j + 1] - y, points[3 * j + 2] - z
    return dx * dx + dy * dy + dz * dz


@kernel
def search(x, y, z, within, hint, other_hint, target):  # type: ignore[no-untyped-def]
    """Return the two nearest points within a distance in metres, -1: none, and their distances, at most that.

    The hints are two points that may be near, or -1: they make a wide search shorter.
    """
    points = target.points
    if other_hint >= 0:
        bound = math.sqrt(max(_square(x, y, z, points, hint), _square(x, y, z, points, other_hint)))
        within = min(within, bound * _f32(1.00001) + target.margin)
    # by columns of the grid, from the point's own outwards
    inverse = _f32(1) / target.cell
    near, other, first, second = _i32(-1), _i32(-1), within * within, within * within
    position = (x - target.x0) * inverse
    own = int(position) - (position < 0)
    for side in range(2):  # own column and those to the right of it, then those to the left
        column = max(own, 0) if side == 0 else min(own, target.columns) - 1
        while 0 <= column < target.columns:
            gap = _f32(0)
            if column != own:
                gap = abs(target.x0 + _f32(column + side) * target.cell - x) - target.margin
            rest = second - gap * abs(gap)
            if not rest > 0:
                break
            span = math.sqrt(rest) + target.margin
            low = max(int((y - span - target.y0) * inverse), 0)
            high = min(int((y + span - target.y0) * inverse), target.rows - 1)
            if low <= high:
                start, stop = target.starts[column * target.rows + low], target.starts[column * target.rows + high + 1]
                for j in range(start, stop):
                    square = _square(x, y, z, points, j)
                    if square < second:
                        if square < first:
                            near, other, first, second = _i32(j), near, square, first
                        else:
                            other, second = _i32(j), square
            column += 1 - 2 * side
    return near, other, math.sqrt(first), math.sqrt(second)
