"""The forces of a pair's matches at a place: what its covariance, and the factor of a graph, are made of.

Equations are those of docs/closures.md; `pair.reference` has the same in plain NumPy.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from pointnetkl.registration import gicp
from pointnetkl.registration.gicp.kernel import Motion
from pointnetkl.registration.gicp.registration import limits
from pointnetkl.registration.pair import along_normals, blocks, compilation, kernel
from pointnetkl.registration.pair.settings import PairError
from pointnetkl.surveys.se2 import SE2, rotate

_f32, _u64 = np.float32, np.uint64


class Source(Protocol):
    """A cloud that moves: a gicp.Cloud, or a gicp.Part of one."""

    @property
    def points(self) -> np.ndarray:
        """The points (n, 3), metres."""

    @property
    def normals(self) -> np.ndarray:
        """Their normals (n, 3) float32, unit."""


@dataclass(frozen=True)
class Forces:
    """Forces and stiffness of the matches of a source at a place, for motions of M = 2 or 3 dimensions.

    The axes are the target's. A yaw is about the source's centroid, where it lies, and counts in metres: radians times
    the lever, so that every entry of an array has one unit. `covariance` and `factor` answer in radians.
    """

    total: np.ndarray  # f (M,) metres: the sum of M_n d, in which I / 2 in the plane is 1/2
    stiffness: np.ndarray  # H (M, M): of the ground, and of what noise makes of the normals
    ground: np.ndarray  # X (M, M), symmetric: of the ground alone
    chance: np.ndarray  # (M, M): what X has too much, because normals that agree by chance weigh more (Eq. 8)
    variance: np.ndarray  # S (M, M) m^2, of f
    residual_variance: float  # s^2, m^2
    matched: int  # points
    blocks: int  # with points, of the grid that has fewest: S cannot be told from M or fewer
    lever_m: float  # root mean square of the source's points from their centroid
    scale: float  # sum of tr M_n: the stiffness along the normals themselves

    @property
    def dimensions(self) -> int:
        """Return M."""
        return len(self.total)


def at(
    source: Source,
    target: gicp.Cloud,
    T_target_source: SE2,
    block_m: float,
    settings: gicp.Settings,
    in_plane: bool = False,
) -> Forces:
    """Return the forces after a motion, about the target's centre, as any registration has found it.

    With `in_plane` they hold d / 2 as well, which acts along the seabed: at an end that GICP has found its noise is
    noise of the end. `block_m` is the edge of the blocks of Eq. 9.

    Raises:
        PairError: blocks are so small that most hold no point.
    """
    cloud, yaw = as_source(source, target, T_target_source), float(T_target_source.yaw)
    return from_kernel(
        _at(cloud, target.as_target, yaw, block_m, limits(settings), in_plane), settings.dimensions, block_m
    )


def as_source(source: Source, target: gicp.Cloud, start: SE2) -> Any:
    """Return a source as the kernels take it, who turn it by start.yaw themselves."""
    # they take a source that is moved first, and then turned; a part has no neighbours that would be copied
    move = rotate(start.translation, -start.yaw)
    return gicp.Part(source.points, source.normals).as_source(target, np.array([*move, 0.0]))


def from_kernel(sums: tuple[np.ndarray, ...], dimensions: int, block_m: float) -> Forces:
    """Return the Forces of the sums that the kernel `total` returns.

    Raises:
        PairError: blocks are so small that most hold no point.
    """
    stiffness, ground, tilts, variance, (f_x, f_y, f_yaw, square, matched, count, lever, scale) = sums
    if count < 0:
        raise PairError(
            f"blocks of {block_m:g} m are too small for the cloud: most hold no point; raise block_spacings"
        )
    m = dimensions
    return Forces(
        total=np.array([f_x, f_y, f_yaw])[:m],
        stiffness=(np.triu(stiffness) + np.triu(stiffness, 1).T)[:m, :m],
        ground=(ground + ground.T)[:m, :m] / 2,
        chance=(scale / max(matched, 1) * tilts[0] - tilts[1])[:m, :m],
        variance=variance[:m, :m],
        residual_variance=square / max(matched - m, 1),
        matched=int(matched),
        blocks=int(count),
        lever_m=float(lever),
        scale=float(scale),
    )


class _Sums(NamedTuple):
    x: np.ndarray  # (n,) metres, from the source's centroid
    y: np.ndarray
    forces: np.ndarray  # (n, 3)
    H: np.ndarray  # (3, 3), its upper triangle
    X: np.ndarray  # (3, 3), not symmetric
    tilts: np.ndarray  # (2, 3, 3)


@compilation.kernel
def _at(source, target, yaw, block, limits, in_plane):  # type: ignore[no-untyped-def]
    cloud, motion = kernel.load(source), Motion(0.0, 0.0, yaw, 0.0, 0.0)
    kernel.match(cloud, target, motion, limits)
    return total(cloud, target, motion, block, limits.epsilon, in_plane)


@compilation.kernel
def total(cloud, target, motion, block, epsilon, in_plane):  # type: ignore[no-untyped-def]
    """Return H (its upper triangle), X (not symmetric), the tilts and S of a Cloud's matches at a place, (3, 3) each.

    The tilts (2, 3, 3) are sums of t t^T and of k t t^T with t = A^T (a - b) / 2. With them eight
    numbers: f_x, f_y, f_yaw, the sum of d^T M_n d, matched points, blocks, the lever in metres, the sum of tr M_n.
    """
    n, matched = len(cloud.copy.x), 0
    sums, numbers = (
        _Sums(np.empty(n), np.empty(n), np.empty((n, 3)), np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((2, 3, 3))),
        np.zeros(8),
    )
    place = math.cos(motion.yaw), math.sin(motion.yaw), motion.x, motion.y, 1 / cloud.lever
    for i in range(n):
        if cloud.copy.matches[i] >= 0:
            square, k = _add(_u64(i), matched, cloud, target, place, np.float64(epsilon), in_plane, sums)
            numbers[3] += square
            numbers[7] += k
            matched += 1
    for axis in range(3):
        numbers[axis] = sums.forces[:matched, axis].sum()
    S, count = blocks.variance(sums.x[:matched], sums.y[:matched], sums.forces[:matched], block)
    numbers[4], numbers[5], numbers[6] = matched, count, cloud.lever
    return sums.H, sums.X, sums.tilts, S, numbers


@compilation.device
def _add(i, row, cloud, target, place, epsilon, in_plane, sums):  # type: ignore[no-untyped-def]
    # fills a row of arms and forces with a point's, adds its part to H and X; returns its d^T M_n d and tr M_n
    copy, j, n, (cosine, sine, tx, ty, per_lever) = (
        cloud.copy,
        _u64(3) * _u64(cloud.copy.matches[i]),
        _u64(3) * i,
        place,
    )
    px, py = copy.x[i] - cloud.x, copy.y[i] - cloud.y
    rx, ry = cosine * px - sine * py, sine * px + cosine * py
    qx = rx + cosine * cloud.x - sine * cloud.y + tx
    qy = ry + sine * cloud.x + cosine * cloud.y + ty
    qz, az = np.float64(copy.z[i]), np.float64(copy.normals[n + _u64(2)])
    ax = cosine * copy.normals[n] - sine * copy.normals[n + _u64(1)]
    ay = sine * copy.normals[n] + cosine * copy.normals[n + _u64(1)]
    bx, by = np.float64(target.normals[j]), np.float64(target.normals[j + _u64(1)])
    xx, xy, yy, fx, fy, square = along_normals.weigh(qx, qy, qz, ax, ay, az, target.points, target.normals, j, epsilon)
    if in_plane:
        fx, fy = fx + 0.5 * (target.points[j] - qx), fy + 0.5 * (target.points[j + _u64(1)] - qy)
    jx, jy = -ry * per_lever, rx * per_lever  # the column of yaw in the Jacobian, Eq. 3
    sums.x[row], sums.y[row] = rx, ry
    sums.forces[row, 0], sums.forces[row, 1], sums.forces[row, 2] = fx, fy, jx * fx + jy * fy
    x_yaw, y_yaw = xx * jx + xy * jy, xy * jx + yy * jy
    for one, other, value in ((0, 0, xx), (0, 1, xy), (1, 1, yy), (0, 2, x_yaw), (1, 2, y_yaw)):
        sums.H[one, other] += value
    sums.H[2, 2] += jx * x_yaw + jy * y_yaw
    c = ax * bx + ay * by + az * target.normals[j + _u64(2)]
    same, cross = along_normals.factors(c, epsilon)
    k = 2 * same + 2 * cross * c
    sign = 1.0 if c >= 0 else -1.0  # a normal may have either sign, and a match's two have one
    bx, by = sign * bx, sign * by
    _add_ground((ax, ay, jx * ax + jy * ay), (bx, by, jx * bx + jy * by), k, sums)
    return square, k


@compilation.device
def _add_ground(alpha, beta, k, sums):  # type: ignore[no-untyped-def]
    # adds a match's part to X (Eq. 7) and to the tilts (Eq. 8), of A^T a and A^T b
    for row in range(3):
        tilt = 0.5 * (alpha[row] - beta[row])
        for column in range(3):
            sums.X[row, column] += k * alpha[row] * beta[column]
            square = tilt * 0.5 * (alpha[column] - beta[column])
            sums.tilts[0, row, column] += square
            sums.tilts[1, row, column] += k * square
