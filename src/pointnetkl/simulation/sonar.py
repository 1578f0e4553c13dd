"""A multibeam echo sounder: beams cast onto the seabed, and what the sonar makes of them."""

from dataclasses import dataclass

import numpy as np

from pointnetkl.simulation.seabed import Seabed
from pointnetkl.workflow import parameters
from pointnetkl.workflow.errors import PointNetKLError

_ITERATIONS = 10
_HIT_M = 0.01  # a beam has hit when it ends this near to the seabed
_LEAST_DESCENT = 0.02  # towards the ground, per metre of beam: below it a step goes as far as the beam may


class SonarError(PointNetKLError):
    """The sonar cannot ping as asked."""


@dataclass(frozen=True)
class Settings:
    """One multibeam sonar, its beams equally far apart on flat ground."""

    sector_deg: float  # from the outermost beam to port to that to starboard
    beams: int  # the most that it can form
    noise_m: float  # standard deviation of a range straight below
    noise_growth: float  # how many times as much more at the sector's edge, with the square of the angle
    range_limit: float  # in altitudes: no echo from farther away
    dropouts: float  # share of beams without a sounding
    outliers: float  # share of soundings that are wrong
    outlier_m: float  # standard deviation of their ranges' errors
    flagged: float  # share of the wrong ones that the sonar rejects itself (quality 1)

    def __post_init__(self) -> None:
        """Refuse what no sonar can be.

        Raises:
            ValueError: a number is out of its range.
        """
        parameters.require_positive(self, "sector_deg", "beams", "range_limit")
        if self.sector_deg > 170:
            raise ValueError(f"sector_deg is {self.sector_deg}, must be at most 170")


@dataclass(frozen=True)
class Soundings:
    """What a sonar logs; arrays (n,). Along, across, down: forward, starboard, downward of the levelled vehicle."""

    ping: np.ndarray  # row of the pings' poses
    beam: np.ndarray  # 0 is the outermost to port
    along: np.ndarray
    across: np.ndarray
    down: np.ndarray
    quality: np.ndarray


def angles(altitude_m: float, beam_spacing_m: float, sonar: Settings) -> np.ndarray:
    """Return the beams' angles (k,) from straight down, radians, positive to starboard.

    Raises:
        SonarError: the sonar has not as many beams.
    """
    edge = np.tan(np.deg2rad(sonar.sector_deg / 2))
    count = round(2 * altitude_m * edge / beam_spacing_m) + 1
    if not 2 <= count <= sonar.beams:
        raise SonarError(
            f"beams {beam_spacing_m:g} m apart over {2 * altitude_m * edge:.0f} m are {count}, the sonar has"
            f" {sonar.beams}; change beam_spacing_m or altitude_m"
        )
    return np.arctan(np.linspace(-edge, edge, count))


def levelled(angle: np.ndarray, roll: np.ndarray, pitch: np.ndarray) -> np.ndarray:
    """Return unit vectors (n, k, 3) of beams (k,) along, across and down, for n attitudes.

    Roll is positive with the starboard side down, pitch with the bow up.
    """
    across, down = np.sin(angle), np.cos(angle)
    cr, sr, cp, sp = (f(a)[:, None] for a in (roll, pitch) for f in (np.cos, np.sin))
    tilted = sr * across + cr * down  # downward after roll
    return np.stack([sp * tilted, cr * across - sr * down, cp * tilted], axis=-1)


def cast(seabed: Seabed, origins: np.ndarray, directions: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """Return ranges (n,) metres from origins (n, 3) along directions (n, 3), x, y, z, to the seabed.

    NaN where a beam meets no seabed within its limit (n,) metres, or grazes it so that the search does not settle.
    """
    ranges, active = np.full(len(origins), np.nan), np.arange(len(origins))
    gap_before = origins[:, 2] - seabed(origins[:, 0], origins[:, 1])
    before, reach = np.zeros(len(origins)), np.minimum(gap_before / -directions[:, 2], limit)
    for _ in range(_ITERATIONS):
        end = origins[active] + reach[:, None] * directions[active]
        gap = end[:, 2] - seabed(end[:, 0], end[:, 1])
        hit = np.abs(gap) < _HIT_M
        ranges[active[hit]] = reach[hit]
        # a secant step: fixed-point steps diverge where the ground falls away as steeply as the beam
        descent = np.maximum((gap_before - gap) / (reach - before), _LEAST_DESCENT)
        following = np.clip(reach + gap / descent, 0.0, limit[active])
        on = ~hit & (following != reach)
        gap_before, before, reach, active = gap[on], reach[on], following[on], active[on]
    return ranges


def ping(
    seabed: Seabed,
    position: np.ndarray,
    yaw: np.ndarray,
    attitude: np.ndarray,
    measured: np.ndarray,
    angle: np.ndarray,
    altitude_m: float,
    sonar: Settings,
    rng: np.random.Generator,
) -> Soundings:
    """Return the soundings of n pings from true positions (n, 3), yaws (n,) and attitudes (n, 2: roll, pitch).

    The sonar levels its soundings with the `measured` attitudes (n, 2).
    """
    beams = _beams_in_map(levelled(angle, *attitude.T), yaw).reshape(-1, 3)
    origins = np.repeat(position, len(angle), axis=0)
    ranges = cast(seabed, origins, beams, np.full(len(origins), sonar.range_limit * altitude_m))
    edge = np.tile(angle / np.abs(angle).max(), len(position))
    ranges += sonar.noise_m * (1.0 + sonar.noise_growth * edge**2) * rng.normal(size=len(ranges))
    wrong = rng.uniform(size=len(ranges)) < sonar.outliers
    ranges += wrong * sonar.outlier_m * rng.normal(size=len(ranges))
    quality = wrong & (rng.uniform(size=len(ranges)) < sonar.flagged)
    heard = np.isfinite(ranges) & (ranges > 0) & (rng.uniform(size=len(ranges)) >= sonar.dropouts)
    number, beam = np.divmod(np.flatnonzero(heard), len(angle))
    local = levelled(angle, *measured.T).reshape(-1, 3)[heard] * ranges[heard, None]
    along, across, down = local.T
    return Soundings(number, beam, along, across, down, quality[heard])


def _beams_in_map(local: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """Turn along, across (starboard), down (n, k, 3) into east, north, up."""
    c, s = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    along, across, down = np.moveaxis(local, -1, 0)
    return np.stack([c * along + s * across, s * along - c * across, -down], axis=-1)
