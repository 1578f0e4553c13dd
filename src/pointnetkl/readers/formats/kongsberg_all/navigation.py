"""Positions and attitude of a Kongsberg .all file, of the systems that the sonar itself used."""

import struct
from array import array

import numpy as np

from pointnetkl.readers.formats import interpolation
from pointnetkl.readers.formats.kongsberg_all.datagrams import BIG, LITTLE, Datagram

_POSITIONS = {order: struct.Struct(order + "iiHHHHBB") for order in (LITTLE, BIG)}
_ACTIVE, _SYSTEM = 0x80, 0x03  # of a position's descriptor
_ROLL_UNUSED = 0x02  # of an attitude's descriptor
_LATITUDE, _LONGITUDE = 2e7, 1e7  # units per degree
_GAP_S = 30.0  # the longest that pings go without a position: in deep water some wait that long for their first
_ATTITUDE_GAP_S = 2.0
_SAMPLES = {
    order: np.dtype([("ms", order + "u2"), ("status", order + "u2"), ("roll", order + "i2"), ("pitch", order + "i2"),
                     ("heave", order + "i2"), ("heading", order + "u2")])
    for order in (LITTLE, BIG)
}  # fmt: skip
_EVERY_MS = 50  # motion of a vehicle needs no more, and memory grows with the file here


class Positions:
    """Positions of all systems as they come; in the end those that count are the active one's."""

    def __init__(self, order: str) -> None:
        """Begin without any; `order` is the file's byte order."""
        self._unpack = _POSITIONS[order]
        self._table = array("d")

    def take(self, datagram: Datagram) -> None:
        """Take a position datagram; what is not on the earth, or has no time, does not count."""
        if len(datagram.content) < self._unpack.size:
            return
        latitude, longitude, *_, descriptor, _ = self._unpack.unpack_from(datagram.content)
        latitude, longitude = latitude / _LATITUDE, longitude / _LONGITUDE
        if abs(latitude) <= 90 and abs(longitude) <= 180 and np.isfinite(datagram.time_s):
            self._table.extend((datagram.time_s, longitude, latitude, descriptor))

    def at(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return longitude, latitude in degrees (n,) at times (n,), and seconds to the nearest if beyond all."""
        known, east, north = self._used()
        if not len(known) or not len(time):
            nowhere = np.full(len(time), np.nan)
            return nowhere, nowhere, np.zeros(len(time))
        far = np.maximum(np.maximum(known.min() - time, time - known.max()), 0.0)
        far[far > _GAP_S] = 0.0
        longitude = interpolation.longitude(time, known, east, _GAP_S)
        return longitude, interpolation.linear(time, known, north, _GAP_S), far

    def _used(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        known, east, north, descriptor = np.frombuffer(self._table).reshape(-1, 4).T
        described = descriptor.astype(np.uint8)
        used = described & _ACTIVE != 0
        if not used.any() and len(known):  # of several antennas only one at a time is a track
            system = described & _SYSTEM
            used = system == np.argmax(np.bincount(system))
        return known[used], east[used], north[used]


class Attitudes:
    """Roll and pitch of all sensors as they come; in the end those that count are the used one's."""

    def __init__(self, order: str) -> None:
        """Begin without any; `order` is the file's byte order."""
        self._order, self._samples = order, _SAMPLES[order]
        self._tables = {used: (array("d"), array("h"), array("h")) for used in (True, False)}

    def take(self, datagram: Datagram) -> None:
        """Take an attitude datagram; one that is too short for its samples, or has no time, does not count."""
        content = datagram.content
        count = struct.unpack_from(self._order + "H", content)[0] if len(content) > 2 else 0
        end = 2 + count * self._samples.itemsize
        if not count or end >= len(content) or not np.isfinite(datagram.time_s):
            return
        samples = np.frombuffer(content, self._samples, count, 2)
        samples = samples[np.diff(samples["ms"] // _EVERY_MS, prepend=1 << 16) != 0]
        time, roll, pitch = self._tables[not content[end] & _ROLL_UNUSED]
        time.frombytes((datagram.time_s + samples["ms"] / 1000.0).tobytes())
        roll.frombytes(samples["roll"].astype(np.int16).tobytes())
        pitch.frombytes(samples["pitch"].astype(np.int16).tobytes())

    def at(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return roll and pitch in radians (n,) at times (n,), as recorded; NaN where there is none."""
        known, *angles = (
            np.frombuffer(column, column.typecode) for column in self._tables[bool(self._tables[True][0])]
        )
        roll, pitch = (interpolation.linear(time, known, angle, _ATTITUDE_GAP_S) for angle in angles)
        return np.deg2rad(roll / 100.0), np.deg2rad(pitch / 100.0)
