"""The ground of a submap on a raster as fine as its points: heights, slopes, and both continued past its border."""

import math

import numpy as np

from pointnetkl.registration.gicp.device import device, kernel

FEWEST = 6  # points that a plane is fitted to
MOST_CELLS = 2**19  # of a raster: 2 km by 2 km at 3 m
_TURNS = 3  # of the search for the spacing, which then changes by less than 1 %
_FAR = 1 << 14  # cells, where there is no nearest cell: its square is still an int32
# The sums over a plane's points are of w p q, p and q each one of 1, x, y, z. These are the pairs (p, q).
_PAIRS = ((0, 0), (0, 1), (0, 2), (0, 3), (1, 1), (1, 2), (2, 2), (1, 3), (2, 3))


@kernel
def spacing(points: np.ndarray) -> float:
    """Return the side in metres of the square that a point has to itself on the ground that points (n, 3) cover."""
    n = len(points)
    x0, y0 = points[:, 0].min(), points[:, 1].min()
    x1, y1 = points[:, 0].max(), points[:, 1].max()
    # on a line there is no area
    side = max(math.sqrt((x1 - x0) * (y1 - y0) / n), (x1 - x0 + y1 - y0) / n, 1e-6)
    for _ in range(_TURNS):
        cell = 2 * side
        if ((x1 - x0) / cell + 1) * ((y1 - y0) / cell + 1) > MOST_CELLS:
            break  # outliers spread the points too far for a raster
        covered = np.zeros((int((x1 - x0) / cell) + 1, int((y1 - y0) / cell) + 1), np.bool_)
        for i in range(n):
            covered[int((points[i, 0] - x0) / cell), int((points[i, 1] - y0) / cell)] = True
        side = math.sqrt(covered.sum() * cell * cell / n)
    return side


