"""A map in memory: the count, the sum and the sum of squares of the depths in square cells, where there are any.

Cells are held in tiles of 64 x 64, so that a map takes memory for the ground that was sounded and not for its bounding
box; larger tiles would be emptier along the edges of swaths.
"""

from typing import NamedTuple

import numpy as np

from pointnetkl.correction.result import CorrectionError

MOST = 1 << 12  # tiles of a map: 2^24 cells
_BITS = 6
SIDE = 1 << _BITS  # cells of a tile, along each axis
_CELLS = SIDE * SIDE
_BLOCK = 256  # tiles that get memory at once


class Box(NamedTuple):
    """A rectangle of cells; column 0 begins at easting 0, row 0 at northing 0."""

    column: int  # the westernmost
    row: int  # the southernmost
    columns: int
    rows: int


class Tiles:
    """The depths in square cells, which are aligned to multiples of their size."""

    def __init__(self, cell_m: float) -> None:
        self.cell_m = cell_m
        self._numbers: dict[int, int] = {}  # of tiles, in the order that memory has them
        # depths are summed as they differ from a tile's first, so that their squares keep their digits
        self._first = np.empty(0)
        self._count: list[np.ndarray] = []
        self._sum: list[np.ndarray] = []
        self._square: list[np.ndarray] = []

    def add(self, places: np.ndarray, depth: np.ndarray) -> None:
        """Add soundings at places (n, 2), easting and northing, with depths (n,) in metres.

        Raises:
            CorrectionError: the map has too many cells.
        """
        if not len(depth):
            return
        cell = np.floor(places / self.cell_m).astype(np.int64)
        tile, within = cell >> _BITS, cell & (SIDE - 1)
        number = self._numbered(_key(tile), depth)
        relative = depth - self._first[number]
        block, index = number // _BLOCK, number % _BLOCK * _CELLS + within[:, 1] * SIDE + within[:, 0]
        for one in np.unique(block).tolist():
            here = block == one
            cells, depths = index[here], relative[here]
            np.add.at(self._count[one], cells, np.ones(len(cells), np.uint32))  # an array: a number is ten times slower
            np.add.at(self._sum[one], cells, depths)
            np.add.at(self._square[one], cells, depths**2)

    @property
    def cells(self) -> int:
        """Return the number of cells that have a sounding."""
        return sum(int(np.count_nonzero(count)) for count in self._count)

    @property
    def box(self) -> Box | None:
        """Return the smallest rectangle of all cells that have a sounding; None if there are none."""
        edges = []
        for key, number in self._numbers.items():
            row, column = np.nonzero(self._cells_of(self._count, number))
            west, south = _tile(key)
            edges.append((west * SIDE + column.min(), south * SIDE + row.min(), column.max(), row.max(), west, south))
        if not edges:
            return None
        left, low, right, top, west, south = np.array(edges).T
        columns, rows = (west * SIDE + right).max() - left.min() + 1, (south * SIDE + top).max() - low.min() + 1
        return Box(int(left.min()), int(low.min()), int(columns), int(rows))

    def window(self, box: Box) -> np.ndarray | None:
        """Return depth, count and standard deviation (3, rows, columns) float32, the northernmost row first.

        Cells without a sounding are NaN, and so is the standard deviation of a single one. None: there are none at all.
        """
        count, total, square, first = np.zeros((4, box.rows, box.columns))
        found = False
        for row in range(box.row >> _BITS, (box.row + box.rows - 1 >> _BITS) + 1):
            for column in range(box.column >> _BITS, (box.column + box.columns - 1 >> _BITS) + 1):
                number = self._numbers.get((row << 32) + column)
                if number is None:
                    continue
                found = True
                target, source = _overlap(box, column, row)
                first[target] = self._first[number]
                for image, blocks in ((count, self._count), (total, self._sum), (square, self._square)):
                    image[target] = self._cells_of(blocks, number)[source]
        return _statistics(count, total, square, first)[:, ::-1] if found else None

    def _numbered(self, key: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """Return the number (n,) of the tile of each sounding, and make room for new tiles."""
        # neighbours are most often of one tile, and few runs of them sort faster than all soundings
        begin = np.flatnonzero(np.diff(key, prepend=key[0] - 1))
        keys, first, run = np.unique(key[begin], return_index=True, return_inverse=True)
        new = [index for index, one in enumerate(keys.tolist()) if one not in self._numbers]
        for index in new:
            self._numbers[int(keys[index])] = len(self._numbers)
        self._first = np.concatenate([self._first, depth[begin[first[new]]]])
        self._grow()
        numbers = np.array([self._numbers[one] for one in keys.tolist()])
        return np.repeat(numbers[run], np.diff(begin, append=len(key)))

    def _grow(self) -> None:
        if len(self._numbers) > MOST:
            raise CorrectionError(
                f"a map with cells of {self.cell_m:g} m takes more than {MOST} tiles of {SIDE} x {SIDE} cells;"
                " give larger cells"
            )
        while len(self._count) * _BLOCK < len(self._numbers):
            self._count.append(np.zeros(_BLOCK * _CELLS, np.uint32))
            self._sum.append(np.zeros(_BLOCK * _CELLS))
            self._square.append(np.zeros(_BLOCK * _CELLS))

    def _cells_of(self, blocks: list[np.ndarray], number: int) -> np.ndarray:
        begin = number % _BLOCK * _CELLS
        return blocks[number // _BLOCK][begin : begin + _CELLS].reshape(SIDE, SIDE)


def count(places: np.ndarray, cell_m: float) -> int:
    """Return the number of tiles with cells of a size that places (n, 2) need."""
    tile = np.floor(places / (cell_m * SIDE)).astype(np.int64)
    return len(np.unique(_key(tile)))


def _key(tile: np.ndarray) -> np.ndarray:
    return (tile[:, 1] << 32) + tile[:, 0]


def _tile(key: int) -> tuple[int, int]:
    row = (key + (1 << 31)) >> 32
    return key - (row << 32), row


def _overlap(box: Box, column: int, row: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Return where a tile lies in a box, and which part of it."""
    target, source = [], []
    for tile, begin, length in ((row, box.row, box.rows), (column, box.column, box.columns)):
        low, high = max(tile * SIDE, begin), min((tile + 1) * SIDE, begin + length)
        target.append(slice(low - begin, high - begin))
        source.append(slice(low - tile * SIDE, high - tile * SIDE))
    return (target[0], target[1]), (source[0], source[1])


def _statistics(count: np.ndarray, total: np.ndarray, square: np.ndarray, first: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore", divide="ignore"):  # of empty cells, and of single soundings
        mean = total / count
        variance = np.maximum(square - total * mean, 0.0) / (count - 1)
    deviation = np.where(count > 1, np.sqrt(variance, where=count > 1, out=np.zeros_like(variance)), np.nan)
    return np.stack([first + mean, np.where(count > 0, count, np.nan), deviation]).astype(np.float32)
