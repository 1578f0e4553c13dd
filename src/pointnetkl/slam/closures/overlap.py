"""Covariances from the ground that a loop closure's submaps have in common, and not from all of the submap.

A registration only sees the points that lie over its targets. Where these are flat, what the rest of the submap looks
like is no help: its own covariance, which the paper gives the edge, is too small.
"""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from pointnetkl.registration.covariance import method, table
from pointnetkl.registration.covariance.method import Method
from pointnetkl.slam.closures import errors as closure_errors
from pointnetkl.slam.graph.survey_graph import SurveyGraph
from pointnetkl.surveys import pose
from pointnetkl.surveys.submap import Submap

_SUFFIX = "_overlap"  # of a method's name
_FEWEST = 100  # points of a part: fewer have no ground to tell of, and the whole submap is asked


def tabulate(
    methods: Sequence[Method], graph: SurveyGraph, submaps: Sequence[Submap], reach: float | None
) -> pd.DataFrame:
    """Return the covariance table of the methods, asked about the common ground of each submap that closes a loop.

    `submaps` are the graph's nodes; ground is common within `reach` metres in plan of a target's point, as GT has the
    poses (None: all of it, where all of a submap was registered). A method's name gets the suffix _overlap.

    Raises:
        CovarianceError: a method's answer is not a covariance.
    """
    found = [(submaps[case.node], _part(case, graph, submaps, reach)) for case in closure_errors.cases(graph)]
    if not found:
        return table.schema(3 if graph.closures.centroid is not None else 2).empty_table().to_pandas()
    covariances = method.tabulate(methods, [part for _, part in found])
    q = table.to_matrices(covariances)
    if q.shape[-1] == 3:
        q = _about_whole(q, found * len(methods))
    return covariances.assign(**table.to_columns(q), method=covariances["method"] + _SUFFIX)


def _part(case: closure_errors.Case, graph: SurveyGraph, submaps: Sequence[Submap], reach: float | None) -> Submap:
    one = submaps[case.node]
    if reach is None:
        return one
    around = np.concatenate([pose.transform(graph.gt[k], submaps[k].points)[:, :2] for k in case.targets])
    mine = pose.transform(graph.gt[case.node], one.points)[:, :2]
    distance, _ = cKDTree(around).query(mine, distance_upper_bound=reach)
    points = one.points[np.isfinite(distance)]
    return Submap(one.survey, one.number, points if len(points) >= _FEWEST else one.points, one.first, one.second)


def _about_whole(q: np.ndarray, found: Sequence[tuple[Submap, Submap]]) -> np.ndarray:
    """Return covariances (n, 3, 3) about the middles of parts as about the middles of their submaps, as the edges'."""
    x, y = np.array([(whole.points - part.points.mean(axis=0)).mean(axis=0)[:2] for whole, part in found]).T
    turn = np.tile(np.eye(3), (len(q), 1, 1))  # a turn moves a point ahead to port, and one to port astern
    turn[:, 0, 2], turn[:, 1, 2] = -y, x
    return np.asarray(turn @ q @ np.swapaxes(turn, 1, 2))
