"""Ranges and angles of a multibeam sonar to soundings: one sound speed, straight rays, motion at sending and receiving.

Frames are x forward, y to starboard, z down; roll is positive with the starboard side down, pitch with the bow up, yaw
and heading clockwise. A beam lies on two cones, one about the axis of the transmitter when it sent and one about that
of the receiver when it heard (Beaudoin, Hughes Clarke and Bartlett 2004, "Application of surface sound speed
measurements in post-processing for multi-sector multibeam echosounders").
"""

from dataclasses import dataclass

import numpy as np

MOST_BEAMS = 4096  # of a ping
SPEEDS = (1300.0, 1700.0)  # m/s, of sound in water


@dataclass(frozen=True)
class Fan:
    """What a sonar measured with one ping of b beams, from port to starboard."""

    time_s: float  # UTC since 1970; NaN where the sonar has not said
    travel_s: np.ndarray  # (b,) two ways
    angle: np.ndarray  # (b,) radians from the receiver's axis, to starboard
    tilt: float  # radians of the transmitted fan, forward
    speed: float  # m/s at the sonar; NaN where it has not said
    quality: np.ndarray  # (b,) int8
    sensor: str
    mount: float = 0.0  # radians by which the sonar says that its receiver is mounted; told, and not applied


@dataclass(frozen=True)
class Motion:
    """Attitude of the vessel at times of any shape: radians; heave in metres, positive up."""

    roll: np.ndarray
    pitch: np.ndarray
    heading: np.ndarray
    heave: np.ndarray


@dataclass(frozen=True)
class Arms:
    """Where the sonars of n pings are, metres, and how they are turned, in the vessel's axes."""

    navigation: np.ndarray  # (n, 3) from where the positions are to the sonar
    motion: np.ndarray  # (n, 3) from where the heave is to the sonar
    depth_m: np.ndarray  # (n,) of where the heave is, below the water line
    ahead: np.ndarray  # (n, 3) the transmitter's axis, of length 1
    across: np.ndarray  # (n, 3) the receiver's axis, to starboard, of length 1


Vector = tuple[np.ndarray, np.ndarray, np.ndarray]  # forward, to starboard, down; each of any shape


def turned(vector: Vector, roll: np.ndarray, pitch: np.ndarray, heading: np.ndarray) -> Vector:
    """Return a vector in the vessel's axes as one that is levelled, and counts from where `heading` does; radians."""
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
    """Return where n pings of b beams met the seabed: metres forward, to starboard of the position, below the water.

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
    ahead, across = turned(_columns(arms.ahead), *sending), turned(_columns(arms.across), *hearing)
    beam = _directions(ahead, across, angle, tilt[:, None])
    reach = travel_s * (speed[:, None] / 2.0)
    forward, starboard, _ = turned(_columns(arms.navigation), *sending)
    # the sonar's depth is between what it was at sending and at hearing
    arm = _columns(arms.motion)
    down = (turned(arm, *sending)[2] + turned(arm, *hearing)[2]) / 2.0
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
    """Return unit vectors (n, b) down, at an angle to each of two axes that are not quite square to each other."""
    (ax, ay, az), (bx, by, bz) = ahead, across
    between = ax * bx + ay * by + az * bz
    square = 1.0 - between**2
    of_ahead, of_across = np.sin(tilt), np.sin(angle)
    a = (of_ahead - between * of_across) / square
    b = (of_across - between * of_ahead) / square
    rest = np.maximum(1.0 - a**2 - b**2 - 2.0 * a * b * between, 0.0)
    down = np.sqrt(rest / square)
    return (
        a * ax + b * bx + down * (ay * bz - az * by),
        a * ay + b * by + down * (az * bx - ax * bz),
        a * az + b * bz + down * (ax * by - ay * bx),
    )
