"""Clouds prepared for registration, parts of them as sources, and the settings."""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy.spatial import cKDTree

from pointnetkl.registration.gicp import kernel, matching, neighbours, normals
from pointnetkl.workflow import parameters
from pointnetkl.workflow.errors import PointNetKLError

_LARGEST_M = 1e5  # float32 places a point within 4 mm up to here
_LEAST_EPSILON = 1e-5
_MOST_ITERATIONS = 100_000
_NO_NEIGHBOURS = np.empty(0, np.float32), np.empty((0, 0), np.uint32)  # only noisy copies need neighbours


class GicpError(PointNetKLError):
    """A cloud cannot be registered."""


@dataclass(frozen=True)
class Settings:
    """Section `registration` of the parameters.

    Raises:
        ValueError: a setting is out of its range.
    """

    neighbours: int  # points whose scatter gives a normal
    plane_epsilon: float  # variance along the normal, against 1 in the plane
    max_distance_m: float  # farther points do not match
    tolerance_m: float  # converged when a step is shorter
    max_iterations: int
    dof: str = "xy"  # degrees of freedom of a registration: xy (the paper) or xyyaw

    @property
    def dimensions(self) -> int:
        """Return M, the size of an error (x, y and perhaps yaw) and of its covariance."""
        return 3 if self.dof == "xyyaw" else 2

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        if self.dof not in ("xy", "xyyaw"):
            raise ValueError(f"dof is {self.dof!r}, must be xy or xyyaw")
        parameters.require_positive(self, "max_distance_m", "tolerance_m", "max_iterations")
        if self.neighbours < 3:
            raise ValueError(f"neighbours is {self.neighbours}, must be at least 3: fewer points have no plane")
        if not _LEAST_EPSILON <= self.plane_epsilon <= 1:
            raise ValueError(
                f"plane_epsilon is {self.plane_epsilon:g}, must be {_LEAST_EPSILON:g} (less is lost in float32) to 1,"
                " the variance in the plane"
            )
        for name, largest in (("max_iterations", _MOST_ITERATIONS), ("max_distance_m", _LARGEST_M)):
            if getattr(self, name) > largest:
                raise ValueError(f"{name} is {getattr(self, name):g}, must be at most {largest:g}")


@dataclass(frozen=True)
class Cloud:
    """A cloud ready to be registered; its points are in the order of its search grid, not in the caller's."""

    points: np.ndarray  # (n, 3) float64, metres
    normals: np.ndarray  # (n, 3) float32, unit, upwards (nz >= 0)
    spacing_m: float  # median distance to the nearest other point
    centre: np.ndarray  # (3,) float64, metres: the mean, subtracted before going to float32
    neighbourhoods: np.ndarray  # (blocks, 9, 16) float32, see normals.neighbourhoods
    lists: np.ndarray  # (n, k) uint32, each point's neighbours, itself first
    grid: neighbours.Grid

    def as_source(self, target: "Cloud", move: np.ndarray) -> kernel.Source:
        """Return the cloud, moved by (3,) metres, as the kernel takes it, in the axes of the target's centre."""
        points = np.ascontiguousarray((self.points - target.centre + move).T, np.float32)
        shift = (self.centre - target.centre + move).astype(np.float32)
        around = self.neighbourhoods.copy()
        around[:, :3] += shift[:, None]
        return kernel.Source(points, self.normals.reshape(-1), around.reshape(-1), self.lists)

    @cached_property
    def as_target(self) -> matching.Target:
        """Return the cloud as the kernel takes it to match to, with its table of candidates."""
        local = (self.points - self.centre).astype(np.float32)
        return matching.build_target(local, self.normals, self.grid)


class Source(Protocol):
    """What can be registered to a cloud: a cloud, or a part of one."""

    @property
    def points(self) -> np.ndarray:
        """The points (n, 3), metres."""

    def as_source(self, target: Cloud, move: np.ndarray) -> kernel.Source:
        """Return it, moved by (3,) metres, as the kernel takes it."""


@dataclass(frozen=True)
class Part:
    """Some points of a cloud, with the normals that they have without the others; a source for `register` alone."""

    points: np.ndarray  # (n, 3) float64, metres
    normals: np.ndarray  # (n, 3) float32, unit, upwards

    def as_source(self, target: Cloud, move: np.ndarray) -> kernel.Source:
        """Return the points, moved by (3,) metres, as the kernel takes them, in the axes of the target's centre."""
        points = np.ascontiguousarray((self.points - target.centre + move).T, np.float32)
        return kernel.Source(points, self.normals.reshape(-1), *_NO_NEIGHBOURS)


def prepare(points: np.ndarray, settings: Settings) -> Cloud:
    """Return a cloud of points (n, 3), in metres, ready to be registered: normals, neighbour lists, search grid.

    Raises:
        GicpError: fewer than 3 points, a coordinate that is not finite, or an extent beyond 100 km.
    """
    points = _checked(np.asarray(points, np.float64))
    centre = points.mean(axis=0)
    count = min(settings.neighbours, len(points))
    distances, lists = neighbours.nearest(points, count)
    # a disk through the last neighbour holds `count` points: cells of one point each search fastest
    spacing = float(np.median(distances[:, -1])) * np.sqrt(np.pi / count)
    grid, order = neighbours.build_grid((points - centre).astype(np.float32), spacing)
    rank = np.empty(len(order), np.uint32)
    rank[order] = np.arange(len(order), dtype=np.uint32)
    lists, points = rank[lists[order]], points[order]
    around = normals.neighbourhoods(points - centre, lists)
    upwards = normals.from_neighbourhoods(around, len(points))
    return Cloud(points, upwards, float(np.median(distances[:, 1])), centre, around, lists, grid)


def part(cloud: Cloud, keep: np.ndarray, settings: Settings) -> Part:
    """Return the points of a cloud where `keep` (n,) is true, at least settings.neighbours of them.

    Their normals are those that `prepare` would give them. A point whose neighbours are all kept has the cloud's normal
    already, so this takes a fraction of the time of preparing the points.
    """
    points, upwards = cloud.points[keep], cloud.normals[keep]
    changed = np.flatnonzero(~keep[cloud.lists[keep]].all(axis=1))
    if len(changed):
        _, lists = cKDTree(points).query(points[changed], np.arange(1, settings.neighbours + 1))
        around = normals.neighbourhoods(points - cloud.centre, lists)
        upwards[changed] = normals.from_neighbourhoods(around, len(changed))
    return Part(points, upwards)


def _checked(points: np.ndarray) -> np.ndarray:
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 3:
        raise GicpError(f"a cloud of shape {points.shape} cannot be registered; it needs 3 or more points (n, 3)")
    if not np.isfinite(points).all():
        raise GicpError("a cloud has a coordinate that is not finite; remove such points before registering it")
    if (extent := float(np.ptp(points, axis=0).max())) > _LARGEST_M:
        raise GicpError(
            f"a cloud extends over {extent:.0f} m, at most {_LARGEST_M:.0f} m can be registered;"
            " remove its outliers or cut it"
        )
    return points
