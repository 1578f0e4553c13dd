"""Tables of what moves a copy at an offset: the slopes' force and stiffness, and the pull of nearest points."""

import functools

import numpy as np

from pointnetkl.models.mean_field.settling import Slopes
from pointnetkl.registration.gicp.device import device, kernel

FINE = 6  # cells of the pull's raster to a point's spacing: with 5 copies run through places where they stick
_LANES = 40  # FINE squared, and a little, so that they fill whole vectors
_BLOCK = 32  # floats that a loop takes at once: a row of so many has no rest to be added one by one
_FAR = np.float32(1e9)  # m^2, where there is no point yet
_NUMBERS = len(Slopes._fields)  # in a table of slopes


@functools.partial(kernel, reorder=True)
def slopes(
    raster: np.ndarray, ground: np.ndarray, extended: np.ndarray, reach: int, stride: int, epsilon: float
) -> np.ndarray:
    """Return the sums over points of the residuals along normals, (2 reach + 1, 2 reach + 1, 9): Slopes.

    At an offset of whole strides of cells (row and column from the middle), with `epsilon` the least eigenvalue of the
    two points' summed covariances: along the mean normal it grows by half the square of the normals' difference.
    """
    _, rows, columns = raster.shape
    table = np.zeros((2 * reach + 1, 2 * reach + 1, _NUMBERS), np.float64)
    zero, half, one, least = np.float32(0), np.float32(0.5), np.float32(1), np.float32(epsilon)
    # rows one behind the other: one long loop has no rests, and in the rim there are no points
    rim = reach * stride * (columns + 1)
    size = rows * columns - 2 * rim
    count, own_x, own_y, own_z = (
        raster[0].reshape(-1)[rim : rim + size], ground[0].reshape(-1)[rim : rim + size],
        ground[1].reshape(-1)[rim : rim + size], ground[2].reshape(-1)[rim : rim + size],
    )  # fmt: skip
    other_x, other_y, other_z, others = (
        extended[0].reshape(-1), extended[1].reshape(-1), extended[2].reshape(-1), extended[3].reshape(-1)
    )  # fmt: skip
    for i in range(-reach, reach + 1):
        for j in range(-reach, reach + 1):
            place = rim + stride * (i * columns + j)
            there_x, there_y = other_x[place : place + size], other_y[place : place + size]
            there_z, has_ground = other_z[place : place + size], others[place : place + size]
            fx = fy = xx = xy = yy = noise_xx = noise_xy = noise_yy = points = zero
            for k in range(size):
                n = count[k] * has_ground[k]
                gx, gy = half * (own_x[k] + there_x[k]), half * (own_y[k] + there_y[k])
                dx, dy = own_x[k] - there_x[k], own_y[k] - there_y[k]
                w = one / ((least + half * (dx * dx + dy * dy)) * (one + gx * gx + gy * gy))
                wx, wy = n * w * gx, n * w * gy
                residual = own_z[k] - there_z[k]
                fx, fy = fx + wx * residual, fy + wy * residual
                xx, xy, yy = xx + wx * gx, xy + wx * gy, yy + wy * gy
                noise_xx, noise_xy, noise_yy = noise_xx + w * wx * gx, noise_xy + w * wx * gy, noise_yy + w * wy * gy
                points += n
            entry = table[i + reach, j + reach]
            entry[0], entry[1], entry[2], entry[3], entry[4] = fx, fy, xx, xy, yy
            entry[5], entry[6], entry[7], entry[8] = noise_xx, noise_xy, noise_yy, points
    return table


