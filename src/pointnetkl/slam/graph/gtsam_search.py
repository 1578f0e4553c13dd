"""GTSAM for every pose graph: poses as values, held nodes, and a search that ends at a minimum."""

from collections.abc import Mapping
from typing import NamedTuple

import gtsam
import numpy as np

_HELD_SIGMA = 1e-6  # metres and radians, of the prior that holds a node
_STEPS = 20
_STEADY_M = 1e-3  # at a minimum, another step moves no pose farther


class End(NamedTuple):
    """The end of a search, and what its last undamped step still changed."""

    poses: np.ndarray  # (n, 4, 4)
    moved_m: float  # the farthest that a pose moved
    change: float  # of the error, relative

    @property
    def is_steady(self) -> bool:
        """Return whether the poses no longer move."""
        return self.moved_m < _STEADY_M


def to_values(poses: np.ndarray) -> gtsam.Values:
    """Return poses (n, 4, 4) as values of nodes 0 to n - 1."""
    values = gtsam.Values()
    for node, T in enumerate(poses):
        values.insert(node, gtsam.Pose3(T))
    return values


def to_poses(values: gtsam.Values) -> np.ndarray:
    """Return the poses (n, 4, 4) of nodes 0 to n - 1."""
    rows = gtsam.utilities.extractPose3(values)  # by key: rotation row by row, then position
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = rows[:, :9].reshape(-1, 3, 3), rows[:, 9:]
    return poses


def hold(poses: Mapping[int, np.ndarray]) -> gtsam.NonlinearFactorGraph:
    """Return the factors that hold some nodes at poses (4, 4)."""
    model = gtsam.noiseModel.Isotropic.Sigma(6, _HELD_SIGMA)
    factors = gtsam.NonlinearFactorGraph()
    for node, T in poses.items():
        factors.add(gtsam.PriorFactorPose3(node, gtsam.Pose3(T), model))
    return factors


def join(*parts: gtsam.NonlinearFactorGraph) -> gtsam.NonlinearFactorGraph:
    """Return the factors of all parts, in their order."""
    graph = gtsam.NonlinearFactorGraph()
    for part in parts:
        graph.push_back(part)
    return graph


def precise_search(iterations: int = 100) -> gtsam.LevenbergMarquardtParams:
    """Return a search that ends where the error's relative change is 1e-8; 100 iterations are GTSAM's default."""
    search = gtsam.LevenbergMarquardtParams()
    search.setMaxIterations(iterations)
    search.setRelativeErrorTol(1e-8)  # GTSAM's 1e-5 stops metres short along a bend that closures hardly see
    search.setAbsoluteErrorTol(1e-8)
    return search


def minimum(
    graph: gtsam.NonlinearFactorGraph, initial: gtsam.Values, search: gtsam.LevenbergMarquardtParams
) -> np.ndarray | None:
    """Return the poses (n, 4, 4) that a search finds; None if undamped steps from its end still move them."""
    end = optimise(graph, initial, search)
    return end.poses if end is not None and end.is_steady else None


def optimise(
    graph: gtsam.NonlinearFactorGraph, initial: gtsam.Values, search: gtsam.LevenbergMarquardtParams
) -> End | None:
    """Return the end of a search and of some undamped steps after it; None where the linear system has no solution.

    The search stops at a small change of the error, where poses may still be centimetres from the minimum.
    """
    undamped = gtsam.GaussNewtonParams()
    undamped.setLinearSolverType(search.getLinearSolverType())
    try:
        near = gtsam.LevenbergMarquardtOptimizer(graph, initial, search).optimize()
        steps, before = gtsam.GaussNewtonOptimizer(graph, near, undamped), to_poses(near)
        for _ in range(_STEPS):
            error = steps.error()
            steps.iterate()
            after = to_poses(steps.values())
            moved = float(np.abs(after - before)[:, :3, 3].max())
            end = End(after, moved, abs(steps.error() - error) / max(error, 1.0))
            if end.is_steady:  # NaN is not
                break
            before = after
    except RuntimeError:  # a system that is singular to working precision
        return None
    return end
