"""A survey's good soundings, those of quality 0 with a valid position, read part by part and given out by ping.

What is left out is counted.
"""

from collections import Counter
from collections.abc import Iterable

import numpy as np
import pandas as pd

from pointnetkl.workflow.errors import PointNetKLError

XYZ = ["x_m", "y_m", "z_m"]
_FARTHEST_M = 1e7  # from the map's origin: no place on earth is farther


class SoundingsError(PointNetKLError):
    """None of a survey's soundings can be used, or they are not those of its pings."""


def good(part: pd.DataFrame, dropped: Counter[str]) -> pd.DataFrame:
    """Return the good ones of a part's soundings (survey.SOUNDINGS); the others are counted in `dropped`."""
    accepted, placed = part["quality"].to_numpy() == 0, on_earth(part)
    dropped["soundings of bad quality"] += int(np.sum(~accepted))
    dropped["soundings without a valid position"] += int(np.sum(accepted & ~placed))
    return part[accepted & placed]


def on_earth(table: pd.DataFrame) -> np.ndarray:
    """Return which rows (n,) of a table have a valid position in the map frame."""
    return np.asarray((np.abs(table[XYZ].to_numpy(np.float64)) < _FARTHEST_M).all(axis=1))  # false for NaN


def none_good(survey: str, read: int) -> SoundingsError:
    """Return the error of a survey without a good sounding among those read."""
    return SoundingsError(
        f"{survey}: none of its {read} soundings has quality 0 and a valid position; check the quality flags of the"
        " raw data"
    )


class Forward:
    """The good soundings of a survey, read forward as pings are asked for, and released behind them."""

    def __init__(self, survey: str, pings: np.ndarray, parts: Iterable[pd.DataFrame], dropped: Counter[str]) -> None:
        """Begin with the first of the pings (k,), in rising order; parts are in order of ping."""
        self._survey, self._pings, self._parts, self._dropped = survey, pings, iter(parts), dropped
        self._row, self._xyz = np.empty(0, np.int64), np.empty((0, 3))
        self._read, self._good, self._last = 0, 0, -1

    def between(self, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
        """Return each good sounding's ping as a row (n,) and its map position (n, 3), for pings first to last - 1.

        Raises:
            SoundingsError: the soundings are not in order of ping, or belong to no ping.
        """
        while not len(self._row) or self._row[-1] < last:
            self._drop_before(first)
            if not self._read_part():
                break
        begin, end = np.searchsorted(self._row, [first, last])
        return self._row[begin:end], self._xyz[begin:end]

    def finish(self) -> None:
        """Count the soundings that no call of `between` asked for.

        Raises:
            SoundingsError: as by `between`, or there was no good sounding.
        """
        while self._read_part():
            self._drop_before(len(self._pings))
        if not self._good:
            raise none_good(self._survey, self._read)

    def _drop_before(self, first: int) -> None:
        begin = np.searchsorted(self._row, first)
        self._row, self._xyz = self._row[begin:], self._xyz[begin:]

    def _read_part(self) -> bool:
        part = next(self._parts, None)
        if part is None:
            return False
        rows = good(part, self._dropped)
        self._read, self._good = self._read + len(part), self._good + len(rows)
        self._row = np.concatenate([self._row, self._rows(rows["ping"].to_numpy())])
        self._xyz = np.concatenate([self._xyz, rows[XYZ].to_numpy(np.float64)])
        return True

    def _rows(self, ping: np.ndarray) -> np.ndarray:
        """Return the rows of pings (n,) in the table of pings."""
        row = np.searchsorted(self._pings, ping).clip(max=len(self._pings) - 1)
        if (strays := self._pings[row] != ping).any():
            raise SoundingsError(
                f"{self._survey}: {strays.sum()} soundings belong to no ping, the first to ping {ping[strays][0]}; both"
                " tables must come from one run of ingest"
            )
        if np.any(np.diff(row, prepend=self._last) < 0):
            raise SoundingsError(f"{self._survey}: its soundings are not in order of ping; run ingest again")
        self._last = int(row[-1]) if len(row) else self._last
        return row
