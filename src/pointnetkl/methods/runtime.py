"""Seconds that a method takes for one submap, every preprocessing step included (Table III of the paper)."""

import platform
import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pointnetkl.registration.covariance import gaussian
from pointnetkl.registration.covariance.method import Method
from pointnetkl.surveys.submap import Submap
from pointnetkl.workflow import machine as this_machine
from pointnetkl.workflow import parameters
from pointnetkl.workflow.errors import PointNetKLError

_SHORT_S, _ROUNDS = 0.1, 9


class RuntimeMeasurementError(PointNetKLError):
    """There is nothing to time."""


@dataclass(frozen=True)
class Settings:
    """Section `time` of the parameters: what the methods are timed on.

    Raises:
        ValueError: a number is too small.
    """

    seed: int
    submaps: int
    terrain: str  # whose ground: a survey of section `simulate`
    points: int  # of each submap
    spacing_m: float  # between them
    runs: int  # registrations of monte_carlo

    def __post_init__(self) -> None:
        """Refuse values out of their range."""
        parameters.require_seed(self.seed)
        parameters.require_positive(self, "submaps", "spacing_m")
        if min(self.points, self.runs) < 3:
            raise ValueError(f"points is {self.points} and runs {self.runs}, must be at least 3 each")


@dataclass(frozen=True)
class Timing:
    """Seconds per submap."""

    mean_s: float
    std_s: float  # over submaps; 0 of a single one


def measure(method: Method, submaps: Sequence[Submap]) -> Timing:
    """Return how long a method takes for a submap, after one call that is not counted.

    Raises:
        RuntimeMeasurementError: there are no submaps.
        CovarianceError: the answer is not a covariance, so its time means nothing.
    """
    if not submaps:
        raise RuntimeMeasurementError("there are no submaps to time on; time.submaps must be at least 1")
    # the first call compiles kernels and loads libraries
    gaussian.check(method.covariance(submaps[0]), f"{submaps[0].survey}, {method.name}")
    rounds = [[_seconds(method, submap) for submap in submaps]]
    # a few milliseconds are measured again, submap after submap so that none is still in the cache; the median counts
    if statistics.fmean(rounds[0]) < _SHORT_S:
        rounds += [[_seconds(method, submap) for submap in submaps] for _ in range(_ROUNDS - 1)]
    seconds = [statistics.median(times) for times in zip(*rounds, strict=True)]
    return Timing(statistics.fmean(seconds), statistics.stdev(seconds) if len(seconds) > 1 else 0.0)


def submap(points: np.ndarray, number: int) -> Submap:
    """Return a submap to time on, of points (n, 3): its two halves are every other point."""
    return Submap("time", number, points, points[::2], points[1::2])


def machine() -> dict[str, Any]:
    """Return what the times depend on: processor, its cores, and Python's version."""
    return {**this_machine.describe(), "threads": 1, "python": platform.python_version()}


def _seconds(method: Method, submap: Submap) -> float:
    start = time.perf_counter()
    method.covariance(submap)
    return time.perf_counter() - start
