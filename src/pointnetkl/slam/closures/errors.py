"""The errors of a graph's loop closures, and of the same registrations with every submap where it truly lies.

A loop closure errs because its registration does, and because the ground that it is registered to was put together
from wrong poses. The second kind of registration has the first error only: Q_ij of submap i on its targets j is the
second moment of that, as a label is of submap i and its copy. No noise is added to it: two passes over the same ground
have their own.
"""

import dataclasses
import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.registration.covariance import table
from pointnetkl.registration.streams import Stream
from pointnetkl.slam.closures import loop_closure, tables
from pointnetkl.slam.closures import terrain as closure_terrain
from pointnetkl.slam.closures.tables import PAIR, SPLIT
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
    runs: int  # registrations behind each covariance

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        require_seed(self.seed)
        if self.runs < 4:
            raise ValueError(f"runs is {self.runs}, must be 4 or above: fewer make a singular covariance")


@dataclass(frozen=True)
class How:
    """What the registrations of a graph and of its labels were made with."""

    spacing_m: float  # of neighbouring points
    graph: loop_closure.Settings
    label: monte_carlo.Settings
    registration: gicp.Settings


@dataclass(frozen=True)
class Case:
    """A node that closes loops, with its targets in the first draw that registers it."""

    node: int
    targets: np.ndarray  # nodes


@dataclass(frozen=True)
class _Measured:
    node: int
    described: dict[str, float]
    placed: np.ndarray  # (draws, M) errors of the registrations with each draw's start; NaN without a match
    covariances: dict[str, np.ndarray]  # SPLIT and PAIR, (M, M)


