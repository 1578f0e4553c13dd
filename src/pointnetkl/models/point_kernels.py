"""Kernels of a PointNet's training on a CPU: what torch has no fast operation for, over the points of many clouds.

Work is shared out by cloud, by channel or by a fixed number of parts, so that the number of threads changes no bit. No
kernel calls another function, so that each is compiled alike wherever it is.
"""

from typing import Any

import numba
import numpy as np

PARTS = 128  # of the rows that a sum is taken over, whatever the number of threads
_CHANNELS = 32  # at a time: their gradients stay in a core's cache

_kernel: Any = numba.njit(
    cache=True, nogil=True, parallel=True, error_model="numpy", fastmath={"nsz", "reassoc"}
)  # sums may be reordered, to add sixteen terms at a time


@_kernel
def point_of_largest(outputs, first, points):  # type: ignore[no-untyped-def]
    """Write which row of outputs (b, n, channels) is largest into points[first : first + b], (B, channels) int32."""
    clouds, rows, channels = outputs.shape
    for b in numba.prange(clouds):
        largest = outputs[b, 0].copy()
        at = np.zeros(channels, np.int32)
        for r in range(1, rows):
            for o in range(channels):
                if outputs[b, r, o] > largest[o]:
                    largest[o] = outputs[b, r, o]
                    at[o] = r
        points[first + b] = at


@_kernel
def at_points(features, weight, points, outputs):  # type: ignore[no-untyped-def]
    """Write weight[o] . features[b, points[b, o]] into outputs (B, channels)."""
    clouds, channels = points.shape
    for b in numba.prange(clouds):
        for o in range(channels):
            total = np.float32(0)
            for c in range(features.shape[2]):
                total += features[b, points[b, o], c] * weight[o, c]
            outputs[b, o] = total


@_kernel
def add_to_features(gradient, weight, points, to_features):  # type: ignore[no-untyped-def]
    """Add the gradient of `at_points`'s outputs, (B, channels), to that of its features, (B, n, c)."""
    clouds, channels = points.shape
    for b in numba.prange(clouds):
        for o in range(channels):
            for c in range(weight.shape[1]):
                to_features[b, points[b, o], c] += gradient[b, o] * weight[o, c]


@_kernel
def add_to_weight(gradient, features, points, to_weight):  # type: ignore[no-untyped-def]
    """Add the gradient of `at_points`'s outputs, (B, channels), to that of its weight, (channels, c)."""
    clouds, channels = points.shape
    for block in numba.prange(-(-channels // _CHANNELS)):
        for b in range(clouds):
            for o in range(block * _CHANNELS, min(channels, (block + 1) * _CHANNELS)):
                for c in range(features.shape[2]):
                    to_weight[o, c] += gradient[b, o] * features[b, points[b, o], c]


@_kernel
def sums(rows, totals):  # type: ignore[no-untyped-def]
    """Write sums and sums of squares of rows (n, channels) less their first one into totals (PARTS, 2, channels)."""
    count, channels = rows.shape
    for part in numba.prange(len(totals)):
        first_order, second_order = np.zeros(channels, np.float32), np.zeros(channels, np.float32)
        for r in range(part * count // len(totals), (part + 1) * count // len(totals)):
            for c in range(channels):
                difference = rows[r, c] - rows[0, c]
                first_order[c] += difference
                second_order[c] += difference * difference
        totals[part, 0] = first_order
        totals[part, 1] = second_order


@_kernel
def scale_relu(rows, scale, shift, outputs):  # type: ignore[no-untyped-def]
    """Write max(0, scale * row + shift) of rows (n, channels) into outputs."""
    count, channels = rows.shape
    for part in numba.prange(PARTS):
        for r in range(part * count // PARTS, (part + 1) * count // PARTS):
            for c in range(channels):
                value = rows[r, c] * scale[c] + shift[c]
                outputs[r, c] = np.float32(0) if value <= 0 else value  # so that NaN stays NaN


@_kernel
def gradient_sums(gradient, rows, scale, shift, mean, totals):  # type: ignore[no-untyped-def]
    """Write sums of gradient and gradient * (row - mean), where `scale_relu` is above 0, into totals (PARTS, 2, c)."""
    count, channels = rows.shape
    for part in numba.prange(len(totals)):
        first_order, second_order = np.zeros(channels, np.float32), np.zeros(channels, np.float32)
        for r in range(part * count // len(totals), (part + 1) * count // len(totals)):
            for c in range(channels):
                value = np.float32(0) if rows[r, c] * scale[c] + shift[c] <= 0 else gradient[r, c]
                first_order[c] += value
                second_order[c] += value * (rows[r, c] - mean[c])
        totals[part, 0] = first_order
        totals[part, 1] = second_order


@_kernel
def gradient_of_rows(gradient, rows, scale, shift, constant, slope, outputs):  # type: ignore[no-untyped-def]
    """Write scale * gradient (where `scale_relu` is above 0) - constant - slope * row into outputs (n, channels)."""
    count, channels = rows.shape
    for part in numba.prange(PARTS):
        for r in range(part * count // PARTS, (part + 1) * count // PARTS):
            for c in range(channels):
                value = np.float32(0) if rows[r, c] * scale[c] + shift[c] <= 0 else gradient[r, c]
                outputs[r, c] = scale[c] * value - constant[c] - slope[c] * rows[r, c]
