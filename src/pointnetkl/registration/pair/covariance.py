"""The covariance of a pair's registration, from the forces at its end: Eq. 10 to 12 of docs/closures.md.

K is what the ground tells of the place, in the axes of the target, about the place where the source lies: (M, M) in
1/m^2 and, with yaw about the source's centroid, 1/rad^2. Q judges errors and has the start's prior in it. V is for a
graph, which knows the start already.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from pointnetkl.registration.pair.forces import Forces
from pointnetkl.registration.pair.settings import PairError
from pointnetkl.workflow.parameters import require_positive, require_within

# m^2, added to S: with few blocks it may be singular, and on ground without noise it is zero
LEAST_VARIANCE_M2 = 1e-9


@dataclass(frozen=True)
class Settings:
    """Numbers of the covariance of a pair, the same for all ground.

    Raises:
        ValueError: a setting is out of its range.
    """

    inflation: float = 3.0  # a, of the variance of forces
    drift_share: float = 3e-4  # of a submap's length along its track: root of b, what drift does to its shape
    block_spacings: float = 8.0  # edge of the blocks that the variance of forces is taken by
    largest_m2: float = 1e4  # of V, where the ground holds nothing
    without_chance: bool = (
        True  # X less what it has too much where normals are noisy (Eq. 8); nothing at 3 m of spacing
    )

    submap_length_m: float = 100.0  # along the track; it is the survey's, not a parameter: see of_submaps

    @property
    def drift_m2(self) -> float:
        """Return b, m^2: what drift inside a submap adds to the variance of its place, whatever the ground."""
        return (self.drift_share * self.submap_length_m) ** 2

    def of_submaps(self, positions: np.ndarray) -> Self:
        """Return the numbers for submaps at positions (n, 2 or 3) along a track, whose median distance is their length.

        Of fewer than two the length stays as it is.
        """
        if len(positions) < 2:
            return self
        return replace(self, submap_length_m=float(np.median(np.hypot(*np.diff(positions[:, :2], axis=0).T))))

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        require_positive(self, "inflation", "block_spacings", "largest_m2")
        require_within(self, 0.0, 0.1, "drift_share")
        require_within(self, 0.0, 1e6, "submap_length_m")


def information(forces: Forces, settings: Settings) -> np.ndarray:
    """Return K = X S^-1 X / a (M, M), Eq. 10, which holds nothing of the start.

    It is zero where matches lie in M or fewer blocks, because S cannot be told from them. X is never inverted: 1e12 m^2
    in one direction would cost the other its digits.
    """
    m = forces.dimensions
    if forces.blocks <= m:
        return np.zeros((m, m))
    w, v = np.linalg.eigh(ground(forces, settings))
    X = (v * np.maximum(w, 0.0)) @ v.T  # noise makes small eigenvalues negative
    K = X @ np.linalg.solve(forces.variance + LEAST_VARIANCE_M2 * np.eye(m), X) / settings.inflation
    lever = levers(forces.lever_m, m)
    return np.asarray((K + K.T) / 2 * np.outer(lever, lever))


def ground(forces: Forces, settings: Settings) -> np.ndarray:
    """Return X (M, M), the stiffness that is the ground's, by Eq. 7 or, with settings.without_chance, by Eq. 8."""
    return forces.ground - forces.chance if settings.without_chance else forces.ground


def with_prior(K: np.ndarray, prior: np.ndarray, lever_m: float, settings: Settings) -> np.ndarray:
    """Return Q = (K + P^-1)^-1 + b I (M, M), Eq. 11: the variance of the errors of a place found with the prior P.

    P (M, M) is the true variance of the start. With yaw b is that of points at the lever. Q holds the start, which a
    graph knows already: weight no factor with it.

    Raises:
        PairError: the prior is no covariance of K's size.
    """
    if prior.shape != K.shape or np.linalg.eigvalsh(prior)[0] <= 0:
        raise PairError(f"the prior must be a covariance of {len(K)} dimensions, and is {prior.tolist()}")
    return np.asarray(np.linalg.inv(K + np.linalg.inv(prior)) + _drift(lever_m, settings, len(K)))


def without_prior(K: np.ndarray, lever_m: float, settings: Settings) -> np.ndarray:
    """Return V = K^-1 + b I (M, M), Eq. 12, with eigenvalues of K^-1 of at most settings.largest_m2 at the lever."""
    lever = levers(lever_m, len(K))
    w, v = np.linalg.eigh(K / np.outer(lever, lever))
    V = (v / np.maximum(w, 1 / settings.largest_m2)) @ v.T
    return np.asarray(V / np.outer(lever, lever) + _drift(lever_m, settings, len(K)))


def levers(lever_m: float, dimensions: int) -> np.ndarray:
    """Return what a motion's entries (M,) count in metres: 1, 1 and the lever."""
    return np.array([1.0, 1.0, lever_m])[:dimensions]


def _drift(lever_m: float, settings: Settings, dimensions: int) -> np.ndarray:
    return np.asarray(np.diag(settings.drift_m2 / levers(lever_m, dimensions) ** 2))
