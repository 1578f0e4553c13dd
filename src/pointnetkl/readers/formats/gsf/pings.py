"""The pings of a GSF file, from their bytes: the header of versions 1 and 2 or of 3, and scaled arrays, one per value.

Their layout is that of the Generic Sensor Format Specification (Leidos) up to version 03.10.
"""

import math
import struct
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from pointnetkl.readers.formats.gsf import sensors as gsf_sensors
from pointnetkl.surveys.survey import SurveyError

# time; longitude, latitude; beams, centre, flags, spare; tide, depth corrector; heading; pitch, roll, heave; course,
# speed. A header of version 3 goes on with heights above the ellipsoid, which nothing here needs
_HEADER = struct.Struct(">IIiiHHHHhiHhhhHH")
_SINGLE_HEADER = struct.Struct(">IIiihiHhhhihH")  # the same without beams and flags; depth, sound speed correction
_HEADER_BYTES = {1: 42, 2: 42, 3: 56}

_DEPTH, _ACROSS, _ALONG, _NOMINAL, _QUALITY, _FLAGS, _INTENSITIES, _SCALES = 1, 2, 3, 14, 15, 16, 21, 100
_NAMES = {_DEPTH: "depths", _ACROSS: "across track", _ALONG: "along track", _NOMINAL: "nominal depths"}
_ARRAYS = range(1, 32)
_UNSIGNED, _SIGNED = {1: "u1", 2: ">u2", 4: ">u4"}, {1: "i1", 2: ">i2", 4: ">i4"}  # by bytes per value

# stand for values that are not known, in hundredths
_NO_CORRECTOR, _NO_ANGLE, _FULL_CIRCLE = 9999, 9900, 36000
_IGNORED = 1  # of a ping's or beam's flags; the other bits select soundings or say why


Parts = dict[int, tuple[int, int]]  # of a ping, by kind: first byte, and size


class PingError(SurveyError):
    """The bytes of a ping cannot be used."""


class Ping(NamedTuple):
    """A ping of n beams; arrays (n,), metres. Depths are below the surface, with draught and tide added already."""

    navigation: tuple[float, ...]  # recording.PING_COLUMNS
    along_m: np.ndarray
    across_m: np.ndarray
    depth_m: np.ndarray
    rejected: np.ndarray  # whether the sonar or its operator refuses a beam
    placed: bool  # whether the file says where the beams are across track
    sensor: str
    tide: bool  # whether a tide was added to its depths


