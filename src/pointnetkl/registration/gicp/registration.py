"""Preparing clouds and registering them: what the rest of the package sees of GICP."""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from pointnetkl.registration.gicp import kernel, matching, neighbours, normals
from pointnetkl.registration.gicp.noise import Noise
from pointnetkl.surveys.se2 import SE2, rotate
from pointnetkl.workflow import parameters
from pointnetkl.workflow.errors import PointNetKLError

_LARGEST_M = 1e5  # float32 places a point within 4 mm up to here
_LEAST_EPSILON = 1e-5
_MOST_ITERATIONS = 100_000


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
    dof: str = "xy"  # what a registration finds: xy (the paper) or xyyaw

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
        for name, most in (("max_iterations", _MOST_ITERATIONS), ("max_distance_m", _LARGEST_M)):
            if getattr(self, name) > most:
                raise ValueError(f"{name} is {getattr(self, name):g}, must be at most {most:g}")


@dataclass(frozen=True)
class Cloud:
    """A cloud ready to be registered; its points stand in the order of its search grid, not in the caller's."""

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
        return matching.target(local, self.normals, self.grid)


class Source(Protocol):
    """What can be laid on a cloud: a cloud, or a part of one."""

    @property
    def points(self) -> np.ndarray:
        """The points (n, 3), metres."""

    def as_source(self, target: Cloud, move: np.ndarray) -> kernel.Source:
        """Return it, moved by (3,) metres, as the kernel takes it."""


@dataclass(frozen=True)
class Registration:
    """Outcome of aligning one cloud with another."""

    T_target_source: SE2  # lays the source on the target, in axes with the origin at the target's centre
    # (M, M) 1/m^2 and 1/rad^2, yaw about the target's centre: the sum of J^T M J over the matches at the solution, J
    # the Jacobian of (x, y) or (x, y, yaw); zero without any match
    information: np.ndarray
    converged: bool
    iterations: int
    matched_share: float  # of the source's points


@dataclass(frozen=True)
class Registrations:
    """Outcomes of aligning b noisy copies of one cloud with another."""

    T_target_copy: SE2  # (b) motions that lay the moved, noisy copies on the target, with the origin at its centre
    converged: np.ndarray  # (b,) bool
    iterations: np.ndarray  # (b,) int32


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
    upwards = normals.of_neighbourhoods(around, len(points))
    return Cloud(points, upwards, float(np.median(distances[:, 1])), centre, around, lists, grid)


def register(
    source: Source,
    target: Cloud,
    settings: Settings,
    start: SE2 | None = None,
) -> Registration:
    """Return the motion by settings.dof, near `start`, that lays the source on the target.

    Both clouds are in the same axes. Motions, the answer's and `start`, have their origin at the target's centre; only
    the dof xyyaw has a yaw. Without any match within settings.max_distance_m the answer is the start itself, not
    converged, with zero information.

    Raises:
        GicpError: the start has a yaw, and the dof is xy.
    """
    start = start or SE2.identity()
    if start.yaw and settings.dimensions == 2:
        raise GicpError(f"a start with a yaw of {start.yaw:g} rad needs the dof xyyaw, and it is xy")
    # the kernel's source is moved first and turned then
    move = rotate(start.translation, -start.yaw)
    (x, y, yaw), sums, iterations, converged, matched = kernel.register(
        source.as_source(target, np.array([*move, 0.0])), target.as_target, float(start.yaw), _limits(settings)
    )
    return Registration(
        T_target_source=SE2(np.array([x, y]), yaw) @ SE2(move, 0.0),
        information=_information(sums, settings.dimensions),
        converged=converged,
        iterations=iterations,
        matched_share=matched / len(source.points),
    )


def register_noisy(
    source: Cloud,
    target: Cloud,
    moves: np.ndarray,
    noise: Noise,
    settings: Settings,
    recompute_normals: bool = True,
    engine: str = "cpu",
) -> Registrations:
    """Register copies of the source, each moved by x, y of moves (b, 2) in metres and noise, onto the target.

    With the dof xyyaw moves may be (b, 3): a search begins with the moved copy turned by so many radians. Copy i has
    the noise of run `noise.first` + i, in the order of source.points. A copy's normals come from its own noisy points
    and the clean source's neighbour lists, or are the clean source's. The motion found lays the moved, noisy copy on
    the target. The engine is cpu, or cuda for an NVIDIA GPU: the same answer, up to float32's rounding.

    Raises:
        GicpError: moves have a yaw, and the dof is xy; or the engine cuda cannot do it, as cuda.register_noisy says.
    """
    if moves.shape[1] > settings.dimensions:
        raise GicpError(f"moves of shape {moves.shape} have a yaw, which the dof {settings.dof} does not find")
    limits = _limits(settings, recompute_normals)
    if engine == "cuda":
        from pointnetkl.registration.gicp.cuda import (
            engine as cuda,  # here, because a machine without a GPU needs none of it
        )

        return cuda.register_noisy(source, target, moves, noise, limits)
    turns = np.ascontiguousarray(moves[:, 2], np.float64) if moves.shape[1] == 3 else np.zeros(len(moves))
    found = kernel.register_noisy(
        source.as_source(target, np.zeros(3)),
        target.as_target,
        np.ascontiguousarray(moves[:, :2], np.float64),
        turns,
        noise.draws(),
        limits,
    )
    motions, iterations, converged = found
    return Registrations(SE2.from_vector(motions), converged, iterations)


def _information(sums: np.ndarray, dimensions: int) -> np.ndarray:
    xx, xy, yy, _, _, x_yaw, y_yaw, yaw_yaw, _ = sums
    return np.array([[xx, xy, x_yaw], [xy, yy, y_yaw], [x_yaw, y_yaw, yaw_yaw]])[:dimensions, :dimensions]


def _limits(settings: Settings, recompute: bool = True, keep: bool = True) -> kernel.Limits:
    return kernel.Limits(
        np.float32(settings.plane_epsilon),
        np.float32(settings.max_distance_m),
        settings.tolerance_m,
        settings.max_iterations,
        settings.dimensions == 3,
        recompute,
        keep,
    )


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
