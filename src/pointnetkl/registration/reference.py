"""The method as the paper writes it: GICP in x and y (and yaw), and the Monte Carlo label.

Plain NumPy in float64: a k-d tree, dense matrices, and nothing kept from one step to the next. This module is for
reading. The packages `gicp` and `monte_carlo` do the same hundreds of times as fast; tests and benchmarks compare them
with this. Equation numbers are those of the paper (Torroba et al. 2020), or of Segal 2009 where its name stands.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from pointnetkl.registration import gicp
from pointnetkl.surveys.se2 import SE2


class Cloud(NamedTuple):
    """Points with their normals."""

    points: np.ndarray  # (n, 3) metres
    normals: np.ndarray  # (n, 3) of unit length and either sign


def register(source: Cloud, target: Cloud, settings: gicp.Settings) -> tuple[SE2, np.ndarray, bool]:
    """Return h(P_i, P_j) of Eq. 1: T_target_source, its information (M, M), and whether it converged.

    Both clouds are in the same axes. T_target_source minimises the sum of d^T (C_target + R C_source R^T)^-1 d over the
    matches (Segal 2009, Eq. 2), by Gauss and Newton.
    """
    tree, T, m = cKDTree(target.points), SE2.identity(), settings.dimensions
    C_source, C_target = (covariances(cloud.normals, settings.plane_epsilon) for cloud in (source, target))
    lever = np.sqrt(np.mean(np.sum(source.points[:, :2] ** 2, axis=1)))  # metres that a typical point moves per radian
    for _ in range(settings.max_iterations):
        R, moved = T.to_matrix()[:3, :3], T.act(source.points)
        distance, match = tree.query(moved)
        near = distance < settings.max_distance_m
        d = target.points[match[near]] - moved[near]
        W = np.linalg.inv(C_target[match[near]] + R @ C_source[near] @ R.T)
        J = jacobian(source.points[near] @ R.T)[:, :, :m]
        information = np.einsum("nki,nkl,nlj->ij", J, W, J)
        step = np.zeros(3)
        step[:m] = np.linalg.solve(information, np.einsum("nki,nkl,nl->i", J, W, d))
        T = SE2.from_vector(T.to_vector() + step)
        if max(np.linalg.norm(step[:2]), abs(step[2]) * lever) < settings.tolerance_m:
            return T, information, True
    return T, information, False


def errors(
    points: np.ndarray, perturbations: Iterable[SE2], noise: Iterable[np.ndarray], settings: gicp.Settings
) -> np.ndarray:
    """Return the errors e_l (L, M) of L registrations of a perturbed, noisy copy of a submap onto it (Eq. 10).

    `points` are those of the submap S_i, (n, 3); `perturbations` are L draws of T_j from O, about the mean of the
    points; `noise` is L draws of the copy's noise, (n, 3) metres.
    """
    points = points - points.mean(axis=0)
    lists = neighbours(points, settings.neighbours)
    submap, residuals = Cloud(points, normals(points, lists)), []
    for T_j, shifts in zip(perturbations, noise, strict=True):
        moved = T_j.act(points) + shifts
        # the registration takes the copy back to the submap: its motion is the inverse of the paper's exp(hat T_j)
        T_submap_copy, _, _ = register(Cloud(moved, normals(moved, lists)), submap, settings)
        residuals.append((T_submap_copy @ T_j).log())  # Eq. 10: log(exp(hat T_j)^-1 T_j)
    return np.array(residuals)[:, : settings.dimensions]


def label(errors: np.ndarray) -> np.ndarray:
    """Return Q_i (M, M) of L errors (L, M): Eq. 11, which does not subtract their mean."""
    return np.asarray(np.sum([np.outer(e, e) for e in errors], axis=0) / (len(errors) - 1))


def prepare(points: np.ndarray, settings: gicp.Settings) -> Cloud:
    """Return points (n, 3) with their normals."""
    return Cloud(points, normals(points, neighbours(points, settings.neighbours)))


def neighbours(points: np.ndarray, count: int) -> np.ndarray:
    """Return the numbers (n, count) of each point's nearest points, itself among them."""
    return np.asarray(cKDTree(points).query(points, count)[1])


def normals(points: np.ndarray, lists: np.ndarray) -> np.ndarray:
    """Return unit normals (n, 3) of points (n, 3), of either sign, from the scatter of their neighbours (n, k)."""
    near = points[lists]
    centred = near - near.mean(axis=1, keepdims=True)
    return np.linalg.eigh(np.einsum("nki,nkj->nij", centred, centred))[1][:, :, 0]


def covariances(normals: np.ndarray, epsilon: float) -> np.ndarray:
    """Return C = V diag(epsilon, 1, 1) V^T (n, 3, 3) of unit normals (n, 3), as Segal 2009 writes it."""
    # any two directions in the plane will do
    other = np.where(np.abs(normals[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]])
    u = np.cross(normals, other)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.stack([normals, u, np.cross(normals, u)], axis=2)
    return np.asarray(v @ np.diag([epsilon, 1, 1]) @ v.transpose(0, 2, 1))


def jacobian(turned: np.ndarray) -> np.ndarray:
    """Return what x, y and yaw move points (n, 3) by, (n, 3, 3), that have been turned and not yet moved."""
    J = np.zeros((len(turned), 3, 3))
    J[:, 0, 0] = J[:, 1, 1] = 1
    J[:, 0, 2], J[:, 1, 2] = -turned[:, 1], turned[:, 0]
    return J
