"""GSF files by the format's definition, byte by byte, for tests: a ship heading east, a seabed deeper to port."""

import struct
from collections.abc import Sequence

import numpy as np

BEAMS = np.linspace(-40, 40, 21)
DEPTH, ACROSS, ALONG = 45.0 - BEAMS / 8, BEAMS, np.full(len(BEAMS), 2.0)
TIME = 1_400_000_000

PING, COMMENT, PARAMETERS, SINGLE_BEAM, ATTITUDE = 2, 6, 4, 10, 12
Scales = dict[int, tuple[int, int]]
SCALES: Scales = {1: (100, 0), 2: (100, 0), 3: (100, 0), 14: (100, 0)}


def record(kind: int, data: bytes, checksum: bool = False, registry: int = 0) -> bytes:
    """Return a record with its two words and its checksum."""
    data += bytes(-len(data) % 4)
    word = kind | registry << 12 | checksum << 31
    return struct.pack(">II", len(data), word) + (struct.pack(">I", sum(data)) if checksum else b"") + data


def header(version: str = "GSF-v03.09") -> bytes:
    """Return the record at the beginning of a file."""
    return record(1, version.encode().ljust(12, b"\0"))


def part(kind: int, data: bytes) -> bytes:
    """Return a part of a ping."""
    return struct.pack(">I", kind << 24 | len(data)) + data


def scale_factors(scales: Scales) -> bytes:
    """Return the part with multiplier and offset of each kind of array."""
    table = b"".join(struct.pack(">BBHIi", kind, 0, 0, *factors) for kind, factors in scales.items())
    return part(100, struct.pack(">I", len(scales)) + table)


def array(kind: int, values: np.ndarray, scales: Scales = SCALES, width: int = 2) -> bytes:
    """Return the part with an array as whole numbers of so many bytes, signed across and along track."""
    multiplier, offset = scales[kind]
    raw = np.round((values + offset) * multiplier)
    return part(kind, raw.astype(f">{'i' if kind in (2, 3) else 'u'}{width}").tobytes())


def swath(
    number: int = 0,
    parts: Sequence[bytes] | None = None,
    major: int = 3,
    beams: int = len(BEAMS),
    longitude: float = 5.0,
    latitude: float = 10.0,
    heading: float = 90.0,
    flags: int = 0,
    corrector: float = 0.0,
    tide: float = 0.0,
    nanoseconds: int = 0,
    checksum: bool = False,
) -> bytes:
    """Return the record of a swath bathymetry ping, a second and a metre behind the one before."""
    if parts is None:
        parts = [scale_factors(SCALES), *soundings(), part(16, bytes(3) + b"\1" + bytes(len(BEAMS) - 4))]
    place = (round(1e7 * longitude) + 100 * number, round(1e7 * latitude))
    time = (TIME + number, nanoseconds, *place, beams, 0, flags, 0)
    angles = (round(100 * heading), -100, 100, 0, 0, 0)
    data = struct.pack(">IIiiHHHHhiHhhhHH", *time, round(100 * tide), round(100 * corrector), *angles)
    return record(PING, data + bytes(14 if major > 2 else 0) + b"".join(parts), checksum)


def soundings(scales: Scales = SCALES, width: int = 2) -> list[bytes]:
    """Return the parts with depth, across and along track of BEAMS."""
    return [array(kind, values, scales, width) for kind, values in ((1, DEPTH), (2, ACROSS), (3, ALONG))]


def single_beam(number: int = 0, depth: float = 45.0, corrector: float = 0.0) -> bytes:
    """Return the record of a single-beam ping, with what is an Echotrac's own behind it."""
    time = (TIME + number, 0, 50_000_000 + 100 * number, 100_000_000)
    angles = (9000, -100, 100, 0)
    data = struct.pack(">IIiihiHhhhihH", *time, 0, round(100 * corrector), *angles, round(100 * depth), 0, 0)
    return record(SINGLE_BEAM, data + part(201, bytes(4)))


def parameters(**values: str) -> bytes:
    """Return the record of processing parameters."""
    texts = [f"{name}={value}".encode() + b"\0" for name, value in values.items()]
    counted = b"".join(struct.pack(">H", len(text)) + text for text in texts)
    return record(PARAMETERS, struct.pack(">IIH", TIME, 0, len(texts)) + counted)


def attitude(number: int = 0) -> bytes:
    """Return the record of one measurement of attitude."""
    return record(ATTITUDE, struct.pack(">IIHHhhhH", TIME + number, 0, 1, 0, 100, -100, 0, 9000))
