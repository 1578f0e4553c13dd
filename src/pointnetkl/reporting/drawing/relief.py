"""A submap's seabed as an image: depth as colour, slope as shade, on a regular grid without holes."""

from dataclasses import dataclass

import numpy as np
from matplotlib import colormaps
from scipy import ndimage

DEPTHS = "viridis_r"  # perceptually even; deep is dark
_LIGHT = np.array([-0.5, 0.5, 0.7])  # where it comes from, in the image: from the left above
_STEEPER = 4.0  # times, for the shade: slopes of a few hundredths decide whether a registration locks on
_WHITE = 0.35  # mixed in, or the colours would hide the shade
_CELLS = 130  # along the longer side, at most
_LEAST_TINT_M = 10.0  # of depth from the palest to the darkest: flat ground must not look like a valley


@dataclass(frozen=True)
class Relief:
    """A submap seen from above, the track upward."""

    rgba: np.ndarray  # (h, w, 4) uint8, first row foremost
    extent: tuple[float, float, float, float]  # metres to starboard (-y), then along the track (x), as imshow's
    depths_m: tuple[float, float]  # least and most, above the submap's origin if negative


def from_points(points: np.ndarray) -> Relief:
    """Return the relief of points (n, 3) in a submap's frame, metres.

    Shade and the least span of colours are absolute, so that the images of several submaps can be compared.
    """
    z, extent = _gridded(np.column_stack([-points[:, 1], points[:, 0], points[:, 2]]))
    low, high = float(np.nanmin(z)), float(np.nanmax(z))
    tint = 0.5 + ((low + high) / 2 - z) / max(high - low, _LEAST_TINT_M)
    rgba = _WHITE + (1 - _WHITE) * colormaps[DEPTHS](np.nan_to_num(tint))
    rgba[..., :3] *= _shade(z, (extent[1] - extent[0]) / z.shape[1])[..., None]
    rgba[..., 3] = np.isfinite(z)
    return Relief(np.asarray(255 * np.clip(rgba, 0, 1), np.uint8), extent, (-high, -low))


def _shade(z: np.ndarray, cell: float) -> np.ndarray:
    """Return how bright each cell is, 1 where the ground is level."""
    along, across = np.gradient(_STEEPER * z, cell)
    normal = np.stack([-across, along, np.ones_like(z)], -1)  # rows run backward
    light = _LIGHT / np.linalg.norm(_LIGHT)
    shade = normal @ light / np.linalg.norm(normal, axis=-1) / light[2]
    return np.asarray(np.clip(np.nan_to_num(shade, nan=1.0), 0.55, 1.25))


def _gridded(points: np.ndarray) -> tuple[np.ndarray, tuple[float, float, float, float]]:
    """Return z of points (n, 3) on a grid, first row at the largest y, NaN far from any point; and its extent."""
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    spacing = float(np.sqrt(np.prod(np.maximum(high - low, 1e-3)) / len(points)))
    cell = max(float((high - low).max()) / _CELLS, spacing / 2)
    shape = np.floor((high - low) / cell).astype(int) + 1
    column, row = np.floor((points[:, :2] - low) / cell).astype(int).T
    flat = row * shape[0] + column
    # a kernel one spacing wide: narrower leaves holes, wider smooths away what registration holds on to
    sums = [
        ndimage.gaussian_filter(
            np.bincount(flat, weights, minlength=shape.prod()).reshape(shape[1], shape[0]), 0.7 * spacing / cell,
            mode="constant",
        )
        for weights in (np.ones(len(points)), points[:, 2])
    ]  # fmt: skip
    weight = sums[0] > 0.3 * (cell / spacing) ** 2
    z = np.divide(sums[1], sums[0], out=np.full_like(sums[0], np.nan), where=weight)
    left, bottom = low
    return z[::-1], (float(left), float(left + shape[0] * cell), float(bottom), float(bottom + shape[1] * cell))
