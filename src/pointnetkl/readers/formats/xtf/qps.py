"""Multibeam pings as QINSy writes them for any sonar (XTF packet 28): travel time, beam and tilt angle of each beam.

The format does not define its angles. They are taken as degrees, to starboard and forward, as MBES-lib does.
"""

import numpy as np

from pointnetkl.readers.formats.recording import IMPOSSIBLE
from pointnetkl.readers.formats.xtf.raytrace import MOST_BEAMS, Fan

_BEAM = np.dtype(
    [
        ("beam", "<i4"),
        ("intensity", "<f8"),
        ("quality", "<i4"),
        ("travel", "<f8"),
        ("delay", "<f8"),
        ("angle", "<f8"),
        ("tilt", "<f8"),
        ("reserved", "<f4", 4),
    ]
)
_STEEPEST = 89.0  # degrees


def fan(content: bytes | memoryview) -> Fan | str:
    """Return a ping's beams, without time and sound speed, or the reason why they cannot be used."""
    count = len(content) // _BEAM.itemsize
    if not 0 < count <= MOST_BEAMS:
        return f"has {count} beams"
    beams = np.frombuffer(content, _BEAM, count)
    tilt = beams["tilt"][np.abs(beams["tilt"]) < _STEEPEST]
    quality = np.where(beams["travel"] > 0.0, 0, IMPOSSIBLE).astype(np.int8)
    turn = float(np.deg2rad(np.median(tilt))) if len(tilt) else 0.0
    unknown = float("nan")
    return Fan(
        unknown, beams["travel"], np.deg2rad(beams["angle"]), turn, unknown, quality, "multibeam by way of QINSy"
    )
