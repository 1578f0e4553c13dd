"""The mean field of one submap: where copies end, and the sums over points that move them there."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pointnetkl.models.mean_field import forces, settling
from pointnetkl.models.mean_field import ground as raster
from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.workflow.errors import PointNetKLError

_REACH = 2.5  # standard deviations of the prior: farther, a copy meets the forces that it would meet here
# Of a cloud denser than labels are made of, tables stay small: slopes' offsets then lie several cells apart, and where
# a copy lies many spacings away, its nearest points pull it to nowhere.
_MOST_SLOPES = 6  # offsets to either side
_MOST_PULLS = 15


class MeanFieldError(PointNetKLError):
    """A submap has no ground to tabulate."""


@dataclass(frozen=True)
class Conditions:
    """The registrations that are described: the numbers of sections `label` and `registration` that matter here."""

    neighbours: int  # of a point's plane
    plane_epsilon: float
    tolerance_m: float
    max_iterations: int
    prior_sigma_m: float  # of the starts, in x and y
    noise_sigma_m: float  # of each coordinate of the copy
    prior_yaw_sigma_rad: float = 0.0  # of the starts, where yaw is registered


@dataclass(frozen=True)
class Description:
    """Where the copies of one submap end in x and y, and the sums over its points that hold them at the offset zero."""

    ends: np.ndarray  # (n, 2) metres: the errors of the copies
    iterations: np.ndarray  # (n,)
    stiffness: np.ndarray  # (2, 2) of the slopes, a point's share: 1 is twice what nearest points hold with
    noise: np.ndarray  # (2, 2) of the slopes' force, squared, a point's share, for noise of 1 m
    turning: np.ndarray  # (2,) m^2: stiffness and noise as above, of the moment about the points' mean
    extent: np.ndarray  # (2, 2) m^2, second moments of the points about their mean
    points: int
    spacing_m: float
    tolerance_m: float  # of the registrations

    @property
    def covariance(self) -> np.ndarray:
        """Return the mean of e e^T over the ends, (2, 2) m^2, and what the registrations' tolerance adds to it."""
        return np.asarray(self.ends.T @ self.ends / len(self.ends) + self.tolerance_m**2 * np.eye(2))

    def yaw_variance(self, conditions: Conditions) -> float:
        """Return the variance of a registration's yaw, rad^2: what noise leaves it, and what it keeps of its prior.

        What holds it is the moment of the slopes, and of nearest points in the plane, about the points' mean. Where no
        direction is held, nothing holds yaw: it keeps as much of its prior as x and y where they are held best.
        """
        stiffness, noise = self.turning
        flat = settling.IN_PLANE * float(np.trace(self.extent))
        moment = conditions.noise_sigma_m**2 * (noise + settling.IN_PLANE * flat) / self.points
        kept = float(np.linalg.eigvalsh(self.covariance)[0]) / conditions.prior_sigma_m**2
        return float(moment / (stiffness + flat) ** 2) + kept * conditions.prior_yaw_sigma_rad**2


class _Ground(NamedTuple):
    """A submap on its rasters."""

    points: np.ndarray  # (n, 3) metres, x and y from the raster's corner
    cell: float  # metres
    counts: np.ndarray  # (4, rows, columns), as ground.fill returns it
    first: np.ndarray
    planes: np.ndarray  # (4, rows, columns), as ground.planes returns it
    rim: int  # cells around the points


def conditions(label: monte_carlo.Settings, registration: gicp.Settings) -> Conditions:
    """Return the conditions under which labels are made; the copy is always of the very points, as with copy `same`.

    Raises:
        MeanFieldError: points match no farther than the starts are spread, which no table of forces knows.
    """
    if registration.max_distance_m < _REACH * math.sqrt(label.prior_variance_m2):
        raise MeanFieldError(
            f"max_distance_m of registration is {registration.max_distance_m:g}, the mean field holds from {_REACH:g}"
            f" sigmas of the starts on, {_REACH * math.sqrt(label.prior_variance_m2):g} m; raise it, or lower"
            " label.prior_variance_m2"
        )
    return Conditions(
        registration.neighbours,
        registration.plane_epsilon,
        registration.tolerance_m,
        registration.max_iterations,
        math.sqrt(label.prior_variance_m2),
        label.noise_sigma_m,
        label.prior_yaw_sigma_rad,
    )


