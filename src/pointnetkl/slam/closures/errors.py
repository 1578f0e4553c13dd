"""The errors of a graph's loop closures, and of the same registrations with all submaps at their true poses.

A loop closure has two errors: that of its registration, and that of the ground it is registered to, which was put
together from wrong poses. With all submaps at their true poses only the first remains. Q_ij of submap i on its targets
j is the second moment of that error, as a label is of a submap and its copy. No noise is added for it, because two
passes over the same ground have noise of their own. What the matches of a single registration tell of its own error is
in `placed`.
"""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd

from pointnetkl.registration import gicp, monte_carlo, pair
from pointnetkl.registration.covariance import gaussian, table
from pointnetkl.registration.covariance.catalogue import MEASURED_PAIR, SPLIT
from pointnetkl.registration.streams import Stream
from pointnetkl.slam.closures import loop_closure, placed, schemas
from pointnetkl.slam.closures import terrain as closure_terrain
from pointnetkl.slam.graph import survey_graph
from pointnetkl.slam.graph.survey_graph import SurveyGraph
from pointnetkl.surveys import pose
from pointnetkl.surveys.submap import Submap
from pointnetkl.workflow import compute
from pointnetkl.workflow.errors import PointNetKLError
from pointnetkl.workflow.parameters import require_seed


class ClosureErrorsError(PointNetKLError):
    """Submaps and graph do not belong together."""


@dataclass(frozen=True)
class Settings:
    """Section `calibrate` of the parameters.

    Raises:
        ValueError: a setting is out of its range.
    """

    seed: int
    runs: int  # registrations for each covariance

    def __post_init__(self) -> None:
        """Refuse numbers out of their range."""
        require_seed(self.seed)
        if self.runs < 4:
            raise ValueError(f"runs is {self.runs}, must be 4 or above: fewer make a singular covariance")


@dataclass(frozen=True)
class Setup:
    """The settings of a survey's graph, its labels, its registrations and their covariances."""

    spacing_m: float  # of neighbouring points
    graph: loop_closure.Settings
    label: monte_carlo.Settings
    registration: gicp.Settings
    numbers: pair.covariance.Settings  # of Q of a pair

    @property
    def reach_m(self) -> float | None:
        """Return the reach of common ground around a target's points, metres; None without a limit."""
        factor = self.graph.overlap_factor
        return None if factor is None else factor * self.spacing_m


@dataclass(frozen=True)
class ClosingNode:
    """A node that closes loops, with its targets in the first draw that registers it."""

    node: int
    targets: np.ndarray  # nodes


@dataclass(frozen=True)
class _Measured:
    node: int
    description: dict[str, float]  # columns schemas.DESCRIPTION
    errors: np.ndarray  # (draws, M) errors of the registrations with each draw's start; NaN without a match
    judged: list[list[placed.Judged]]  # of each draw; empty where the draw does not register the node, or no match
    covariances: dict[str, np.ndarray]  # SPLIT and MEASURED_PAIR, (M, M)


class Measured(NamedTuple):
    """The tables of a survey's loop closures."""

    rows: pd.DataFrame  # schemas.CLOSURES, one for each registration of each draw
    covariances: pd.DataFrame  # of covariance.table: SPLIT and MEASURED_PAIR of each submap registered
    ends: pd.DataFrame  # schemas.ENDS, one for each registration and method that judges a registration


