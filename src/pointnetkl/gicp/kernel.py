"""The kernel: GICP with the motion constrained to a translation in x and y.

With C = I - (1 - epsilon) n n^T for both points of a match and no rotation, the weight M = (C_q + C_p)^-1 does not
change while the match stands, so the cost sum d^T M d is quadratic in the translation: one 2 x 2 solve per
re-matching. The sums of that solve are kept, and changed only by the points whose match changes.
"""

import math
from typing import NamedTuple

import numba
import numpy as np

# The compiler may fuse a multiplication with an addition, but not reorder sums: that would cost digits.
_FUSED = {"contract", "nsz"}
_kernel = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FUSED)
_inner = numba.njit(forceinline=True, error_model="numpy", fastmath=_FUSED)


class Surface(NamedTuple):
    """A cloud, or clouds of b each: x, y, z of point after point, (3 n,) float32 or (b, 3 n), and unit normals."""

    points: np.ndarray
    normals: np.ndarray


class Limits(NamedTuple):
    """The settings of a registration; `keep` false searches every match anew at every iteration."""

    epsilon: np.float32
    farthest: np.float32  # metres, of a match
    tolerance: float  # metres
    iterations: int
    keep: bool


class _State(NamedTuple):
    matches: np.ndarray  # (n, 2) int32, nearest and second nearest, -1: none
    deadlines: np.ndarray  # (n,) float32, metres of motion at which the match is to be searched again
    terms: np.ndarray  # (n, 5) float32, a point's part of the sums
    sums: np.ndarray  # (5,) float64: M_xx, M_xy, M_yy, (M d)_x, (M d)_y with d of the unmoved source


@_kernel
def align(sources, target, grid, limits):  # type: ignore[no-untyped-def]
    """Register b clouds (Surface) onto one, sorted by its grid, each from where it is.

    Returns translations (b, 2) in metres, informations (b, 3) as xx, xy, yy in 1/m^2, iterations (b,), whether the
    last step was shorter than the tolerance (b,), and matched points (b,). Without any match: zeros.
    """
    count, n = len(sources.points), sources.points.shape[1] // 3
    translations, informations = np.zeros((count, 2)), np.zeros((count, 3))
    iterations, matched = np.zeros(count, np.int32), np.zeros(count, np.int32)
    converged = np.zeros(count, np.bool_)
    state = _State(
        np.empty((n, 2), np.int32), np.empty(n, np.float32), np.empty((n, 5), np.float32), np.empty(5)
    )  # fmt: skip
    for b in range(count):
        source = Surface(sources.points[b], sources.normals[b])
        state.matches[:], state.deadlines[:], state.terms[:], state.sums[:] = -1, -1, 0, 0
        x = y = path = 0.0
        while iterations[b] < limits.iterations and not converged[b]:
            if not limits.keep:
                state.deadlines[:] = -1
            matched[b] += _rematch(source, target, grid, limits, state, np.float32(x), np.float32(y), np.float32(path))
            if matched[b] == 0:
                x, y, state.sums[:] = 0.0, 0.0, 0.0
                break
            new_x, new_y = _solve(state.sums)
            step = math.hypot(new_x - x, new_y - y)
            x, y, path = new_x, new_y, path + step
            iterations[b] += 1
            converged[b] = step < limits.tolerance
        translations[b] = x, y
        informations[b] = state.sums[:3]
    return translations, informations, iterations, converged, matched


@_inner
def _solve(sums):  # type: ignore[no-untyped-def]
    # M is at least I / 2 for every match, so with any match at all the determinant is positive
    xx, xy, yy, gx, gy = sums
    determinant = xx * yy - xy * xy
    return (yy * gx - xy * gy) / determinant, (xx * gy - xy * gx) / determinant


@_inner
def _rematch(source, target, grid, limits, state, tx, ty, path):  # type: ignore[no-untyped-def]
    # Searches the matches that the motion so far, (tx, ty) along a path of such length, may have changed; returns
    # how many more points are matched. A match stands while the motion since it was found is under half the gap to
    # the second nearest; `margin` keeps that true of rounded numbers.
    margin = np.float32(1e-6) * (grid.cell * np.float32(max(grid.columns, grid.rows)) + limits.farthest)
    farthest = limits.farthest * limits.farthest
    growth, near, other = 0, -1, -1
    for i in range(len(state.matches)):
        if path < state.deadlines[i]:
            continue
        x, y, z = source.points[3 * i] + tx, source.points[3 * i + 1] + ty, source.points[3 * i + 2]
        old_near, old_other = state.matches[i]
        # the two nearest of the point before and of this one's last search are near
        bound = min(farthest, _bound(x, y, z, target.points, near, other, margin))
        bound = min(bound, _bound(x, y, z, target.points, old_near, old_other, margin))
        near, other, first, second = _nearest_two(x, y, z, bound, target.points, grid, margin)
        state.deadlines[i] = path + np.float32(0.5) * (math.sqrt(second) - math.sqrt(first)) - margin
        state.matches[i, 0], state.matches[i, 1] = near, other
        growth += (near >= 0) - (old_near >= 0)
        if near != old_near:
            _exchange(source, i, target, near, limits.epsilon, state.terms, state.sums)
    return growth


