"""Segmentation of points without pings, such as surfaces and point clouds, into square tiles.

The points of a survey wait on disk, 24 bytes each, and those of one tile at a time are in memory.
"""

import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
import pandas as pd

from pointnetkl import segmentation
from pointnetkl.segmentation import Segmentation, Take, soundings, spacing
from pointnetkl.surveys.submap import POSES, Submap
from pointnetkl.workflow.errors import PointNetKLError

_FLUSHED = 1 << 20  # points that are sorted into tiles and written at once
_COVERED = 0.5  # least share of a tile's area that has points
_CELL = 2.0  # edge of the cells that measure the share, in point spacings; smaller cells leave holes in a full tile
_POINT_BYTES = 24


class TilesError(PointNetKLError):
    """Points cannot be cut into tiles."""


class _Tile(NamedTuple):
    row: int
    column: int
    xyz: np.ndarray  # (n, 3) in the map frame


def segment(
    survey: str,
    parts: Iterable[pd.DataFrame],
    edge_m: float,
    spacing_m: float,
    seed: int,
    take: Take,
    scratch: Path | None = None,
) -> Segmentation:
    """Cut points (survey.SOUNDINGS, in parts of any size) into square tiles, and call `take` with each as a submap.

    Tiles lie along the map's axes and are numbered from 0, row by row to and fro, so that the next one is a neighbour.
    A tile's frame is levelled, not turned, with its origin at the tile's centre and its points' mean height. Its points
    are thinned as those of a swath; its halves are those of `spacing.alternate`. A pose has no time (NaN) and no pings;
    its line is its row of tiles, and its track_m is the edge.

    Raises:
        TilesError: no tile has enough points, or the points do not fit on the disk of `scratch`.
        SoundingsError: no point is usable.
    """
    dropped: Counter[str] = Counter()
    poses: list[dict[str, float]] = []
    most_points = 0
    with tempfile.TemporaryDirectory(prefix=".tiles-", dir=scratch) as folder:
        shelf = _filled(survey, Path(folder) / "points", edge_m, parts, dropped)
        first_row = shelf.first_row()
        for tile in shelf.tiles():
            most_points = max(most_points, len(tile.xyz))
            points, place = _in_its_frame(tile, edge_m, spacing_m, dropped)
            cut = _submap(survey, len(poses), points, spacing_m, seed)
            if reason := _refused(cut, points, edge_m, spacing_m):
                dropped[reason] += 1
                continue
            take(cut)
            poses.append({"submap": cut.number, **place, "soundings": len(points), "line": tile.row - first_row})
    if not poses:
        raise TilesError(_nothing_left(survey, most_points, edge_m, spacing_m, dropped))
    table = pd.DataFrame(poses).assign(time_s=np.nan, yaw_rad=0.0, track_m=edge_m, pings=0)
    return Segmentation(table[POSES.names], dict(dropped))


def _filled(survey: str, path: Path, edge_m: float, parts: Iterable[pd.DataFrame], dropped: Counter[str]) -> "_Shelf":
    shelf, read = _Shelf(path, edge_m), 0
    for part in parts:
        shelf.add(soundings.good(part, dropped)[soundings.XYZ].to_numpy(np.float64))
        read += len(part)
    shelf.flush()
    if not shelf.points:
        raise soundings.none_good(survey, read)
    return shelf


def _in_its_frame(
    tile: _Tile, edge_m: float, spacing_m: float, dropped: Counter[str]
) -> tuple[np.ndarray, dict[str, float]]:
    """Return a tile's points (n, 3) in its frame, without those standing alone, and the frame's origin in the map."""
    x, y = (edge_m * (index + 0.5) for index in (tile.column, tile.row))
    points = tile.xyz - [x, y, 0.0]
    points = points[~segmentation.standing_alone(points, spacing_m, dropped)]
    z = float(points[:, 2].mean()) if len(points) else 0.0
    return points - [0.0, 0.0, z], {"x_m": x, "y_m": y, "z_m": z}


