"""A registration linearised at its solution, which the closed forms of its covariance start from.

With fixed matches and weights the motion is a linear function of the points: it changes by H^-1 sum A^T M (q - p).
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from pointnetkl.registration.gicp import normals
from pointnetkl.registration.gicp.cloud import Cloud, Settings
from pointnetkl.registration.gicp.noise import Noise
from pointnetkl.registration.gicp.registration import register_noisy
from pointnetkl.surveys.se2 import SE2


@dataclass(frozen=True)
class Linearised:
    """The m matches of a registration at its solution, for motions of M = 2 or 3 dimensions."""

    jacobian: np.ndarray  # (m, 3, M), A: x, y in metres and yaw about the target's centre move a point by so much
    weights: np.ndarray  # (m, 3, 3) 1/m^2, (C_q + R C_p R^T)^-1
    residuals: np.ndarray  # (m, 3) metres, from the moved point to its match
    matches: np.ndarray  # (m,) the target's point

    @property
    def gains(self) -> np.ndarray:
        """Return B = A^T M, (m, M, 3): the pull of a match on the motion, per metre of residual."""
        return np.asarray(np.swapaxes(self.jacobian, 1, 2) @ self.weights)

    @property
    def information(self) -> np.ndarray:
        """Return H, (M, M), the sum of A^T M A."""
        return np.asarray((self.gains @ self.jacobian).sum(axis=0))

    @property
    def along_normals(self) -> "Linearised":
        """Return it without the I / 2 of every weight, which acts along the seabed too, where a point cannot tell."""
        return replace(self, weights=self.weights - 0.5 * np.eye(3))

    def with_centre(self, centre: np.ndarray) -> "Linearised":
        """Return it with the yaw about another centre (3,), in metres from the target's centre."""
        shifts = jacobian(-centre[None], self.jacobian.shape[2]) - jacobian(np.zeros((1, 3)), self.jacobian.shape[2])
        return replace(self, jacobian=self.jacobian + shifts)


def solve(source: Cloud, target: Cloud, noise: Noise, settings: Settings) -> Linearised:
    """Register the copy of run `noise.first` of the source onto the target, from where it is; return its solution."""
    solution = register_noisy(source, target, np.zeros((1, settings.dimensions)), noise, settings)
    points, upwards = noisy_copy(source, target, noise)
    return linearise(points, upwards, target, SE2.from_vector(solution.T_target_copy.to_vector()[0]), settings)


def noisy_copy(source: Cloud, target: Cloud, noise: Noise) -> tuple[np.ndarray, np.ndarray]:
    """Return points (n, 3) in metres and unit normals (n, 3) of the copy of run `noise.first` of the source.

    They are the ones that `register_noisy` registers to the target.
    """
    clean = source.as_source(target, np.zeros(3))
    n = clean.points.shape[1]
    shifts = np.ascontiguousarray(noise.draw(1, n)[0].T)
    rows, sums = np.empty(normals.ROW * n, np.float32), np.empty_like(clean.neighbourhoods)
    upwards = np.empty(3 * (n + normals.LANES), np.float32)
    normals.fill_normals(clean.points, shifts, clean.neighbourhoods, clean.lists, rows, sums, upwards)
    return source.points + shifts.T, upwards[: 3 * n].reshape(n, 3).astype(np.float64)


def linearise(
    points: np.ndarray, upwards: np.ndarray, target: Cloud, T_target_source: SE2, settings: Settings
) -> Linearised:
    """Return the matches of points (n, 3), with their normals, after a motion about the target's centre."""
    turn = T_target_source.to_matrix()[:3, :3]
    arms = (points - target.centre) @ turn.T
    moved = arms + target.centre + [*T_target_source.translation, 0.0]
    distances, matches = cKDTree(target.points).query(moved, distance_upper_bound=settings.max_distance_m)
    matched = np.isfinite(distances)
    matches = matches[matched]
    return Linearised(
        jacobian(arms[matched], settings.dimensions),
        weigh(upwards[matched] @ turn.T, target.normals[matches].astype(np.float64), settings.plane_epsilon),
        target.points[matches] - moved[matched],
        matches,
    )


def jacobian(arms: np.ndarray, dimensions: int) -> np.ndarray:
    """Return A, (n, 3, M), of points at arms (n, 3) in metres from the centre that the yaw turns about."""
    columns = np.zeros((len(arms), 3, 3))
    columns[:, 0, 0] = columns[:, 1, 1] = 1.0
    columns[:, 0, 2], columns[:, 1, 2] = -arms[:, 1], arms[:, 0]
    return columns[:, :, :dimensions]


def weigh(a: np.ndarray, b: np.ndarray, epsilon: float) -> np.ndarray:
    """Return M = (2 I - (1 - epsilon) (a a^T + b b^T))^-1, (n, 3, 3), of two points' unit normals (n, 3) each.

    As in weights.weigh: I / 2 + [a b] S [a b]^T.
    """
    w, m = 1 - epsilon, 1 + epsilon
    c = w * (a * b).sum(axis=1)
    scale = 0.5 * w / (m * m - c * c)
    same, cross = m * scale, c * scale
    u, v = same[:, None] * a + cross[:, None] * b, cross[:, None] * a + same[:, None] * b
    return np.asarray(0.5 * np.eye(3) + u[:, :, None] * a[:, None] + v[:, :, None] * b[:, None])