def describe(points: np.ndarray, conditions: Conditions) -> Description:
    """Return the description of a submap's points (n, 3), metres, in their frame.

    Raises:
        MeanFieldError: there are too few points for a plane, all on a line, with a coordinate that is not a number, or
            with outliers so far away that a raster of them all is out of proportion.
    """
    centred = _checked(points)
    centred = centred - [column.mean() for column in centred.T]
    reach = _REACH * conditions.prior_sigma_m
    ground = _ground(centred, reach, conditions.neighbours)
    # a noisy copy's normals differ from the ground's by the slope that noise gives a plane through its neighbours
    tilt = (
        conditions.noise_sigma_m / math.sqrt(conditions.neighbours) / (_radius(conditions.neighbours) * ground.cell / 2)
    )
    epsilon = 2 * conditions.plane_epsilon + tilt**2
    slopes, apart = _slopes(ground, reach, epsilon)
    pulls = _pulls(ground, reach)
    starts, noises = settling.draws()
    ends, iterations = settling.settle(
        slopes, apart, pulls, ground.cell / forces.FINE, conditions.prior_sigma_m * starts, noises,
        conditions.noise_sigma_m, conditions.tolerance_m, conditions.max_iterations,
    )  # fmt: skip
    middle = settling.Slopes(*slopes[len(slopes) // 2, len(slopes) // 2])
    return Description(
        ends,
        iterations,
        np.array([[middle.xx, middle.xy], [middle.xy, middle.yy]]) / middle.points,
        np.array([[middle.noise_xx, middle.noise_xy], [middle.noise_xy, middle.noise_yy]]) / middle.points,
        _turning(ground, epsilon) / middle.points,
        centred[:, :2].T @ centred[:, :2] / len(centred),
        len(centred),
        ground.cell,
        conditions.tolerance_m,
    )


def _checked(points: np.ndarray) -> np.ndarray:
    if len(points) >= raster.FEWEST and np.isfinite(points).all():
        return np.asarray(points, np.float64)
    numbers = int(np.isfinite(points).all(axis=1).sum())
    raise MeanFieldError(
        f"{len(points)} points, of which {numbers} are numbers, have no ground to register;"
        f" remove points that are no numbers, and give {raster.FEWEST} or more"
    )


def _radius(neighbours: int) -> float:
    """Return the radius in cells of a disc that has so many points, one in each cell."""
    return math.sqrt(neighbours / math.pi)


def _ground(points: np.ndarray, reach: float, neighbours: int) -> _Ground:
    """Return points (n, 3) about their mean on rasters with room for offsets up to `reach` metres."""
    cell, radius = float(raster.spacing(points)), _radius(neighbours)
    offsets, stride = _offsets(reach, cell)
    rim = max(offsets * stride, int(radius)) + 2
    corner = np.array([points[:, k].min() for k in (0, 1)])  # numpy is slow along the short side
    extent = [points[:, k].max() - corner[k] for k in (0, 1)]
    shape = int(extent[0] / cell) + 1 + 2 * rim, int(extent[1] / cell) + 1 + 2 * rim
    if shape[0] * shape[1] > raster.MOST_CELLS:
        raise MeanFieldError(
            f"{len(points)} points, {cell:.2g} m apart, lie scattered over {extent[0]:.0f} m by"
            f" {extent[1]:.0f} m, which takes a raster of {shape[0]} by {shape[1]} cells;"
            " remove outliers and repeated points, or cut the submap"
        )
    placed = points - [*(corner - rim * cell), 0.0]
    counts, first = raster.fill(placed, cell, shape)
    planes = raster.planes(counts, cell, radius)
    if not (counts[0] * planes[3]).any():
        raise MeanFieldError(f"{len(points)} points lie on a line, or too far apart for planes; there is no ground")
    return _Ground(placed, cell, counts, first, planes, rim)


def _slopes(ground: _Ground, reach: float, epsilon: float) -> tuple[np.ndarray, float]:
    """Return the table of slopes for offsets up to `reach` metres, and how far apart these are, metres."""
    offsets, stride = _offsets(reach, ground.cell)
    extended = raster.extend(ground.counts, ground.planes, ground.cell, ground.rim)
    return forces.slopes(ground.counts, ground.planes, extended, offsets, stride, epsilon), stride * ground.cell


def _offsets(reach: float, cell: float) -> tuple[int, int]:
    """Return how many offsets to either side a table of slopes has, and how many cells apart they lie."""
    cells = max(2, math.ceil(reach / cell))
    stride = -(-cells // _MOST_SLOPES)
    return -(-cells // stride), stride


def _pulls(ground: _Ground, reach: float) -> np.ndarray:
    """Return the table of pulls for offsets up to `reach` metres."""
    fine = min(math.ceil(reach / ground.cell * forces.FINE), _MOST_PULLS)
    shape = ground.counts.shape[1:]
    xy = raster.sort(ground.points, ground.cell, ground.first, shape[1])
    vectors = forces.nearest(xy, ground.first, ground.cell, shape, math.ceil(fine / forces.FINE) + 1)
    return np.asarray(forces.pulls(xy, vectors, ground.cell, fine))


def _turning(ground: _Ground, epsilon: float) -> np.ndarray:
    """Return the sums over points of w (g x r)^2 and w^2 (g x r)^2: what the slopes g do about the points' mean."""
    count, (slope_x, slope_y) = ground.counts[0], ground.planes[:2]
    x, y = (
        ((np.arange(count.shape[k]) + 0.5) * ground.cell - ground.points[:, k].mean()).astype(np.float32)
        for k in (0, 1)
    )
    lever = slope_y * x[:, None] - slope_x * y
    weight = 1 / (np.float32(epsilon) * (1 + slope_x**2 + slope_y**2))
    moment = count * weight * lever**2
    return np.array([moment.sum(), (weight * moment).sum()], np.float64)
