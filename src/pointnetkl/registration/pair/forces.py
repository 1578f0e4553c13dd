"""The forces of a pair's matches at a place: what its covariance, and the factor of a graph, are made of.

Equations are those of docs/closures.md; `pair.reference` has the same in plain NumPy.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from pointnetkl.registration import gicp
from pointnetkl.registration.gicp.kernel import Motion
from pointnetkl.registration.gicp.registration import limits
from pointnetkl.registration.pair import along_normals, blocks, compilation, kernel
from pointnetkl.registration.pair.settings import PairError
from pointnetkl.surveys.se2 import SE2, rotate

_u64 = np.uint64


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


def as_source(source: Source, target: gicp.Cloud, start: SE2) -> kernel.Source:
    """Return a source as the kernels take it, who turn it by start.yaw themselves."""
    return kernel.Source(
        np.ascontiguousarray(source.points, np.float64),
        np.ascontiguousarray(source.normals, np.float32),
        target.centre,
        np.asarray(rotate(start.translation, -start.yaw), np.float64),  # they take a source that is moved, then turned
    )


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
        stiffness=stiffness[:m, :m],
        ground=(ground + ground.T)[:m, :m] / 2,
        chance=(scale / max(matched, 1) * tilts[0] - tilts[1])[:m, :m],
        variance=variance[:m, :m],
        residual_variance=float(square / max(matched - m, 1)),
        matched=int(matched),
        blocks=int(count),
        lever_m=float(lever),
        scale=float(scale),
    )


class _Matches(NamedTuple):
    """The n matches of a cloud, in columns."""

    arms: np.ndarray  # (2, n) metres, from the source's centroid
    a: np.ndarray  # (3, n) A^T a, of the source's normals
    b: np.ndarray  # (3, n) A^T b, of the target's
    same: np.ndarray  # (n,) of M_n = same (a a^T + b b^T) + cross (a b^T + b a^T)
    cross: np.ndarray  # (n,)
    trace: np.ndarray  # (n,) k
    forces: np.ndarray  # (3, n) A^T M_n d
    square: np.ndarray  # (n,) d^T M_n d


@compilation.kernel
def _at(source, target, yaw, block, limits, in_plane):  # type: ignore[no-untyped-def]
    cloud, motion = kernel.load(source), Motion(0.0, 0.0, yaw, 0.0, 0.0)
    kernel.match(cloud, target, motion, limits)
    return total(cloud, target, motion, block, limits.epsilon, in_plane)


@compilation.kernel
def total(cloud, target, motion, block, epsilon, in_plane):  # type: ignore[no-untyped-def]
    """Return H, X (not symmetric), the tilts and S of a Cloud's matches at a place, (3, 3) each, and eight numbers.

    The tilts (2, 3, 3) are sums of t t^T and of k t t^T with t = A^T (a - b) / 2. The numbers are f_x, f_y, f_yaw, the
    sum of d^T M_n d, matched points, blocks, the lever in metres, and the sum of tr M_n.
    """
    m = _matches(cloud, target, motion, np.float64(epsilon), in_plane)
    both, tilt, tilts = _moments(m.cross, m.a, m.b), 0.5 * (m.a - m.b), np.empty((2, 3, 3))
    H = _moments(m.same, m.a, m.a) + _moments(m.same, m.b, m.b) + both + both.T
    X = _moments(m.trace, m.a, m.b)
    tilts[0], tilts[1] = _moments(np.ones(len(m.same)), tilt, tilt), _moments(m.trace, tilt, tilt)
    S, count = blocks.variance(m.arms[0], m.arms[1], m.forces, block)
    numbers = np.empty(8)
    numbers[0], numbers[1], numbers[2] = m.forces[0].sum(), m.forces[1].sum(), m.forces[2].sum()
    numbers[3], numbers[4], numbers[5] = m.square.sum(), len(m.square), count
    numbers[6], numbers[7] = cloud.lever, m.trace.sum()
    return H, X, tilts, S, numbers


@compilation.kernel
def _moments(weights, left, right):  # type: ignore[no-untyped-def]
    # the sums (3, 3) of weights (n,) times rows of left and right (3, n)
    sums = np.empty((3, 3))
    for row in range(3):
        for column in range(3):
            total = 0.0
            for i in range(len(weights)):
                total += weights[i] * left[row, i] * right[column, i]
            sums[row, column] = total
    return sums


@compilation.kernel
def _matches(cloud, target, motion, epsilon, in_plane):  # type: ignore[no-untyped-def]
    n = (cloud.copy.matches >= 0).sum()
    rows = _Matches(
        np.empty((2, n)),
        np.empty((3, n)),
        np.empty((3, n)),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty((3, n)),
        np.empty(n),
    )
    place, row = (math.cos(motion.yaw), math.sin(motion.yaw), motion.x, motion.y, 1 / cloud.lever), _u64(0)
    for i in range(len(cloud.copy.x)):
        if cloud.copy.matches[i] >= 0:
            _fill(_u64(i), row, cloud, target, place, epsilon, in_plane, rows)
            row += _u64(1)
    return rows


@compilation.device
def _fill(i, row, cloud, target, place, epsilon, in_plane, rows):  # type: ignore[no-untyped-def]
    # fills a row of matches with that of point i
    copy, j, n, (cosine, sine, tx, ty, per_lever) = (
        cloud.copy,
        _u64(3) * _u64(cloud.copy.matches[i]),
        _u64(3) * i,
        place,
    )
    px, py = copy.x[i] - cloud.x, copy.y[i] - cloud.y
    rx, ry = cosine * px - sine * py, sine * px + cosine * py
    dx = target.points[j] - (rx + cosine * cloud.x - sine * cloud.y + tx)
    dy = target.points[j + _u64(1)] - (ry + sine * cloud.x + cosine * cloud.y + ty)
    dz = np.float64(target.points[j + _u64(2)]) - copy.z[i]
    ax = cosine * copy.normals[n] - sine * copy.normals[n + _u64(1)]
    ay = sine * copy.normals[n] + cosine * copy.normals[n + _u64(1)]
    az = np.float64(copy.normals[n + _u64(2)])
    bx, by, bz = target.normals[j], target.normals[j + _u64(1)], target.normals[j + _u64(2)]
    c = ax * bx + ay * by + az * bz
    sign = 1.0 if c >= 0 else -1.0  # a normal may have either sign, and a match's two have one
    bx, by, bz, c = sign * bx, sign * by, sign * bz, sign * c
    same, cross = along_normals.factors(c, epsilon)
    along_a, along_b = ax * dx + ay * dy + az * dz, bx * dx + by * dy + bz * dz
    u, v = same * along_a + cross * along_b, cross * along_a + same * along_b
    fx, fy = ax * u + bx * v, ay * u + by * v
    if in_plane:
        fx, fy = fx + 0.5 * dx, fy + 0.5 * dy
    jx, jy = -ry * per_lever, rx * per_lever  # the column of yaw in the Jacobian, Eq. 3
    rows.arms[0, row], rows.arms[1, row] = rx, ry
    rows.a[0, row], rows.a[1, row], rows.a[2, row] = ax, ay, jx * ax + jy * ay
    rows.b[0, row], rows.b[1, row], rows.b[2, row] = bx, by, jx * bx + jy * by
    rows.forces[0, row], rows.forces[1, row], rows.forces[2, row] = fx, fy, jx * fx + jy * fy
    rows.same[row], rows.cross[row], rows.trace[row] = same, cross, 2 * same + 2 * cross * c
    rows.square[row] = along_a * u + along_b * v