@kernel
def fill(points: np.ndarray, cell: float, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return the raster (4, rows, columns) of points (n, 3), x and y above 0, and where each cell's points begin.

    The raster holds counts, and the means of a cell's points: x and y from its centre, z. In points sorted by cell, as
    `sort` does, those of cell k are first[k] to first[k + 1], first being (rows columns + 1,).
    """
    rows, columns = shape
    raster = np.zeros((4, rows, columns), np.float32)
    first = np.zeros(rows * columns + 1, np.int64)
    for i in range(len(points)):
        a, b = int(points[i, 0] / cell), int(points[i, 1] / cell)
        raster[0, a, b] += 1
        raster[1, a, b] += points[i, 0] - (a + 0.5) * cell
        raster[2, a, b] += points[i, 1] - (b + 0.5) * cell
        raster[3, a, b] += points[i, 2]
        first[a * columns + b + 1] += 1
    for k in range(rows * columns):
        first[k + 1] += first[k]
    for a in range(rows):
        for b in range(columns):
            for k in range(1, 4):
                raster[k, a, b] /= max(raster[0, a, b], np.float32(1))
    return raster, first


@kernel
def sort(points: np.ndarray, cell: float, first: np.ndarray, columns: int) -> np.ndarray:
    """Return x and y (2, n) float32 of points (n, 3), by cell, whose points begin at `first`."""
    ordered = np.empty((2, len(points)), np.float32)
    place = first.copy()
    for i in range(len(points)):
        k = int(points[i, 0] / cell) * columns + int(points[i, 1] / cell)
        ordered[0, place[k]] = points[i, 0]
        ordered[1, place[k]] = points[i, 1]
        place[k] += 1
    return ordered


@kernel
def planes(raster: np.ndarray, cell: float, radius: float) -> np.ndarray:
    """Return slopes in x and y, the height at the cell's centre, and whether they are known, (4, rows, columns).

    By least squares over the points within `radius` cells: the plane that GICP takes from a point's neighbours. A
    cell's height is that of its own points, brought to its centre; without any it is the plane's.
    """
    _, rows, columns = raster.shape
    reach = int(radius)
    # rows one behind the other, so that a shift is one number; cells in the rim alone see another row's end
    rim = reach * (columns + 1)
    size = rows * columns - 2 * rim
    values = raster.copy().reshape(4, -1)
    values[0] = 0
    sums, shift = np.zeros((len(_PAIRS), size), np.float32), np.array([1, 0, 0, 0], np.float32)
    for i in range(-reach, reach + 1):
        width = int(math.sqrt(radius * radius - i * i))
        for j in range(-width, width + 1):
            place = rim + i * columns + j
            shift[1], shift[2] = i * cell, j * cell
            for k, (p, q) in enumerate(_PAIRS):
                _add(sums[k], raster[0].reshape(-1)[place:], values[p, place:], shift[p], values[q, place:], shift[q])
    result = np.zeros((4, rows, columns), np.float32)
    _solve(sums, raster.reshape(4, -1)[:, rim:], np.float32(1e-3 * cell**4), result.reshape(4, -1)[:, rim:])
    return result


# One array is written and few are read: the compiler then sees that none overlaps another, and adds side by side.
@kernel
def _add(total: np.ndarray, w: np.ndarray, u: np.ndarray, du: float, v: np.ndarray, dv: float) -> None:
    """Add w (u + du) (v + dv) to every cell's total."""
    for k in range(len(total)):
        total[k] += w[k] * (u[k] + du) * (v[k] + dv)


@kernel
def _solve(sums: np.ndarray, raster: np.ndarray, least: float, result: np.ndarray) -> None:
    """Write the planes of cells with enough points, not on a line: their spread's determinant is above `least`."""
    for b in range(sums.shape[1]):
        if sums[0, b] < FEWEST:
            continue
        n = np.float32(1) / sums[0, b]
        x, y, z = sums[1, b] * n, sums[2, b] * n, sums[3, b] * n
        xx, xy, yy = sums[4, b] * n - x * x, sums[5, b] * n - x * y, sums[6, b] * n - y * y
        xz, yz = sums[7, b] * n - x * z, sums[8, b] * n - y * z
        determinant = xx * yy - xy * xy
        if determinant <= least:
            continue
        gx, gy = (yy * xz - xy * yz) / determinant, (xx * yz - xy * xz) / determinant
        result[0, b], result[1, b], result[3, b] = gx, gy, 1
        if raster[0, b] > 0:
            x, y, z = raster[1, b], raster[2, b], raster[3, b]
        result[2, b] = z - gx * x - gy * y


@kernel
def extend(raster: np.ndarray, ground: np.ndarray, cell: float, reach: int) -> np.ndarray:
    """Return the planes (4, rows, columns) of cells on the ground, and within `reach` cells of it the nearest one's.

    What lies past the border matches the border: its plane is the border's, at the place that is asked for.
    """
    _, rows, columns = ground.shape
    inside = _inside(raster, ground)
    away = _rows_away(inside)
    extended = np.zeros((4, rows, columns), np.float32)
    for a in range(rows):
        for b in range(columns):
            i, j = _nearest(away, a, b, reach)
            if i == _FAR:
                continue
            gx, gy = ground[0, a + i, b + j], ground[1, a + i, b + j]
            extended[0, a, b], extended[1, a, b], extended[3, a, b] = gx, gy, 1
            extended[2, a, b] = ground[2, a + i, b + j] - np.float32(cell) * (gx * i + gy * j)
    return extended


@kernel
def _inside(raster: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """Return which cells are on the ground: they have a point, or most cells around them have."""
    _, rows, columns = raster.shape
    inside = np.zeros((rows, columns), np.bool_)
    for a in range(1, rows - 1):
        for b in range(1, columns - 1):
            around = 0
            for i in range(-1, 2):
                for j in range(-1, 2):
                    around += raster[0, a + i, b + j] > 0
            inside[a, b] = ground[3, a, b] > 0 and (raster[0, a, b] > 0 or around >= 5)
    return inside


@kernel
def _rows_away(inside: np.ndarray) -> np.ndarray:
    """Return how many rows down (below 0: up) the nearest cell inside is in each cell's column; _FAR: none."""
    rows, columns = inside.shape
    away = np.full((rows, columns), _FAR, np.int32)
    for a in range(rows):
        for b in range(columns):
            if inside[a, b]:
                away[a, b] = 0
            elif a > 0 and away[a - 1, b] != _FAR:
                away[a, b] = away[a - 1, b] - 1
    for a in range(rows - 2, -1, -1):
        for b in range(columns):
            if away[a + 1, b] + 1 < abs(away[a, b]) and away[a + 1, b] >= 0:
                away[a, b] = away[a + 1, b] + 1
    return away


@device  # type: ignore[untyped-decorator]
def _nearest(away: np.ndarray, a: int, b: int, reach: int) -> tuple[int, int]:
    """Return how many rows and columns away the nearest cell inside is, _FAR where it is more than `reach` cells."""
    row, column, best = _FAR, 0, (reach + 1) ** 2
    side = 0
    while side <= reach and side * side < best:
        for j in (-side, side):
            if 0 <= b + j < away.shape[1] and away[a, b + j] ** 2 + j * j < best:
                row, column, best = away[a, b + j], j, away[a, b + j] ** 2 + j * j
        side += 1
    return row, column
