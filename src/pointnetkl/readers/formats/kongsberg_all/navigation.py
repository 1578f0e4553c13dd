"""Positions and attitude of a Kongsberg .all file, of the systems that the sonar used."""

import struct
from array import array

import numpy as np

from pointnetkl.readers.formats import interpolation
from pointnetkl.readers.formats.kongsberg_all.datagrams import BIG, LITTLE, Datagram

_POSITIONS = {order: struct.Struct(order + "iiHHHHBB") for order in (LITTLE, BIG)}
_ACTIVE, _SYSTEM = 0x80, 0x03  # of a position's descriptor
_ROLL_UNUSED = 0x02  # of an attitude's descriptor
_LATITUDE, _LONGITUDE = 2e7, 1e7  # units per degree
_GAP_S = 30.0  # between positions; in deep water some files have their first position that late
_ATTITUDE_GAP_S = 2.0
_SAMPLES = {
    order: np.dtype([("ms", order + "u2"), ("status", order + "u2"), ("roll", order + "i2"), ("pitch", order + "i2"),
                     ("heave", order + "i2"), ("heading", order + "u2")])
    for order in (LITTLE, BIG)
}  # fmt: skip
_EVERY_MS = 50  # between samples that are kept: enough for a vehicle's motion, and memory grows with the file here


class Positions:
    """Positions of all systems; those of the active system are used."""

    def __init__(self, order: str) -> None:
        """Begin without any; `order` is the file's byte order."""
        self._unpack = _POSITIONS[order]
        self._table = array("d")

    def take(self, datagram: Datagram) -> None:
        """Take a position datagram; one without a time or a place on the earth is ignored."""
        if len(datagram.content) < self._unpack.size:
            return
        latitude, longitude, *_, descriptor, _ = self._unpack.unpack_from(datagram.content)
        latitude, longitude = latitude / _LATITUDE, longitude / _LONGITUDE
        if abs(latitude) <= 90 and abs(longitude) <= 180 and np.isfinite(datagram.time_s):
            self._table.extend((datagram.time_s, longitude, latitude, descriptor))

    def interpolate(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return longitude, latitude in degrees (n,) at times (n,), and seconds before the first or after the last."""
        sampled, east, north = self._used()
        if not len(sampled) or not len(time):
            nowhere = np.full(len(time), np.nan)
            return nowhere, nowhere, np.zeros(len(time))
        far = np.maximum(np.maximum(sampled.min() - time, time - sampled.max()), 0.0)
        far[far > _GAP_S] = 0.0
        longitude = interpolation.longitude(time, sampled, east, _GAP_S)
        return longitude, interpolation.linear(time, sampled, north, _GAP_S), far

    def _used(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        time, east, north, descriptor = np.frombuffer(self._table).reshape(-1, 4).T
        described = descriptor.astype(np.uint8)
        used = described & _ACTIVE != 0
        if not used.any() and len(time):  # none is active: positions of several antennas make no track
            system = described & _SYSTEM
            used = system == np.argmax(np.bincount(system))
        return time[used], east[used], north[used]


class Attitudes:
    """Roll and pitch of all sensors; those of the sensor in use are taken."""

    def __init__(self, order: str) -> None:
        """Begin without any; `order` is the file's byte order."""
        self._order, self._samples = order, _SAMPLES[order]
        self._tables = {used: (array("d"), array("h"), array("h")) for used in (True, False)}

    def take(self, datagram: Datagram) -> None:
        """Take an attitude datagram; one that is too short for its samples, or has no time, is ignored."""
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

    def interpolate(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return roll and pitch in radians (n,) at times (n,), as recorded; NaN where there is none."""
        sampled, *angles = (
            np.frombuffer(column, column.typecode) for column in self._tables[bool(self._tables[True][0])]
        )
        roll, pitch = (interpolation.linear(time, sampled, angle, _ATTITUDE_GAP_S) for angle in angles)
        return np.deg2rad(roll / 100.0), np.deg2rad(pitch / 100.0)
