"""A trained model for use on board: it takes a submap's points and returns the covariance of its registration."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from pointnetkl.models import model, model_file, trained
from pointnetkl.models.model_file import Stored
from pointnetkl.registration.covariance import gaussian
from pointnetkl.workflow.errors import PointNetKLError

FEWEST = 20  # points; a registration fits a plane to as many neighbours
_APART = 10.0  # a point this many times as far out as the average is an outlier
_COARSEST_M = 0.01  # largest step between neighbouring float32 coordinates


class EstimatorError(PointNetKLError):
    """Points do not make a submap."""


@dataclass(frozen=True)
class Prediction:
    """A model's answer for one submap."""

    covariance: np.ndarray  # (M, M): m^2; with yaw (M = 3) m rad and rad^2
    novelty: float | None  # distance to the training submaps, 1 at the limit; None if the model's file does not have it

    @property
    def is_novel(self) -> bool:
        """Return whether the submap is unlike the training submaps, so that its covariance is a guess."""
        return self.novelty is not None and self.novelty > 1


class CovarianceEstimator:
    """Covariances by a model of any kind. The first call compiles kernels, some seconds; the next take milliseconds."""

    def __init__(self, stored: Stored) -> None:
        """Take the content of a model's file."""
        self._stored = stored

    @classmethod
    def load(cls, path: str | Path) -> "CovarianceEstimator":
        """Read a model, and set torch to one thread, which is the fastest for one submap.

        `path` is a model's file (.pt), or the name of one that comes with the package (`model_file.shipped`). Nothing
        in the file is executed.

        Raises:
            ModelFileError: the file is missing, damaged or holds something else.
        """
        stored = model_file.read(model_file.shipped().get(str(path), Path(path)))
        torch.set_num_threads(1)  # with more threads, waiting takes longer than the sums
        return cls(stored)

    def predict(self, points: np.ndarray) -> np.ndarray:
        """Return Q of the registration's error, (2, 2) in m^2, of a submap's points (n, 3) in metres, z up.

        Q has the axes of the points' own frame; the origin does not matter. A model of x, y and yaw returns (3, 3),
        with m rad and rad^2.

        Raises:
            EstimatorError: the points are too few, not finite, without an area, or too coarsely rounded.
            CovarianceError: the model's answer is not a covariance.
        """
        return self._covariance(_centred(points))

    def judge(self, points: np.ndarray) -> Prediction:
        """Return Q as `predict` does, and the submap's novelty.

        Raises:
            EstimatorError, CovarianceError: as `predict`.
        """
        centred, training = _centred(points), self._stored.traits
        return Prediction(self._covariance(centred), training.novelty(centred) if training else None)

    def _covariance(self, centred: np.ndarray) -> np.ndarray:
        origin = f"a submap of {len(centred)} points"
        inputs = trained.inputs(self._stored, centred, origin)
        return gaussian.check(model.predict(self._stored.model, inputs)[0], origin)


def _centred(points: np.ndarray) -> np.ndarray:
    """Return points (n, 3) about their mean, float64, if they make a submap."""
    array = np.asarray(points)
    if array.ndim != 2 or array.shape[1] != 3 or array.dtype.kind not in "fiu":
        raise EstimatorError(
            f"points are {array.dtype} of shape {array.shape}, must be (n, 3) numbers: x, y, z, metres"
        )
    if len(array) < FEWEST:
        raise EstimatorError(f"a submap of {len(array)} points cannot be registered, {FEWEST} are the least")
    exact = array.astype(np.float64)
    if not np.isfinite(exact).all():
        wrong = int((~np.isfinite(exact)).any(axis=1).sum())
        raise EstimatorError(f"{wrong} of {len(exact)} points have a coordinate that is no number; drop them")
    _require_resolution(exact)
    centred = exact - exact.mean(axis=0)
    _require_area(centred)
    return np.asarray(centred)


def _require_resolution(points: np.ndarray) -> None:
    largest = np.abs(points).max()
    step = float(np.spacing(np.float32(largest)))
    if step > _COARSEST_M and np.array_equal(points, points.astype(np.float32)):
        raise EstimatorError(
            f"coordinates of up to {largest:.3g} m were stored as float32, whole steps of {step:g} m;"
            " subtract an origin before they are"
        )


def _require_area(centred: np.ndarray) -> None:
    x, y = centred[:, 0], centred[:, 1]
    narrow, wide = np.linalg.eigvalsh(np.array([[x @ x, x @ y], [x @ y, y @ y]]))
    if narrow <= 1e-6 * wide:
        raise EstimatorError(f"all {len(centred)} points lie on a line or in one place; a submap covers an area")
    distance = np.sqrt(x * x + y * y)
    if (farthest := distance.max()) > _APART * (usual := distance.mean()):
        raise EstimatorError(
            f"a point lies {farthest:.0f} m from the middle of the submap, the others {usual:.0f} m on average;"
            " drop what is not seabed"
        )
