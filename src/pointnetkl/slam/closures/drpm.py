"""The covariance of an end by point-to-plane residuals, whose Hessian is weighed by what noise makes of it: DRPM.

Hatleskog and Alexis (IEEE RA-L 9(12), 2024) propagate the noise of normals into the Hessian H of point-to-plane
registration, and ask of each of its eigenvectors how probable it is that the signal is ten times the noise. A step
along an eigenvector is multiplied by that probability. As a covariance: an eigenvector has so much of its information,
and the rest is the start's. Residuals count as independent, as there, and the noise of points is a parameter.
"""

from dataclasses import dataclass

import numpy as np
from scipy import special
from scipy.spatial import cKDTree

from pointnetkl.registration import gicp
from pointnetkl.surveys.se2 import SE2

_SIGNAL_TO_NOISE = 10.0  # as in the authors' published example
_LEAST_VARIANCE_M2 = 1e-9  # of residuals
_LEAST_SCATTER_M2 = 1e-12  # of neighbours that lie on one another


@dataclass(frozen=True)
class Target:
    """A cloud to match points to, and the noise of its normals."""

    cloud: gicp.Cloud
    tree: cKDTree
    noise: np.ndarray  # (n, 3, 3) of the normals, see normal_noise


def target(cloud: gicp.Cloud, noise_m: float) -> Target:
    """Return a cloud as a target, whose points have this noise."""
    return Target(cloud, cKDTree(cloud.points), normal_noise(cloud, noise_m))


def normal_noise(cloud: gicp.Cloud, noise_m: float) -> np.ndarray:
    """Return the covariance (n, 3, 3) of a cloud's unit normals, in their tangent planes, for noise of its points.

    A normal is that of a plane through neighbours with scatter S (a sum). Its covariance is noise_m^2 sum v v^T / mu,
    v and mu the eigenvectors and eigenvalues of S in the plane.
    """
    sums = cloud.neighbourhoods.transpose(0, 2, 1).reshape(-1, 9)[: len(cloud.points), 3:]
    xx, xy, xz, yy, yz, zz = sums.T.astype(np.float64)
    mu, v = np.linalg.eigh(np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], -1).reshape(-1, 3, 3))
    tangent, scale = v[:, :, 1:], noise_m**2 / np.maximum(mu[:, 1:], _LEAST_SCATTER_M2)
    return np.asarray((tangent * scale[:, None]) @ np.swapaxes(tangent, 1, 2))


def covariance(
    source: gicp.Part, to: Target, T_target_source: SE2, prior: np.ndarray, settings: gicp.Settings
) -> np.ndarray:
    """Return Q (M, M), m^2 and rad^2, of an end, about the centroid of the source where it lies.

    The end is a motion about the target's centre, and `prior` (M, M) the variance of its start.
    """
    centre = np.append(to.cloud.centre[:2], 0.0)
    moved = T_target_source.act(source.points - centre) + centre
    distance, match = to.tree.query(moved, distance_upper_bound=settings.max_distance_m)
    near = np.isfinite(distance)
    b, arms = to.cloud.normals[match[near]].astype(np.float64), (moved - moved.mean(axis=0))[near]
    residuals = ((to.cloud.points[match[near]] - moved[near]) * b).sum(axis=1)
    axes = np.zeros((len(b), 3, len(prior)))  # of the motion: A of docs/closures.md, in radians
    axes[:, 0, 0] = axes[:, 1, 1] = 1
    if len(prior) == 3:
        axes[:, 0, 2], axes[:, 1, 2] = -arms[:, 1], arms[:, 0]
    jacobian = np.einsum("nki,nk->ni", axes, b)
    noise = np.swapaxes(axes, 1, 2) @ to.noise[match[near]] @ axes
    return of_matches(jacobian, residuals, noise, prior)


def of_matches(jacobian: np.ndarray, residuals: np.ndarray, noise: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """Return Q (M, M) of n matches: their Jacobian (n, M), its rows' noise (n, M, M), and residuals (n,) in metres."""
    root = np.linalg.cholesky(prior)  # in units of the start, so that eigenvectors do not depend on the unit of yaw
    scaled = jacobian @ root
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    probability = signal_probability(scaled @ vectors, (root @ vectors).T @ noise @ (root @ vectors))
    variance = max(float(residuals @ residuals) / max(len(residuals) - len(prior), 1), _LEAST_VARIANCE_M2)
    precision = probability * np.maximum(values, 0) / variance
    axes = root @ vectors
    return np.asarray((axes / (1 + precision)) @ axes.T)


def signal_probability(jacobian: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Return for each of M axes the probability that its sum of squares is over ten times its noise, and one more.

    `jacobian` (n, M) holds a row for each match, in these axes, and `noise` (n, M, M) the rows' covariances. A square
    of a Gaussian with mean m and variance v has v of noise in the mean, and a variance of 2 v^2 + 4 m^2 v.
    """
    v = np.diagonal(noise, axis1=1, axis2=2)
    mean, variance = v.sum(axis=0), (2 * v**2 + 4 * jacobian**2 * v).sum(axis=0)
    bound = (jacobian**2).sum(axis=0) / (1 + _SIGNAL_TO_NOISE)
    return np.asarray(special.ndtr((bound - mean) / np.sqrt(np.maximum(variance, 1e-300))))
