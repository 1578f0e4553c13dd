"""The benchmark of false loop closures: SLAM with robust estimators, each with every method's covariances."""

import dataclasses
import functools
import itertools
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from pointnetkl.slam.benchmark import errors as slam_errors
from pointnetkl.slam.benchmark import protocol
from pointnetkl.slam.benchmark.protocol import Methods
from pointnetkl.slam.graph import gtsam_search, pose_graph, survey_graph, trajectory_error
from pointnetkl.slam.graph.pose_graph import Edges
from pointnetkl.slam.graph.survey_graph import SurveyGraph
from pointnetkl.slam.robust import estimators, false_closures, schemas
from pointnetkl.slam.robust.estimators import RobustGraph, Solution, Thresholds
from pointnetkl.workflow import compute
from pointnetkl.workflow.errors import PointNetKLError
from pointnetkl.workflow.parameters import require_positive, require_seed

_NOISE, _FALSE = 0, 1  # streams of random numbers: of the yaw noise, and of the false closures


class StressError(PointNetKLError):
    """The benchmark of false loop closures cannot run on these covariances."""


@dataclass(frozen=True)
class Settings:
    """Section `stress` of the parameters.

    Raises:
        ValueError: a setting is out of its range.
    """

    seed: int  # of the yaw noise and the false closures
    methods: list[str]
    shares: list[float]  # of false loop closures among all, in rising order
    repetitions: int
    corrupted_repetitions: int  # repetitions in which every kernel starts from the corrupted poses too
    thresholds: Thresholds

    def __post_init__(self) -> None:
        """Refuse numbers out of their range, and the same method or share twice."""
        require_seed(self.seed)
        require_positive(self, "repetitions")
        if self.corrupted_repetitions < 0:
            raise ValueError(f"corrupted_repetitions is {self.corrupted_repetitions}, must not be negative")
        if not self.methods or len(set(self.methods)) < len(self.methods):
            raise ValueError(f"methods is {self.methods}, must name at least one, and each once")
        within = all(0 <= share <= 0.9 for share in self.shares)
        if not self.shares or not within or sorted(set(self.shares)) != self.shares:
            raise ValueError(f"shares is {self.shares}, must be shares from 0 to 0.9, in rising order")


@dataclass(frozen=True)
class Experiment:
    """What all repetitions have in common."""

    graph: SurveyGraph
    methods: Methods
    pairs_apart: np.ndarray  # (p, 2) nodes whose submaps do not overlap
    yaw_sigma_rad: float  # of the noise on dead reckoning
    settings: Settings


def select_methods(covariances: Methods, settings: Settings, survey: str) -> dict[str, Mapping[int, np.ndarray]]:
    """Return the covariances of the methods that the settings name.

    Raises:
        StressError: one of them has no covariances.
    """
    if missing := [name for name in settings.methods if name not in covariances]:
        raise StressError(
            f"{survey}: stress.methods names {missing[0]}, which has no covariances; there are {', '.join(covariances)}"
        )
    return {name: covariances[name] for name in settings.methods}


def benchmark(experiment: Experiment) -> pd.DataFrame:
    """Return schemas.ROWS; repetitions run in parallel, and a survey that closes no loop has only share 0."""
    repeat = functools.partial(_repetition, experiment)
    label = f"wrong loop closures, {experiment.graph.survey}"
    repetitions = compute.over(repeat, range(experiment.settings.repetitions), label, unit="repetition")
    return pd.DataFrame(list(itertools.chain.from_iterable(repetitions)), columns=schemas.ROWS.names)


def corrupt(experiment: Experiment, repetition: int) -> np.ndarray:
    """Return dead reckoning (n - 1, 4, 4) with noise on each edge's yaw, the same for all kernels and methods."""
    return protocol.with_noise(experiment.graph, _rng(experiment, repetition, _NOISE), experiment.yaw_sigma_rad)


def corrupted_poses(experiment: Experiment, repetition: int) -> np.ndarray:
    """Return the poses (n, 4, 4) by corrupted dead reckoning."""
    return pose_graph.chain(experiment.graph.gt[0], corrupt(experiment, repetition))


