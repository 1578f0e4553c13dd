"""Soundings from ranges and angles of a multibeam sonar: straight rays, motion at sending and at receiving.

Frames are x forward, y to starboard, z down; roll is positive with the starboard side down, pitch with the bow up, yaw
and heading clockwise. A beam is on two cones: one around the transmitter's axis at the time of sending, one around the
receiver's axis at the time of receiving (Beaudoin, Hughes Clarke and Bartlett 2004, "Application of surface sound speed
measurements in post-processing for multi-sector multibeam echosounders").
"""

from dataclasses import dataclass

import numpy as np

MOST_BEAMS = 4096  # of a ping
SPEEDS = (1300.0, 1700.0)  # m/s, of sound in water


@dataclass(frozen=True)
class Fan:
    """A sonar's measurements of one ping of b beams, from port to starboard."""

    time_s: float  # UTC since 1970; NaN where unknown
    travel_s: np.ndarray  # (b,) two ways
    angle: np.ndarray  # (b,) radians from the receiver's axis, to starboard
    tilt: float  # radians of the transmitted fan, forward
    speed: float  # of sound at the sonar, m/s; NaN where unknown
    quality: np.ndarray  # (b,) int8
    sensor: str
    mount: float = 0.0  # tilt of the receiver's mount by the sonar, radians; reported, but not applied


@dataclass(frozen=True)
class Motion:
    """Attitude of the vessel at times of any shape: radians; heave in metres, positive up."""

    roll: np.ndarray
    pitch: np.ndarray
    heading: np.ndarray
    heave: np.ndarray


@dataclass(frozen=True)
class Arms:
    """Lever arms and axes of the sonars of n pings, in the vessel's axes; metres."""

    navigation: np.ndarray  # (n, 3) from the point of the positions to the sonar
    motion: np.ndarray  # (n, 3) from the point of the heave to the sonar
    depth_m: np.ndarray  # (n,) of the point of the heave, below the water line
    ahead: np.ndarray  # (n, 3) the transmitter's axis, of length 1
    across: np.ndarray  # (n, 3) the receiver's axis, to starboard, of length 1


Vector = tuple[np.ndarray, np.ndarray, np.ndarray]  # forward, to starboard, down; each of any shape


def levelled(vector: Vector, roll: np.ndarray, pitch: np.ndarray, heading: np.ndarray) -> Vector:
    """Return a vector in the vessel's axes in levelled axes, from whose x the angle `heading` counts; radians."""
    x, y, z = vector
    cos, sin = np.cos(roll), np.sin(roll)
    y, z = cos * y - sin * z, sin * y + cos * z
    cos, sin = np.cos(pitch), np.sin(pitch)
    x, z = cos * x + sin * z, cos * z - sin * x
    cos, sin = np.cos(heading), np.sin(heading)
    return cos * x - sin * y, sin * x + cos * y, z


def soundings(
    travel_s: np.ndarray,
    angle: np.ndarray,
    tilt: np.ndarray,
    speed: np.ndarray,
    sent: Motion,
    heard: Motion,
    arms: Arms,
) -> Vector:
    """Return the soundings of n pings of b beams: metres forward, to starboard of the position, below the water line.

    Args:
        travel_s: (n, b) two-way travel times.
        angle: (n, b) of the beam from the plane across the receiver's axis, radians, positive to starboard.
        tilt: (n,) of the transmitted fan, radians, positive forward.
        speed: (n,) of sound, m/s.
        sent: motion at the n pings.
        heard: motion at the (n, b) times of the echoes.
        arms: of the sonar.
    """
    sending = (sent.roll[:, None], sent.pitch[:, None], np.zeros((len(speed), 1)))
    hearing = (heard.roll, heard.pitch, heard.heading - sent.heading[:, None])
    ahead, across = levelled(_columns(arms.ahead), *sending), levelled(_columns(arms.across), *hearing)
    beam = _directions(ahead, across, angle, tilt[:, None])
    reach = travel_s * (speed[:, None] / 2.0)
    forward, starboard, _ = levelled(_columns(arms.navigation), *sending)
    # the sonar's depth is the mean of those at sending and at receiving
    arm = _columns(arms.motion)
    down = (levelled(arm, *sending)[2] + levelled(arm, *hearing)[2]) / 2.0
    heave = (sent.heave[:, None] + heard.heave) / 2.0
    return (
        reach * beam[0] + forward,
        reach * beam[1] + starboard,
        reach * beam[2] + down - heave + arms.depth_m[:, None],
    )


def _columns(vectors: np.ndarray) -> Vector:
    x, y, z = vectors.T
    return x[:, None], y[:, None], z[:, None]


def _directions(ahead: Vector, across: Vector, angle: np.ndarray, tilt: np.ndarray) -> Vector:
    """Return unit vectors (n, b) down, each at an angle to two axes that are almost perpendicular."""
    (ax, ay, az), (bx, by, bz) = ahead, across
    between = ax * bx + ay * by + az * bz
    square = 1.0 - between**2
    sin_tilt, sin_angle = np.sin(tilt), np.sin(angle)
    a = (sin_tilt - between * sin_angle) / square
    b = (sin_angle - between * sin_tilt) / square
    remainder = np.maximum(1.0 - a**2 - b**2 - 2.0 * a * b * between, 0.0)
    down = np.sqrt(remainder / square)
    return (
        a * ax + b * bx + down * (ay * bz - az * by),
        a * ay + b * by + down * (az * bx - ax * bz),
        a * az + b * bz + down * (ax * by - ay * bx),
    )
