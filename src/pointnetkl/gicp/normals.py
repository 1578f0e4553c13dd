"""Normals of a cloud from its points' neighbours, for one cloud or many noisy copies of it."""

import math

import numba
import numpy as np

_FUSED = {"contract", "nsz"}
_jit = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FUSED)


def of_cloud(points: np.ndarray, lists: np.ndarray) -> np.ndarray:
    """Return unit normals (n, 3) float32, upwards, of points (n, 3) float32 with neighbours (n, k) int32."""
    return np.asarray(of_copies(points[None], lists)[0])


@_jit
def of_copies(copies, lists):  # type: ignore[no-untyped-def]
    """Return unit normals (b, n, 3) float32 of b copies (b, n, 3) float32 that share their neighbours (n, k).

    A normal is the eigenvector of the smallest eigenvalue of the neighbours' scatter, turned upwards; where the
    scatter says nothing (all the neighbours in one place) it is vertical.
    """
    normals = np.empty_like(copies)
    for b in range(copies.shape[0]):
        for i in range(copies.shape[1]):
            normals[b, i] = _smallest_eigenvector(*_scatter(copies[b], lists[i]))
    return normals


@_jit
def _scatter(points, neighbours):  # type: ignore[no-untyped-def]
    # relative to one of them, because the squares of coordinates would not fit in float32
    origin = points[neighbours[0]]
    x = y = z = xx = xy = xz = yy = yz = zz = np.float32(0)
    for j in neighbours:
        dx, dy, dz = points[j, 0] - origin[0], points[j, 1] - origin[1], points[j, 2] - origin[2]
        x += dx
        y += dy
        z += dz
        xx += dx * dx
        xy += dx * dy
        xz += dx * dz
        yy += dy * dy
        yz += dy * dz
        zz += dz * dz
    k = 1.0 / len(neighbours)
    x, y, z = x * k, y * k, z * k
    return xx * k - x * x, xy * k - x * y, xz * k - x * z, yy * k - y * y, yz * k - y * z, zz * k - z * z


@_jit
def _smallest_eigenvector(xx, xy, xz, yy, yz, zz):  # type: ignore[no-untyped-def]
    value = _smallest_eigenvalue(xx, xy, xz, yy, yz, zz)
    a, b, c = xx - value, yy - value, zz - value
    # the columns of the adjugate of (scatter - value I) are all along the eigenvector: take the longest
    ux, uy, uz = b * c - yz * yz, yz * xz - xy * c, xy * yz - b * xz
    vx, vy, vz = uy, a * c - xz * xz, xz * xy - a * yz
    wx, wy, wz = uz, vz, a * b - xy * xy
    uu, vv, ww = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, wx * wx + wy * wy + wz * wz
    if ww < uu or ww < vv:
        if uu > vv:
            wx, wy, wz, ww = ux, uy, uz, uu
        else:
            wx, wy, wz, ww = vx, vy, vz, vv
    if not ww > 0:
        return np.float32(0), np.float32(0), np.float32(1)
    scale = math.copysign(1 / math.sqrt(ww), wz)
    return np.float32(wx * scale), np.float32(wy * scale), np.float32(wz * scale)


@_jit
def _smallest_eigenvalue(xx, xy, xz, yy, yz, zz):  # type: ignore[no-untyped-def]
    # Newton from zero on the characteristic polynomial: its roots are real and not negative, so every step stays
    # below the smallest root and comes closer
    trace = xx + yy + zz
    minors = xx * yy - xy * xy + xx * zz - xz * xz + yy * zz - yz * yz
    determinant = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    value = 0.0
    for _ in range(50):
        slope = minors + value * (3 * value - 2 * trace)
        if not slope > 0:
            break
        step = (determinant + value * (value * (trace - value) - minors)) / slope
        value += step
        if not step > 1e-7 * value:
            break
    return value
