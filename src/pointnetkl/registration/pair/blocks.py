"""The variance of a sum of forces by square blocks: forces of neighbours are alike, those of blocks are not (Eq. 9)."""

import math

import numpy as np

from pointnetkl.registration.pair.compilation import device, kernel

_u64 = np.uint64
_MOST_PER_POINT = 16  # cells: finer blocks hold no two neighbours, and would fill the memory


@kernel
def variance(x, y, forces, block):  # type: ignore[no-untyped-def]
    """Return S (3, 3) of forces (3, n) at x and y (n,) in metres, and the fewest blocks of the four shifted grids.

    `block` is the edge in metres. Blocks so small that there are over four for every point: zeros, and -1.
    """
    S, fewest = np.zeros((3, 3)), len(x)
    if len(x) == 0:
        return S, 0
    # an even cell to begin with, so that cells 2 k and 2 k + 1 make a block, and shifted 2 k - 1 and 2 k
    first_x, first_y = math.floor(x.min() / block) * block, math.floor(y.min() / block) * block
    columns, rows = int((x.max() - first_x) * (2 / block)) + 1, int((y.max() - first_y) * (2 / block)) + 1
    if columns * rows > _MOST_PER_POINT * len(x):
        return S, -1
    cells = np.zeros((columns, rows, 4))
    _fill(x, y, forces, 2 / block, first_x, first_y, cells)
    total = _sum(cells, 0, columns, 0, rows)
    for shift_x in range(2):
        for shift_y in range(2):
            fewest = min(fewest, _add_grid(cells, total, shift_x, shift_y, S))
    return S, fewest


@kernel
def _fill(x, y, forces, per_metre, first_x, first_y, cells):  # type: ignore[no-untyped-def]
    # the sums of the forces, and the number of points, of every cell of half a block
    for i in range(len(x)):
        column, row = _u64((x[i] - first_x) * per_metre), _u64((y[i] - first_y) * per_metre)
        cells[column, row, 0] += forces[0, i]
        cells[column, row, 1] += forces[1, i]
        cells[column, row, 2] += forces[2, i]
        cells[column, row, 3] += 1


@kernel
def _add_grid(cells, total, shift_x, shift_y, S):  # type: ignore[no-untyped-def]
    # adds a quarter of the variance by one grid's blocks to S; returns how many of them have points
    columns, rows, count, xx, xy, yy, xw, yw, ww = cells.shape[0], cells.shape[1], 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for column in range(-shift_x, columns, 2):
        for row in range(-shift_y, rows, 2):
            x, y, w, points = _sum(cells, max(column, 0), min(column + 2, columns), max(row, 0), min(row + 2, rows))
            if points > 0:
                share = points / total[3]
                x, y, w = x - share * total[0], y - share * total[1], w - share * total[2]
                xx, xy, yy, xw, yw, ww = xx + x * x, xy + x * y, yy + y * y, xw + x * w, yw + y * w, ww + w * w
                count += 1
    weight = 0.25 * count / max(count - 1, 1)
    for row, values in enumerate(((xx, xy, xw), (xy, yy, yw), (xw, yw, ww))):
        for column, value in enumerate(values):
            S[row, column] += weight * value
    return count


@device
def _sum(cells, first, last, low, high):  # type: ignore[no-untyped-def]
    x, y, w, points = 0.0, 0.0, 0.0, 0.0
    for column in range(first, last):
        for row in range(low, high):
            x += cells[column, row, 0]
            y += cells[column, row, 1]
            w += cells[column, row, 2]
            points += cells[column, row, 3]
    return x, y, w, points
