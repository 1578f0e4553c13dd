"""The variance of a sum of forces by square blocks: forces of neighbours are alike, those of blocks are not (Eq. 8)."""

import math

import numpy as np

from pointnetkl.registration.pair.compilation import kernel

_MOST_PER_POINT = 16  # cells: finer blocks hold no two neighbours, and would fill the memory


@kernel
def variance(arms, forces, block):  # type: ignore[no-untyped-def]
    """Return S (3, 3) of forces (n, 3) at arms (n, 2) in metres, and the fewest blocks of the four shifted grids.

    `block` is the edge in metres. Blocks so small that there are over four for every point: zeros, and -1.
    """
    S, fewest = np.zeros((3, 3)), len(arms)
    if len(arms) == 0:
        return S, 0
    half = 0.5 * block
    # an even cell to begin with, so that cells 2 k and 2 k + 1 make a block, and shifted 2 k - 1 and 2 k
    first = 2 * math.floor(arms[:, 0].min() / block), 2 * math.floor(arms[:, 1].min() / block)
    columns = math.floor(arms[:, 0].max() / half) - first[0] + 1
    rows = math.floor(arms[:, 1].max() / half) - first[1] + 1
    if columns * rows > _MOST_PER_POINT * len(arms):
        return S, -1
    cells = _cells(arms, forces, half, first, columns, rows)
    total = cells.sum(axis=0).sum(axis=0)
    for shift_x in range(2):
        for shift_y in range(2):
            fewest = min(fewest, _add_grid(cells, total, shift_x, shift_y, S))
    return S, fewest


@kernel
def _cells(arms, forces, half, first, columns, rows):  # type: ignore[no-untyped-def]
    # the sums of the forces, and the number of points, of every cell of half a block
    cells = np.zeros((columns, rows, 4))
    for i in range(len(arms)):
        column = int(math.floor(arms[i, 0] / half)) - first[0]
        row = int(math.floor(arms[i, 1] / half)) - first[1]
        for axis in range(3):
            cells[column, row, axis] += forces[i, axis]
        cells[column, row, 3] += 1
    return cells


@kernel
def _add_grid(cells, total, shift_x, shift_y, S):  # type: ignore[no-untyped-def]
    # adds a quarter of the variance by one grid's blocks to S; returns how many of them have points
    columns, rows, count, squares = cells.shape[0], cells.shape[1], 0, np.zeros((3, 3))
    for column in range(-shift_x, columns, 2):
        for row in range(-shift_y, rows, 2):
            low_c, low_r = max(column, 0), max(row, 0)
            block = cells[low_c : column + 2, low_r : row + 2].sum(axis=0).sum(axis=0)
            if block[3] > 0:
                force = block[:3] - block[3] / total[3] * total[:3]
                squares += force.reshape(3, 1) * force
                count += 1
    S += 0.25 * count / max(count - 1, 1) * squares
    return count
