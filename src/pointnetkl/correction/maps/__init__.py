"""Maps and soundings of a survey, before and after its correction.

All products come of one pass over the soundings, after one that draws a sample of them. Soundings that lie far from
their ping are in the products of soundings, but not in the maps: one stray would make a raster of gigabytes.
"""

import contextlib
import os
import shutil
import uuid
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from tqdm import tqdm

from pointnetkl.correction.maps import rasters, renavigation, table, thinning
from pointnetkl.correction.maps.cloud import CloudWriter
from pointnetkl.correction.maps.renavigation import renavigated
from pointnetkl.correction.maps.tiles import Tiles
from pointnetkl.correction.result import Corrected, CorrectionError
from pointnetkl.surveys.survey import SWATHS
from pointnetkl.workflow.errors import PointNetKLError
from pointnetkl.workflow.table_writer import TableWriter

__all__ = ["CLOUD", "TABLE", "MapNumbers", "renavigated", "write"]

CLOUD, TABLE = "soundings.laz", "soundings.parquet"

Parts = Iterable[pd.DataFrame]


@dataclass(frozen=True)
class MapNumbers:
    """What the maps hold."""

    cell_m: float
    cells_before: int
    cells_after: int
    soundings: int
    good: int
    left_out: int  # good ones too far from their ping to be believed; without pings, from the middle of all
    rms_difference_m: float  # of depth, over the cells of both maps; NaN without one


def write(
    folder: Path, corrected: Corrected, parts: Callable[[], Iterator[pd.DataFrame]], cell_m: float | None
) -> MapNumbers:
    """Write maps before and after, their difference, and the soundings as LAZ and Parquet; all of them or none.

    `parts` yields the soundings (survey.SOUNDINGS) in the order of pings. It is called twice: first for a random
    sample, that tells how far soundings lie from their pings and, where `cell_m` is None, the size of cells.

    Raises:
        CorrectionError: no sounding is good, one is of a ping that the track lacks or lies beyond the earth, the map
            has too many cells, the CRS is unknown, or a file cannot be written.
        ArtifactError: the soundings cannot be read, or their table cannot be written.
    """
    sample = thinning.draw(_progress(parts(), None, "surveying soundings"), corrected.track)
    cell_m = cell_m or thinning.cell_size(sample, corrected.origin)
    with _whole(folder) as partial:
        products = _Products(partial, corrected, sample, cell_m)
        with products.cloud, products.table:
            for part in _progress(parts(), sample.soundings, "writing soundings and maps"):
                products.add(part)
        rms = rasters.write(partial, products.before, products.after, corrected)
    cells = products.before.cells, products.after.cells
    return MapNumbers(cell_m, *cells, sample.soundings, products.good, products.left_out, rms)


class _Products:
    """The maps in memory and the files of soundings."""

    def __init__(self, folder: Path, corrected: Corrected, sample: thinning.Sample, cell_m: float) -> None:
        self.good = self.left_out = 0
        self.before = Tiles(cell_m)
        self._moves = corrected.verdict.applied and not corrected.track.empty
        self.after = Tiles(cell_m) if self._moves else self.before
        self._track, self._origin, self._sample = corrected.track, np.array(corrected.origin), sample
        known = corrected.kind == SWATHS  # of submaps times are but a count
        self._time = self._track["time_s"].to_numpy() if known else np.empty(0)
        farthest = sample.farthest_m + (_farthest_move(self._track, sample.farthest_m) if self._moves else 0.0)
        self.cloud = CloudWriter(folder / CLOUD, corrected, farthest)
        self.table = TableWriter(folder / TABLE, table.SOUNDINGS)
        self.table.metadata = {"crs": corrected.crs, "vertical": list(corrected.vertical), "survey": corrected.name}

    def add(self, part: pd.DataFrame) -> None:
        before = renavigation.places(part)
        rows = renavigation.rows_of(part, self._track)
        after = renavigation.moved(before, rows, self._track) if self._moves else before
        time = self._time[rows] if len(self._time) else np.full(len(part), np.nan)
        self.cloud.write(part, rows, after)
        self.table.write(table.rows(part, time, after + self._origin))
        good = part["quality"].to_numpy() == 0
        near = thinning.distances(before, rows, self._track, self._sample.middle) <= self._sample.reach_m
        self.good += int(good.sum())
        self.left_out += int((good & ~near).sum())
        depth = -part["z_m"].to_numpy()[good & near]
        self.before.add((before + self._origin)[good & near], depth)
        if self._moves:
            self.after.add((after + self._origin)[good & near], depth)


def _farthest_move(track: pd.DataFrame, farthest_m: float) -> float:
    """Return a bound on how far a correction moves a sounding, metres, where none lies farther from the origin."""
    shift = float(np.abs(track[["moved_x_m", "moved_y_m"]].to_numpy()).max())
    pings = float(np.abs(track[["x_m", "y_m"]].to_numpy()).max())
    return shift + 2 * float(np.abs(track["moved_yaw_rad"]).max()) * (pings + farthest_m)


def _progress(parts: Parts, total: int | None, doing: str) -> Iterator[pd.DataFrame]:
    """Yield the parts; after two seconds a progress bar counts their soundings."""
    bar = {"unit": " soundings", "unit_scale": True, "delay": 2.0, "leave": False, "dynamic_ncols": True}
    with tqdm(desc=doing, total=total, **bar) as progress:
        for part in parts:
            yield part
            progress.update(len(part))


@contextlib.contextmanager
def _whole(folder: Path) -> Iterator[Path]:
    """Yield a new folder, whose files move to `folder` in the end unless there was an error."""
    partial = folder / f".maps.{uuid.uuid4().hex}.partial"
    try:
        partial.mkdir(parents=True)
        yield partial
        for path in sorted(partial.iterdir()):
            os.replace(path, folder / path.name)
    except OSError as error:
        raise CorrectionError(f"{folder}: cannot be written ({error.strerror}); is the disk full?") from error
    except PointNetKLError as error:  # its sentence names a file that nobody will find
        raise type(error)(str(error).replace(str(partial), str(folder))) from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)
