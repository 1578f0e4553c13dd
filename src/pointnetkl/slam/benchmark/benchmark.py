"""Runs the SLAM benchmark: the same noise for every method, blocks of repetitions in parallel, a row per solution."""

import functools
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from pointnetkl.registration.covariance import catalogue
from pointnetkl.slam.benchmark import errors as slam_errors
from pointnetkl.slam.benchmark import protocol, schemas
from pointnetkl.slam.benchmark.protocol import Methods, Settings
from pointnetkl.slam.benchmark.schemas import TABLE
from pointnetkl.slam.graph import pose_graph
from pointnetkl.slam.graph.pose_graph import Odometry, PoseGraph, PoseGraphError
from pointnetkl.slam.graph.survey_graph import SurveyGraph
from pointnetkl.surveys import pose
from pointnetkl.workflow import compute

MapError = Callable[[np.ndarray], float]
_BLOCK = 10  # repetitions in one task of a worker


class _Block(NamedTuple):
    draw: int
    repetitions: range


class _Run(NamedTuple):
    variant: str
    method: str
    draw: int
    repetition: int


class _Estimate(NamedTuple):
    run: _Run
    errors: dict[str, float]
    poses: np.ndarray | None  # (n, 4, 4); None where neither a map nor a trajectory is made of them


def benchmark(
    graph: SurveyGraph, methods: Methods, map_errors: Mapping[str, MapError], settings: Settings
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the benchmark's tables (schemas.ROWS, schemas.TRAJECTORIES) for covariances by method and submap.

    `map_errors` holds, by column, functions that return the map's error in metres for poses (n, 4, 4). The errors of a
    graph without a solution are NaN (see `unsolved`). Workers share the blocks (see `compute`); progress is shown.
    """
    solve_block = functools.partial(_solve, graph, methods, settings)
    blocks = list(_blocks(len(graph.draws), settings))
    solved = compute.over(solve_block, blocks, f"slam, {graph.survey}", unit="block")
    navigation = _estimate(graph, _Run(TABLE, catalogue.NAVIGATION, 0, 0), graph.navigation)
    estimates = [navigation, *itertools.chain.from_iterable(solved)]
    rows = [
        {
            "survey": graph.survey,
            **estimate.run._asdict(),
            **estimate.errors,
            **_map_errors(estimate, map_errors, settings),
        }
        for estimate in estimates
    ]
    return pd.DataFrame(rows, columns=schemas.ROWS.names), _trajectories(graph, estimates)


def unsolved(rows: pd.DataFrame) -> Iterator[str]:
    """Yield a sentence for every variant and method of schemas.ROWS of which some repetitions have no solution."""
    for (survey, variant, method), runs in rows.groupby(["survey", "variant", "method"], sort=False):
        if missing := int(runs["rmse_xyz_m"].isna().sum()):
            yield (
                f"{survey}, {method} ({variant}): {missing} of {len(runs)} graphs have no solution, and so no errors:"
                " covariances are next to singular; raise slam.floor_m2"
            )


def _blocks(draws: int, settings: Settings) -> Iterator[_Block]:
    for draw in range(draws):
        repetitions = range(settings.repetitions if draw == 0 else settings.draw_repetitions)
        yield from (_Block(draw, repetitions[first : first + _BLOCK]) for first in repetitions[::_BLOCK])


def _solve(graph: SurveyGraph, methods: Methods, settings: Settings, block: _Block) -> list[_Estimate]:
    variants = protocol.variants(methods, settings)
    graphs = [(variant, protocol.pose_graphs(graph, methods, variant, block.draw)) for variant in variants]
    estimates = []
    for repetition in block.repetitions:
        relative = protocol.corrupt(graph, block.draw, repetition, settings)
        corrupted = pose_graph.chain(graph.gt[0], relative)
        odometry = Odometry(relative, graph.dead_reckoning_noise, corrupted)
        run = _Run(TABLE, catalogue.CORRUPTED, block.draw, repetition)
        estimates.append(_estimate(graph, run, corrupted))
        for variant, factors_by_method in graphs:
            if repetition < variant.repetitions(block.draw, settings):
                for method, factors in factors_by_method.items():
                    run = _Run(variant.name, method, block.draw, repetition)
                    estimates.append(_solution(graph, run, factors, odometry))
    # poses are many megabytes, which a worker would have to send
    return [estimate if _keeps_poses(estimate, settings) else estimate._replace(poses=None) for estimate in estimates]


def _solution(graph: SurveyGraph, run: _Run, factors: PoseGraph, odometry: Odometry) -> _Estimate:
    try:
        poses = factors.solve(odometry)
    except PoseGraphError:
        return _estimate(graph, run, np.full_like(graph.gt, np.nan))
    estimate = _estimate(graph, run, poses)
    if (run.variant, run.draw, run.repetition) != (TABLE, 0, 0):
        return estimate
    reference = graph.truth if np.isfinite(graph.truth).all() else graph.gt
    nees = slam_errors.pose_nees(factors.position_covariances(odometry, poses), poses, reference)
    return estimate._replace(errors={**estimate.errors, "pose_nees": nees})


def _estimate(graph: SurveyGraph, run: _Run, poses: np.ndarray) -> _Estimate:
    return _Estimate(run, slam_errors.errors(graph, graph.draws[run.draw].edges, poses), poses)


def _keeps_poses(estimate: _Estimate, settings: Settings) -> bool:
    """Return whether an estimate's map is measured, or its trajectory drawn."""
    variant, _, draw, repetition = estimate.run
    first = variant == TABLE and draw == 0 and repetition < max(1, settings.map_to_map_repetitions)
    return first and estimate.poses is not None and bool(np.isfinite(estimate.poses).all())


def _map_errors(estimate: _Estimate, map_errors: Mapping[str, MapError], settings: Settings) -> dict[str, float]:
    if estimate.poses is None or estimate.run.repetition >= settings.map_to_map_repetitions:
        return {}
    return {column: error(estimate.poses) for column, error in map_errors.items()}


def _trajectories(graph: SurveyGraph, estimates: Sequence[_Estimate]) -> pd.DataFrame:
    references = {catalogue.TRUTH: graph.truth, catalogue.GT: graph.gt}
    solved = {e.run.method: e.poses for e in estimates if e.poses is not None and e.run.repetition == 0}
    trajectories = {name: poses for name, poses in references.items() if np.isfinite(poses).all()} | solved
    return pd.concat([_trajectory(graph, name, poses) for name, poses in trajectories.items()], ignore_index=True)


def _trajectory(graph: SurveyGraph, name: str, poses: np.ndarray) -> pd.DataFrame:
    x, y, z = poses[:, :3, 3].T
    yaw = [pose.yaw_of(T) for T in poses]
    columns = {"submap": graph.number, "x_m": x, "y_m": y, "z_m": z, "yaw_rad": yaw}
    return pd.DataFrame({"survey": graph.survey, "which": name, **columns})
