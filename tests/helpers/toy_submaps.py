"""Submaps over toy seabeds, turned ones, and how they are labelled: for the ways to get Q."""

import dataclasses

import numpy as np

import terrains
from pointnetkl.methods.closed_forms.self_registration import SelfRegistration
from pointnetkl.methods.fitted import fitting
from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.surveys.submap import Submap

REGISTRATION = gicp.Settings(
    neighbours=20, plane_epsilon=1e-3, max_distance_m=20.0, tolerance_m=1e-3, max_iterations=50
)
WITH_YAW = dataclasses.replace(REGISTRATION, dof="xyyaw")
LABEL = monte_carlo.Settings(seed=2, copy="same", prior_variance_m2=9.0, noise_sigma_m=0.1, held_out_runs=0)
FIT = fitting.Settings(seed=4, floor_m2=0.01, starts=6)
SETUP = SelfRegistration(5, LABEL, REGISTRATION)
SETUP_WITH_YAW = SelfRegistration(5, LABEL, WITH_YAW)
BOTH = {"xy": SETUP, "xyyaw": SETUP_WITH_YAW}


def submap(kind: str, number: int = 0, points: int = 900, height: float = 1.0) -> Submap:
    """Return a submap over a seabed of terrains.cloud, `height` times as high; others have other points."""
    parts = [terrains.cloud(kind, points, 3 * number + part) * [1, 1, height] for part in range(3)]
    return Submap("toy", number, *parts)


def turned(submap: Submap, angle: float) -> Submap:
    """Return a submap turned about z by an angle in radians."""
    R = rotation(angle, 3)
    parts = {name: getattr(submap, name) @ R.T for name in ("points", "first", "second")}
    return dataclasses.replace(submap, **parts)


def rotation(angle: float, dimensions: int) -> np.ndarray:
    """Return what turns vectors (x, y), (x, y, z) or (x, y, yaw) by an angle about z."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])[:dimensions, :dimensions]


def assert_turns(method, kind: str, angle: float, share: float) -> None:
    """See that a method's Q turns with the submap, but for a share of it that the copy's other noise may change."""
    whole = submap(kind)
    q, seen = method.covariance(whole), method.covariance(turned(whole, angle))
    R = rotation(angle, len(q))
    root = np.linalg.inv(np.linalg.cholesky(R @ q @ R.T))
    np.testing.assert_allclose(root @ seen @ root.T, np.eye(len(q)), atol=share)
