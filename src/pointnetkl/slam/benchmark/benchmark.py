"""Running the SLAM benchmark: the same noise for every method, the work shared out, and a row for each solution."""

import functools
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from pointnetkl.slam.benchmark import errors as slam_errors
from pointnetkl.slam.benchmark import protocol, tables
from pointnetkl.slam.benchmark.protocol import Methods, Settings
from pointnetkl.slam.benchmark.tables import TABLE
from pointnetkl.slam.graph import pose_graph
from pointnetkl.slam.graph.pose_graph import Odometry, PoseGraph, PoseGraphError
from pointnetkl.slam.graph.survey_graph import SurveyGraph
from pointnetkl.surveys import pose
from pointnetkl.workflow import compute

MapError = Callable[[np.ndarray], float]
_BLOCK = 10  # repetitions that a worker takes at once


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
    poses: np.ndarray | None  # (n, 4, 4), of those that more is asked of


def benchmark(
    graph: SurveyGraph, methods: Methods, map_errors: Mapping[str, MapError], settings: Settings
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the benchmark's tables (tables.ROWS, tables.TRAJECTORIES) for covariances by method and submap.

    `map_errors` give errors of the map in metres for poses (n, 4, 4), by column. What has no solution is NaN (see
    `unsolved`). Workers share the work, see `compute`; progress is shown.
    """
    work = functools.partial(_solve, graph, methods, settings)
    done = compute.over(work, list(_blocks(len(graph.draws), settings)), f"slam, {graph.survey}", unit="block")
    navigation = _estimate(graph, _Run(TABLE, "navigation", 0, 0), graph.navigation)
    found = [navigation, *itertools.chain.from_iterable(done)]
    rows = [
        {"survey": graph.survey, **each.run._asdict(), **each.errors, **_map_errors(each, map_errors, settings)}
        for each in found
    ]
    return pd.DataFrame(rows, columns=tables.ROWS.names), _trajectories(graph, found)


def unsolved(rows: pd.DataFrame) -> Iterator[str]:
    """Yield a sentence for every variant and method of tables.ROWS of which some repetitions have no solution."""
    for (survey, variant, method), of in rows.groupby(["survey", "variant", "method"], sort=False):
        if missing := int(of["rmse_xyz_m"].isna().sum()):
            yield (
                f"{survey}, {method} ({variant}): {missing} of {len(of)} graphs have no solution, and so no errors:"
                " covariances are next to singular; raise slam.floor_m2"
            )


def _blocks(draws: int, settings: Settings) -> Iterator[_Block]:
    for draw in range(draws):
        repetitions = range(settings.repetitions if draw == 0 else settings.draw_repetitions)
        yield from (_Block(draw, repetitions[first : first + _BLOCK]) for first in repetitions[::_BLOCK])


def _solve(graph: SurveyGraph, methods: Methods, settings: Settings, block: _Block) -> list[_Estimate]:
    every = protocol.variants(methods, settings)
    graphs = [(each, protocol.pose_graphs(graph, methods, each, block.draw)) for each in every]
    found = []
    for repetition in block.repetitions:
        relative = protocol.corrupt(graph, block.draw, repetition, settings)
        corrupted = pose_graph.chain(graph.gt[0], relative)
        odometry = Odometry(relative, graph.dead_reckoning_noise, corrupted)
        found.append(_estimate(graph, _Run(TABLE, "corrupted", block.draw, repetition), corrupted))
        for variant, of_methods in graphs:
            if repetition < variant.repetitions(block.draw, settings):
                for method, factors in of_methods.items():
                    run = _Run(variant.name, method, block.draw, repetition)
                    found.append(_solution(graph, run, factors, odometry))
    return [each if _wanted(each, settings) else each._replace(poses=None) for each in found]


def _solution(graph: SurveyGraph, run: _Run, factors: PoseGraph, odometry: Odometry) -> _Estimate:
    try:
        poses = factors.solve(odometry)
    except PoseGraphError:
        return _estimate(graph, run, np.full_like(graph.gt, np.nan))
    made = _estimate(graph, run, poses)
    if (run.variant, run.draw, run.repetition) != (TABLE, 0, 0):
        return made
    reference = graph.truth if np.isfinite(graph.truth).all() else graph.gt
    nees = slam_errors.pose_nees(factors.position_covariances(odometry, poses), poses, reference)
    return made._replace(errors={**made.errors, "pose_nees": nees})


def _estimate(graph: SurveyGraph, run: _Run, poses: np.ndarray) -> _Estimate:
    return _Estimate(run, slam_errors.errors(graph, graph.draws[run.draw].edges, poses), poses)


def _wanted(each: _Estimate, settings: Settings) -> bool:
    """Whether an estimate's map is measured, or its trajectory drawn."""
    variant, _, draw, repetition = each.run
    first = variant == TABLE and draw == 0 and repetition < max(1, settings.map_to_map_repetitions)
    return first and each.poses is not None and bool(np.isfinite(each.poses).all())


def _map_errors(each: _Estimate, map_errors: Mapping[str, MapError], settings: Settings) -> dict[str, float]:
    if each.poses is None or each.run.repetition >= settings.map_to_map_repetitions:
        return {}
    return {column: error(each.poses) for column, error in map_errors.items()}


def _trajectories(graph: SurveyGraph, found: Sequence[_Estimate]) -> pd.DataFrame:
    known = {"truth": graph.truth, "gt": graph.gt}
    solved = {each.run.method: each.poses for each in found if each.poses is not None and each.run.repetition == 0}
    every = {which: poses for which, poses in known.items() if np.isfinite(poses).all()} | solved
    return pd.concat([_trajectory(graph, which, poses) for which, poses in every.items()], ignore_index=True)


def _trajectory(graph: SurveyGraph, which: str, poses: np.ndarray) -> pd.DataFrame:
    x, y, z = poses[:, :3, 3].T
    yaw = [pose.yaw_of(T) for T in poses]
    columns = {"submap": graph.number, "x_m": x, "y_m": y, "z_m": z, "yaw_rad": yaw}
    return pd.DataFrame({"survey": graph.survey, "which": which, **columns})
