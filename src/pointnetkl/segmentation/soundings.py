"""A survey's good soundings: those of quality 0 that lie somewhere, part by part, and of the pings that are asked for.

Nothing is left out without being counted.
"""

from collections import Counter
from collections.abc import Iterable

import numpy as np
import pandas as pd

from pointnetkl.workflow.errors import PointNetKLError

XYZ = ["x_m", "y_m", "z_m"]
_FARTHEST_M = 1e7  # from the map's origin: beyond it is no place on earth


class SoundingsError(PointNetKLError):
    """A survey's soundings are of no use, or not those of its pings."""


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
    """The good soundings of a survey, read on as pings are asked for, and let go behind them."""

    def __init__(self, survey: str, known: np.ndarray, parts: Iterable[pd.DataFrame], dropped: Counter[str]) -> None:
        """Begin with the first of the `known` pings (k,), in rising order; parts are in order of ping."""
        self._survey, self._known, self._parts, self._dropped = survey, known, iter(parts), dropped
        self._row, self._xyz = np.empty(0, np.int64), np.empty((0, 3))
        self._read, self._good, self._last = 0, 0, -1

    def between(self, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
        """Return each good sounding's ping as a row (n,) and its map position (n, 3), of the pings first to last.

        Raises:
            SoundingsError: the soundings are not in order of ping, or of pings that are not known.
        """
        while not len(self._row) or self._row[-1] < last:
            self._drop_before(first)
            if not self._more():
                break
        begin, end = np.searchsorted(self._row, [first, last])
        return self._row[begin:end], self._xyz[begin:end]

    def finish(self) -> None:
        """Count what nobody asked for.

        Raises:
            SoundingsError: as `between`, or there was not one good sounding.
        """
        while self._more():
            self._drop_before(len(self._known))
        if not self._good:
            raise none_good(self._survey, self._read)

    def _drop_before(self, first: int) -> None:
        begin = np.searchsorted(self._row, first)
        self._row, self._xyz = self._row[begin:], self._xyz[begin:]

    def _more(self) -> bool:
        part = next(self._parts, None)
        if part is None:
            return False
        kept = good(part, self._dropped)
        self._read, self._good = self._read + len(part), self._good + len(kept)
        self._row = np.concatenate([self._row, self._rows(kept["ping"].to_numpy())])
        self._xyz = np.concatenate([self._xyz, kept[XYZ].to_numpy(np.float64)])
        return True

    def _rows(self, ping: np.ndarray) -> np.ndarray:
        """Return the rows of pings among all."""
        row = np.searchsorted(self._known, ping).clip(max=len(self._known) - 1)
        if (lost := self._known[row] != ping).any():
            raise SoundingsError(
                f"{self._survey}: {lost.sum()} soundings belong to no ping, the first to ping {ping[lost][0]}; both"
                " tables must come from one run of ingest"
            )
        if np.any(np.diff(row, prepend=self._last) < 0):
            raise SoundingsError(f"{self._survey}: its soundings are not in order of ping; run ingest again")
        self._last = int(row[-1]) if len(row) else self._last
        return row
