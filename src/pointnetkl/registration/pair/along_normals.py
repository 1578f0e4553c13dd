"""The weight of a match along its normals, M_n of docs/closures.md, and what a cloud's matches add up to."""

import math

import numpy as np

from pointnetkl.registration.pair.compilation import device, kernel

_f32, _u64 = np.float32, np.uint64


@device
def weigh(px, py, pz, ax, ay, az, points, normals, j, epsilon):  # type: ignore[no-untyped-def]
    """Return (M_n)_xx, (M_n)_xy, (M_n)_yy, (M_n d)_x, (M_n d)_y and d^T M_n d of a point and its match.

    The arguments are those of gicp.weights.weigh, and M_n is its M without I / 2 (Eq. 2), added up without it: on flat
    ground the rest is a millionth of it, which float32 would lose.
    """
    bx, by, bz = normals[j], normals[j + _u64(1)], normals[j + _u64(2)]
    dx, dy, dz = points[j] - px, points[j + _u64(1)] - py, points[j + _u64(2)] - pz
    same, cross = factors(ax * bx + ay * by + az * bz, epsilon)
    along_a, along_b = ax * dx + ay * dy + az * dz, bx * dx + by * dy + bz * dz
    u, v = same * along_a + cross * along_b, cross * along_a + same * along_b
    xx = same * (ax * ax + bx * bx) + (cross + cross) * ax * bx
    xy = same * (ax * ay + bx * by) + cross * (ax * by + ay * bx)
    yy = same * (ay * ay + by * by) + (cross + cross) * ay * by
    return xx, xy, yy, ax * u + bx * v, ay * u + by * v, along_a * u + along_b * v


@device
def factors(cosine, epsilon):  # type: ignore[no-untyped-def]
    """Return the two factors of M_n = same (a a^T + b b^T) + cross (a b^T + b a^T), by the normals' cosine: Eq. 2."""
    w, m = _f32(1) - epsilon, _f32(1) + epsilon
    c = w * cosine
    scale = _f32(0.5) * w / (m * m - c * c)
    return m * scale, c * scale


@kernel
def sums_with_yaw(cloud, target, motion, epsilon):  # type: ignore[no-untyped-def]
    """Return the ten sums of a kernel.Cloud's matches at a place, with yaw about the centroid, in metres of its lever.

    They are H_xx, H_xy, H_yy, f_x, f_y, H_x,yaw, H_y,yaw, H_yaw,yaw, f_yaw and d^T M_n d.
    """
    copy, sums = cloud.copy, np.zeros(10)
    cosine, sine = _f32(math.cos(motion.yaw)), _f32(math.sin(motion.yaw))
    x, y, inverse = _f32(cloud.x), _f32(cloud.y), _f32(1 / cloud.lever)
    tx, ty = _f32(motion.x) + cosine * x - sine * y, _f32(motion.y) + sine * x + cosine * y
    for i in range(len(copy.x)):
        if copy.matches[i] >= 0:
            px, py, ax, ay = copy.x[i] - x, copy.y[i] - y, copy.normals[3 * i], copy.normals[3 * i + 1]
            rx, ry = cosine * px - sine * py, sine * px + cosine * py
            xx, xy, yy, fx, fy, square = weigh(
                rx + tx, ry + ty, copy.z[i], cosine * ax - sine * ay, sine * ax + cosine * ay, copy.normals[3 * i + 2],
                target.points, target.normals, _u64(3) * _u64(copy.matches[i]), epsilon,
            )  # fmt: skip
            # the column of yaw in the Jacobian, Eq. 3
            jx, jy = -ry * inverse, rx * inverse
            x_yaw, y_yaw = xx * jx + xy * jy, xy * jx + yy * jy
            yaw_yaw, f_yaw = x_yaw * jx + y_yaw * jy, fx * jx + fy * jy
            for term, value in enumerate((xx, xy, yy, fx, fy, x_yaw, y_yaw, yaw_yaw, f_yaw, square)):
                sums[term] += value
    return sums
