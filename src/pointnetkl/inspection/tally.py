"""Counts and samples of soundings, kept part by part: memory does not grow with their number."""

import numpy as np
import pandas as pd

MOST_POINTS, MOST_PINGS = 1 << 18, 1500  # kept to be drawn

_DRAWN = ["ping", "beam", "x_m", "y_m", "z_m"]


class Tally:
    """Counts the parts of a survey's soundings (survey.SOUNDINGS), which are whole pings in order."""

    def __init__(self) -> None:
        """Begin without soundings."""
        self.low, self.high = np.full(2, np.inf), np.full(2, -np.inf)  # x, y of the valid ones, metres
        self._beams: list[np.ndarray] = []
        self._widths: list[np.ndarray] = []
        self._points = _Points()
        self._swaths = _Swaths()

    def take(self, part: pd.DataFrame) -> None:
        """Count a part."""
        valid = part[part["quality"].to_numpy() == 0]
        places = valid[["x_m", "y_m", "z_m"]].to_numpy()
        self.low = np.minimum(self.low, places[:, :2].min(axis=0, initial=np.inf))
        self.high = np.maximum(self.high, places[:, :2].max(axis=0, initial=-np.inf))
        self._points.add(places)
        if len(part) and part["ping"].iloc[0] >= 0:
            self._beams.append(np.diff(_begins(part["ping"].to_numpy())))
            self._widths.append(_widths(valid["ping"].to_numpy(), places))
            self._swaths.add(valid)

    @property
    def points(self) -> np.ndarray:
        """Valid soundings (n, 3), x, y, z: all, or at most MOST_POINTS by chance, the same ones of the same file."""
        return np.concatenate([np.empty((0, 3)), *self._points.places])

    @property
    def swaths(self) -> pd.DataFrame:
        """Valid soundings (ping, beam, x_m, y_m, z_m) of all pings, or of every second, fourth, eighth..."""
        return pd.concat(self._swaths.tables) if self._swaths.tables else pd.DataFrame(columns=_DRAWN)

    def beams(self, pings: int) -> dict[str, int] | None:
        """Return how many soundings the `pings` pings of a survey have; pings that were not counted have none."""
        if not pings:
            return None
        counted = np.concatenate([np.empty(0, int), *self._beams])
        count = np.append(counted, np.zeros(max(0, pings - len(counted)), int))
        return {"min": int(count.min()), "median": int(np.median(count)), "max": int(count.max())}

    def swath_m(self) -> float | None:
        """Return the median width of a ping's valid soundings; None if every ping has only one."""
        widths = np.concatenate([np.empty(0), *self._widths])
        return float(np.median(widths)) if np.any(widths > 0) else None


class _Points:
    """Places, each kept if its random number is below a share, which is halved whenever there are too many."""

    def __init__(self) -> None:
        self.places: list[np.ndarray] = []
        self._keys: list[np.ndarray] = []
        self._share, self._count = 1.0, 0
        self._rng = np.random.default_rng(0)

    def add(self, places: np.ndarray) -> None:
        keys = self._rng.random(len(places))
        kept = keys < self._share
        self.places.append(places[kept])
        self._keys.append(keys[kept])
        self._count += int(kept.sum())
        while self._count > MOST_POINTS:
            self._share /= 2
            places, keys = np.concatenate(self.places), np.concatenate(self._keys)
            kept = keys < self._share
            self.places, self._keys, self._count = [places[kept]], [keys[kept]], int(kept.sum())


class _Swaths:
    """Soundings of every k-th ping; k doubles whenever there are too many pings."""

    def __init__(self) -> None:
        self.tables: list[pd.DataFrame] = []
        self._step = 1

    def add(self, valid: pd.DataFrame) -> None:
        self._keep(valid)
        while len(self.tables) and self.tables[-1]["ping"].iloc[-1] // self._step >= MOST_PINGS:
            self._step *= 2
            before, self.tables = self.tables, []
            for table in before:
                self._keep(table)

    def _keep(self, table: pd.DataFrame) -> None:
        thinned = table.loc[table["ping"].to_numpy() % self._step == 0, _DRAWN]
        if len(thinned):
            self.tables.append(thinned)


def _begins(ping: np.ndarray) -> np.ndarray:
    """Return the rows at which each ping of a sorted column begins, and the length of the column."""
    return np.flatnonzero(np.r_[True, np.diff(ping) != 0, True])


def _widths(ping: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return the distance between the outermost soundings of each ping, metres."""
    if not len(ping):
        return np.empty(0)
    begin = _begins(ping)[:-1]
    sides = [np.maximum.reduceat(axis, begin) - np.minimum.reduceat(axis, begin) for axis in places[:, :2].T]
    return np.asarray(np.hypot(*sides))  # a swath is a line, so the diagonal of its box is its length
