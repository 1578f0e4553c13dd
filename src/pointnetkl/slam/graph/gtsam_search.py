"""What every pose graph asks of GTSAM: poses as values, nodes that are held, and a search that ends at a minimum."""

from collections.abc import Mapping
from typing import NamedTuple

import gtsam
import numpy as np

_HELD_SIGMA = 1e-6  # metres and radians: a node is held, and this says how
_STEPS = 20
_STEADY_M = 1e-3  # what a step more may move a pose at a minimum


class Rest(NamedTuple):
    """Where a search ended, and what its last undamped step still changed."""

    poses: np.ndarray  # (n, 4, 4)
    moved_m: float  # a pose, at most
    change: float  # of the error, as a share of it

    @property
    def is_steady(self) -> bool:
        """Return whether the poses have come to rest."""
        return self.moved_m < _STEADY_M


def to_values(poses: np.ndarray) -> gtsam.Values:
    """Return poses (n, 4, 4) as those of nodes 0 to n - 1."""
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


def held(poses: Mapping[int, np.ndarray]) -> gtsam.NonlinearFactorGraph:
    """Return the factors that hold some nodes at poses (4, 4)."""
    model = gtsam.noiseModel.Isotropic.Sigma(6, _HELD_SIGMA)
    factors = gtsam.NonlinearFactorGraph()
    for node, T in poses.items():
        factors.add(gtsam.PriorFactorPose3(node, gtsam.Pose3(T), model))
    return factors


def joined(*parts: gtsam.NonlinearFactorGraph) -> gtsam.NonlinearFactorGraph:
    """Return the factors of all parts, in their order."""
    graph = gtsam.NonlinearFactorGraph()
    for part in parts:
        graph.push_back(part)
    return graph


def precisely(iterations: int = 100) -> gtsam.LevenbergMarquardtParams:
    """Return a search that ends at a change of the error by 1e-8 of it; 100 iterations are GTSAM's own."""
    how = gtsam.LevenbergMarquardtParams()
    how.setMaxIterations(iterations)
    how.setRelativeErrorTol(1e-8)  # GTSAM's 1e-5 stops metres short along a bend that closures hardly see
    how.setAbsoluteErrorTol(1e-8)
    return how


def minimum(
    graph: gtsam.NonlinearFactorGraph, initial: gtsam.Values, how: gtsam.LevenbergMarquardtParams
) -> np.ndarray | None:
    """Return the poses (n, 4, 4) that a search finds; None if it ends where undamped steps do not come to rest."""
    found = rest(graph, initial, how)
    return found.poses if found is not None and found.is_steady else None


def rest(graph: gtsam.NonlinearFactorGraph, initial: gtsam.Values, how: gtsam.LevenbergMarquardtParams) -> Rest | None:
    """Return where a search ends; None where the linear system has no solution.

    Undamped steps stand at its end in any case: it stops at a change of the error that may still be centimetres.
    """
    further = gtsam.GaussNewtonParams()
    further.setLinearSolverType(how.getLinearSolverType())
    try:
        near = gtsam.LevenbergMarquardtOptimizer(graph, initial, how).optimize()
        steps, before = gtsam.GaussNewtonOptimizer(graph, near, further), to_poses(near)
        for _ in range(_STEPS):
            error = steps.error()
            steps.iterate()
            after = to_poses(steps.values())
            moved = float(np.abs(after - before)[:, :3, 3].max())
            found = Rest(after, moved, abs(steps.error() - error) / max(error, 1.0))
            if found.is_steady:  # NaN is not
                break
            before = after
    except RuntimeError:  # a system that is singular to working precision
        return None
    return found