def measure(
    graph: SurveyGraph, submaps: Sequence[Submap], settings: Settings, how: How
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return a row for each registration of each draw, and the covariances SPLIT and PAIR of each submap registered.

    The rows have the columns of tables.schema; `submaps` are the graph's nodes. Where too few registrations of a submap
    at its true place had a match, PAIR is its SPLIT: another draw may have closed a loop with it all the same.

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
    one = functools.partial(_measure, graph=graph, submaps=submaps, settings=settings, how=how)
    found = compute.in_threads(one, cases(graph), f"calibrate {graph.survey}")
    by_node = {each.node: each for each in found}
    names = tables.schema(how.registration.dimensions).names
    rows = [_rows(graph, draw, by_node) for draw in range(len(graph.draws))]
    measured = [table.from_matrices(graph.survey, SPLIT, [], np.empty((0, *2 * [how.registration.dimensions])))]
    for method in (SPLIT, PAIR):
        have = {int(graph.number[each.node]): each.covariances[method] for each in found}
        measured += [table.from_matrices(graph.survey, method, have, np.array(list(have.values())))] if have else []
    return pd.concat(rows, ignore_index=True)[names], pd.concat(measured, ignore_index=True)


def true_poses(graph: SurveyGraph) -> np.ndarray:
    """Return the true poses (n, 4, 4) of a graph's nodes, those of GT where the truth is not known."""
    return graph.gt if np.isnan(graph.truth).any() else graph.truth


def cases(graph: SurveyGraph) -> list[Case]:
    """Return a case for each node that closes a loop in any draw, in the order of the track."""
    found: dict[int, Case] = {}
    for closures in graph.draws:
        for which, node in enumerate(closures.node.tolist()):
            targets = closures.edges.target[closures.registration == which]
            found.setdefault(node, Case(node, targets))
    return [found[node] for node in sorted(found)]


def _measure(case: Case, graph: SurveyGraph, submaps: Sequence[Submap], settings: Settings, how: How) -> _Measured:
    one, T = submaps[case.node], true_poses(graph)
    around = [pose.transform(T[k], submaps[k].points) for k in case.targets]
    m, label = how.registration.dimensions, dataclasses.replace(how.label, seed=settings.seed, copy="split")
    rng, sigmas = monte_carlo.generator(label, one, Stream.CLOSURE), monte_carlo.prior_sigmas(label, m)
    drawn = rng.normal(0.0, sigmas, (settings.runs, m))
    given = [loop_closure.starts(graph.survey, [one], how.graph, m, draw)[0] for draw in range(len(graph.draws))]
    centroid = one.points[:, :2].mean(axis=0) if m == 3 else None
    errors = _errors(one, T[case.node], around, np.concatenate([drawn, given]), centroid, how)
    cell = how.graph.cell_factor * how.spacing_m
    terrain, middle = closure_terrain.describe(one, T[case.node], around, cell, how.registration)
    split = _split(one, label, settings.runs, how)
    return _Measured(
        case.node,
        terrain | _misplaced(graph, case, middle, centroid),
        errors[settings.runs :],
        {SPLIT: split, PAIR: _moment(errors[: settings.runs], split)},
    )


def _split(one: Submap, label: monte_carlo.Settings, runs: int, how: How) -> np.ndarray:
    rng = monte_carlo.generator(label, one, Stream.LABEL)
    return monte_carlo.covariance(monte_carlo.errors(one, runs, rng, label, how.registration).errors)


def _moment(errors: np.ndarray, otherwise: np.ndarray) -> np.ndarray:
    matched = errors[np.isfinite(errors[:, 0])]
    return monte_carlo.covariance(matched) if len(matched) > errors.shape[1] else otherwise


def _errors(
    one: Submap,
    T: np.ndarray,
    around: Sequence[np.ndarray],
    starts: np.ndarray,
    centroid: np.ndarray | None,
    how: How,
) -> np.ndarray:
    """Return the errors (b, M) of a submap's registrations onto points around it, (b, M) off its pose T at first."""
    cloud = pose.transform(T, one.points)
    reach = None if how.graph.overlap_factor is None else how.graph.overlap_factor * how.spacing_m
    ground = loop_closure.Ground(np.concatenate(around), cloud.mean(axis=0), reach, how.registration)
    left = np.full((len(starts), 4, 4), np.nan)
    motions = [SE2.from_vector(start) for start in np.pad(starts, ((0, 0), (0, 3 - starts.shape[1])))]
    for i, found in enumerate(ground.lay_each(cloud, motions)):
        if found is not None:
            left[i] = np.linalg.inv(found[0].act_on_pose(T)) @ T
    return survey_graph.what_is_left(left, None if centroid is None else np.tile(centroid, (len(left), 1)))


def _misplaced(graph: SurveyGraph, case: Case, middle: np.ndarray, centroid: np.ndarray | None) -> dict[str, float]:
    """Return given_m and heading_m of a case, NaN where the truth is not known (and heading_m where yaw is found).

    For heading_m a registration without yaw brings the `middle` (3,) of the common ground together, as the true poses
    have it, while both submaps are turned as GT has them.
    """
    i, k = case.node, case.targets
    gt, truth = np.linalg.inv(graph.gt[k]) @ graph.gt[i], np.linalg.inv(graph.truth[k]) @ graph.truth[i]
    seen, turned = (each[:, :3, :3] @ middle + each[:, :3, 3] for each in (truth, gt))
    together = gt.copy()
    together[:, :2, 3] += seen[:, :2] - turned[:, :2]
    centroids = None if centroid is None else np.tile(centroid, (len(k), 1))
    given, heading = (
        float(np.hypot(*survey_graph.what_is_left(np.linalg.inv(each) @ truth, centroids).mean(axis=0)[:2]))
        for each in (gt, together)
    )
    return {"given_m": given, "heading_m": heading if centroid is None else np.nan}


def _rows(graph: SurveyGraph, draw: int, by_node: dict[int, _Measured]) -> pd.DataFrame:
    closures = graph.draws[draw]
    cases = [by_node[node] for node in closures.node.tolist()]
    placed = np.array([case.placed[draw] for case in cases]).reshape(len(cases), closures.start.shape[1])
    against_truth = survey_graph.registration_errors(closures, graph.truth)
    errors = (against_truth, survey_graph.registration_errors(closures, graph.gt), placed)
    units = ("x_m", "y_m", "w_rad")
    described = {name: [case.described[name] for case in cases] for name in tables.DESCRIPTION}
    return pd.DataFrame(
        {
            "survey": graph.survey,
            "draw": np.full(len(cases), draw, np.int32),
            "submap": graph.number[closures.node].astype(np.int32),
            "targets": np.bincount(closures.registration, minlength=len(cases)).astype(np.int32),
            "converged": closures.converged,
            **described,
            **{
                f"{k}_{u}": e[:, a]
                for k, e in zip(tables.KINDS, errors, strict=True)
                for a, u in enumerate(units[: e.shape[1]])
            },
        }
    )
