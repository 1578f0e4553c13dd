"""Robust estimators for pose graphs with wrong loop closures: kernels and graduated non-convexity, by GTSAM.

An estimator weighs a loop closure by the length of its whitened residual. So a Q that is too small makes true closures
look wrong, and a Q that is too large lets wrong ones pass.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np

from pointnetkl.slam.graph import gtsam_search
from pointnetkl.slam.graph.pose_graph import Edges
from pointnetkl.slam.robust import schemas
from pointnetkl.workflow.errors import PointNetKLError
from pointnetkl.workflow.parameters import require_positive

ACCEPTED = 0.5  # a closure with a larger weight counts as accepted
_ESTIMATORS: dict[str, Callable[[float], Any]] = {
    "huber": gtsam.noiseModel.mEstimator.Huber.Create,
    "cauchy": gtsam.noiseModel.mEstimator.Cauchy.Create,
    "dcs": gtsam.noiseModel.mEstimator.DCS.Create,
}


class RobustError(PointNetKLError):
    """A graph with wrong loop closures cannot be optimised."""


@dataclass(frozen=True)
class Thresholds:
    """Where a robust estimator begins to doubt a loop closure.

    Raises:
        ValueError: a threshold is not positive, or a probability not below 1.
    """

    huber: float  # length of the whitened residual
    cauchy: float
    dcs: float  # Phi, a squared length
    gnc_probability: float  # of the chi-square distribution of a true closure's squared length, 6 degrees of freedom
    gnc_step: float  # factor of the control parameter from one problem to the next

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        require_positive(self, *vars(self))
        if self.gnc_probability >= 1:
            raise ValueError(f"gnc_probability is {self.gnc_probability}, must be below 1")
        if self.gnc_step <= 1:
            raise ValueError(f"gnc_step is {self.gnc_step}, must be above 1")


@dataclass(frozen=True)
class Solution:
    """Poses, and the weight of each loop closure."""

    values: gtsam.Values
    poses: np.ndarray  # (n, 4, 4) T_map_submap
    weights: np.ndarray  # (e,) from 0 to 1


class RobustGraph:
    """A graph with loop closures that may be wrong; its other factors are trusted."""

    def __init__(
        self,
        trusted: gtsam.NonlinearFactorGraph,
        initial: gtsam.Values,
        closures: Edges,
        covariances: np.ndarray,
        thresholds: Thresholds,
    ) -> None:
        """Take trusted factors (also held nodes), and closures with covariances (e, 6, 6) in their sources' frames."""
        self._trusted, self._initial, self._thresholds = trusted, initial, thresholds
        self._pairs = [
            (int(k), int(i), gtsam.Pose3(T))
            for k, i, T in zip(closures.target, closures.source, closures.T_target_source, strict=True)
        ]
        self._models = [gtsam.noiseModel.Gaussian.Covariance(covariance) for covariance in covariances]
        self._plain = self._factors(self._models)

    def solve(self, kernel: str, start: Solution | None = None) -> Solution:
        """Return the solution by one of schemas.KERNELS, from an earlier solution or else from the initial poses.

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
        if kernel != schemas.PLAIN:
            estimator = _ESTIMATORS[kernel](getattr(self._thresholds, kernel))
            closures = self._factors([gtsam.noiseModel.Robust.Create(estimator, model) for model in self._models])
        initial = self._initial if start is None else start.values
        values = gtsam.LevenbergMarquardtOptimizer(
            self._with(closures), initial, gtsam_search.precise_search()
        ).optimize()
        lengths = self._lengths(values)
        weights = np.ones(len(lengths)) if estimator is None else np.array([estimator.weight(d) for d in lengths])
        return Solution(values, _poses(values), weights)

    def _gnc(self, start: Solution | None) -> Solution:
        trusted = self._trusted.size()
        parameters = gtsam.GncLMParams(gtsam_search.precise_search())
        parameters.setLossType(gtsam.GncLossType.TLS)
        parameters.setKnownInliers(list(range(trusted)))
        parameters.setLambdaStep(self._thresholds.gnc_step)
        initial = self._initial if start is None else start.values
        search = gtsam.GncLMOptimizer(self._with(self._plain), initial, parameters)
        search.setInlierCostThresholdsAtProbability(self._thresholds.gnc_probability)
        if start is not None:  # else the first problem accepts every closure, and leads away from the start
            limits = 2 * np.ravel(search.getInlierCostThresholds())[trusted:]  # GTSAM's costs are halves
            search.setWeights(np.concatenate([np.ones(trusted), self._lengths(initial) ** 2 <= limits]))
        values = search.optimize()
        self._lengths(values)
        return Solution(values, _poses(values), np.ravel(search.getWeights())[trusted:])

    def _lengths(self, values: gtsam.Values) -> np.ndarray:
        """Return the lengths (e,) of the closures' whitened residuals."""
        lengths = np.sqrt([2 * factor.error(values) for factor in self._plain])
        if not np.isfinite(lengths).all():  # where it fails, GTSAM's search returns its first poses without an error
            raise RobustError(f"a graph of {values.size()} nodes has residuals that are not numbers")
        return np.asarray(lengths)

    def _factors(self, models: Iterable[gtsam.noiseModel.Base]) -> list[gtsam.BetweenFactorPose3]:
        return [gtsam.BetweenFactorPose3(*pair, model) for pair, model in zip(self._pairs, models, strict=True)]

    def _with(self, closures: list[gtsam.BetweenFactorPose3]) -> gtsam.NonlinearFactorGraph:
        graph = gtsam.NonlinearFactorGraph(self._trusted)
        for factor in closures:
            graph.add(factor)
        return graph


def _poses(values: gtsam.Values) -> np.ndarray:
    poses = gtsam_search.to_poses(values)
    if not np.isfinite(poses).all():
        raise RobustError(f"a graph of {len(poses)} nodes has poses that are not numbers")
    return poses