@kernel
def nearest(xy: np.ndarray, first: np.ndarray, cell: float, shape: tuple[int, int], rings: int) -> np.ndarray:
    """Return the vector to the nearest point from the centre of each fine cell, (rows FINE, columns FINE, 2), metres.

    Points `xy` (2, n) are sorted by cell, as ground.sort does; a cell without any within `rings` cells has zeros.
    """
    rows, columns = shape
    vectors = np.zeros((rows * FINE, columns * FINE, 2), np.float32)
    best, index = np.empty(_LANES, np.float32), np.zeros(_LANES, np.int32)  # squared distances, and of which points
    bits = best.view(np.int32)  # of numbers that are not negative: their order is that of whole numbers
    x, y = np.zeros(_LANES, np.float32), np.zeros(_LANES, np.float32)  # of fine cells' centres
    for k in range(FINE * FINE):
        x[k], y[k] = (k // FINE + 0.5) * cell / FINE, (k % FINE + 0.5) * cell / FINE
    for a in range(rows):
        for b in range(columns):
            if not _any(first, a, b, rings, shape):
                continue
            best[:] = _FAR
            for ring in range(1, rings + 1):
                # the nearest point that a ring can hold lies ring - 1 cells away
                if ring > 1 and _largest(bits) <= np.float32(((ring - 1) * cell) ** 2).view(np.int32):
                    break
                for i in range(max(a - ring, 0), min(a + ring, rows - 1) + 1):
                    for begin, end in _runs(first, i, b, ring, ring == 1 or abs(i - a) == ring, columns):
                        for s in range(begin, end):
                            px, py = np.float32(xy[0, s] - a * cell), np.float32(xy[1, s] - b * cell)
                            _compare(px, py, np.int32(s), x, y, best, index)
            for k in range(FINE * FINE):
                row, column = a * FINE + k // FINE, b * FINE + k % FINE
                vectors[row, column, 0] = np.float32(xy[0, index[k]] - a * cell) - x[k]
                vectors[row, column, 1] = np.float32(xy[1, index[k]] - b * cell) - y[k]
    return vectors


@device  # type: ignore[untyped-decorator]
def _any(first: np.ndarray, a: int, b: int, rings: int, shape: tuple[int, int]) -> bool:
    """Return whether a cell has a point within so many rings."""
    rows, columns = shape
    points, left, right = 0, max(b - rings, 0), min(b + rings, columns - 1)
    for i in range(max(a - rings, 0), min(a + rings, rows - 1) + 1):
        points += first[i * columns + right + 1] - first[i * columns + left]
    return points > 0


@device  # type: ignore[untyped-decorator]
def _largest(numbers: np.ndarray) -> np.int32:
    largest = np.int32(0)
    for k in range(_LANES):
        largest = max(largest, numbers[k])
    return largest


@device  # type: ignore[untyped-decorator]
def _runs(
    first: np.ndarray, i: int, b: int, ring: int, whole: bool, columns: int
) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return the points of row i in a ring about column b, as two runs: all between its sides, or those in them."""
    left, right = max(b - ring, 0), min(b + ring, columns - 1)
    row = i * columns
    west_end = right if whole else left if b - ring >= 0 else left - 1
    east_end = right if not whole and b + ring < columns else right - 1
    return (first[row + left], first[row + west_end + 1]), (first[row + right], first[row + east_end + 1])


@device  # type: ignore[untyped-decorator]
def _compare(
    px: float, py: float, point: int, x: np.ndarray, y: np.ndarray, best: np.ndarray, index: np.ndarray
) -> None:
    """Keep, for each fine cell, the nearest point yet, and the square of its distance."""
    for k in range(_LANES):
        dx, dy = px - x[k], py - y[k]
        square = dx * dx + dy * dy
        nearer = square < best[k]
        best[k] = square if nearer else best[k]
        index[k] = point if nearer else index[k]


@kernel
def pulls(xy: np.ndarray, vectors: np.ndarray, cell: float, reach: int) -> np.ndarray:
    """Return the sum over points (2, n) of the vectors to their nearest points, (2 reach + 1, 2 reach + 1, 2), metres.

    At an offset of whole fine cells (row and column from the middle); `vectors` are those of `nearest`.
    """
    size, step, n = 2 * reach + 1, cell / FINE, xy.shape[1]
    width = -(-2 * size // _BLOCK) * _BLOCK  # of a row of vectors, and then some that are not looked at
    flat, row = vectors.reshape(-1), 2 * vectors.shape[1]
    sums, place, rest = np.zeros((size, width), np.float32), np.empty(n, np.int64), np.zeros(2)
    for i in range(n):
        a, b = int(xy[0, i] / step), int(xy[1, i] / step)
        place[i] = (a - reach) * row + 2 * (b - reach)
        rest[0] += (a + 0.5) * step - xy[0, i]  # from points to the centres of their fine cells
        rest[1] += (b + 0.5) * step - xy[1, i]
    whole = n // 4 * 4
    for u in range(size):
        for i in range(0, whole, 4):
            _add_four(sums[u], flat[u * row :], place[i], place[i + 1], place[i + 2], place[i + 3])
        for i in range(whole, n):
            _add(sums[u], flat[u * row :], place[i])
    table = sums[:, : 2 * size].copy().reshape((size, size, 2))
    return table + rest.astype(np.float32)


@device  # type: ignore[untyped-decorator]
def _add_four(total: np.ndarray, flat: np.ndarray, a: int, b: int, c: int, d: int) -> None:
    """Add four rows, so that the total is read and written once."""
    size = len(total)
    first, second, third, fourth = flat[a : a + size], flat[b : b + size], flat[c : c + size], flat[d : d + size]
    for k in range(size):
        total[k] += (first[k] + second[k]) + (third[k] + fourth[k])


@device  # type: ignore[untyped-decorator]
def _add(total: np.ndarray, flat: np.ndarray, a: int) -> None:
    row = flat[a : a + len(total)]
    for k in range(len(total)):
        total[k] += row[k]
