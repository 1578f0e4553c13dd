"""Reads submaps with poses from the files of another program, and builds their pose graph."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from pointnetkl.exchange import g2o, graph_exchange
from pointnetkl.readers.formats import clouds
from pointnetkl.registration import gicp
from pointnetkl.registration.gicp import neighbours
from pointnetkl.slam.closures import loop_closure
from pointnetkl.slam.graph import pose_graph, survey_graph
from pointnetkl.slam.graph.survey_graph import Closures
from pointnetkl.surveys import pose
from pointnetkl.surveys.submap import Submap
from pointnetkl.workflow.errors import PointNetKLError

_NEIGHBOURS = 20  # of a point, to measure the spacing


class PosedSubmapsError(PointNetKLError):
    """Files of submaps do not make a survey."""


def read(paths: Sequence[Path]) -> tuple[list[Submap], np.ndarray]:
    """Return the submaps of files, numbered from 0 in their order, and their poses T_map_submap (n, 4, 4).

    The frames become level: the roll and pitch of a file's pose go into the points.

    Raises:
        CloudFileError: a file is damaged or has no pose.
        PosedSubmapsError: there are fewer than two files, all have the same position, or one has too few points.
    """
    if len(paths) < 2:
        raise PosedSubmapsError(f"there is {len(paths)} submap, a graph needs 2 or more")
    submaps, poses = [], []
    for number, path in enumerate(paths):
        points, T = levelled(*clouds.read_posed(path))
        if len(points) <= _NEIGHBOURS or not np.isfinite(points).all():
            raise PosedSubmapsError(f"{path}: a submap needs more than {_NEIGHBOURS} points, all of them finite")
        submaps.append(Submap("submaps", number, points, points[::2], points[1::2]))
        poses.append(T)
    if not np.ptp(np.array(poses)[:, :3, 3], axis=0).any():
        raise PosedSubmapsError(f"{paths[0]} and all others are at one place: their VIEWPOINT says no pose")
    return submaps, np.array(poses)


def levelled(points: np.ndarray, T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return points (n, 3) and their pose T (4, 4) for a level frame, with the position and yaw of T."""
    level = pose.matrix(T[:3, 3], pose.yaw_of(T))
    return pose.transform(np.linalg.inv(level) @ T, points), level


def spacing(submaps: Sequence[Submap]) -> float:
    """Return the side in metres of a square that holds one point: the median over points, and then over submaps.

    A disk up to a point's farthest neighbour holds _NEIGHBOURS points. The nearest alone would not do, because points
    may be much denser along a ping than along the track.
    """
    farthest = [neighbours.nearest(s.points, _NEIGHBOURS)[0][:, -1] for s in submaps]
    return float(np.median([np.median(d) for d in farthest]) * np.sqrt(np.pi / _NEIGHBOURS))


def connect(
    submaps: Sequence[Submap],
    poses: np.ndarray,
    q: Mapping[int, np.ndarray],
    edges: str,
    settings: loop_closure.Settings,
    registration: gicp.Settings,
) -> tuple[g2o.Graph, Closures]:
    """Return the graph of submaps at poses (n, 4, 4) with Q (M, M) by submap on its loop closures, and the closures.

    Registrations start at dead reckoning from the corrected submap before; `edges` is all or shared, as slam.edges.

    Raises:
        SurveyGraphError: a Q does not have the dimensions of the registration.
    """
    closures = loop_closure.close(submaps, poses, None, spacing(submaps), settings, registration)
    number = np.array([s.number for s in submaps], np.int64)
    full = survey_graph.full_covariances(number, q, closures, settings.loop_closure, "submaps", edges)
    relative = pose_graph.between(poses)
    graph = graph_exchange.join(number, poses, relative, settings.dead_reckoning, closures.edges, full)
    return graph, closures
