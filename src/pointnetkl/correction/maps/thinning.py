"""What a map must hold, by a random sample of a survey's good soundings: its cells, and how far soundings may lie."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pandas as pd

from pointnetkl.correction.maps import renavigation, tiles
from pointnetkl.correction.result import CorrectionError

LARGEST = 1 << 28  # cells of a map's bounding box

_MOST = 1 << 20  # soundings of a sample
_SEED = 20_240_229  # unlike those of simulations, whose soundings would be of one stream with the choice
_PER_CELL = 5.0  # good soundings that a cell of a map should hold
_ENOUGH = 16  # soundings of the sample in a cell that tells their density
_SMALLEST_M, _ROOM = 0.01, 0.9
_REACH, _TIMES, _NEAREST_M = 0.999, 3.0, 1.0


@dataclass(frozen=True)
class Sample:
    """Good soundings drawn at random, without those that lie too far away; and counts of all soundings."""

    before: np.ndarray  # (k, 2) places, metres in the map frame
    after: np.ndarray  # (k, 2) at the corrected track
    share: float  # of the good soundings that were drawn
    soundings: int
    farthest_m: float  # of a sounding from the map frame's origin along an axis, before the correction
    middle: np.ndarray  # (2,) median
    reach_m: float  # farther from its ping than this (without pings: from the middle) no sounding is believed


def draw(parts: Iterable[pd.DataFrame], track: pd.DataFrame) -> Sample:
    """Read all soundings (survey.SOUNDINGS) and draw a million good ones; the sample does not depend on the parts.

    No sounding is believed that lies three times as far from its ping as 99.9 % of them do, and over a metre.

    Raises:
        CorrectionError: no sounding is good, or one is of a ping that the track lacks.
    """
    rng, share, soundings, farthest = np.random.default_rng(_SEED), 1.0, 0, 0.0
    drawn: list[pd.DataFrame] = []
    for part in parts:
        soundings += len(part)
        farthest = max(farthest, float(np.abs(renavigation.places(part)).max(initial=0.0)))
        good = np.flatnonzero(part["quality"].to_numpy() == 0)
        chance = rng.random(len(good))
        drawn.append(part[["ping", "x_m", "y_m"]].iloc[good[chance < share]].assign(chance=chance[chance < share]))
        while sum(map(len, drawn)) > _MOST:
            share /= 2
            rows = pd.concat(drawn)
            drawn = [rows[rows["chance"] < share]]
    if not sum(map(len, drawn)):
        raise CorrectionError(f"none of {soundings} soundings is good, and there is nothing to map; check their flags")
    return _believed(pd.concat(drawn), track, share, soundings, farthest)


def distances(before: np.ndarray, rows: np.ndarray, track: pd.DataFrame, middle: np.ndarray) -> np.ndarray:
    """Return how far soundings at `before` (n, 2) lie from their pings, metres; without pings, from the middle."""
    offset = before - (middle if track.empty else renavigation.pings_at(rows, track))
    return np.hypot(offset[:, 0], offset[:, 1])


def cell_size(sample: Sample, origin: tuple[float, float]) -> float:
    """Return the size of a map's cells in metres, so that a typical one holds some five good soundings.

    Their density is the median over coarse cells, which are as small as 16 soundings of the sample in each allow. The
    size is 1, 2 or 5 times a power of ten, at least 0.01 m, and so large that a map has at most 2^24 cells with
    soundings and 2^28 in its bounding box.
    """
    wanted = max(math.sqrt(_PER_CELL / _density(sample.before, sample.share)), _SMALLEST_M)
    steps = [round(digit * 10.0**power, 2) for power in range(-2, 8) for digit in (1, 2, 5)]
    nearest = min(range(len(steps)), key=lambda index: abs(math.log(steps[index] / wanted)))
    places = [before_or_after + origin for before_or_after in (sample.before, sample.after)]
    return next(size for size in steps[nearest:] if _fits(places, size))


def _believed(drawn: pd.DataFrame, track: pd.DataFrame, share: float, soundings: int, farthest: float) -> Sample:
    before, rows = renavigation.places(drawn), renavigation.rows_of(drawn, track)
    middle = np.median(before, axis=0)
    distance = distances(before, rows, track, middle)
    # the next lower, so that of few soundings the farthest does not decide alone
    reach = max(_TIMES * float(np.quantile(distance, _REACH, method="lower")), _NEAREST_M)
    near = distance <= reach
    after = renavigation.moved(before, rows, track)
    return Sample(before[near], after[near], share, soundings, farthest, middle, reach)


def _density(places: np.ndarray, share: float) -> float:
    """Return good soundings per square metre in a typical place."""
    offset = places - places.min(axis=0)
    side = max(float(offset.max()), 1.0) / 65536
    while True:
        column, row = np.floor(offset / side).astype(np.int64).T
        count = np.unique(row << 32 | column, return_counts=True)[1]
        if np.median(count) >= _ENOUGH or len(count) == 1:
            return float(np.median(count)) / share / side**2
        side *= 2


def _fits(places: list[np.ndarray], size: float) -> bool:
    together = np.concatenate(places)
    columns, rows = np.ptp(together, axis=0) / size + 1
    return columns * rows <= _ROOM * LARGEST and max(tiles.count(one, size) for one in places) <= _ROOM * tiles.MOST
