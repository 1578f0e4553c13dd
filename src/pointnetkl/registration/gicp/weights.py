"""The weight of a match, its terms in the sums of a step, and the step in x and y from these sums."""

import numpy as np

from pointnetkl.registration.gicp.device import device

_f32, _u64 = np.float32, np.uint64
TERMS = 5  # numbers of a match in the sums


@device
def weigh(px, py, pz, ax, ay, az, points, normals, j, epsilon):  # type: ignore[no-untyped-def]
    """Return M_xx, M_xy, M_yy, (M d)_x, (M d)_y of a point, its normal and its match at j, 3 times its number.

    d is from the point to its match, of points (3 n,) and normals (3 n,).
    M = (2 I - w (a a^T + b b^T))^-1 with w = 1 - epsilon, by Woodbury: I / 2 + [a b] S [a b]^T with
    S = [[same, cross], [cross, same]].
    """
    half = _f32(0.5)
    bx, by, bz = normals[j], normals[j + _u64(1)], normals[j + _u64(2)]
    dx, dy, dz = points[j] - px, points[j + _u64(1)] - py, points[j + _u64(2)] - pz
    w, m = _f32(1) - epsilon, _f32(1) + epsilon
    c = w * (ax * bx + ay * by + az * bz)
    scale = half * w / (m * m - c * c)
    same, cross = m * scale, c * scale
    along_a, along_b = ax * dx + ay * dy + az * dz, bx * dx + by * dy + bz * dz
    u, v = same * along_a + cross * along_b, cross * along_a + same * along_b
    xx = half + same * (ax * ax + bx * bx) + (cross + cross) * ax * bx
    xy = same * (ax * ay + bx * by) + cross * (ax * by + ay * bx)
    yy = half + same * (ay * ay + by * by) + (cross + cross) * ay * by
    return _f32(xx), _f32(xy), _f32(yy), half * dx + ax * u + bx * v, half * dy + ay * u + by * v


@device
def solve(sums):  # type: ignore[no-untyped-def]
    """Return the translation (x, y), metres, of sums as `weigh` returns them."""
    # M is at least I / 2 for every match, so with any match at all the determinant is positive
    xx, xy, yy, gx, gy = sums[0], sums[1], sums[2], sums[3], sums[4]
    determinant = xx * yy - xy * xy
    return (yy * gx - xy * gy) / determinant, (xx * gy - xy * gx) / determinant
