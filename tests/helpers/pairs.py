"""Pairs of clouds to be registered: two passes over one toy ground, with the sonar's noise, where they truly lie."""

import dataclasses

import numpy as np

import terrains
from pointnetkl.registration import gicp, pair, reference

GICP = pair.Settings(neighbours=20, plane_epsilon=1e-3, max_distance_m=20.0, tolerance_m=1e-3, max_iterations=50)
SETTINGS = {dof: dataclasses.replace(GICP, method="map", dof=dof) for dof in ("xy", "xyyaw")}
NUMBERS = pair.covariance.Settings()
GATES = pair.factor.Settings()
POINTS, SIZE_M = 1600, 120.0
SPACING_M = SIZE_M / np.sqrt(POINTS)
BLOCK_M = NUMBERS.block_spacings * SPACING_M
NOISE_M = 0.1


def prior(dof: str, sigma_m: float = 3.0) -> np.ndarray:
    """Return the variance of a start (M, M), with 0.03 rad of yaw."""
    return np.diag([sigma_m, sigma_m, 0.03][: SETTINGS[dof].dimensions]) ** 2


def points(kind: str, number: int, noise_m: float = NOISE_M) -> np.ndarray:
    """Return a pass (n, 3) over the ground of terrains.cloud, in metres; other numbers are other passes.

    The ridge is a wider one, and "hills" are mild ground with waves of 80 m: a normal is a mean over 15 m, which takes
    half of the slope of waves of 20 m away.
    """
    clean = terrains.cloud("flat" if kind == "hills" else kind, POINTS, number, SIZE_M)
    if kind == "ridge":
        clean[:, 2] = 3 * np.exp(-((clean[:, 1] / 20) ** 2))
    if kind == "hills":
        clean[:, 2] = 4 * terrains.height("mild", clean[:, :2] / 4)
    return clean + np.random.default_rng([11, number]).normal(0, noise_m, (len(clean), 1)) * [0, 0, 1]


def clouds(kind: str, number: int = 0, noise_m: float = NOISE_M) -> tuple[gicp.Cloud, gicp.Cloud]:
    """Return a source and a target; with number k + 1 both are other passes than with k."""
    source, target = (gicp.prepare(points(kind, 2 * number + k, noise_m), GICP) for k in (0, 1))
    return source, target


def plain(source: gicp.Cloud | gicp.Part, target: gicp.Cloud) -> tuple[reference.Cloud, reference.Cloud]:
    """Return two clouds as the references take them, about the target's centre."""
    first, second = (
        reference.Cloud(cloud.points - target.centre, cloud.normals.astype(np.float64)) for cloud in (source, target)
    )
    return first, second


def rotation(angle: float) -> np.ndarray:
    """Return what turns vectors (x, y, z) by an angle about z."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
