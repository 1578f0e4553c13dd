"""The pings of a GSF file, decoded from their bytes: a header, then scaled arrays, one per quantity.

The layout is that of the Generic Sensor Format Specification (Leidos) up to version 03.10.
"""

import math
import struct
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from pointnetkl.readers.formats.gsf import sensors as gsf_sensors
from pointnetkl.surveys.survey import SurveyError

# time; longitude, latitude; beams, centre, flags, spare; tide, depth corrector; heading; pitch, roll, heave; course,
# speed. A header of version 3 continues with heights above the ellipsoid, which are not used here
_HEADER = struct.Struct(">IIiiHHHHhiHhhhHH")
_SINGLE_HEADER = struct.Struct(">IIiihiHhhhihH")  # the same without beams and flags; depth, sound speed correction
_HEADER_BYTES = {1: 42, 2: 42, 3: 56}

_DEPTH, _ACROSS, _ALONG, _NOMINAL, _QUALITY, _FLAGS, _INTENSITIES, _SCALES = 1, 2, 3, 14, 15, 16, 21, 100
_NAMES = {_DEPTH: "depths", _ACROSS: "across track", _ALONG: "along track", _NOMINAL: "nominal depths"}
_ARRAYS = range(1, 32)
_UNSIGNED, _SIGNED = {1: "u1", 2: ">u2", 4: ">u4"}, {1: "i1", 2: ">i2", 4: ">i4"}  # by bytes per value

# hundredths that mean an unknown value
_NO_CORRECTOR, _NO_ANGLE, _FULL_CIRCLE = 9999, 9900, 36000
_IGNORED = 1  # bit of a ping's or beam's flags; the other bits select soundings or give a reason

Parts = dict[int, tuple[int, int]]  # of a ping, by kind: first byte, and size


class PingError(SurveyError):
    """The bytes of a ping cannot be used."""


class SwathPing(NamedTuple):
    """A ping of n beams; arrays (n,), metres. Depths are below the surface and include draught and tide."""

    navigation: tuple[float, ...]  # recording.PING_COLUMNS
    along_m: np.ndarray
    across_m: np.ndarray
    depth_m: np.ndarray
    rejected: np.ndarray  # beams refused by the sonar or its operator
    placed: bool  # whether the file has the beams' distances across track
    sensor: str
    tide: bool  # whether a tide was added to its depths


