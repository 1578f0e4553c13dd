"""The numbers of the page, and how they are written: never more digits than are of use."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from pointnetkl.correction.result import Corrected, Verdict
from pointnetkl.slam.closing.schemas import State

UNKNOWN = "—"
LARGEST = 20  # residuals in the table


@dataclass(frozen=True)
class Number:
    """One of the numbers on the first screen."""

    label: str
    value: str
    unit: str
    note: str


@dataclass(frozen=True)
class Curves:
    """How far each of many is off, before and after the correction."""

    of: str
    label: str
    before: np.ndarray
    after: np.ndarray
    in_sigmas: bool = False


def headline(corrected: Corrected) -> list[Number]:
    """Return the five numbers on the first screen."""
    verdict, track = corrected.verdict, corrected.track
    tried = "before → after" if verdict.applied else "before → if corrected"
    sigmas = sigma_m(track, "before_"), sigma_m(track, "")
    return [
        Number("Track moved by", *_moved(track)),
        Number(
            "Overlapping passes disagree by",
            pair(verdict.disagreement_before_m, verdict.disagreement_after_m),
            "m",
            f"rms of depths, {tried}",
        ),
        Number("Loop closures accepted", *_accepted(verdict.accepted, verdict.closures)),
        Number(
            "A closure left out misses by",
            pair(verdict.left_out_before_m, verdict.left_out_after_m),
            "m",
            f"rms, {tried}",
        ),
        Number(
            "Typical sigma of a ping",
            pair(*sigmas) if verdict.applied else length(sigmas[1]),
            "m",
            "along an axis, median" + (f", {tried}" if verdict.applied else " over pings"),
        ),
    ]


def _moved(track: pd.DataFrame) -> tuple[str, str, str]:
    if track.empty:
        return UNKNOWN, "", "there are no pings"
    moved = np.hypot(track["moved_x_m"], track["moved_y_m"]).to_numpy(np.float64)
    if not moved.any():
        return "0", "m", "nothing was added to navigation"
    return length(rms(moved)), "m", f"rms over pings, {length(float(moved.max()))} m at most"


def _accepted(accepted: int, closures: int) -> tuple[str, str, str]:
    if not closures:
        return "0", "", "no part of the track returns to mapped ground"
    return f"{accepted} of {closures}", "", f"{100 * accepted / closures:.0f} % of the submaps on mapped ground"


def sigma_m(track: pd.DataFrame, prefix: str) -> float:
    """Return the median over pings of sigma along an axis, metres, of the variances with a prefix; NaN if unknown."""
    variance = (track[f"{prefix}var_xx_m2"] + track[f"{prefix}var_yy_m2"]).to_numpy(np.float64) / 2
    known = variance[np.isfinite(variance)]
    return float(np.median(np.sqrt(known))) if len(known) else np.nan


def rms(values: np.ndarray) -> float:
    """Return the root mean square of the values that are known; NaN without any."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else np.nan


def length(metres: float | None) -> str:
    """Return a length in metres as text: to the millimetre below a decimetre, to the metre above a hundred."""
    return _fixed(metres, _decimals(metres))


def pair(before: float, after: float) -> str:
    """Return two lengths with an arrow between, to as many decimals as the smaller one needs."""
    if not np.isfinite([before, after]).any():
        return UNKNOWN
    decimals = max(_decimals(value) for value in (before, after) if np.isfinite(value))
    return f"{_fixed(before, decimals)} → {_fixed(after, decimals)}"


def _decimals(metres: float | None) -> int:
    size = abs(metres) if metres is not None and np.isfinite(metres) else 0.0
    return 0 if size >= 100 else 1 if size >= 10 else 2 if size >= 0.1 or size == 0 else 3


def _fixed(value: float | None, decimals: int) -> str:
    if value is None or not np.isfinite(value):
        return UNKNOWN
    return f"{value:.{decimals}f}".replace("-", "−")


def plain(value: Any) -> str:
    """Return any value as text: numbers to four digits, counts whole."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}".replace(",", " ").replace("-", "−")
    if isinstance(value, float):
        text = UNKNOWN if not np.isfinite(value) else f"{value:.0f}" if abs(value) >= 1000 else f"{value:.4g}"
        return text.replace("-", "−")
    return str(value)


def by_state(closures: pd.DataFrame) -> dict[State, int]:
    """Return how many closures there are of each state that occurs, accepted first."""
    counts = closures["state"].value_counts()
    return {state: int(counts[state]) for state in State if state in counts.index}


def largest_residuals(closures: pd.DataFrame) -> pd.DataFrame:
    """Return the closures that lie farthest off at the corrected poses, in sigmas, the worst first."""
    order = pd.to_numeric(closures["sigmas_after"]).sort_values(ascending=False, kind="stable", na_position="last")
    return closures.loc[order.dropna().index[:LARGEST]]


def curves(closures: pd.DataFrame, cells: tuple[np.ndarray, np.ndarray] | None) -> list[Curves]:
    """Return what is off by how much before and after: depths of `cells` that passes share, if known, and closures."""
    accepted = closures[closures["state"] == State.ACCEPTED]
    x, y, left_out = _known(accepted, ["shift_x_m", "shift_y_m", "left_out_m"])
    sigmas_before, sigmas_after = _known(accepted, ["sigmas_before", "sigmas_after"])
    before, after = (np.abs(each[np.isfinite(each)]) for each in cells or (np.empty(0), np.empty(0)))
    every = (
        Curves("cells", "two passes differ in depth by (m)", before, after),
        Curves("closures", "a closure left out misses by (m)", np.hypot(x, y), left_out),
        Curves("closures", "residual of a closure (sigmas)", sigmas_before, sigmas_after, True),
    )
    return [each for each in every if len(each.before) and len(each.after)]


def _known(closures: pd.DataFrame, names: Sequence[str]) -> list[np.ndarray]:
    """Return columns as numbers, of the closures alone that have a value in all of them."""
    columns = np.array([pd.to_numeric(closures[name]).to_numpy(np.float64) for name in names])
    return list(columns[:, np.isfinite(columns).all(axis=0)])


def sigmas(value: float | None) -> str:
    """Return a length in sigmas as text."""
    return UNKNOWN if value is None or not np.isfinite(value) else f"{value:.1f}"


def agreement(verdict: Verdict) -> list[tuple[str, str, str]]:
    """Return what was measured at navigation and after the correction: what, and the two values."""
    cells = verdict.disagreement_before_m, verdict.disagreement_after_m
    left_out = verdict.left_out_before_m, verdict.left_out_after_m
    rows = (("Depths that two passes give of a cell, rms", cells), ("Closures, each left out in turn, rms", left_out))
    return [(what, _metres(b), _metres(a)) for what, (b, a) in rows if np.isfinite([b, a]).any()]


def _metres(value: float) -> str:
    return f"{length(value)} m" if np.isfinite(value) else UNKNOWN
