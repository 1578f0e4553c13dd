"""Covariances from the common ground of a loop closure's submaps, instead of from the whole submap.

A registration uses only the points that lie over its targets. Where these are flat, slopes elsewhere in the submap do
not help, and the covariance of the whole submap, which the paper gives the edge, is too small.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from pointnetkl.registration.covariance import catalogue, method, table
from pointnetkl.registration.covariance.method import Method
from pointnetkl.slam.closures import errors as closure_errors
from pointnetkl.slam.graph.survey_graph import SurveyGraph
from pointnetkl.surveys import pose
from pointnetkl.surveys.se2 import SE2
from pointnetkl.surveys.submap import Submap

_FEWEST = 100  # points of a part; with fewer the method gets the whole submap


def tabulate(
    methods: Sequence[Method], graph: SurveyGraph, submaps: Sequence[Submap], reach: float | None
) -> pd.DataFrame:
    """Return the methods' covariance table for the common ground of each submap that closes a loop.

    `submaps` are the graph's nodes. Ground is common within `reach` metres in plan of a target's point at GT's poses
    (None: all of the submap). A method's name gets the suffix catalogue.OVERLAP.

    Raises:
        CovarianceError: a method's answer is not a covariance.
    """
    pairs = [(submaps[n.node], _part(n, graph, submaps, reach)) for n in closure_errors.closing_nodes(graph)]
    if not pairs:
        return table.schema(3 if graph.closures.centroid is not None else 2).empty_table().to_pandas()
    covariances = method.tabulate(methods, [part for _, part in pairs])
    q = table.to_matrices(covariances)
    if q.shape[-1] == 3:
        q = _about_whole(q, pairs * len(methods))
    return covariances.assign(**table.to_columns(q), method=covariances["method"].map(catalogue.overlapping))


def _part(
    closing: closure_errors.ClosingNode, graph: SurveyGraph, submaps: Sequence[Submap], reach: float | None
) -> Submap:
    whole = submaps[closing.node]
    if reach is None:
        return whole
    targets = np.concatenate([pose.transform(graph.gt[k], submaps[k].points)[:, :2] for k in closing.targets])
    source = pose.transform(graph.gt[closing.node], whole.points)[:, :2]
    distance, _ = cKDTree(targets).query(source, distance_upper_bound=reach)
    points = whole.points[np.isfinite(distance)]
    return dataclasses.replace(whole, points=points if len(points) >= _FEWEST else whole.points)


def _about_whole(q: np.ndarray, pairs: Sequence[tuple[Submap, Submap]]) -> np.ndarray:
    """Return covariances (n, 3, 3), which are about the means of parts, about the means of the whole submaps."""
    offset = np.array([(whole.points - part.points.mean(axis=0)).mean(axis=0)[:2] for whole, part in pairs])
    adjoint = SE2(-offset, 0.0).adjoint()
    return np.asarray(adjoint @ q @ np.swapaxes(adjoint, 1, 2))
