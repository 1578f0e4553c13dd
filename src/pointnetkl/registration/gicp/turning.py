"""A step of the registration with yaw: the source's normals turn with it, so M changes at every step."""

import math

import numpy as np

from pointnetkl.registration.gicp import weights
from pointnetkl.registration.gicp.device import device, kernel

_f32, _at = np.float32, np.uint64


@device
def lever(x, y):  # type: ignore[no-untyped-def]
    """Return how far a typical point (x, y) moves when the cloud turns by a radian, metres."""
    total = 0.0
    for i in range(len(x)):
        total += x[i] * x[i] + y[i] * y[i]
    return math.sqrt(total / len(x))


@kernel
def fill_sums(state, target, epsilon, sums, x, y, yaw):  # type: ignore[no-untyped-def]
    """Fill the nine sums of a step, all made anew, of the source moved by (x, y, yaw)."""
    px, py, pz, n = state.points[0], state.points[1], state.points[2], state.normals
    cosine, sine, tx, ty = _f32(math.cos(yaw)), _f32(math.sin(yaw)), _f32(x), _f32(y)
    sums[:] = 0
    for i in range(len(px)):
        if state.matches[i] >= 0:
            rx, ry = cosine * px[i] - sine * py[i], sine * px[i] + cosine * py[i]
            ax, ay = cosine * n[3 * i] - sine * n[3 * i + 1], sine * n[3 * i] + cosine * n[3 * i + 1]
            xx, xy, yy, gx, gy = weights.weigh(
                rx + tx, ry + ty, pz[i], ax, ay, n[3 * i + 2],
                target.points, target.normals, _at(3) * _at(state.matches[i]), epsilon,
            )  # fmt: skip
            # the column of yaw in the Jacobian is (-ry, rx)
            x_yaw, y_yaw = xy * rx - xx * ry, yy * rx - xy * ry
            yaw_yaw, g_yaw = y_yaw * rx - x_yaw * ry, gy * rx - gx * ry
            for term, value in enumerate((xx, xy, yy, gx, gy, x_yaw, y_yaw, yaw_yaw, g_yaw)):
                sums[term] += value


@device
def solve(sums):  # type: ignore[no-untyped-def]
    """Return a step's x, y in metres and yaw in radians of its nine sums."""
    # by Schur: yaw first, then x and y given yaw; a cloud of one place cannot turn
    xx, xy, yy, gx, gy, x_yaw, y_yaw, yaw_yaw, g_yaw = sums
    determinant = xx * yy - xy * xy
    ux, uy = (yy * x_yaw - xy * y_yaw) / determinant, (xx * y_yaw - xy * x_yaw) / determinant
    left = yaw_yaw - ux * x_yaw - uy * y_yaw
    turn = (g_yaw - ux * gx - uy * gy) / left if left > 1e-12 * yaw_yaw else 0.0
    fx, fy = gx - turn * x_yaw, gy - turn * y_yaw
    return (yy * fx - xy * fy) / determinant, (xx * fy - xy * fx) / determinant, turn