def _submap(survey: str, number: int, points: np.ndarray, spacing_m: float, seed: int) -> Submap:
    rng = np.random.default_rng([seed, number])
    second = spacing.alternate(points, spacing_m, rng)
    return segmentation.thinned(survey, number, points, second, spacing_m, rng)


def _refused(cut: Submap, points: np.ndarray, edge_m: float, spacing_m: float) -> str | None:
    """Return the reason to drop a tile, None if it is kept."""
    if segmentation.too_few(cut):
        return "tiles of too few points"
    across = max(1, round(edge_m / (_CELL * spacing_m)))
    cell = edge_m / across  # a whole number of cells along the edge
    occupied = len(np.unique(spacing.cells(points[:, :2] + edge_m / 2, cell)))
    return "tiles of which points cover less than half" if occupied < _COVERED * across**2 else None


def _nothing_left(survey: str, most_points: int, edge_m: float, spacing_m: float, dropped: Counter[str]) -> str:
    counts = ", ".join(f"{count} {reason}" for reason, count in dropped.items() if count)
    return (
        f"{survey}: no tile of {edge_m:g} m has {segmentation.FEWEST} points or more, one in each {spacing_m:g} m, over"
        f" half of it; the fullest has {most_points}, one in {edge_m / np.sqrt(most_points):.3g} m (left out:"
        f" {counts}); raise study.surveys.{survey}.point_spacing_m to that, or its submap_length_m"
    )


class _Shelf:
    """Points on disk, sorted by tile within each batch, and a list of the places of each tile's points."""

    def __init__(self, path: Path, edge_m: float) -> None:
        self._path, self._edge = path, edge_m
        self._waiting: list[np.ndarray] = []
        self._runs: list[np.ndarray] = []  # each (k, 4): row, column, first point, points
        self.points = 0

    def first_row(self) -> int:
        return min(int(runs[:, 0].min()) for runs in self._runs)

    def add(self, xyz: np.ndarray) -> None:
        self._waiting.append(xyz)
        if sum(map(len, self._waiting)) >= _FLUSHED:
            self.flush()

    def flush(self) -> None:
        """Write the waiting points, sorted by tile; the sort is stable, so that tiles do not depend on the parts."""
        xyz = np.concatenate([np.empty((0, 3)), *self._waiting])
        self._waiting = []
        if not len(xyz):
            return
        column, row = np.floor(xyz[:, :2] / self._edge).astype(np.int64).T
        order = np.lexsort((column, row))
        place = np.column_stack([row[order], column[order]])
        begins = _begins(place)
        counts = np.diff(np.append(begins, len(place)))
        self._runs.append(np.column_stack([place[begins], self.points + begins, counts]))
        self._write(xyz[order])
        self.points += len(xyz)

    def _write(self, xyz: np.ndarray) -> None:
        try:
            with self._path.open("ab") as file:
                file.write(xyz.tobytes())
        except OSError as error:
            raise TilesError(f"{self._path.parent}: cannot keep points ({error.strerror}); make room there") from error

    def tiles(self) -> Iterator[_Tile]:
        """Yield the tiles row by row, to and fro, with their points in the order in which they were added."""
        runs = np.concatenate(self._runs)
        row, column, first, _ = runs.T
        along = np.where((row - row.min()) % 2 == 0, column, -column)
        runs = runs[np.lexsort((first, along, row))]
        with self._path.open("rb") as file:
            for tile in np.split(runs, _begins(runs[:, :2])[1:]):
                xyz = np.concatenate([_points(file, *run[2:].tolist()) for run in tile])
                yield _Tile(int(tile[0, 0]), int(tile[0, 1]), xyz)


def _begins(place: np.ndarray) -> np.ndarray:
    """Return where each stretch of equal rows of a table (n, 2) begins."""
    return np.flatnonzero(np.append(True, np.any(np.diff(place, axis=0) != 0, axis=1)))


def _points(file: BinaryIO, first: int, count: int) -> np.ndarray:
    file.seek(_POINT_BYTES * first)
    return np.frombuffer(file.read(_POINT_BYTES * count)).reshape(-1, 3)
