"""Small surveys over toy grounds, to and fro, whose lines overlap: submaps, true poses, drift."""

from dataclasses import dataclass

import numpy as np

import terrains
from pointnetkl.registration import pair
from pointnetkl.slam.closing import drift, survey
from pointnetkl.slam.closing.survey import Closed
from pointnetkl.surveys import pose

LENGTH_M, SWATH_M, SPACING_M, NOISE_M = 60.0, 100.0, 2.0, 0.1
ALONG, APART_M, SPEED_MPS, TURN_S = 4, 15.0, 2.0, 120.0
DRIFT = drift.Settings(1e-3, 5e-4, 5e-4, 300.0, 4e-3, 300.0)
REGISTRATION = pair.Settings(20, 1e-3, 20.0, 1e-3, 50, method="map")


@dataclass(frozen=True)
class Toy:
    """Submaps of a survey, where they truly lie, and when."""

    clouds: list[np.ndarray]
    truth: np.ndarray  # (n, 4, 4)
    time_s: np.ndarray  # (n,)

    @property
    def covariance(self) -> np.ndarray:
        """Return the covariance (3 n, 3 n) of its drift."""
        return self.of_drift(1.0)

    def of_drift(self, factor: float) -> np.ndarray:
        """Return what it is believed to be, were its sigmas `factor` times as large."""
        return drift.covariance(self.time_s, self.truth[:, :2, 3], DRIFT.times(factor))

    def drifted(self, seed: int) -> np.ndarray:
        """Return its navigation (n, 4, 4) with a drift of its covariance."""
        errors = np.random.default_rng([3, seed]).multivariate_normal(np.zeros(len(self.covariance)), self.covariance)
        return moved(self.truth, errors.reshape(-1, 3))

    def close(self, navigation: np.ndarray, factor: float = 1.0, settings: survey.Settings | None = None) -> Closed:
        """Return it closed from its navigation."""
        covariance = self.of_drift(factor)
        return survey.close(self.clouds, navigation, covariance, SPACING_M, settings or survey.Settings(), REGISTRATION)


def sail(kind: str, lines: int = 3) -> Toy:
    """Return a survey over a ground: flat, hills of 80 m, or a ridge along the lines."""
    rng, clouds, truth, times = np.random.default_rng(1), [], [], []
    for line in range(lines):
        for step in range(ALONG):
            along = step if line % 2 == 0 else ALONG - 1 - step
            T = pose.matrix(np.array([LENGTH_M * along, APART_M * line, -20.0]), np.pi * (line % 2))
            truth.append(T)
            times.append(len(times) * LENGTH_M / SPEED_MPS + TURN_S * line)
            clouds.append(_cloud(kind, T, rng))
    return Toy(clouds, np.array(truth), np.array(times))


def moved(poses: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """Return poses (n, 4, 4) after errors (n, 3) in x, y (axes of the map) and yaw."""
    out = poses.copy()
    for T, (x, y, yaw) in zip(out, errors, strict=True):
        T[:3, :3] = pose.matrix(np.zeros(3), yaw)[:3, :3] @ T[:3, :3]
        T[:2, 3] += x, y
    return out


def rms(poses: np.ndarray, truth: np.ndarray) -> float:
    """Return the root mean square of the errors in the plane, metres."""
    return float(np.sqrt(np.mean(np.sum((poses - truth)[:, :2, 3] ** 2, axis=1))))


def _cloud(kind: str, T_map_submap: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    corners = np.stack(
        np.meshgrid(np.arange(-LENGTH_M / 2, LENGTH_M / 2, SPACING_M), np.arange(-SWATH_M / 2, SWATH_M / 2, SPACING_M)),
        axis=-1,
    ).reshape(-1, 2)
    points = np.column_stack([corners + SPACING_M * rng.random(corners.shape), np.zeros(len(corners))])
    in_map = pose.transform(T_map_submap, points)[:, :2]
    points[:, 2] = _height(kind, in_map) - 40.0 + rng.normal(0, NOISE_M, len(points))
    return points


def _height(kind: str, xy: np.ndarray) -> np.ndarray:
    if kind == "hills":
        return np.asarray(4 * terrains.height("mild", xy / 4))
    if kind == "ridge":
        return np.asarray(3 * np.exp(-(((xy[:, 1] - 10) / 20) ** 2)))
    return np.zeros(len(xy))
