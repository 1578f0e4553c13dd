"""What a graph gets of a pair: the ground's pull and nothing of the start, Eq. 13 to 16 of docs/closures.md.

A factor's residual is A offset - c with unit variance. `offset` (M,) is where the source lies from the place at which
its forces were taken: metres in the axes of the target of that time and, with yaw, radians about the source's centroid.
"""

from dataclasses import dataclass

import numpy as np
from scipy import stats

from pointnetkl.registration.pair import covariance
from pointnetkl.registration.pair.covariance import LEAST_VARIANCE_M2, levers
from pointnetkl.registration.pair.forces import Forces
from pointnetkl.workflow.parameters import require_positive, require_within

# of the stiffness along normals: slopes below 3e-5, which are the rounding of float32 on a plane
_LEAST_STIFFNESS = 1e-9


@dataclass(frozen=True)
class Settings:
    """Numbers of a graph's factor and of its gates.

    Raises:
        ValueError: a setting is out of its range.
    """

    least_share: float = 0.5  # of a component's stiffness that must be ground; 0.3 lets noise in
    largest_variance_ratio: float = 2.5  # of residual variance to the survey's median: wrong ends have 3 to 5
    drift_factor: float = 3.0  # the gate takes the graph's drift for so many times what it says
    gate_probability: float = 0.999  # that a right closure passes the gate by chi2

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        require_within(self, 0.0, 1.0, "least_share")
        require_positive(self, "largest_variance_ratio", "drift_factor")
        if not 0 < self.gate_probability < 1:
            raise ValueError(f"gate_probability is {self.gate_probability:g}, must be between 0 and 1")


@dataclass(frozen=True)
class Factor:
    """The likelihood of a place, whitened: of rank 0 where no ground holds, to M."""

    A: np.ndarray  # (rank, M) 1/m, and 1/rad of yaw
    c: np.ndarray  # (rank,)
    shares: np.ndarray  # (M,) r, ascending: of the stiffness that is ground; 1 on rock, 0 to 0.4 on flat ground

    @property
    def information(self) -> np.ndarray:
        """Return A^T A (M, M) in 1/m^2 and 1/rad^2: K with b in it, of the components that are ground."""
        return np.asarray(self.A.T @ self.A)

    @property
    def pull(self) -> np.ndarray:
        """Return the offset (M,) of least size at which the residual is 0: what a prior has held back."""
        return np.asarray(np.linalg.pinv(self.A) @ self.c)

    def residual(self, offset: np.ndarray) -> np.ndarray:
        """Return A offset - c (rank,)."""
        return np.asarray(self.A @ offset - self.c)


def of(forces: Forces, numbers: covariance.Settings, settings: Settings) -> Factor:
    """Return the factor of forces along normals (Eq. 13 to 15).

    It has rank 0 where matches lie in M or fewer blocks. Take the forces at the last place, without `in_plane`.
    """
    lever, shares, root, inverse, u = _components(forces, covariance.ground(forces, numbers))
    ground = (shares > settings.least_share) & (forces.blocks > forces.dimensions)
    Y, F = shares[ground, None] * (u.T @ root)[ground], (u.T @ inverse)[ground]
    S = forces.variance + LEAST_VARIANCE_M2 * np.eye(forces.dimensions)
    L = np.linalg.cholesky(numbers.inflation * F @ S @ F.T + numbers.drift_m2 * Y @ Y.T)
    return Factor(np.linalg.solve(L, Y) * lever, np.linalg.solve(L, F @ forces.total), shares)


def place(factor: Factor, prior: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the most probable offset (M,) and its variance (M, M), with a prior (M, M) about the offset of a start.

    They are for judging errors; a graph has a prior of its own.
    """
    precision = np.linalg.inv(prior)
    Q = np.linalg.inv(factor.information + precision)
    return Q @ (factor.A.T @ factor.c + precision @ start), Q


def chi2(factor: Factor, offset: np.ndarray, variance: np.ndarray) -> float:
    """Return how far a graph's prediction is off: r^T (I + A Sigma A^T)^-1 r, Eq. 16; 0 where the ground says nothing.

    `offset` (M,) is the predicted one, and Sigma = `variance` (M, M) that of a graph without this very closure.
    """
    r = factor.residual(offset)
    return float(r @ np.linalg.solve(np.eye(len(r)) + factor.A @ variance @ factor.A.T, r))


def passes_residuals(forces: Forces, median: float, settings: Settings) -> bool:
    """Whether the residual variance is that of a right match; `median` is that of the survey's registrations, m^2."""
    return forces.residual_variance <= settings.largest_variance_ratio * median


def passes_prediction(factor: Factor, offset: np.ndarray, variance: np.ndarray, settings: Settings) -> bool:
    """Whether a graph's prediction and the factor agree, if drift were settings.drift_factor times what it says."""
    limit = stats.chi2.ppf(settings.gate_probability, factor.A.shape[1])
    return bool(chi2(factor, offset, settings.drift_factor**2 * variance) <= limit)


def _components(forces: Forces, X: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    # levers, shares r, H^1/2, H^-1/2, and U of H^-1/2 X H^-1/2 = U diag(r) U^T; a component without stiffness has r = 0
    w, v = np.linalg.eigh(forces.stiffness)
    held = w > _LEAST_STIFFNESS * forces.scale
    roots = np.sqrt(np.where(held, w, 0.0))
    root = (v * roots) @ v.T
    inverse = (v * np.divide(1.0, roots, out=np.zeros_like(roots), where=held)) @ v.T
    shares, u = np.linalg.eigh(inverse @ X @ inverse)
    return levers(forces.lever_m, forces.dimensions), shares, root, inverse, u
