"""MAP registration and the forces of a pair in plain NumPy, as docs/closures.md derives them.

A k-d tree, dense matrices, float64, and nothing kept from one step to the next. This module is for reading. `kernel`
and `forces` do the same many times as fast; tests compare them with this. Equation numbers are those of
docs/closures.md.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from pointnetkl.registration import reference
from pointnetkl.registration.pair.settings import Settings
from pointnetkl.surveys.se2 import SE2

GRIDS = ((0.0, 0.0), (0.5, 0.0), (0.0, 0.5), (0.5, 0.5))  # shifts of the four grids of blocks, in blocks


class Matches(NamedTuple):
    """The n matches of a source at a place, for motions of M dimensions: x, y and perhaps yaw times the lever."""

    arms: np.ndarray  # (n, 2) metres, from the source's centroid to the moved point
    residuals: np.ndarray  # (n, 3) d, metres, from the moved point to its match
    normals: tuple[np.ndarray, np.ndarray]  # a of the source and b of the target, (n, 3) each, unit
    weights: np.ndarray  # (n, 3, 3) M_n, Eq. 2
    jacobian: np.ndarray  # (n, 3, M) A, Eq. 3


def register(
    source: reference.Cloud, target: reference.Cloud, prior: np.ndarray, spacing_m: float, settings: Settings
) -> SE2:
    """Return T_target_source, the most probable motion of a source that starts where it is, by Eq. 5 and 6.

    `prior` (M, M) is the variance of the start, in m^2 (and rad^2), of the source's centroid and of its yaw about it.
    """
    m, lever = settings.dimensions, lever_m(source.points)
    scale = np.diag([1, 1, lever][:m])
    precision = np.linalg.inv(scale @ prior @ scale)
    place = np.zeros(m)  # from the start: metres of the centroid, and of the lever
    for _ in range(settings.map_steps):
        matched = matches(source, target, _motion(source, place, lever), settings)
        _, total, stiffness, _ = sums(matched)
        weight = 1 / (settings.residuals_as_one * max(residual_variance(matched), 1e-12))
        gradient = weight * total - precision @ place
        step = np.linalg.solve(weight * stiffness + precision, gradient)
        size = max(np.linalg.norm(step[:2]), *np.abs(step[2:]), 1e-12)
        place += step * min(1, settings.longest_step_spacings * spacing_m / size)
        if size < settings.tolerance_m or step @ gradient < settings.tolerance_sigmas**2:
            break
    return _motion(source, place, lever)


def matches(source: reference.Cloud, target: reference.Cloud, T: SE2, settings: Settings) -> Matches:
    """Return the matches of a source after a motion T_target_source."""
    R, moved = T.to_matrix()[:3, :3], T.act(source.points)
    distance, match = cKDTree(target.points).query(moved)
    near = distance < settings.max_distance_m
    a, b = source.normals[near] @ R.T, target.normals[match[near]]
    b = np.where((a * b).sum(axis=1, keepdims=True) < 0, -b, b)  # a normal may have either sign, two of a match one
    C_a, C_b = (reference.covariances(n, settings.plane_epsilon) for n in (a, b))
    arms = (moved - moved.mean(axis=0))[near]
    jacobian = reference.jacobian(arms)[:, :, : settings.dimensions]
    jacobian[:, :, 2:] /= lever_m(source.points)
    weights = np.linalg.inv(C_a + C_b) - 0.5 * np.eye(3)  # Eq. 2
    return Matches(arms[:, :2], target.points[match[near]] - moved[near], (a, b), weights, jacobian)


def chance(matched: Matches) -> np.ndarray:
    """Return what X (M, M) has too much because normals that agree by chance weigh more: Eq. 8."""
    k = np.trace(matched.weights, axis1=1, axis2=2)
    a, b = matched.normals
    tilts = np.einsum("nki,nk->ni", matched.jacobian, a - b) / 2
    return np.asarray(np.einsum("n,ni,nj->ij", k.mean() - k, tilts, tilts))


def sums(matched: Matches, in_plane: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the forces (n, M), their sum f (M,), H (M, M) and X (M, M): Eq. 3, 4 and 7.

    With `in_plane` a force has the half identity of GICP's weights too, which acts along the seabed.
    """
    A, (a, b) = matched.jacobian, matched.normals
    W = matched.weights + 0.5 * np.eye(3) if in_plane else matched.weights
    forces = np.einsum("nki,nkl,nl->ni", A, W, matched.residuals)
    stiffness = np.einsum("nki,nkl,nlj->ij", A, matched.weights, A)
    k = np.trace(matched.weights, axis1=1, axis2=2)
    ground = np.einsum("n,nki,nk,nl,nlj->ij", k, A, a, b, A)
    return forces, forces.sum(axis=0), stiffness, (ground + ground.T) / 2


def residual_variance(matched: Matches) -> float:
    """Return s^2, m^2, the variance of the residuals along normals, weighted: Eq. 6."""
    d, dimensions = matched.residuals, matched.jacobian.shape[2]
    return float(np.einsum("ni,nij,nj->", d, matched.weights, d) / max(len(d) - dimensions, 1))


def force_variance(arms: np.ndarray, forces: np.ndarray, block_m: float) -> np.ndarray:
    """Return S (M, M), the variance of the sum of forces (n, M) at arms (n, 2) in metres, by square blocks: Eq. 9."""
    S = np.zeros(2 * forces.shape[1:])
    for shift in GRIDS:
        cells = np.floor(arms / block_m + shift)
        _, block, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
        blocks = np.stack([forces[block == k].sum(axis=0) for k in range(len(counts))])
        blocks -= np.outer(counts / len(arms), forces.sum(axis=0))
        S += blocks.T @ blocks * len(counts) / max(len(counts) - 1, 1) / len(GRIDS)
    return S


def lever_m(points: np.ndarray) -> float:
    """Return the metres that a typical point of (n, 3) moves when they turn about their centroid by a radian."""
    arms = points[:, :2] - points[:, :2].mean(axis=0)
    return float(np.sqrt(np.mean(np.sum(arms**2, axis=1))))


def _motion(source: reference.Cloud, place: np.ndarray, lever: float) -> SE2:
    # the motion that takes the centroid by place[:2], and turns about it
    yaw = place[2] / lever if len(place) == 3 else 0.0
    centroid = source.points[:, :2].mean(axis=0)
    return SE2(place[:2], yaw).from_centre(centroid)
