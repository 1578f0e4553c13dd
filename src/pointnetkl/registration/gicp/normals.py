"""Normals of a cloud, from the scatter of each point's neighbours; and of noisy copies, from what noise adds to it."""

import math

import numpy as np

from pointnetkl.registration.gicp.device import device, kernel

_f32, _u64 = np.float32, np.uint64  # an index without a sign needs no check for one
_NINE = 9  # numbers of a neighbourhood: three of a mean, six of a scatter
ROW = 16  # floats from one point's nine to the next one's: a cache line
LANES = 16  # points of a block: what one instruction handles
_NEWTON_STEPS = 8


def neighbourhoods(points: np.ndarray, lists: np.ndarray) -> np.ndarray:
    """Return the mean and scatter of each point's neighbours, (blocks, 9, 16) float32, a block for 16 points.

    Points are (n, 3) in metres; `lists` are the neighbours (n, k), or (m, k) of m of the points. The nine numbers are
    x, y, z of the mean, and xx, xy, xz, yy, yz, zz of the scatter, a sum over the neighbours in m^2. The last block is
    filled up with zeros.
    """
    near = np.asarray(points, np.float64)[lists]
    mean = near.mean(axis=1)
    x, y, z = np.moveaxis(near - mean[:, None], 2, 0)
    products = [(a * b).sum(axis=1) for a, b in ((x, x), (x, y), (x, z), (y, y), (y, z), (z, z))]
    table = np.zeros((-(-len(lists) // LANES) * LANES, _NINE), np.float32)
    table[: len(lists)] = np.column_stack([mean, *products])
    return np.ascontiguousarray(table.reshape(-1, LANES, _NINE).transpose(0, 2, 1))


def from_neighbourhoods(clean: np.ndarray, count: int) -> np.ndarray:
    """Return unit normals (count, 3) float32, upwards, of the first points of neighbourhoods (blocks, 9, 16)."""
    normals = np.empty(clean.size // _NINE * 3, np.float32)
    _finish(clean.reshape(-1), np.zeros(clean.size, np.float32), _f32(1), normals)
    return normals.reshape(-1, 3)[:count]


@kernel
def fill_normals(points, noise, clean, lists, rows, sums, normals):  # type: ignore[no-untyped-def]
    """Fill the normals of a copy of points (3, n) by noise (3, n), flat, from the clean cloud's neighbourhoods.

    With p + e for p the scatter of k neighbours grows by sum(p e^T + e p^T + e e^T) - m s^T - s m^T - s s^T / k, where
    m is their mean and s the sum of their noise. A point's terms of these sums are computed once, in `rows`; `rows`
    (16 n,) and `sums`, as long as `clean`, are room to work in.
    """
    _fill_rows(points[0], points[1], points[2], noise[0], noise[1], noise[2], rows)
    _add_rows(rows, lists, sums)
    _finish(clean, sums, _f32(1.0 / lists.shape[1]), normals)


@kernel
def _fill_rows(x, y, z, ex, ey, ez, rows):  # type: ignore[no-untyped-def]
    for i in range(len(x)):
        r = _u64(ROW * i)
        rows[r], rows[r + _u64(1)], rows[r + _u64(2)] = ex[i], ey[i], ez[i]
        xx, xy, xz, yy, yz, zz = growth(x[i], y[i], z[i], ex[i], ey[i], ez[i])
        rows[r + _u64(3)], rows[r + _u64(4)], rows[r + _u64(5)] = xx, xy, xz
        rows[r + _u64(6)], rows[r + _u64(7)], rows[r + _u64(8)] = yy, yz, zz


@device
def growth(x, y, z, ex, ey, ez):  # type: ignore[no-untyped-def]
    """Return what noise (ex, ey, ez) at a point adds to a sum of products: p e^T + e p^T + e e^T, six numbers."""
    xx, yy, zz = (x + x + ex) * ex, (y + y + ey) * ey, (z + z + ez) * ez
    return xx, x * ey + y * ex + ex * ey, x * ez + z * ex + ex * ez, yy, y * ez + z * ey + ey * ez, zz


@kernel
def _add_rows(rows, lists, sums):  # type: ignore[no-untyped-def]
    n, k = lists.shape
    for i in range(n):
        a = b = c = d = e = f = g = h = last = _f32(0)
        for j in range(k):
            r = _u64(ROW) * _u64(lists[_u64(i), _u64(j)])
            a += rows[r]
            b += rows[r + _u64(1)]
            c += rows[r + _u64(2)]
            d += rows[r + _u64(3)]
            e += rows[r + _u64(4)]
            f += rows[r + _u64(5)]
            g += rows[r + _u64(6)]
            h += rows[r + _u64(7)]
            last += rows[r + _u64(8)]
        s = _u64((i // LANES * _NINE) * LANES + i % LANES)
        sums[s], sums[s + _u64(LANES)], sums[s + _u64(2 * LANES)] = a, b, c
        sums[s + _u64(3 * LANES)], sums[s + _u64(4 * LANES)], sums[s + _u64(5 * LANES)] = d, e, f
        sums[s + _u64(6 * LANES)], sums[s + _u64(7 * LANES)], sums[s + _u64(8 * LANES)] = g, h, last


@kernel
def _finish(clean, sums, share, normals):  # type: ignore[no-untyped-def]
    for block in range(len(clean) // (_NINE * LANES)):
        for lane in range(LANES):
            i = _u64(block * _NINE * LANES + lane)
            o = _u64(3 * (block * LANES + lane))
            mx, my, mz = clean[i], clean[i + _u64(LANES)], clean[i + _u64(2 * LANES)]
            sx, sy, sz = sums[i], sums[i + _u64(LANES)], sums[i + _u64(2 * LANES)]
            tx, ty, tz = mx + share * sx, my + share * sy, mz + share * sz
            normals[o], normals[o + _u64(1)], normals[o + _u64(2)] = normal(
                clean[i + _u64(3 * LANES)] + sums[i + _u64(3 * LANES)] - mx * sx - tx * sx,
                clean[i + _u64(4 * LANES)] + sums[i + _u64(4 * LANES)] - my * sx - tx * sy,
                clean[i + _u64(5 * LANES)] + sums[i + _u64(5 * LANES)] - mz * sx - tx * sz,
                clean[i + _u64(6 * LANES)] + sums[i + _u64(6 * LANES)] - my * sy - ty * sy,
                clean[i + _u64(7 * LANES)] + sums[i + _u64(7 * LANES)] - mz * sy - ty * sz,
                clean[i + _u64(8 * LANES)] + sums[i + _u64(8 * LANES)] - mz * sz - tz * sz,
            )


@device
def normal(xx, xy, xz, yy, yz, zz):  # type: ignore[no-untyped-def]
    """Return the unit eigenvector, upwards, of a scatter's smallest eigenvalue; vertical where all points are one."""
    trace = xx + yy + zz
    scale = _f32(1) / trace if trace > 0 else _f32(0)  # so that no product under- or overflows
    xx, xy, xz, yy, yz, zz = xx * scale, xy * scale, xz * scale, yy * scale, yz * scale, zz * scale
    value = _smallest_eigenvalue(xx, xy, xz, yy, yz, zz)
    a, b, c = xx - value, yy - value, zz - value
    # the columns of the adjugate of (scatter - value I) are all along the eigenvector: take the longest
    ux, uy, uz = b * c - yz * yz, yz * xz - xy * c, xy * yz - b * xz
    vx, vy, vz = uy, a * c - xz * xz, xz * xy - a * yz
    wx, wy, wz = uz, vz, a * b - xy * xy
    uu, vv, ww = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, wx * wx + wy * wy + wz * wz
    take_u = (uu > vv) & (uu > ww)
    take_v = (vv > ww) & (not take_u)
    x = ux if take_u else (vx if take_v else wx)
    y = uy if take_u else (vy if take_v else wy)
    z = uz if take_u else (vz if take_v else wz)
    square = x * x + y * y + z * z
    has_length = square > _f32(1e-30)
    length = _f32(1) / math.sqrt(square) if has_length else _f32(0)
    length = -length if z < 0 else length
    return x * length, y * length, (z * length if has_length else _f32(1))


@device
def _smallest_eigenvalue(xx, xy, xz, yy, yz, zz):  # type: ignore[no-untyped-def]
    # Newton from zero on the characteristic polynomial of a scatter of trace 1: its roots are real and not negative,
    # so every step stays below the smallest root and comes closer
    minors = xx * yy - xy * xy + xx * zz - xz * xz + yy * zz - yz * yz
    determinant = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    value = _f32(0)
    for _ in range(_NEWTON_STEPS):
        slope = minors + value * (_f32(3) * value - _f32(2))
        residual = determinant + value * (value * (_f32(1) - value) - minors)
        value += residual / slope if slope > _f32(1e-20) else _f32(0)
    return value
