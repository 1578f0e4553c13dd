"""Preparing clouds and registering them: what the rest of the package sees of GICP."""

from dataclasses import dataclass

import numpy as np

from pointnetkl.errors import PointNetKLError
from pointnetkl.gicp import kernel, neighbours, normals

_LARGEST_M = 1e5  # float32 places a point within 4 mm up to here


class GicpError(PointNetKLError):
    """A cloud cannot be registered, or a setting of the registration makes no sense."""


@dataclass(frozen=True)
class Settings:
    """Section `registration` of the parameters."""

    neighbours: int  # points whose scatter gives a normal
    plane_epsilon: float  # variance along the normal, against 1 in the plane
    max_distance_m: float  # farther points do not match
    tolerance_m: float  # converged when a step is shorter
    max_iterations: int

    def __post_init__(self) -> None:
        """Refuse what makes no sense.

        Raises:
            GicpError: a setting is out of its range.
        """
        if self.neighbours < 3 or self.max_iterations < 1:
            raise GicpError(
                f"registration.neighbours is {self.neighbours} and max_iterations {self.max_iterations};"
                " they must be at least 3 and 1"
            )
        if not 0 < self.plane_epsilon <= 1:
            raise GicpError(f"registration.plane_epsilon is {self.plane_epsilon}, must be in (0, 1]")
        if not (self.max_distance_m > 0 and self.tolerance_m > 0):
            raise GicpError(
                f"registration.max_distance_m is {self.max_distance_m} and tolerance_m {self.tolerance_m};"
                " both must be positive"
            )


@dataclass(frozen=True)
class Cloud:
    """A cloud ready to be registered; its points stand in the order of its search grid, not in the caller's."""

    points: np.ndarray  # (n, 3) float64, metres
    normals: np.ndarray  # (n, 3) float32, unit, upwards (nz >= 0)
    spacing_m: float  # median distance to the nearest other point
    centre: np.ndarray  # (3,) float64, metres: what was subtracted before going to float32
    local: np.ndarray  # (n, 3) float32, points - centre
    lists: np.ndarray  # (n, k) int32, each point's neighbours, itself first
    grid: neighbours.Grid


@dataclass(frozen=True)
class Registration:
    """Outcome of aligning one cloud with another."""

    translation: np.ndarray  # (2,) metres: source + translation lies on the target
    information: np.ndarray  # (2, 2) 1/m^2, the sum of M_xy over the matches at the solution; zero without any
    converged: bool
    iterations: int
    matched_share: float  # of the source's points


@dataclass(frozen=True)
class Registrations:
    """Outcomes of aligning b noisy copies of one cloud with another."""

    translation: np.ndarray  # (b, 2) metres
    converged: np.ndarray  # (b,) bool
    iterations: np.ndarray  # (b,) int32


def prepare(points: np.ndarray, settings: Settings) -> Cloud:
    """Return a cloud of points (n, 3), in metres, ready to be registered: normals, neighbour lists, search grid.

    Raises:
        GicpError: fewer than 3 points, a coordinate that is not finite, or an extent beyond 100 km.
    """
    points = _checked(np.asarray(points, np.float64))
    centre = 0.5 * (points.min(0) + points.max(0))
    count = min(settings.neighbours, len(points))
    distances, lists = neighbours.nearest(points, count)
    # a disk through the last neighbour holds `count` points: cells of one point each search fastest
    spacing = float(np.median(distances[:, -1])) * np.sqrt(np.pi / count)
    grid, order = neighbours.build_grid((points - centre).astype(np.float32), spacing)
    rank = np.empty(len(order), np.int32)
    rank[order] = np.arange(len(order), dtype=np.int32)
    lists, points = rank[lists[order]], points[order]
    local = (points - centre).astype(np.float32)
    nearest = float(np.median(distances[:, 1]))
    return Cloud(points, normals.of_cloud(local, lists), nearest, centre, local, lists, grid)


def register(source: Cloud, target: Cloud, settings: Settings, start: tuple[float, float] = (0.0, 0.0)) -> Registration:
    """Return the translation in x and y, near `start` (metres), that lays the source on the target.

    Both clouds are in the same axes. Without any match within settings.max_distance_m the answer is the start
    itself, not converged, with zero information.
    """
    offset = np.array([start[0], start[1], 0.0])
    moved = (source.points - target.centre + offset).astype(np.float32)[None]
    translation, information, iterations, converged, matched = _align(moved, source.normals[None], target, settings)
    xx, xy, yy = information[0]
    return Registration(
        translation=translation[0] + offset[:2],
        information=np.array([[xx, xy], [xy, yy]]),
        converged=bool(converged[0]),
        iterations=int(iterations[0]),
        matched_share=float(matched[0] / len(source.points)),
    )


def register_noisy(
    source: Cloud, target: Cloud, translations: np.ndarray, noise: np.ndarray, settings: Settings
) -> Registrations:
    """Register copies of the source, each moved by a translation (b, 2) and noise (b, n, 3), onto the target.

    Both in metres, noise in the order of source.points. A copy's normals come from its own noisy points and the
    clean source's neighbour lists. The translation found lays the moved, noisy copy on the target.
    """
    base = (source.points - target.centre).astype(np.float32)
    moved = base + np.asarray(noise, np.float32)
    moved[..., :2] += np.asarray(translations, np.float32)[:, None]
    found = _align(moved, normals.of_copies(moved, source.lists), target, settings)
    return Registrations(translation=found[0], converged=found[3], iterations=found[2])


def _align(
    moved: np.ndarray, moved_normals: np.ndarray, target: Cloud, settings: Settings, keep: bool = True
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    limits = kernel.Limits(
        np.float32(settings.plane_epsilon),
        np.float32(settings.max_distance_m),
        settings.tolerance_m,
        settings.max_iterations,
        keep,
    )
    sources = kernel.Surface(moved.reshape(len(moved), -1), moved_normals.reshape(len(moved), -1))
    onto = kernel.Surface(target.local.reshape(-1), target.normals.reshape(-1))
    return kernel.align(sources, onto, target.grid, limits)


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
