"""A multibeam echo sounder: it casts beams onto the seabed and logs soundings with noise, dropouts and outliers."""

from dataclasses import dataclass

import numpy as np

from pointnetkl.simulation.seabed import Seabed
from pointnetkl.workflow import parameters
from pointnetkl.workflow.errors import PointNetKLError

_ITERATIONS = 10
_HIT_M = 0.01  # a beam that ends this near the seabed has hit it
_LEAST_DESCENT = 0.02  # towards the ground, per metre of beam; it bounds the steps of the search


class SonarError(PointNetKLError):
    """The sonar does not have the beams that its settings ask for."""


@dataclass(frozen=True)
class Settings:
    """One multibeam sonar with beams at equal distances on flat ground."""

    sector_deg: float  # from the outermost beam to port to that to starboard
    beams: int  # the most that it can form
    noise_m: float  # standard deviation of a range straight below
    noise_growth: float  # relative increase of the noise at the sector's edge; it grows with the angle squared
    range_limit: float  # in altitudes: no echo from farther away
    dropouts: float  # share of beams without a sounding
    outliers: float  # share of soundings with a gross error
    outlier_m: float  # standard deviation of the gross errors of their ranges
    flagged: float  # share of the outliers that the sonar itself rejects (quality 1)

    def __post_init__(self) -> None:
        """Refuse settings that no sonar can have.

        Raises:
            ValueError: a number is out of its range.
        """
        parameters.require_positive(self, "sector_deg", "beams", "range_limit")
        if self.sector_deg > 170:
            raise ValueError(f"sector_deg is {self.sector_deg}, must be at most 170")


@dataclass(frozen=True)
class Soundings:
    """A sonar's log, arrays (n,); along, across, down: forward, starboard, downward of the levelled vehicle."""

    ping: np.ndarray  # row of the pings' poses
    beam: np.ndarray  # 0 is the outermost to port
    along: np.ndarray
    across: np.ndarray
    down: np.ndarray
    quality: np.ndarray


def angles(altitude_m: float, beam_spacing_m: float, sonar: Settings) -> np.ndarray:
    """Return the beams' angles (k,) from straight down, radians, positive to starboard.

    Raises:
        SonarError: the sonar does not have so many beams.
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

    A range is NaN where the beam meets no seabed within its limit (n,) metres, or where it grazes the seabed and the
    search does not converge.
    """
    ranges, active = np.full(len(origins), np.nan), np.arange(len(origins))
    gap_before = origins[:, 2] - seabed(origins[:, 0], origins[:, 1])
    before, reach = np.zeros(len(origins)), np.minimum(gap_before / -directions[:, 2], limit)
    for _ in range(_ITERATIONS):
        end = origins[active] + reach[:, None] * directions[active]
        gap = end[:, 2] - seabed(end[:, 0], end[:, 1])
        hit = np.abs(gap) < _HIT_M
        ranges[active[hit]] = reach[hit]
        # a secant step, because fixed-point steps diverge where the ground falls as steeply as the beam
        descent = np.maximum((gap_before - gap) / (reach - before), _LEAST_DESCENT)
        following = np.clip(reach + gap / descent, 0.0, limit[active])
        moving = ~hit & (following != reach)
        gap_before, before, reach, active = gap[moving], reach[moving], following[moving], active[moving]
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
    outlier = rng.uniform(size=len(ranges)) < sonar.outliers
    ranges += outlier * sonar.outlier_m * rng.normal(size=len(ranges))
    quality = outlier & (rng.uniform(size=len(ranges)) < sonar.flagged)
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
