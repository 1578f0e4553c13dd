"""An independent GICP in x and y to test the kernel against: k-d tree, dense matrices, float64, nothing clever."""

import numpy as np
from scipy.spatial import cKDTree

from pointnetkl.registration import gicp


def normals(points: np.ndarray, lists: np.ndarray) -> np.ndarray:
    """Return unit normals (n, 3) of points (n, 3) whose neighbours are given (n, k)."""
    near = points[lists]
    centred = near - near.mean(axis=1, keepdims=True)
    return np.linalg.eigh(np.einsum("nki,nkj->nij", centred, centred))[1][:, :, 0]


def register(
    source: np.ndarray,
    source_normals: np.ndarray,
    target: np.ndarray,
    target_normals: np.ndarray,
    how: gicp.Settings,
) -> tuple[np.ndarray, np.ndarray, bool]:
    """Return the translation (2,) that lays source on target, the information (2, 2), and whether it converged."""
    tree, t = cKDTree(target), np.zeros(2)
    covariances = [_covariances(n, how.plane_epsilon) for n in (source_normals, target_normals)]
    for _ in range(how.max_iterations):
        moved = source + np.append(t, 0)
        distance, match = tree.query(moved)
        near = distance < how.max_distance_m
        weight = np.linalg.inv(covariances[0][near] + covariances[1][match[near]])
        information = weight[:, :2, :2].sum(axis=0)
        residual = target[match[near]] - moved[near]
        step = np.linalg.solve(information, np.einsum("nij,nj->i", weight[:, :2], residual))
        t = t + step
        if np.linalg.norm(step) < how.tolerance_m:
            return t, information, True
    return t, information, False


def register_with_yaw(
    source: np.ndarray,
    source_normals: np.ndarray,
    target: np.ndarray,
    target_normals: np.ndarray,
    how: gicp.Settings,
) -> np.ndarray:
    """Return x, y in metres and yaw in radians about the origin (3,) that lay source on target, by Gauss-Newton."""
    tree, pose = cKDTree(target), np.zeros(3)
    covariances = [_covariances(n, how.plane_epsilon) for n in (source_normals, target_normals)]
    for _ in range(how.max_iterations):
        c, s = np.cos(pose[2]), np.sin(pose[2])
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        turned = source @ turn.T
        moved = turned + np.array([pose[0], pose[1], 0])
        distance, match = tree.query(moved)
        near = distance < how.max_distance_m
        weight = np.linalg.inv(turn @ covariances[0][near] @ turn.T + covariances[1][match[near]])
        jacobian = np.zeros((near.sum(), 3, 3))
        jacobian[:, 0, 0] = jacobian[:, 1, 1] = 1
        jacobian[:, 0, 2], jacobian[:, 1, 2] = -turned[near, 1], turned[near, 0]
        information = np.einsum("nki,nkl,nlj->ij", jacobian, weight, jacobian)
        gradient = np.einsum("nki,nkl,nl->i", jacobian, weight, target[match[near]] - moved[near])
        step = np.linalg.solve(information, gradient)
        pose = pose + step
        lever = np.sqrt(np.mean(np.sum(source[:, :2] ** 2, axis=1)))
        if max(np.linalg.norm(step[:2]), abs(step[2]) * lever) < how.tolerance_m:
            break
    return pose


def _covariances(normals: np.ndarray, epsilon: float) -> np.ndarray:
    # C = V diag(epsilon, 1, 1) V^T, as Segal 2009 writes it: any two directions in the plane will do
    other = np.where(np.abs(normals[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]])
    u = np.cross(normals, other)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.stack([normals, u, np.cross(normals, u)], axis=2)
    return np.asarray(v @ np.diag([epsilon, 1, 1]) @ v.transpose(0, 2, 1))
