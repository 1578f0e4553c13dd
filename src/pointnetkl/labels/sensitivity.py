"""How a label depends on choices that the paper leaves open: number of runs, point spacing, noise of the copy.

All labels of a submap start from the same draws, and labels of the same points have the same noise, scaled. So they
differ by the choice that was varied, and hardly by chance.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.registration.covariance.label_table import CONDITIONS, RUNS
from pointnetkl.registration.monte_carlo import Outcome
from pointnetkl.registration.streams import Stream
from pointnetkl.segmentation import spacing
from pointnetkl.surveys import submap
from pointnetkl.surveys.submap import Submap
from pointnetkl.workflow.errors import PointNetKLError
from pointnetkl.workflow.parameters import require_positive, require_seed

_REPEATS = 100  # parts of one size at most: the standard error of their mean is a tenth of their spread


class SensitivityError(PointNetKLError):
    """A label cannot be varied."""


@dataclass(frozen=True)
class Settings:
    """Section `vary` of the parameters.

    Raises:
        ValueError: a number is out of its range, or a list is empty.
    """

    seed: int
    submaps: int  # of each survey
    runs: int  # of the label whose parts are labels of fewer runs
    run_counts: list[int]  # sizes of the parts
    compared_runs: int  # of a label under another spacing or noise
    thinnings: list[float]  # edges of cells, as multiples of the survey's
    noise_sigmas_m: list[float]

    def __post_init__(self) -> None:
        """Refuse settings out of range."""
        require_seed(self.seed)
        require_positive(self, "submaps")
        for name, least in (("run_counts", 3), ("thinnings", 1), ("noise_sigmas_m", 0)):
            if min(getattr(self, name), default=-1) < least:
                raise ValueError(f"{name} is {getattr(self, name)}, must be one number or more, each {least} or above")
        for name in ("runs", "compared_runs"):
            if getattr(self, name) < 3:
                raise ValueError(f"{name} is {getattr(self, name)}, must be 3 or above: fewer make a singular label")
        if 3 * min(self.run_counts) > self.runs:
            raise ValueError(f"run_counts is {self.run_counts}, one must be a third of runs ({self.runs}) at most")


@dataclass(frozen=True)
class Variation:
    """A label to compute, and in study `runs` the labels of its parts."""

    submap: int
    study: str
    copy: str
    noise_sigma_m: float
    thinning: float
    runs: int


def ruggedness(cloud: Submap, registration: gicp.Settings) -> float:
    """Return the mean square slope of a submap's normals in the direction of least slope: 0 for flat ground."""
    lean = gicp.prepare(cloud.points, registration).normals[:, :2].astype(np.float64)
    return float(np.linalg.eigvalsh(lean.T @ lean / len(lean))[0])


def spread(ruggednesses: Sequence[float], count: int) -> list[int]:
    """Return the indices of `count` submaps, or of all, evenly spaced in the order of ruggedness, flattest first."""
    order = np.argsort(ruggednesses, kind="stable")
    count = min(count, len(order))
    return [int(order[int((i + 0.5) * len(order) / count)]) for i in range(count)]


def variations(numbers: Sequence[int], settings: Settings, label: monte_carlo.Settings) -> list[Variation]:
    """Return the variations of the submaps with these numbers, the longest first; `label` has the settings to vary."""
    usual, runs = label.noise_sigma_m, settings.compared_runs
    conditions = [*((usual, t) for t in settings.thinnings), *((sigma, 1.0) for sigma in settings.noise_sigmas_m)]
    return [
        *(Variation(number, RUNS, label.copy, usual, 1.0, settings.runs) for number in numbers),
        *(
            Variation(number, CONDITIONS, copy, sigma, thinning, runs)
            for number in numbers
            for copy in ("same", "split")
            for sigma, thinning in dict.fromkeys(conditions)
        ),
    ]


def rows(
    variation: Variation,
    survey: str,
    path: Path,
    cell_m: float,
    settings: Settings,
    label: monte_carlo.Settings,
    registration: gicp.Settings,
) -> list[dict[str, Any]]:
    """Return a variation's rows; `path` is the survey's file of POINTS, whose cells have edges of `cell_m`.

    Raises:
        SensitivityError: a cloud cannot be registered.
    """
    cloud = thinned(submap.read(survey, path, variation.submap), variation.thinning, cell_m, settings.seed)
    varied = replace(label, seed=settings.seed, copy=variation.copy, noise_sigma_m=variation.noise_sigma_m)
    rng = monte_carlo.generator(varied, cloud, Stream.LABEL)
    try:
        outcome = monte_carlo.errors(cloud, variation.runs, rng, varied, registration)
    except gicp.GicpError as error:
        thinned_to = f"thinned to {variation.thinning * cell_m:g} m"
        where = f"submap {variation.submap} of {survey}, {thinned_to}, copy {variation.copy}"
        raise SensitivityError(f"{where}: {error}") from error
    target = cloud.points if variation.copy == "same" else cloud.first
    columns = {
        "survey": survey,
        "submap": variation.submap,
        "study": variation.study,
        "copy": variation.copy,
        "noise_sigma_m": variation.noise_sigma_m,
        "cell_m": variation.thinning * cell_m,
        "spacing_m": spacing.between_neighbours(target),
        "points": len(target),
    }
    counts = settings.run_counts if variation.study == RUNS else []
    return [{**columns, "repeat": i, **monte_carlo.summarise(part)} for i, part in parts(outcome, counts)]


def thinned(cloud: Submap, thinning: float, cell_m: float, seed: int) -> Submap:
    """Return a submap with one point drawn from each cell of `thinning` times `cell_m`, in all its parts."""
    if thinning == 1:
        return cloud
    rng = np.random.default_rng([seed, cloud.number])
    points = (cloud.points, cloud.first, cloud.second)
    return Submap(cloud.survey, cloud.number, *(p[spacing.thin(p, thinning * cell_m, rng)] for p in points))


def parts(outcome: Outcome, counts: Sequence[int]) -> Iterator[tuple[int, Outcome]]:
    """Yield the outcome's parts of each number of runs, with their index, and last the whole outcome."""
    runs = len(outcome.errors)
    for count in sorted(set(counts)):
        for i in range(min(runs // count, _REPEATS) if count < runs else 0):
            part = slice(i * count, (i + 1) * count)
            yield i, Outcome(outcome.errors[part], outcome.converged[part], outcome.iterations[part])
    yield 0, outcome
