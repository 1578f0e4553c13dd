"""A registration at its solution, made linear: what closed forms of its covariance are taken from.

With matches and weights held, the motion is a linear function of the points: it changes by H^-1 sum A^T M (q - p).
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from pointnetkl.registration.gicp import normals
from pointnetkl.registration.gicp.noise import Noise
from pointnetkl.registration.gicp.registration import Cloud, Settings, register_noisy
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
        """Return B = A^T M, (m, M, 3): what a match pulls the motion by."""
        return np.asarray(np.swapaxes(self.jacobian, 1, 2) @ self.weights)

    @property
    def information(self) -> np.ndarray:
        """Return H, (M, M), the sum of A^T M A."""
        return np.asarray((self.gains @ self.jacobian).sum(axis=0))

    @property
    def along_normals(self) -> "Linearised":
        """Return it without the I / 2 of every weight, which holds in the plane too, where a seabed says nothing."""
        return replace(self, weights=self.weights - 0.5 * np.eye(3))

    def about(self, centre: np.ndarray) -> "Linearised":
        """Return it with the yaw about a place (3,), in metres from the target's centre."""
        shifts = jacobian(-centre[None], self.jacobian.shape[2]) - jacobian(np.zeros((1, 3)), self.jacobian.shape[2])
        return replace(self, jacobian=self.jacobian + shifts)


def solve(source: Cloud, target: Cloud, noise: Noise, settings: Settings) -> Linearised:
    """Register the copy of run `noise.first` of the source onto the target, from where it is; return its solution."""
    found = register_noisy(source, target, np.zeros((1, settings.dimensions)), noise, settings)
    points, upwards = noisy_copy(source, target, noise)
    return linearise(points, upwards, target, SE2.from_vector(found.T_target_copy.to_vector()[0]), settings)


def noisy_copy(source: Cloud, target: Cloud, noise: Noise) -> tuple[np.ndarray, np.ndarray]:
    """Return points (n, 3) in metres and unit normals (n, 3) of the copy of run `noise.first` of the source.

    They are those that `register_noisy` registers onto the target.
    """
    given = source.as_source(target, np.zeros(3))
    n = given.points.shape[1]
    shaken = np.ascontiguousarray(noise.of_runs(1, n)[0].T)
    rows, sums = np.empty(normals.ROW * n, np.float32), np.empty_like(given.neighbourhoods)
    upwards = np.empty(3 * (n + normals.LANES), np.float32)
    normals.of_copy(given.points, shaken, given.neighbourhoods, given.lists, rows, sums, upwards)
    return source.points + shaken.T, upwards[: 3 * n].reshape(n, 3).astype(np.float64)


def linearise(
    points: np.ndarray, upwards: np.ndarray, target: Cloud, T_target_source: SE2, settings: Settings
) -> Linearised:
    """Match points (n, 3) with their normals to the target, after a motion about its centre."""
    turn = T_target_source.to_matrix()[:3, :3]
    arms = (points - target.centre) @ turn.T
    moved = arms + target.centre + [*T_target_source.translation, 0.0]
    distances, matches = cKDTree(target.points).query(moved, distance_upper_bound=settings.max_distance_m)
    near = np.isfinite(distances)
    matches = matches[near]
    return Linearised(
        jacobian(arms[near], settings.dimensions),
        weigh(upwards[near] @ turn.T, target.normals[matches].astype(np.float64), settings.plane_epsilon),
        target.points[matches] - moved[near],
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
