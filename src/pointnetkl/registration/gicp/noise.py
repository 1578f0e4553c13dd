"""The noise of Monte Carlo's copies: standard normal numbers, each a function of point, run and key.

A counter-based generator has no state: run 7 of a submap gets the same noise in any batch, process, order and engine.
"""

import math
from dataclasses import dataclass

import numpy as np

from pointnetkl.registration.gicp.device import device, kernel

_u32, _i32, _f32, _u64 = np.uint32, np.int32, np.float32, np.uint64
_LN2, _QUARTER_TURN = _f32(np.log(2)), _f32(np.pi / 2)


@dataclass(frozen=True)
class Noise:
    """Independent noise N(0, sigma_m^2) on every coordinate of every point, of run `first` and the following runs."""

    sigma_m: float
    key: int  # another one for each submap and purpose; its last 64 bits are used
    first: int = 0

    def draw(self, count: int, points: int) -> np.ndarray:
        """Return the noise of `count` runs, (count, points, 3) float32 in metres."""
        noise = np.empty((count, 3, points), np.float32)
        first, low, high, sigma = self.as_arguments()
        for run, (x, y, z) in enumerate(noise):
            fill(x, y, z, first + run, low, high, sigma)
        return noise.transpose(0, 2, 1)

    def as_arguments(self) -> tuple[int, np.uint32, np.uint32, np.float32]:
        """Return the first run, the key's lower and upper half, and sigma, as kernels take them."""
        return self.first, _u32(self.key & 0xFFFFFFFF), _u32(self.key >> 32 & 0xFFFFFFFF), _f32(self.sigma_m)


@kernel
def fill(x, y, z, run, low, high, sigma):  # type: ignore[no-untyped-def]
    """Fill x, y, z (n,) float32 with a run's noise of so many metres."""
    for i in range(len(x)):
        a, b, c = normal3(i, run, low, high)
        x[i], y[i], z[i] = sigma * a, sigma * b, sigma * c


@device
def normal3(point, run, low, high):  # type: ignore[no-untyped-def]
    """Return three standard normal numbers, float32, of a point in a run (Box and Muller 1958)."""
    a, b, c, d = philox(_u32(point), _u32(run), _u32(run >> 32), _u32(0), low, high)
    radius = _radius(a)
    x, y = _direction(b)
    z, _ = _direction(d)
    return radius * x, radius * y, _radius(c) * z


@device
def philox(a, b, c, d, low, high):  # type: ignore[no-untyped-def]
    """Return four random words of 32 bits for a counter of four and a key of two: Philox4x32-10 (Salmon 2011)."""
    for _ in range(10):
        ab, cd = _u64(0xD2511F53) * _u64(a), _u64(0xCD9E8D57) * _u64(c)
        a, b, c, d = _u32(cd >> _u64(32)) ^ b ^ low, _u32(cd), _u32(ab >> _u64(32)) ^ d ^ high, _u32(ab)
        low, high = _u32(low + _u32(0x9E3779B9)), _u32(high + _u32(0xBB67AE85))
    return a, b, c, d


@device
def _radius(word):  # type: ignore[no-untyped-def]
    # sqrt(-2 ln u) of u in (0, 1) from 24 bits; ln u = e ln 2 + ln m, with m in [sqrt(1/2), sqrt(2)) by atanh's series
    u = (_f32(_i32(word >> _u32(8))) + _f32(0.5)) * _f32(2.0**-24)
    bits = _i32(_f32(u).view(np.int32))
    exponent = _i32(_i32(bits - _i32(0x3F3504F3)) >> _i32(23))
    m = _i32(bits - _i32(exponent << _i32(23))).view(np.float32)
    s = (m - _f32(1)) / (m + _f32(1))
    q = s * s
    series = _f32(2) + q * (_f32(2 / 3) + q * (_f32(2 / 5) + q * (_f32(2 / 7) + q * _f32(2 / 9))))
    return math.sqrt(_f32(-2) * (_f32(exponent) * _LN2 + s * series))


@device
def _direction(word):  # type: ignore[no-untyped-def]
    # cosine and sine of a uniform angle: a quarter from the top two bits, an angle within an eighth turn from 24 more
    quarter = _u32(word >> _u32(30))
    angle = (_f32(_i32((word >> _u32(6)) & _u32(0xFFFFFF))) - _f32(2**23 - 0.5)) * _f32(_QUARTER_TURN * 2.0**-24)
    q = angle * angle
    sine = angle * (_f32(1) + q * (_f32(-1 / 6) + q * (_f32(1 / 120) + q * _f32(-1 / 5040))))
    cosine = _f32(1) + q * (_f32(-1 / 2) + q * (_f32(1 / 24) + q * (_f32(-1 / 720) + q * _f32(1 / 40320))))
    odd = (quarter & _u32(1)) != _u32(0)
    x, y = (sine, cosine) if odd else (cosine, sine)
    x = -x if (quarter == _u32(1)) | (quarter == _u32(2)) else x
    y = -y if quarter >= _u32(2) else y
    return x, y