class Decoder:
    """The pings of one file in their order: scale factors hold until others come."""

    def __init__(self, major: int) -> None:
        """Decode pings of a major version of the format."""
        self._header = _HEADER_BYTES[major]
        self._scales: dict[int, tuple[int, int]] = {}  # multiplier and offset of each kind of array

    def forget(self) -> None:
        """Take it that scale factors may have been lost."""
        self._scales = {}

    def swath(self, content: memoryview) -> Ping:
        """Return the swath bathymetry ping of a record's bytes.

        Raises:
            PingError: the bytes contradict themselves, or depths have no scale factors.
        """
        if len(content) < self._header:
            self.forget()
            raise PingError(f"{len(content)} bytes are too short for a ping")
        header = _HEADER.unpack_from(content)
        beams, flags = header[4], header[6]
        parts = self._checked(content, beams)
        navigation, tide = _navigation(header[:4], *header[8:13])
        if beams and _DEPTH not in parts and _NOMINAL not in parts:
            raise PingError("it has no depths")
        kinds = (_ALONG, _ACROSS, _DEPTH if _DEPTH in parts else _NOMINAL)
        along, across, depth = (self._array(content, parts, kind, beams) for kind in kinds)
        rejected = np.ones(beams, bool) if flags & _IGNORED else _rejected(content, parts, beams)
        placed = _ACROSS in parts or beams == 1  # a single beam looks straight down
        return Ping(navigation, along, across, depth, rejected, placed, _sensor(content, parts), tide)

    def _checked(self, content: memoryview, beams: int) -> Parts:
        """Return the parts of a ping, whose scale factors hold from now on."""
        try:
            parts = _parts(content, self._header, beams)
            at, size = parts.get(_SCALES, (0, 0))
            self._scales |= _scales(bytes(content[at : at + size]))
        except PingError:
            if content[self._header] not in _ARRAYS:  # a ping that begins with an array has none of its own to lose
                self.forget()
            raise
        return parts

    def _array(self, content: memoryview, parts: Parts, kind: int, beams: int) -> np.ndarray:
        if kind not in parts or not beams:
            return np.zeros(beams)
        if kind not in self._scales:
            raise PingError(f"no scale factors are known for its {_NAMES[kind]}")
        at, size = parts[kind]
        types = _SIGNED if kind in (_ACROSS, _ALONG) else _UNSIGNED
        multiplier, offset = self._scales[kind]
        values: np.ndarray = np.frombuffer(content, types[size // beams], beams, at) / multiplier
        return values - offset if offset else values


def single(content: memoryview) -> Ping:
    """Return the ping of one beam of a single-beam record's bytes.

    Raises:
        PingError: the bytes are too few.
    """
    if len(content) < _SINGLE_HEADER.size:
        raise PingError(f"{len(content)} bytes are too short for a ping of a single beam")
    header = _SINGLE_HEADER.unpack_from(content)
    navigation, tide = _navigation(header[:4], *header[4:9])
    sensor = content[_SINGLE_HEADER.size] if len(content) >= _SINGLE_HEADER.size + 4 else 0
    none, depth = np.zeros(1), np.array([header[10] / 100.0])
    return Ping(navigation, none, none, depth, np.zeros(1, bool), True, gsf_sensors.name(sensor, b""), tide)


def _navigation(
    when_where: tuple[int, ...], tide: int, corrector: int, heading: int, pitch: int, roll: int
) -> tuple[tuple[float, ...], bool]:
    """Return the columns of a ping, and whether a tide was added to its depths."""
    seconds, nanoseconds, longitude, latitude = when_where
    if nanoseconds >= 1_000_000_000:
        raise PingError(f"its time has {nanoseconds} nanoseconds")
    # positive: a submersible's depth, or draught; negative: a ship's heave, and the ship is at the surface
    vehicle = max(0, corrector) / 100.0 if corrector != _NO_CORRECTOR else 0.0
    angles = [math.radians(angle / 100.0) if angle != _NO_ANGLE else math.nan for angle in (roll, pitch)]
    angles.append(math.radians(heading / 100.0) if heading <= _FULL_CIRCLE else math.nan)
    place = (seconds + nanoseconds / 1e9, longitude / 1e7, latitude / 1e7, vehicle)
    return (*place, *angles), tide not in (0, _NO_CORRECTOR)


def _parts(content: memoryview, at: int, beams: int) -> Parts:
    """Return where each part of a ping begins and its size, by its kind, after checking it."""
    parts: Parts = {}
    end = len(content)
    while end - at > 4:  # fewer are padding
        kind, size = content[at], int.from_bytes(content[at + 1 : at + 4], "big")
        size -= 4 if kind == _INTENSITIES else 0  # the one part that counts its own first word
        at += 4
        if size < 0 or at + size > end:
            raise PingError(f"its part {kind} of {size} bytes goes beyond it")
        if kind in _NAMES and size not in (beams, 2 * beams, 4 * beams):
            raise PingError(f"its part {kind} has {size} bytes for {beams} beams")
        parts[kind] = (at, size)
        at += size
    return parts


@lru_cache(maxsize=16)  # most files repeat one table with every ping
def _scales(table: bytes) -> dict[int, tuple[int, int]]:
    """Return the multiplier and offset of each kind of array that the table names."""
    count = int.from_bytes(table[:4], "big")
    if table and len(table) < 4 + 12 * count:
        raise PingError("its scale factors are cut off")
    found = {}
    for at in range(4, 4 + 12 * count, 12):
        kind, packing, _, multiplier, offset = struct.unpack_from(">BBHIi", table, at)
        if kind in _NAMES and (multiplier == 0 or packing & 0x0F):
            raise PingError(f"the scale factor of its part {kind} is zero or its packing unknown")
        found[kind] = (multiplier, offset)
    return found


def _rejected(content: memoryview, parts: Parts, beams: int) -> np.ndarray:
    """Return which beams are refused: by their flags, or where there are none by the sonar's two tests."""
    if _FLAGS in parts:
        at, size = parts[_FLAGS]
        if size != beams:
            raise PingError(f"it has {size} beam flags for {beams} beams")
        return (np.frombuffer(content, np.uint8, beams, at) & _IGNORED) != 0
    if _QUALITY in parts:
        at, size = parts[_QUALITY]
        if 4 * size < beams:
            raise PingError(f"it has {4 * size} quality flags for {beams} beams")
        packed = np.frombuffer(
            content, np.uint8, size, at
        )  # 2 bits a beam: has passed for brightness, for collinearity
        return np.stack([packed >> shift & 3 for shift in (6, 4, 2, 0)], 1).ravel()[:beams] == 0
    return np.zeros(beams, bool)


def _sensor(content: memoryview, parts: Parts) -> str:
    for kind, (at, size) in parts.items():
        if kind > _SCALES:
            return gsf_sensors.name(kind, bytes(content[at : at + size]))
    return ""
