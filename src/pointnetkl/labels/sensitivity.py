"""How a label depends on what the paper leaves open: the number of runs, the point spacing, the noise of the copy.

Every label of a submap here starts from the same draws, and labels of the same points have the same noise, scaled:
they differ by what was varied and hardly by chance.
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

_REPEATS = 100  # parts of one size at most: their mean is known to a tenth of their spread


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
    runs: int  # that labels of fewer are parts of
    run_counts: list[int]  # sizes of the parts
    compared_runs: int  # of a label under another spacing or noise
    thinnings: list[float]  # edges of cells, in those of the survey
    noise_sigmas_m: list[float]

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
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
class Case:
    """A label to make, or labels of the parts of one."""

    submap: int
    study: str
    copy: str
    noise_sigma_m: float
    thinning: float
    runs: int


def ruggedness(one: Submap, registration: gicp.Settings) -> float:
    """Return how much a submap's normals lean in the direction in which they lean least: mean square, 0 if flat."""
    lean = gicp.prepare(one.points, registration).normals[:, :2].astype(np.float64)
    return float(np.linalg.eigvalsh(lean.T @ lean / len(lean))[0])


def spread(rugged: Sequence[float], count: int) -> list[int]:
    """Return so many places, or all, evenly spaced in the order of ruggedness, the flattest first."""
    order = np.argsort(rugged, kind="stable")
    count = min(count, len(order))
    return [int(order[int((i + 0.5) * len(order) / count)]) for i in range(count)]


def cases(chosen: Sequence[int], settings: Settings, label: monte_carlo.Settings) -> list[Case]:
    """Return every label to make of the chosen submaps, the longest first; `label` is what they are varied from."""
    usual, runs = label.noise_sigma_m, settings.compared_runs
    conditions = [*((usual, t) for t in settings.thinnings), *((sigma, 1.0) for sigma in settings.noise_sigmas_m)]
    return [
        *(Case(number, RUNS, label.copy, usual, 1.0, settings.runs) for number in chosen),
        *(
            Case(number, CONDITIONS, copy, sigma, thinning, runs)
            for number in chosen
            for copy in ("same", "split")
            for sigma, thinning in dict.fromkeys(conditions)
        ),
    ]


def rows(
    case: Case,
    survey: str,
    path: Path,
    cell_m: float,
    settings: Settings,
    label: monte_carlo.Settings,
    registration: gicp.Settings,
) -> list[dict[str, Any]]:
    """Return a case's rows of VARIATIONS; `path` is the survey's file of POINTS, thinned to cells of `cell_m`.

    Raises:
        SensitivityError: a cloud cannot be registered.
    """
    one = thinned(submap.read(survey, path, case.submap), case.thinning, cell_m, settings.seed)
    how = replace(label, seed=settings.seed, copy=case.copy, noise_sigma_m=case.noise_sigma_m)
    rng = monte_carlo.generator(how, one, Stream.LABEL)
    try:
        outcome = monte_carlo.errors(one, case.runs, rng, how, registration)
    except gicp.GicpError as error:
        where = f"submap {case.submap} of {survey}, thinned to {case.thinning * cell_m:g} m, copy {case.copy}"
        raise SensitivityError(f"{where}: {error}") from error
    onto = one.points if case.copy == "same" else one.first
    described = {
        "survey": survey,
        "submap": case.submap,
        "study": case.study,
        "copy": case.copy,
        "noise_sigma_m": case.noise_sigma_m,
        "cell_m": case.thinning * cell_m,
        "spacing_m": spacing.between_neighbours(onto),
        "points": len(onto),
    }
    counts = settings.run_counts if case.study == RUNS else []
    return [{**described, "repeat": i, **monte_carlo.summarise(part)} for i, part in parts(outcome, counts)]


def thinned(one: Submap, thinning: float, cell_m: float, seed: int) -> Submap:
    """Return a submap with one point drawn from each cell of `thinning` times `cell_m`, in all its parts."""
    if thinning == 1:
        return one
    rng = np.random.default_rng([seed, one.number])
    clouds = (one.points, one.first, one.second)
    return Submap(one.survey, one.number, *(p[spacing.thin(p, thinning * cell_m, rng)] for p in clouds))


def parts(outcome: Outcome, counts: Sequence[int]) -> Iterator[tuple[int, Outcome]]:
    """Yield parts of each number of runs that the outcome has, with their place, and last the whole of it."""
    runs = len(outcome.errors)
    for count in sorted(set(counts)):
        for i in range(min(runs // count, _REPEATS) if count < runs else 0):
            these = slice(i * count, (i + 1) * count)
            yield i, Outcome(outcome.errors[these], outcome.converged[these], outcome.iterations[these])
    yield 0, outcome
