"""The errors of a graph's loop closures, and of the same registrations with all submaps at their true poses.

A loop closure has two errors: that of its registration, and that of the ground it is registered to, which was put
together from wrong poses. With all submaps at their true poses only the first remains. Q_ij of submap i on its targets
j is the second moment of that error, as a label is of a submap and its copy. No noise is added for it, because two
passes over the same ground have noise of their own.
"""

import dataclasses
import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.registration.covariance import table
from pointnetkl.registration.covariance.catalogue import PAIR, SPLIT
from pointnetkl.registration.streams import Stream
from pointnetkl.slam.closures import loop_closure, schemas
from pointnetkl.slam.closures import terrain as closure_terrain
from pointnetkl.slam.graph import survey_graph
from pointnetkl.slam.graph.survey_graph import SurveyGraph
from pointnetkl.surveys import pose
from pointnetkl.surveys.se2 import SE2
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
    """The settings of a survey's graph, its labels and its registrations."""

    spacing_m: float  # of neighbouring points
    graph: loop_closure.Settings
    label: monte_carlo.Settings
    registration: gicp.Settings

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
    placed: np.ndarray  # (draws, M) errors of the registrations with each draw's start; NaN without a match
    covariances: dict[str, np.ndarray]  # SPLIT and PAIR, (M, M)


def measure(
    graph: SurveyGraph, submaps: Sequence[Submap], settings: Settings, setup: Setup
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return a row for each registration of each draw, and the covariances SPLIT and PAIR of each submap registered.

    The rows have the columns of tables.schema; `submaps` are the graph's nodes. Where too few registrations of a submap
    at its true pose had a match, its PAIR is its SPLIT: a draw may have closed a loop with it all the same.

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
    measure_node = functools.partial(_measure, graph=graph, submaps=submaps, settings=settings, setup=setup)
    measured = compute.in_threads(measure_node, closing_nodes(graph), f"calibrate {graph.survey}")
    by_node = {node.node: node for node in measured}
    rows = [_rows(graph, draw, by_node) for draw in range(len(graph.draws))]
    names = schemas.schema(setup.registration.dimensions).names
    return pd.concat(rows, ignore_index=True)[names], _covariances(graph, measured, setup.registration.dimensions)


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
    errors = _errors(source, T[closing.node], targets, np.concatenate([random, of_draws]), centroid, setup)
    cell = setup.graph.cell_factor * setup.spacing_m
    terrain, centre = closure_terrain.describe(source, T[closing.node], targets, cell, setup.registration)
    split = _split(source, label, settings.runs, setup)
    return _Measured(
        closing.node,
        terrain | _misplaced(graph, closing, centre, centroid),
        errors[settings.runs :],
        {SPLIT: split, PAIR: _moment(errors[: settings.runs], split)},
    )


def _covariances(graph: SurveyGraph, measured: Sequence[_Measured], dimensions: int) -> pd.DataFrame:
    """Return the covariance table of SPLIT and PAIR."""
    frames = [table.from_matrices(graph.survey, SPLIT, [], np.empty((0, *2 * [dimensions])))]  # columns, if no node
    for method in (SPLIT, PAIR):
        q = {int(graph.number[node.node]): node.covariances[method] for node in measured}
        frames += [table.from_matrices(graph.survey, method, q, np.array(list(q.values())))] if q else []
    return pd.concat(frames, ignore_index=True)


def _split(source: Submap, label: monte_carlo.Settings, runs: int, setup: Setup) -> np.ndarray:
    rng = monte_carlo.generator(label, source, Stream.LABEL)
    return monte_carlo.covariance(monte_carlo.errors(source, runs, rng, label, setup.registration).errors)


def _moment(errors: np.ndarray, otherwise: np.ndarray) -> np.ndarray:
    matched = errors[np.isfinite(errors[:, 0])]
    return monte_carlo.covariance(matched) if len(matched) > errors.shape[1] else otherwise


def _errors(
    source: Submap,
    T_map_source: np.ndarray,
    targets: Sequence[np.ndarray],
    starts: np.ndarray,
    centroid: np.ndarray | None,
    setup: Setup,
) -> np.ndarray:
    """Return the errors (b, M) of a submap's registrations onto its targets, from `starts` (b, M) about its pose."""
    cloud = pose.transform(T_map_source, source.points)
    ground = loop_closure.Ground(np.concatenate(targets), cloud.mean(axis=0), setup.reach_m, setup.registration)
    residual = np.full((len(starts), 4, 4), np.nan)
    motions = [SE2.from_vector(start) for start in np.pad(starts, ((0, 0), (0, 3 - starts.shape[1])))]
    for i, outcome in enumerate(ground.register_many(cloud, motions)):
        if outcome is not None:
            residual[i] = np.linalg.inv(outcome[0].act_on_pose(T_map_source)) @ T_map_source
    return survey_graph.residual_errors(residual, None if centroid is None else np.tile(centroid, (len(residual), 1)))


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
    placed = np.array([node.placed[draw] for node in nodes]).reshape(len(nodes), closures.start.shape[1])
    against_truth = survey_graph.registration_errors(closures, graph.truth)
    errors = (against_truth, survey_graph.registration_errors(closures, graph.gt), placed)
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
