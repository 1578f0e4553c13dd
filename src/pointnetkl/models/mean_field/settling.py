"""Copies that run down the tabulated forces until they settle, as registrations do."""

import functools
import math
import statistics

import numpy as np

from pointnetkl.registration.gicp.device import device, kernel

_DRAWS = 128  # of starts and noise, each turned by quarters: 512 copies
_DIMENSIONS = 6  # start x, y; noise on the slopes' force x, y; noise on the pull x, y
IN_PLANE = 0.5  # of M = (C_q + C_p)^-1 along a plane, where both C are 1


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
    at = np.empty(slopes.shape[2])
    for k in range(len(starts)):
        x, y = starts[k, 0], starts[k, 1]
        for i in range(iterations):
            _look_up(slopes, x / cell, y / cell, at)
            px, py = _pull(pulls, x / step, y / step)
            ux, uy = _newton(at, px, py, noises[k], sigma)
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
def _look_up(table: np.ndarray, u: float, v: float, at: np.ndarray) -> None:
    """Write what a table of slopes has at an offset, between its entries, to `at`, (NUMBERS,)."""
    i, p = _place(u, table.shape[0])
    j, q = _place(v, table.shape[1])
    for k in range(table.shape[2]):
        below = (1 - p) * table[i, j, k] + p * table[i + 1, j, k]
        at[k] = (1 - q) * below + q * ((1 - p) * table[i, j + 1, k] + p * table[i + 1, j + 1, k])


@device  # type: ignore[untyped-decorator]
def _pull(table: np.ndarray, u: float, v: float) -> tuple[float, float]:
    """Return what a table of pulls has at an offset, between its entries."""
    i, p = _place(u, table.shape[0])
    j, q = _place(v, table.shape[1])
    a, b, c, d = (1 - p) * (1 - q), p * (1 - q), (1 - p) * q, p * q
    x = a * table[i, j, 0] + b * table[i + 1, j, 0] + c * table[i, j + 1, 0] + d * table[i + 1, j + 1, 0]
    y = a * table[i, j, 1] + b * table[i + 1, j, 1] + c * table[i, j + 1, 1] + d * table[i + 1, j + 1, 1]
    # beyond the table nothing is known, and what pulls farther out there would do so for ever: points on a lattice do
    reach = (table.shape[0] - 1) / 2
    return 0.0 if abs(u) > reach and x * u > 0 else x, 0.0 if abs(v) > reach and y * v > 0 else y


@device  # type: ignore[untyped-decorator]
def _newton(at: np.ndarray, px: float, py: float, noise: np.ndarray, sigma: float) -> tuple[float, float]:
    """Return the step that makes the forces at one place zero: one 2x2 solve, as a registration's."""
    n = at[8]
    # a square root of what noise in z does to the slopes' force, by Cholesky
    a = math.sqrt(at[5] + 1e-300)
    b = at[6] / a
    c = math.sqrt(max(at[7] - b * b, 0.0))
    flat = IN_PLANE * math.sqrt(n)
    fx = at[0] + IN_PLANE * px + sigma * (a * noise[0] + flat * noise[2])
    fy = at[1] + IN_PLANE * py + sigma * (b * noise[0] + c * noise[1] + flat * noise[3])
    xx, xy, yy = at[2] + IN_PLANE * n, at[3], at[4] + IN_PLANE * n
    determinant = xx * yy - xy * xy
    return (yy * fx - xy * fy) / determinant, (xx * fy - xy * fx) / determinant
