"""Copies that follow the tabulated forces until they settle, as registrations do."""

import functools
import math
import statistics
from typing import NamedTuple

import numpy as np

from pointnetkl.registration.gicp.device import device, kernel

_DRAWS = 128  # of starts and noise, each turned by quarters: 512 copies
_DIMENSIONS = 6  # start x, y; noise on the slopes' force x, y; noise on the pull x, y
IN_PLANE = 0.5  # of M = (C_q + C_p)^-1 along a plane, where both C are 1


# in this file, and not beside the table: numba finds a kernel in its cache unless the kernel's own file has changed
class Slopes(NamedTuple):
    """What the slopes do to a copy at one offset: sums over its points, in the order of a table of slopes."""

    force_x: float
    force_y: float
    xx: float  # stiffness
    xy: float
    yy: float
    noise_xx: float  # covariance of the force, where the noise in z is 1 m
    noise_xy: float
    noise_yy: float
    points: float  # that lie over the ground


@functools.cache
def draws() -> tuple[np.ndarray, np.ndarray]:
    """Return starts (512, 2) and noises (512, 4), standard normal, spread evenly and the same for every submap.

    By an additive recurrence (Roberts 2018: powers of the root of x^7 = x + 1), so that 512 do for the average of
    many more. Quarter turns make their mean zero and their covariance the same in x and y.
    """
    root = 1.5
    for _ in range(50):
        root = (1 + root) ** (1 / (_DIMENSIONS + 1))
    steps = root ** -np.arange(1.0, _DIMENSIONS + 1)
    uniform = (0.5 + np.arange(1, _DRAWS + 1)[:, None] * steps) % 1
    inverse = statistics.NormalDist().inv_cdf
    normal = np.array([[inverse(min(max(u, 1e-3), 1 - 1e-3)) for u in row] for row in uniform])
    pairs = normal.reshape(-1, 3, 2)
    turned = np.concatenate([pairs @ np.linalg.matrix_power(np.array([[0.0, 1], [-1, 0]]), k) for k in range(4)])
    return turned[:, 0].copy(), turned[:, 1:].reshape(-1, 4).copy()


@kernel
def settle(
    slopes: np.ndarray,
    cell: float,
    pulls: np.ndarray,
    step: float,
    starts: np.ndarray,
    noises: np.ndarray,
    sigma: float,
    tolerance: float,
    iterations: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Return where copies end (n, 2), metres, and after how many iterations (n,).

    `slopes` and `pulls` are the tables of `forces`, their offsets `cell` and `step` metres apart; a copy beyond them
    meets what stands at their border. `sigma` is the noise of each coordinate of a point.
    """
    ends = np.empty((len(starts), 2))
    taken = np.zeros(len(starts), np.int32)
    for k in range(len(starts)):
        x, y = starts[k, 0], starts[k, 1]
        for i in range(iterations):
            forces = _slopes(slopes, x / cell, y / cell)
            px, py = _pull(pulls, x / step, y / step)
            ux, uy = _newton(forces, px, py, noises[k], sigma)
            x, y = x + ux, y + uy
            taken[k] = i + 1
            if ux * ux + uy * uy < tolerance * tolerance:
                break
        ends[k, 0], ends[k, 1] = x, y
    return ends, taken


@device  # type: ignore[untyped-decorator]
def _place(offset: float, size: int) -> tuple[int, float]:
    """Return the entry below an offset of a table, whose middle is offset 0, and how far above it lies."""
    clipped = min(max(offset + (size - 1) / 2, 0.0), size - 1 - 1e-6)
    return int(clipped), clipped - int(clipped)


@device  # type: ignore[untyped-decorator]
def _slopes(table: np.ndarray, u: float, v: float) -> Slopes:
    """Return what a table of slopes has at an offset, between its entries."""
    i, p = _place(u, table.shape[0])
    j, q = _place(v, table.shape[1])
    left, right = table[i, j : j + 2], table[i + 1, j : j + 2]
    return Slopes(
        _between(left, right, p, q, 0), _between(left, right, p, q, 1), _between(left, right, p, q, 2),
        _between(left, right, p, q, 3), _between(left, right, p, q, 4), _between(left, right, p, q, 5),
        _between(left, right, p, q, 6), _between(left, right, p, q, 7), _between(left, right, p, q, 8),
    )  # fmt: skip


@device  # type: ignore[untyped-decorator]
def _between(left: np.ndarray, right: np.ndarray, p: float, q: float, k: int) -> float:
    """Return number k between the entries of two columns of a table, each of two entries."""
    below = (1 - p) * left[0, k] + p * right[0, k]
    return (1 - q) * below + q * ((1 - p) * left[1, k] + p * right[1, k])


@device  # type: ignore[untyped-decorator]
def _pull(table: np.ndarray, u: float, v: float) -> tuple[float, float]:
    """Return what a table of pulls has at an offset, between its entries."""
    i, p = _place(u, table.shape[0])
    j, q = _place(v, table.shape[1])
    a, b, c, d = (1 - p) * (1 - q), p * (1 - q), (1 - p) * q, p * q
    x = a * table[i, j, 0] + b * table[i + 1, j, 0] + c * table[i, j + 1, 0] + d * table[i + 1, j + 1, 0]
    y = a * table[i, j, 1] + b * table[i + 1, j, 1] + c * table[i, j + 1, 1] + d * table[i + 1, j + 1, 1]
    # beyond the table a pull that points outwards, as points on a lattice have, would never end
    reach = (table.shape[0] - 1) / 2
    return 0.0 if abs(u) > reach and x * u > 0 else x, 0.0 if abs(v) > reach and y * v > 0 else y


@device  # type: ignore[untyped-decorator]
def _newton(slopes: Slopes, px: float, py: float, noise: np.ndarray, sigma: float) -> tuple[float, float]:
    """Return the step that makes the forces at one place zero: one 2x2 solve, as a registration's."""
    n = slopes.points
    # a square root of what noise in z does to the slopes' force, by Cholesky
    a = math.sqrt(slopes.noise_xx + 1e-300)
    b = slopes.noise_xy / a
    c = math.sqrt(max(slopes.noise_yy - b * b, 0.0))
    flat = IN_PLANE * math.sqrt(n)
    fx = slopes.force_x + IN_PLANE * px + sigma * (a * noise[0] + flat * noise[2])
    fy = slopes.force_y + IN_PLANE * py + sigma * (b * noise[0] + c * noise[1] + flat * noise[3])
    xx, xy, yy = slopes.xx + IN_PLANE * n, slopes.xy, slopes.yy + IN_PLANE * n
    determinant = xx * yy - xy * xy
    return (yy * fx - xy * fy) / determinant, (xx * fy - xy * fx) / determinant
