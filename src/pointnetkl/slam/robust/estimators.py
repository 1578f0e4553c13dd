"""Pose graphs some of whose loop closures are wrong: robust kernels, and graduated non-convexity, by GTSAM.

Each judges a loop closure by the length of its whitened residual, so that a Q which is too small makes true closures
look wrong, and one which is too large lets wrong ones pass.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np

from pointnetkl.slam.graph import gtsam_search
from pointnetkl.slam.graph.pose_graph import Edges
from pointnetkl.slam.robust import tables
from pointnetkl.workflow.errors import PointNetKLError
from pointnetkl.workflow.parameters import require_positive

ACCEPTED = 0.5  # of a closure's weight in the solution: above it the estimator took the closure for true
_ESTIMATORS: dict[str, Callable[[float], Any]] = {
    "huber": gtsam.noiseModel.mEstimator.Huber.Create,
    "cauchy": gtsam.noiseModel.mEstimator.Cauchy.Create,
    "dcs": gtsam.noiseModel.mEstimator.DCS.Create,
}


class RobustError(PointNetKLError):
    """A graph with wrong loop closures cannot be optimised."""


@dataclass(frozen=True)
class Thresholds:
    """From where on a robust estimator doubts a loop closure.

    Raises:
        ValueError: a threshold is not positive, or a probability not below 1.
    """

    huber: float  # length of the whitened residual
    cauchy: float
    dcs: float  # Phi, a squared length
    gnc_probability: float  # of the chi-square distribution of a true closure's squared length, 6 degrees of freedom
    gnc_step: float  # what the control parameter is multiplied by from one problem to the next

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        require_positive(self, *vars(self))
        if self.gnc_probability >= 1:
            raise ValueError(f"gnc_probability is {self.gnc_probability}, must be below 1")
        if self.gnc_step <= 1:
            raise ValueError(f"gnc_step is {self.gnc_step}, must be above 1")


@dataclass(frozen=True)
class Solution:
    """Poses, and how far each loop closure was believed."""

    values: gtsam.Values
    poses: np.ndarray  # (n, 4, 4) T_map_submap
    weights: np.ndarray  # (e,) from 0 to 1


class RobustGraph:
    """A graph with loop closures that may be wrong; its other factors are beyond doubt."""

    def __init__(
        self,
        sure: gtsam.NonlinearFactorGraph,
        initial: gtsam.Values,
        closures: Edges,
        covariances: np.ndarray,
        thresholds: Thresholds,
    ) -> None:
        """Take what is sure, held nodes among it, and closures with covariances (e, 6, 6) in their sources' frames."""
        self._sure, self._initial, self._thresholds = sure, initial, thresholds
        self._pairs = [
            (int(k), int(i), gtsam.Pose3(T))
            for k, i, T in zip(closures.target, closures.source, closures.measured, strict=True)
        ]
        self._models = [gtsam.noiseModel.Gaussian.Covariance(covariance) for covariance in covariances]
        self._plain = self._closures(self._models)

    def solve(self, kernel: str, start: Solution | None = None) -> Solution:
        """Return what one of tables.KERNELS makes of the graph, from a solution or else from the initial poses.

        Raises:
            RobustError: the linear system has no solution, or the answer is not finite.
        """
        try:
            return self._gnc(start) if kernel == "gnc" else self._kernel(kernel, start)
        except RuntimeError as error:
            cause = str(error).strip().splitlines()[0]
            nodes = self._initial.size()
            raise RobustError(f"a graph of {nodes} nodes has no solution by {kernel} ({cause})") from error

    def _kernel(self, kernel: str, start: Solution | None) -> Solution:
        closures, estimator = self._plain, None
        if kernel != tables.PLAIN:
            estimator = _ESTIMATORS[kernel](getattr(self._thresholds, kernel))
            closures = self._closures([gtsam.noiseModel.Robust.Create(estimator, model) for model in self._models])
        initial = self._initial if start is None else start.values
        values = gtsam.LevenbergMarquardtOptimizer(self._with(closures), initial, gtsam_search.precisely()).optimize()
        lengths = self._lengths(values)
        weights = np.ones(len(lengths)) if estimator is None else np.array([estimator.weight(d) for d in lengths])
        return Solution(values, _poses(values), weights)

    def _gnc(self, start: Solution | None) -> Solution:
        sure = self._sure.size()
        how = gtsam.GncLMParams(gtsam_search.precisely())
        how.setLossType(gtsam.GncLossType.TLS)
        how.setKnownInliers(list(range(sure)))
        how.setLambdaStep(self._thresholds.gnc_step)
        initial = self._initial if start is None else start.values
        search = gtsam.GncLMOptimizer(self._with(self._plain), initial, how)
        search.setInlierCostThresholdsAtProbability(self._thresholds.gnc_probability)
        if start is not None:  # or its first problem would believe every closure again, and leave the start
            limits = 2 * np.ravel(search.getInlierCostThresholds())[sure:]  # GTSAM's costs are halves
            search.setWeights(np.concatenate([np.ones(sure), self._lengths(initial) ** 2 <= limits]))
        values = search.optimize()
        self._lengths(values)
        return Solution(values, _poses(values), np.ravel(search.getWeights())[sure:])

    def _lengths(self, values: gtsam.Values) -> np.ndarray:
        """Return the lengths (e,) of the closures' whitened residuals."""
        lengths = np.sqrt([2 * factor.error(values) for factor in self._plain])
        if not np.isfinite(lengths).all():  # GTSAM's searches end without a word where they begin
            raise RobustError(f"a graph of {values.size()} nodes has residuals that are not numbers")
        return np.asarray(lengths)

    def _closures(self, models: Iterable[gtsam.noiseModel.Base]) -> list[gtsam.BetweenFactorPose3]:
        return [gtsam.BetweenFactorPose3(*pair, model) for pair, model in zip(self._pairs, models, strict=True)]

    def _with(self, closures: list[gtsam.BetweenFactorPose3]) -> gtsam.NonlinearFactorGraph:
        graph = gtsam.NonlinearFactorGraph(self._sure)
        for factor in closures:
            graph.add(factor)
        return graph


def _poses(values: gtsam.Values) -> np.ndarray:
    poses = gtsam_search.to_poses(values)
    if not np.isfinite(poses).all():
        raise RobustError(f"a graph of {len(poses)} nodes has poses that are not numbers")
    return poses
