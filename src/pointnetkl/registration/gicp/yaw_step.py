"""A step of the registration with yaw. The source's normals turn with it, so every M changes at every step."""

import math

import numpy as np

from pointnetkl.registration.gicp import weights
from pointnetkl.registration.gicp.device import device, kernel

_f32, _u64 = np.float32, np.uint64


@device
def lever(x, y):  # type: ignore[no-untyped-def]
    """Return the metres that a typical point (x, y) moves when the cloud turns by a radian (root mean square)."""
    total = 0.0
    for i in range(len(x)):
        total += x[i] * x[i] + y[i] * y[i]
    return math.sqrt(total / len(x))


@kernel
def fill_sums(copy, target, motion, epsilon, sums):  # type: ignore[no-untyped-def]
    """Fill the nine sums of a step, all computed anew, of a kernel's Copy after its Motion."""
    px, py, pz, n, matches = copy.x, copy.y, copy.z, copy.normals, copy.matches
    cosine, sine, tx, ty = _f32(math.cos(motion.yaw)), _f32(math.sin(motion.yaw)), _f32(motion.x), _f32(motion.y)
    sums[:] = 0
    for i in range(len(px)):
        if matches[i] >= 0:
            rx, ry = cosine * px[i] - sine * py[i], sine * px[i] + cosine * py[i]
            ax, ay = cosine * n[3 * i] - sine * n[3 * i + 1], sine * n[3 * i] + cosine * n[3 * i + 1]
            xx, xy, yy, gx, gy = weights.weigh(
                rx + tx, ry + ty, pz[i], ax, ay, n[3 * i + 2],
                target.points, target.normals, _u64(3) * _u64(matches[i]), epsilon,
            )  # fmt: skip
            # the column of yaw in the Jacobian is (-ry, rx)
            x_yaw, y_yaw = xy * rx - xx * ry, yy * rx - xy * ry
            yaw_yaw, g_yaw = y_yaw * rx - x_yaw * ry, gy * rx - gx * ry
            for term, value in enumerate((xx, xy, yy, gx, gy, x_yaw, y_yaw, yaw_yaw, g_yaw)):
                sums[term] += value


@device
def solve(sums):  # type: ignore[no-untyped-def]
    """Return a step's x, y in metres and yaw in radians of its nine sums."""
    # by the Schur complement: yaw first, then x and y given yaw; a cloud of a single place cannot turn
    xx, xy, yy, gx, gy, x_yaw, y_yaw, yaw_yaw, g_yaw = sums
    determinant = xx * yy - xy * xy
    ux, uy = (yy * x_yaw - xy * y_yaw) / determinant, (xx * y_yaw - xy * x_yaw) / determinant
    schur = yaw_yaw - ux * x_yaw - uy * y_yaw
    turn = (g_yaw - ux * gx - uy * gy) / schur if schur > 1e-12 * yaw_yaw else 0.0
    fx, fy = gx - turn * x_yaw, gy - turn * y_yaw
    return (yy * fx - xy * fy) / determinant, (xx * fy - xy * fx) / determinant, turn
