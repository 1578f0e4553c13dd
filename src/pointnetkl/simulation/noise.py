"""Random fields over the plane by gradient noise on hashed lattices.

A value depends on the point and the seed alone, not on the other points asked for. Each octave is a lattice whose nodes
hold random slopes, drawn by hashing the node's indices and the seed. Between nodes the slopes are blended so that the
field and its first two derivatives are continuous. A sum of octaves with different lattices and directions is close to
Gaussian.
"""

import math

import numba
import numpy as np

_SLOPES = 256  # directions that a node may take
_UNIT_STD = 0.2156  # of one octave whose nodes have slopes of length 1, by integration over 2 million points
_UNIT_SLOPE = 0.6247  # its rms slope, in any one direction, per lattice step
_TURN = 2.399963  # golden angle, so that no two octaves of a field share a lattice direction
_ANGLES = np.arange(_SLOPES) * (2 * np.pi / _SLOPES)
_COS, _SIN = np.cos(_ANGLES), np.sin(_ANGLES)


def field(x: np.ndarray, y: np.ndarray, seed: int, length_m: float, octaves: int = 1, gain: float = 0.5) -> np.ndarray:
    """Return a random field of zero mean and unit variance at the points x, y (n,) metres.

    `length_m` is the lattice step of the coarsest octave, about the distance from a hill to the next hollow; each
    further octave is half as long and `gain` times as high.
    """
    values = np.empty(len(x))
    _octaves(np.ascontiguousarray(x), np.ascontiguousarray(y), seed, 1.0 / length_m, octaves, gain, values)
    return values


def slope(length_m: float, octaves: int = 1, gain: float = 0.5) -> float:
    """Return the rms slope, in any one direction, of a `field` of unit variance."""
    k = np.arange(octaves)
    squared = np.sum((2.0 * gain) ** (2 * k)) / np.sum(gain ** (2 * k))
    return float(_UNIT_SLOPE / _UNIT_STD / length_m * np.sqrt(squared))


def stretched(x: np.ndarray, y: np.ndarray, stretch: float, azimuth_rad: float) -> tuple[np.ndarray, np.ndarray]:
    """Return coordinates in which an isotropic field becomes `stretch` times as long along an azimuth.

    The azimuth is counter-clockwise from x; lengths across it are kept.
    """
    c, s = math.cos(azimuth_rad), math.sin(azimuth_rad)
    return (c * x + s * y) / stretch, c * y - s * x


def share(values: np.ndarray) -> np.ndarray:
    """Return the ranks of a field of unit variance: the share of the plane that lies lower, from 0 to 1."""
    return np.asarray(1.0 / (1.0 + np.exp(-1.702 * values)))  # the logistic nearest to the normal's integral


@numba.njit(cache=True, nogil=True)
def _hashed(i: int, j: int, seed: int) -> np.uint64:
    # 32 well-mixed bits of two whole numbers and a seed
    h = np.uint64(i) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(j) * np.uint64(0xC2B2AE3D27D4EB4F)
    h += np.uint64(seed) * np.uint64(0xD6E8FEB86659FD93)
    # two rounds of fold and multiply, because after one round neighbouring nodes are visibly alike
    h = (h ^ (h >> np.uint64(32))) * np.uint64(0xD6E8FEB86659FD93)
    h = (h ^ (h >> np.uint64(29))) * np.uint64(0x9E3779B97F4A7C15)
    return h >> np.uint64(32)


@numba.njit(cache=True, nogil=True)
def _node(i: int, j: int, seed: int, dx: float, dy: float) -> float:
    k = _hashed(i, j, seed) % np.uint64(_SLOPES)
    return _COS[k] * dx + _SIN[k] * dy


@numba.njit(cache=True, nogil=True)
def _gradient_noise(u: float, v: float, seed: int) -> float:
    i, j = math.floor(u), math.floor(v)
    fx, fy = u - i, v - j
    # the lowest polynomial that is flat to second order at both ends
    wx = fx * fx * fx * (10.0 + fx * (6.0 * fx - 15.0))
    wy = fy * fy * fy * (10.0 + fy * (6.0 * fy - 15.0))
    low = (1.0 - wx) * _node(i, j, seed, fx, fy) + wx * _node(i + 1, j, seed, fx - 1.0, fy)
    high = (1.0 - wx) * _node(i, j + 1, seed, fx, fy - 1.0) + wx * _node(i + 1, j + 1, seed, fx - 1.0, fy - 1.0)
    return (1.0 - wy) * low + wy * high


@numba.njit(cache=True, nogil=True)
def _octaves(
    x: np.ndarray, y: np.ndarray, seed: int, frequency: float, octaves: int, gain: float, out: np.ndarray
) -> None:
    out[:] = 0.0
    power = 0.0
    for k in range(octaves):
        c, s = math.cos(seed + k * _TURN) * frequency, math.sin(seed + k * _TURN) * frequency
        for n in range(len(x)):
            u, v = c * x[n] + s * y[n] + 0.5, c * y[n] - s * x[n] + 0.5
            out[n] += gain**k * _gradient_noise(u, v, seed + 7919 * k)
        power += gain ** (2 * k)
        frequency *= 2.0
    out *= 1.0 / (_UNIT_STD * math.sqrt(power))