@_inner
def _bound(x, y, z, target, near, other, margin):  # type: ignore[no-untyped-def]
    # any two points bound the distance to the second nearest
    if other < 0:
        return np.float32(np.inf)
    known = max(_squared(target, near, x, y, z), _squared(target, other, x, y, z))
    return known * np.float32(1.00001) + margin * margin


@_inner
def _exchange(source, i, target, j, epsilon, terms, sums):  # type: ignore[no-untyped-def]
    for c in range(5):
        sums[c] -= terms[i, c]
        terms[i, c] = 0
    if j >= 0:
        _weigh(source, i, target, j, epsilon, terms)
        for c in range(5):
            sums[c] += terms[i, c]


@_inner
def _squared(target, j, x, y, z):  # type: ignore[no-untyped-def]
    dx, dy, dz = target[3 * j] - x, target[3 * j + 1] - y, target[3 * j + 2] - z
    return dx * dx + dy * dy + dz * dz


@_inner
def _weigh(source, i, target, j, epsilon, terms):  # type: ignore[no-untyped-def]
    # M = (2 I - w (a a^T + b b^T))^-1 by Woodbury: I / 2 + [a b] S [a b]^T with S = [[same, cross], [cross, same]]
    half = np.float32(0.5)
    p, a, q, b = source.points, source.normals, target.points, target.normals
    ax, ay, az, bx, by, bz = a[3 * i], a[3 * i + 1], a[3 * i + 2], b[3 * j], b[3 * j + 1], b[3 * j + 2]
    dx, dy, dz = q[3 * j] - p[3 * i], q[3 * j + 1] - p[3 * i + 1], q[3 * j + 2] - p[3 * i + 2]
    w, m = np.float32(1) - epsilon, np.float32(1) + epsilon
    c = w * (ax * bx + ay * by + az * bz)
    scale = half * w / (m * m - c * c)
    same, cross = m * scale, c * scale
    along_a, along_b = ax * dx + ay * dy + az * dz, bx * dx + by * dy + bz * dz
    u, v = same * along_a + cross * along_b, cross * along_a + same * along_b
    terms[i, 0] = half + same * (ax * ax + bx * bx) + 2 * cross * ax * bx
    terms[i, 1] = same * (ax * ay + bx * by) + cross * (ax * by + ay * bx)
    terms[i, 2] = half + same * (ay * ay + by * by) + 2 * cross * ay * by
    terms[i, 3] = half * dx + ax * u + bx * v
    terms[i, 4] = half * dy + ay * u + by * v


@_inner
def _nearest_two(x, y, z, bound, target, grid, margin):  # type: ignore[no-untyped-def]
    # Returns the two nearest points below the squared distance `bound` (-1: none) and their squared distances.
    inverse = np.float32(1) / grid.cell
    near, other, first, second = -1, -1, bound, bound
    position = (x - grid.x0) * inverse
    own = int(position) - (position < 0)
    for side in range(2):  # own column and those to the right of it, then those to the left
        column = max(own, 0) if side == 0 else min(own, grid.columns) - 1
        while 0 <= column < grid.columns:
            gap = np.float32(0)
            if column != own:
                gap = abs(grid.x0 + np.float32(column + side) * grid.cell - x) - margin
            left = second - gap * abs(gap)
            if not left > 0:
                break
            reach = math.sqrt(left) + margin
            low = max(int((y - reach - grid.y0) * inverse), 0)
            high = min(int((y + reach - grid.y0) * inverse), grid.rows - 1)
            if low <= high:
                start, stop = grid.starts[column * grid.rows + low], grid.starts[column * grid.rows + high + 1]
                for j in range(start, stop):
                    squared = _squared(target, j, x, y, z)
                    if squared < second:
                        if squared < first:
                            near, other, first, second = j, near, squared, first
                        else:
                            other, second = j, squared
            column += 1 - 2 * side
    return near, other, first, second