def measure(graph: SurveyGraph, submaps: Sequence[Submap], settings: Settings, setup: Setup) -> Measured:
    """Return the errors of a graph's loop closures, and covariances of them; `submaps` are the graph's nodes.

    Where too few registrations of a submap at its true pose had a match, its MEASURED_PAIR is its SPLIT: a draw may
    have closed a loop with it all the same.

    Raises:
        ClosureErrorsError: the submaps are not those of the graph.
        GicpError: a cloud of a submap cannot be registered.
        CovarianceError: a covariance is singular.
    """
    if [s.number for s in submaps] != graph.number.tolist():
        raise ClosureErrorsError(
            f"{graph.survey}: the graph has {len(graph.number)} submaps, not the {len(submaps)} given;"
            f" run dvc repro graph@{graph.survey}"
        )
    setup = dataclasses.replace(setup, numbers=setup.numbers.of_submaps(true_poses(graph)[:, :3, 3]))
    measure_node = functools.partial(_measure, graph=graph, submaps=submaps, settings=settings, setup=setup)
    measured = compute.in_threads(measure_node, closing_nodes(graph), f"calibrate {graph.survey}")
    by_node = {node.node: node for node in measured}
    rows = [_rows(graph, draw, by_node) for draw in range(len(graph.draws))]
    m = setup.registration.dimensions
    return Measured(
        pd.concat(rows, ignore_index=True)[schemas.schema(m).names],
        _covariances(graph, measured, m),
        _ends(graph, by_node, m),
    )


def true_poses(graph: SurveyGraph) -> np.ndarray:
    """Return the true poses (n, 4, 4) of a graph's nodes, or GT where the truth is not known."""
    return graph.gt if np.isnan(graph.truth).any() else graph.truth


def closing_nodes(graph: SurveyGraph) -> list[ClosingNode]:
    """Return each node that closes a loop in any draw, in the order of the track."""
    nodes: dict[int, ClosingNode] = {}
    for closures in graph.draws:
        for registration, node in enumerate(closures.node.tolist()):
            targets = closures.edges.target[closures.registration == registration]
            nodes.setdefault(node, ClosingNode(node, targets))
    return [nodes[node] for node in sorted(nodes)]


def _measure(
    closing: ClosingNode, graph: SurveyGraph, submaps: Sequence[Submap], settings: Settings, setup: Setup
) -> _Measured:
    source, T = submaps[closing.node], true_poses(graph)
    targets = [pose.transform(T[k], submaps[k].points) for k in closing.targets]
    m, label = setup.registration.dimensions, dataclasses.replace(setup.label, seed=settings.seed, copy="split")
    rng, sigmas = monte_carlo.generator(label, source, Stream.CLOSURE), monte_carlo.prior_sigmas(label, m)
    random = rng.normal(0.0, sigmas, (settings.runs, m))
    of_draws = [loop_closure.starts(graph.survey, [source], setup.graph, m, k)[0] for k in range(len(graph.draws))]
    centroid = source.points[:, :2].mean(axis=0) if m == 3 else None
    where = (source, T[closing.node], targets, setup.spacing_m, setup.reach_m)
    there = placed.Placed(*where, setup.registration, setup.numbers)
    ends = there.register(np.concatenate([random, of_draws]))
    errors = there.errors(ends)
    closed = [closing.node in closures.node for closures in graph.draws]
    judged = there.judge(
        [end if closes else None for end, closes in zip(ends[settings.runs :], closed, strict=True)],
        loop_closure.start_sigmas(setup.graph, m),
        label.noise_sigma_m,
    )
    cell = setup.graph.cell_factor * setup.spacing_m
    terrain, centre = closure_terrain.describe(source, T[closing.node], targets, cell, setup.registration)
    split = _split(source, label, settings.runs, setup)
    return _Measured(
        closing.node,
        terrain | _misplaced(graph, closing, centre, centroid),
        errors[settings.runs :],
        judged,
        {SPLIT: split, MEASURED_PAIR: _moment(errors[: settings.runs], split)},
    )


def _covariances(graph: SurveyGraph, measured: Sequence[_Measured], dimensions: int) -> pd.DataFrame:
    """Return the covariance table of SPLIT and MEASURED_PAIR."""
    frames = [table.from_matrices(graph.survey, SPLIT, [], np.empty((0, *2 * [dimensions])))]  # columns, if no node
    for method in (SPLIT, MEASURED_PAIR):
        q = {int(graph.number[node.node]): node.covariances[method] for node in measured}
        frames += [table.from_matrices(graph.survey, method, q, np.array(list(q.values())))] if q else []
    return pd.concat(frames, ignore_index=True)