class Decoder:
    """Decodes the pings of one file in their order: scale factors hold until the next ones."""

    def __init__(self, major: int) -> None:
        """Decode pings of a major version of the format."""
        self._header = _HEADER_BYTES[major]
        self._scales: dict[int, tuple[int, int]] = {}  # multiplier and offset of each kind of array

    def forget(self) -> None:
        """Forget the scale factors, because later ones may have been lost."""
        self._scales = {}

    def swath(self, content: memoryview) -> SwathPing:
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
        return SwathPing(navigation, along, across, depth, rejected, placed, _sensor(content, parts), tide)

    def _checked(self, content: memoryview, beams: int) -> Parts:
        """Return the parts of a ping, and keep its scale factors."""
        try:
            parts = _parts(content, self._header, beams)
            offset, size = parts.get(_SCALES, (0, 0))
            self._scales |= _scales(bytes(content[offset : offset + size]))
        except PingError:
            if content[self._header] not in _ARRAYS:  # a ping that begins with an array has no scale factors
                self.forget()
            raise
        return parts

    def _array(self, content: memoryview, parts: Parts, kind: int, beams: int) -> np.ndarray:
        if kind not in parts or not beams:
            return np.zeros(beams)
        if kind not in self._scales:
            raise PingError(f"no scale factors are known for its {_NAMES[kind]}")
        start, size = parts[kind]
        types = _SIGNED if kind in (_ACROSS, _ALONG) else _UNSIGNED
        multiplier, offset = self._scales[kind]
        values: np.ndarray = np.frombuffer(content, types[size // beams], beams, start) / multiplier
        return values - offset if offset else values


def single(content: memoryview) -> SwathPing:
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
    return SwathPing(navigation, none, none, depth, np.zeros(1, bool), True, gsf_sensors.name(sensor, b""), tide)


def _navigation(
    time_and_place: tuple[int, ...], tide: int, corrector: int, heading: int, pitch: int, roll: int
) -> tuple[tuple[float, ...], bool]:
    """Return a ping's recording.PING_COLUMNS, and whether a tide was added to its depths."""
    seconds, nanoseconds, longitude, latitude = time_and_place
    if nanoseconds >= 1_000_000_000:
        raise PingError(f"its time has {nanoseconds} nanoseconds")
    # a positive corrector is a submersible's depth or a draught; a negative one is the heave of a ship at the surface
    depth = max(0, corrector) / 100.0 if corrector != _NO_CORRECTOR else 0.0
    angles = [math.radians(angle / 100.0) if angle != _NO_ANGLE else math.nan for angle in (roll, pitch)]
    angles.append(math.radians(heading / 100.0) if heading <= _FULL_CIRCLE else math.nan)
    place = (seconds + nanoseconds / 1e9, longitude / 1e7, latitude / 1e7, depth)
    return (*place, *angles), tide not in (0, _NO_CORRECTOR)


def _parts(content: memoryview, offset: int, beams: int) -> Parts:
    """Return the first byte and the size of each part of a ping by its kind, after a check of the sizes."""
    parts: Parts = {}
    end = len(content)
    while end - offset > 4:  # fewer bytes are padding
        kind, size = content[offset], int.from_bytes(content[offset + 1 : offset + 4], "big")
        size -= 4 if kind == _INTENSITIES else 0  # the one part that counts its own first word
        offset += 4
        if size < 0 or offset + size > end:
            raise PingError(f"its part {kind} of {size} bytes goes beyond it")
        if kind in _NAMES and size not in (beams, 2 * beams, 4 * beams):
            raise PingError(f"its part {kind} has {size} bytes for {beams} beams")
        parts[kind] = (offset, size)
        offset += size
    return parts


@lru_cache(maxsize=16)  # most files repeat one table with every ping
def _scales(table: bytes) -> dict[int, tuple[int, int]]:
    """Return the multiplier and offset of each kind of array that the table names."""
    count = int.from_bytes(table[:4], "big")
    if table and len(table) < 4 + 12 * count:
        raise PingError("its scale factors are cut off")
    scales = {}
    for entry in range(4, 4 + 12 * count, 12):
        kind, packing, _, multiplier, offset = struct.unpack_from(">BBHIi", table, entry)
        if kind in _NAMES and (multiplier == 0 or packing & 0x0F):
            raise PingError(f"the scale factor of its part {kind} is zero or its packing unknown")
        scales[kind] = (multiplier, offset)
    return scales


def _rejected(content: memoryview, parts: Parts, beams: int) -> np.ndarray:
    """Return which beams are refused: by their flags, or without flags by the sonar's two tests."""
    if _FLAGS in parts:
        offset, size = parts[_FLAGS]
        if size != beams:
            raise PingError(f"it has {size} beam flags for {beams} beams")
        return (np.frombuffer(content, np.uint8, beams, offset) & _IGNORED) != 0
    if _QUALITY in parts:
        offset, size = parts[_QUALITY]
        if 4 * size < beams:
            raise PingError(f"it has {4 * size} quality flags for {beams} beams")
        # 2 bits a beam: passed the test of brightness, and that of collinearity
        packed = np.frombuffer(content, np.uint8, size, offset)
        return np.stack([packed >> shift & 3 for shift in (6, 4, 2, 0)], 1).ravel()[:beams] == 0
    return np.zeros(beams, bool)


def _sensor(content: memoryview, parts: Parts) -> str:
    for kind, (offset, size) in parts.items():
        if kind > _SCALES:
            return gsf_sensors.name(kind, bytes(content[offset : offset + size]))
    return ""
