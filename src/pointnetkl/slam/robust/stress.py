"""What wrong loop closures do to SLAM, and robust estimators against them, with each method's covariances."""

import dataclasses
import functools
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from pointnetkl.slam.benchmark import errors as slam_errors
from pointnetkl.slam.benchmark import protocol
from pointnetkl.slam.graph import gtsam_search, pose_graph, survey_graph, trajectory_error
from pointnetkl.slam.graph.pose_graph import Edges
from pointnetkl.slam.graph.survey_graph import SurveyGraph
from pointnetkl.slam.robust import estimators, false_closures, tables
from pointnetkl.slam.robust.estimators import RobustGraph, Solution, Thresholds
from pointnetkl.workflow import compute
from pointnetkl.workflow.errors import PointNetKLError
from pointnetkl.workflow.parameters import require_positive, require_seed

_NOISE, _FALSE = 0, 1  # streams of random numbers
Methods = Mapping[str, Mapping[int, np.ndarray]]  # Q (M, M) by method and submap


class StressError(PointNetKLError):
    """The benchmark of wrong loop closures cannot run on these covariances."""


@dataclass(frozen=True)
class Settings:
    """Section `stress` of the parameters; refused by a ValueError where it makes no sense."""

    seed: int
    methods: list[str]
    shares: list[float]
    repetitions: int
    corrupted_repetitions: int
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
class Case:
    """What every repetition is made of."""

    graph: SurveyGraph
    methods: Methods
    apart: np.ndarray  # (p, 2) pairs of nodes whose submaps do not overlap
    yaw_sigma_rad: float  # of the noise on dead reckoning
    settings: Settings


def chosen(covariances: Methods, settings: Settings, survey: str) -> dict[str, Mapping[int, np.ndarray]]:
    """Return the methods that the settings name.

    Raises:
        StressError: there is no such method.
    """
    if missing := [name for name in settings.methods if name not in covariances]:
        raise StressError(
            f"{survey}: stress.methods names {missing[0]}, which has no covariances; there are {', '.join(covariances)}"
        )
    return {name: covariances[name] for name in settings.methods}


def benchmark(case: Case) -> pd.DataFrame:
    """Return tables.ROWS; repetitions run in parallel, and a survey that closes no loop has only share 0."""
    doing = f"wrong loop closures, {case.graph.survey}"
    rows = compute.over(
        functools.partial(_repetition, case), range(case.settings.repetitions), doing, unit="repetition"
    )
    return pd.DataFrame([row for each in rows for row in each], columns=tables.ROWS.names)


def corrupt(case: Case, repetition: int) -> np.ndarray:
    """Return dead reckoning (n - 1, 4, 4) with noise on each edge's yaw, the same whatever kernel and method."""
    return protocol.with_noise(case.graph, _rng(case, repetition, _NOISE), case.yaw_sigma_rad)


def corrupted_poses(case: Case, repetition: int) -> np.ndarray:
    """Return the poses (n, 4, 4) that corrupted dead reckoning makes."""
    return pose_graph.chain(case.graph.gt[0], corrupt(case, repetition))


def with_false(case: Case, repetition: int) -> list[tuple[float, Edges]]:
    """Return each share with a repetition's closures: true ones, then false ones, of which the lower shares have fewer.

    Only share 0 where there is no loop closure to be like, or no pair of submaps apart.
    """
    graph, shares = case.graph, case.settings.shares
    true = graph.draws[repetition % len(graph.draws)].edges
    if len(true.source) == 0 or len(case.apart) == 0:
        return [(0.0, true)]
    counts = false_closures.counts(len(true.source), shares)
    false = false_closures.draw(true, graph.gt, case.apart, counts[-1], _rng(case, repetition, _FALSE))
    return [(share, false_closures.joined(true, false, n)) for share, n in zip(shares, counts, strict=True)]


def _repetition(case: Case, repetition: int) -> list[dict[str, Any]]:
    graph, settings = case.graph, case.settings
    draw = repetition % len(graph.draws)
    true, initial = graph.draws[draw], corrupted_poses(case, repetition)
    odometry = pose_graph.Odometry(corrupt(case, repetition), graph.dead_reckoning_noise, initial)
    sure = gtsam_search.joined(gtsam_search.held({0: graph.gt[0]}), odometry.factors)
    rows = []
    for method, q in case.methods.items():
        for share, edges in with_false(case, repetition):
            every, origin = dataclasses.replace(true, edges=edges), f"{graph.survey}, {method}"
            full = survey_graph.full_covariances(graph.number, q, every, graph.closure_noise, origin)
            made = RobustGraph(sure, odometry.initial, edges, full, settings.thresholds)
            what = {"survey": graph.survey, "method": method, "share": share, "draw": draw, "repetition": repetition}
            for kernel, start, solution in _solutions(made, repetition < settings.corrupted_repetitions):
                found = _judged(graph, true.edges, edges, solution)
                rows.append({**what, "kernel": kernel, "start": start, **found})
    return rows


def _solutions(graph: RobustGraph, from_corrupted: bool) -> Iterator[tuple[str, str, Solution | None]]:
    """Yield kernel, start and solution, None where there is none."""
    first = _attempt(graph, tables.FIRST, None)
    for kernel in tables.KERNELS:
        if kernel in (tables.PLAIN, tables.FIRST):
            yield kernel, tables.CORRUPTED, first if kernel == tables.FIRST else _attempt(graph, kernel, None)
        else:
            yield kernel, tables.SETTLED, _attempt(graph, kernel, first)
            if from_corrupted:
                yield kernel, tables.CORRUPTED, _attempt(graph, kernel, None)


def _attempt(graph: RobustGraph, kernel: str, start: Solution | None) -> Solution | None:
    try:
        return graph.solve(kernel, start)
    except estimators.RobustError:
        return None


def _judged(graph: SurveyGraph, true: Edges, edges: Edges, solution: Solution | None) -> dict[str, Any]:
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


def _rng(case: Case, repetition: int, stream: int) -> np.random.Generator:
    return np.random.default_rng([case.settings.seed, zlib.crc32(case.graph.survey.encode()), repetition, stream])
