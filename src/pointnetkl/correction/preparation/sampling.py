"""The length of submaps and the spacing of their points, chosen from a survey's own pings and soundings."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pandas as pd

_POINTS = 4000.0  # of a submap: enough to register a third of it, few enough to be quick
_FEWEST = 1500.0  # where soundings are so sparse that a swath's width of them has fewer
_OF_LINE = 0.2  # of the longest line, that a submap has at most
_LEAST_BEAMS = 8
_USUAL = 0.75  # quantile of steps: of two kinds in turn the longer one


@dataclass(frozen=True)
class Sampling:
    """How a survey is cut."""

    length_m: float  # of a submap, along the track
    spacing_m: float  # of its points
    max_gap_m: float  # between two pings of a line
    reason: str  # in words


def choose(pings: pd.DataFrame, soundings: Iterable[pd.DataFrame], longest_m: float) -> Sampling:
    """Return a sampling for pings (survey.PINGS) and a sample of their soundings (survey.SOUNDINGS).

    A submap is about as long as the swath is wide, with a point in each square of a spacing that the sonar fills: not
    below the steps from ping to ping and from beam to beam, and such that a submap has some 4,000 points. Where lines
    are short it is a fifth of the longest, which is `longest_m` long.
    """
    step = _step(pings)
    widths, beams = _swaths(pings.set_index("ping")["time_s"], soundings)
    width = max(float(np.median(widths)), step) if len(widths) else 10 * step
    across = width / float(np.median(beams)) if len(beams) else step
    finest = 1.2 * max(step, across)
    spacing = max(finest, math.sqrt(width * width / _POINTS))
    length = max(width, _FEWEST * spacing**2 / width)
    most = max(_OF_LINE * longest_m, 10 * spacing)
    short = f" and the longest line {longest_m:,.4g} m long" if most < length else ""
    length, spacing = _round(min(length, most)), _round(spacing)
    reason = (
        f"the swath is {width:,.4g} m wide{short}, pings are {step:.2g} m and beams {across:.2g} m apart:"
        f" submaps of {length:g} m with a point every {spacing:g} m"
    )
    return Sampling(length, spacing, max(10 * step, 2 * spacing), reason)


def _step(pings: pd.DataFrame) -> float:
    """Return the usual step between pings that move, metres; of pings in pairs, that from pair to pair."""
    steps = np.hypot(*np.diff(pings[["x_m", "y_m"]].to_numpy(np.float64), axis=0).T)
    moving = steps[steps > 1e-3]
    return float(np.quantile(moving, _USUAL)) if len(moving) else 1.0


def _swaths(times: pd.Series, soundings: Iterable[pd.DataFrame]) -> tuple[np.ndarray, np.ndarray]:
    """Return the widths (n,), from the 1st to the 99th percentile of beams, and beams (n,) of sampled pings.

    Pings at one time are the heads of one sonar.
    """
    widths, beams = [], []
    for part in soundings:
        good = part[(part["quality"] == 0) & np.isfinite(part[["x_m", "y_m"]]).all(axis=1)]
        for _, ping in good.groupby(times.reindex(good["ping"]).to_numpy(), sort=True):
            if len(ping) >= _LEAST_BEAMS:
                xy = ping[["x_m", "y_m"]].to_numpy(np.float64)
                _, _, axes = np.linalg.svd(xy - xy.mean(axis=0), full_matrices=False)
                low, high = np.percentile(xy @ axes[0], [1, 99])
                widths.append(high - low)
                beams.append(len(ping))
    return np.array(widths), np.array(beams)


def _round(value: float) -> float:
    """Return a value to two digits."""
    return float(f"{value:.2g}")