def _ends(graph: SurveyGraph, by_node: Mapping[int, _Measured], dimensions: int) -> pd.DataFrame:
    """Return the table of ENDS, by draw, node and method."""
    rows = [
        (draw, int(graph.number[node]), judged)
        for draw, closures in enumerate(graph.draws)
        for node in closures.node.tolist()
        for judged in by_node[node].judged[draw]
    ]
    errors = np.array([judged.error for _, _, judged in rows]).reshape(-1, dimensions)
    covariances = np.array([judged.covariance for _, _, judged in rows]).reshape(-1, *2 * [dimensions])
    for (draw, number, judged), q in zip(rows, covariances, strict=True):
        gaussian.check(q, f"{graph.survey}, submap {number}, draw {draw}, {judged.method}")
    return pd.DataFrame(
        {
            "survey": np.full(len(rows), graph.survey, object),
            "draw": np.array([draw for draw, _, _ in rows], np.int32),
            "submap": np.array([number for _, number, _ in rows], np.int32),
            "method": np.array([judged.method for _, _, judged in rows], object),
            **{f"{schemas.PLACED}_{axis}": e for axis, e in zip(("x_m", "y_m", "w_rad"), errors.T, strict=False)},
            **table.to_columns(covariances),
        }
    )[schemas.ends_schema(dimensions).names]


def _split(source: Submap, label: monte_carlo.Settings, runs: int, setup: Setup) -> np.ndarray:
    rng = monte_carlo.generator(label, source, Stream.LABEL)
    return monte_carlo.covariance(monte_carlo.errors(source, runs, rng, label, setup.registration).errors)


def _moment(errors: np.ndarray, otherwise: np.ndarray) -> np.ndarray:
    matched = errors[np.isfinite(errors[:, 0])]
    return monte_carlo.covariance(matched) if len(matched) > errors.shape[1] else otherwise


def _misplaced(
    graph: SurveyGraph, closing: ClosingNode, centre: np.ndarray, centroid: np.ndarray | None
) -> dict[str, float]:
    """Return given_m and heading_m of a node, NaN where the truth is not known (and heading_m with yaw).

    For heading_m a registration without yaw brings the `centre` (3,) of the common ground together, as the true poses
    have it, while both submaps have GT's headings.
    """
    i, k = closing.node, closing.targets
    gt, truth = np.linalg.inv(graph.gt[k]) @ graph.gt[i], np.linalg.inv(graph.truth[k]) @ graph.truth[i]
    true_centre, gt_centre = (T[:, :3, :3] @ centre + T[:, :3, 3] for T in (truth, gt))
    together = gt.copy()
    together[:, :2, 3] += true_centre[:, :2] - gt_centre[:, :2]
    centroids = None if centroid is None else np.tile(centroid, (len(k), 1))
    given, heading = (
        float(np.hypot(*survey_graph.residual_errors(np.linalg.inv(T) @ truth, centroids).mean(axis=0)[:2]))
        for T in (gt, together)
    )
    return {"given_m": given, "heading_m": heading if centroid is None else np.nan}


def _rows(graph: SurveyGraph, draw: int, by_node: dict[int, _Measured]) -> pd.DataFrame:
    closures = graph.draws[draw]
    nodes = [by_node[node] for node in closures.node.tolist()]
    of_placed = np.array([node.errors[draw] for node in nodes]).reshape(len(nodes), closures.start.shape[1])
    against_truth = survey_graph.registration_errors(closures, graph.truth)
    errors = (against_truth, survey_graph.registration_errors(closures, graph.gt), of_placed)
    axes = ("x_m", "y_m", "w_rad")
    return pd.DataFrame(
        {
            "survey": graph.survey,
            "draw": np.full(len(nodes), draw, np.int32),
            "submap": graph.number[closures.node].astype(np.int32),
            "targets": np.bincount(closures.registration, minlength=len(nodes)).astype(np.int32),
            "converged": closures.converged,
            **{name: [node.description[name] for node in nodes] for name in schemas.DESCRIPTION},
            **{
                f"{kind}_{axis}": e[:, column]
                for kind, e in zip(schemas.KINDS, errors, strict=True)
                for column, axis in enumerate(axes[: e.shape[1]])
            },
        }
    )