def with_false(experiment: Experiment, repetition: int) -> list[tuple[float, Edges]]:
    """Return each share with a repetition's closures: the true ones, then false ones.

    A lower share has the first of the false closures of a higher one. There is only share 0 where no true closure is
    there to imitate, or no pair of submaps lies apart.
    """
    graph, shares = experiment.graph, experiment.settings.shares
    true = graph.draws[repetition % len(graph.draws)].edges
    if len(true.source) == 0 or len(experiment.pairs_apart) == 0:
        return [(0.0, true)]
    counts = false_closures.counts(len(true.source), shares)
    false = false_closures.draw(
        true, graph.gt, experiment.pairs_apart, counts[-1], _rng(experiment, repetition, _FALSE)
    )
    return [(share, false_closures.join(true, false, count)) for share, count in zip(shares, counts, strict=True)]


def _repetition(experiment: Experiment, repetition: int) -> list[dict[str, Any]]:
    graph, settings = experiment.graph, experiment.settings
    draw = repetition % len(graph.draws)
    true, initial = graph.draws[draw], corrupted_poses(experiment, repetition)
    odometry = pose_graph.Odometry(corrupt(experiment, repetition), graph.dead_reckoning_noise, initial)
    trusted = gtsam_search.join(gtsam_search.hold({0: graph.gt[0]}), odometry.factors)
    rows = []
    for method, q in experiment.methods.items():
        for share, edges in with_false(experiment, repetition):
            closures, origin = dataclasses.replace(true, edges=edges), f"{graph.survey}, {method}"
            full = survey_graph.full_covariances(graph.number, q, closures, graph.closure_noise, origin)
            robust_graph = RobustGraph(trusted, odometry.initial, edges, full, settings.thresholds)
            run = {"survey": graph.survey, "method": method, "share": share, "draw": draw, "repetition": repetition}
            for kernel, start, solution in _solutions(robust_graph, repetition < settings.corrupted_repetitions):
                measures = _measures(graph, true.edges, edges, solution)
                rows.append({**run, "kernel": kernel, "start": start, **measures})
    return rows


def _solutions(graph: RobustGraph, from_corrupted: bool) -> Iterator[tuple[str, str, Solution | None]]:
    """Yield kernel, start and solution; None where the kernel finds no solution."""
    first = _attempt(graph, schemas.FIRST, None)
    for kernel in schemas.KERNELS:
        if kernel in (schemas.PLAIN, schemas.FIRST):
            yield kernel, schemas.CORRUPTED, first if kernel == schemas.FIRST else _attempt(graph, kernel, None)
        else:
            yield kernel, schemas.SETTLED, _attempt(graph, kernel, first)
            if from_corrupted:
                yield kernel, schemas.CORRUPTED, _attempt(graph, kernel, None)


def _attempt(graph: RobustGraph, kernel: str, start: Solution | None) -> Solution | None:
    try:
        return graph.solve(kernel, start)
    except estimators.RobustError:
        return None


def _measures(graph: SurveyGraph, true: Edges, edges: Edges, solution: Solution | None) -> dict[str, Any]:
    count = len(true.source)
    closures = {"true_closures": count, "false_closures": len(edges.source) - count}
    if solution is None:
        return {**closures, "failed": True}
    position, accepted = solution.poses[:, :3, 3], solution.weights > estimators.ACCEPTED
    return {
        **closures,
        "rmse_xyz_m": trajectory_error.rmse(position, graph.gt[:, :3, 3]),
        "truth_rmse_xyz_m": trajectory_error.rmse(position, graph.truth[:, :3, 3]),
        "truth_relative_m": slam_errors.relative_error(true, solution.poses, graph.truth),
        "accepted_true": float(accepted[:count].sum()),
        "accepted_false": float(accepted[count:].sum()),
        "failed": False,
    }


def _rng(experiment: Experiment, repetition: int, stream: int) -> np.random.Generator:
    survey = zlib.crc32(experiment.graph.survey.encode())
    return np.random.default_rng([experiment.settings.seed, survey, repetition, stream])
