"""Which submaps a figure shows: some from large label to small, or those that a method is most wrong about."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pointnetkl.registration.covariance import gaussian
from pointnetkl.reporting.covariances.ellipse_plots import Case
from pointnetkl.reporting.drawing import relief
from pointnetkl.reporting.results import Labels, Test


@dataclass(frozen=True)
class Survey:
    """A test survey's submaps: points (n_i, 3) in metres, labels, and every method's covariances."""

    name: str
    clouds: Sequence[np.ndarray]
    labels: Labels
    test: Test
    floor_m2: float  # added to label and Q for the divergence

    @cached_property
    def kl(self) -> dict[str, np.ndarray]:
        """The divergence of each submap's label from each method's Q, (k,) nats by method."""
        covariances = self.test.covariances.items()
        return {method: gaussian.divergence(self.labels.q, q, self.floor_m2) for method, q in covariances}

    def case(self, index: int, methods: Iterable[str]) -> Case:
        """Return what to draw of the submap at a place in the survey's order, of the methods that it has."""
        present = [method for method in methods if method in self.test.covariances]
        return Case(
            survey=self.name,
            submap=int(self.labels.submap[index]),
            seabed=relief.from_points(self.clouds[index]),
            label=self.labels.q[index],
            covariances={method: self.test.covariances[method][index] for method in present},
            kl={method: float(self.kl[method][index]) for method in present},
        )


def large_to_small(survey: Survey, methods: Sequence[str], count: int) -> list[Case]:
    """Return at most `count` submaps, evenly spaced by the trace of their labels in x, y, the largest label first."""
    order = np.argsort(-np.trace(survey.labels.q[:, :2, :2], axis1=1, axis2=2), kind="stable")
    ranks = np.linspace(0, len(order) - 1, min(count, len(order))).round().astype(int)
    return [survey.case(int(order[rank]), methods) for rank in ranks]


def worst(surveys: Sequence[Survey], method: str, count: int) -> list[Case]:
    """Return at most `count` submaps of all the surveys, the largest divergence from the method's Q first."""
    return _first(surveys, method, count, -1)


def best(surveys: Sequence[Survey], method: str, count: int) -> list[Case]:
    """Return at most `count` submaps of all the surveys, the smallest divergence from the method's Q first."""
    return _first(surveys, method, count, 1)


def _first(surveys: Sequence[Survey], method: str, count: int, sign: int) -> list[Case]:
    submaps = [(sign * kl, i, j) for i, survey in enumerate(surveys) for j, kl in enumerate(survey.kl.get(method, ()))]
    return [surveys[i].case(j, [method]) for _, i, j in sorted(submaps)[:count]]
