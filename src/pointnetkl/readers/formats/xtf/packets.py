"""The packets of an XTF file: their places, whether their lengths can be trusted, and their common fields.

By Triton Imaging's "eXtended Triton Format (XTF)", revisions 26 to 44, a file has a header of 1024 bytes or a multiple,
then packets in any order; a packet begins with 0xFACE, its type and its length.
"""

import datetime
import functools
import re
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

from pointnetkl.readers.formats.window import Mark, Window, candidates

METRES, DEGREES = 0, 3  # units of positions
SONAR, BATHYMETRY, ATTITUDE, Q_MULTIBEAM, GYRO, NAVIGATION = 0, 2, 3, 28, 23, 42
RESON, QINSY_R2SONIC, R2SONIC, TIMED_GYRO, RAW_NAVIGATION = 61, 65, 68, 84, 107
HEADER = 256  # bytes of a ping's header, before the sonar's own data
# types of packets with pings; those that are not read are counted
NAMES = {
    SONAR: "side-scan sonar",
    BATHYMETRY: "bathymetry as the sonar sent it",
    4: "forward-looking sonar",
    5: "ELAC multibeam",
    8: "hidden side-scan sonar",
    9: "SeaView angles",
    10: "SeaView depths",
    14: "Klein bathymetry",
    16: "ELAC XSE multibeam",
    17: "processed bathymetry XYZA",
    18: "Klein raw bathymetry",
    22: "single beam",
    25: "multibeam",
    26: "QPS single beam",
    27: "QPS multi-transducer",
    Q_MULTIBEAM: "QPS multibeam",
    60: "Benthos C3D",
    RESON: "RESON 7k multibeam",
    QINSY_R2SONIC: "R2Sonic multibeam of QINSy",
    R2SONIC: "R2Sonic multibeam of Triton",
    70: "CODA Echoscope",
    73: "EdgeTech 4600",
    74: "Kongsberg beams",
    102: "processed bathymetry",
    104: "processed single beam",
    106: "Klein 3000",
    108: "Klein",
}

_FILE_MARK, _PACKET_MARK = 0x7B, b"\xce\xfa"
_BLOCK = 1024  # bytes, of which a file header is one or several
_BLOCKS = 16
_START = struct.Struct("<2sBBHHHI")
_SMALLEST, _LARGEST = 24, 1 << 26  # bytes of a packet
_MARK = Mark(re.compile(re.escape(_PACKET_MARK)), lead=0, length=2, header=_START.size)
_DAY_S = 86_400.0
_YEARS = range(1980, 2100)
_CENTURY = 70  # years of two digits from this one on are of the 20th century
_CLOCK = struct.Struct("<HBBBBB")


class Packet(NamedTuple):
    """A packet whose length fits the file and the next packet."""

    offset: int
    kind: int
    channel: int  # of a ping: the number of its sonar
    size: int


@dataclass(frozen=True)
class Mounting:
    """Place of a sensor on the vessel, metres, and its rotation, degrees."""

    forward: float = 0.0
    starboard: float = 0.0
    down: float = 0.0
    roll: float = 0.0  # starboard side down
    pitch: float = 0.0  # nose up
    yaw: float = 0.0  # to starboard

    @property
    def stated(self) -> bool:
        """Whether the header states an offset: unknown offsets are zero."""
        return any((self.forward, self.starboard, self.down))


@dataclass(frozen=True)
class FileHeader:
    """The vessel and the units, by a file's header."""

    units: int  # of positions
    reference_m: float  # height of the reference point above the water line
    latency_s: float  # delay of positions
    navigation: Mounting
    motion: Mounting
    sonars: tuple[Mounting, ...]  # of the bathymetry channels


# is called with damaged bytes: first, one after the last, type of the packet that begins there or -1
Damaged = Callable[[int, int, int], None]


def begins(head: bytes) -> bool:
    """Return whether a file's first bytes are a header of XTF with a packet behind it."""
    return head[:1] == bytes([_FILE_MARK]) and any(
        head[offset : offset + 2] == _PACKET_MARK for offset in range(_BLOCK, len(head), _BLOCK)
    )


def header(window: Window) -> FileHeader | None:
    """Return the file's header; None if the file ends within it."""
    data = bytes(window.read(0, _BLOCK))
    if len(data) < _BLOCK:
        return None
    latency = struct.unpack_from("<i", data, 204)[0] / 1000.0
    channels = (data[offset : offset + 128] for offset in range(256, _BLOCK, 128))
    return FileHeader(
        struct.unpack_from("<H", data, 164)[0],
        _sane(*struct.unpack_from("<f", data, 178)),
        latency if abs(latency) < 10.0 else 0.0,
        _mounting(data, 216, "yxz", 4),
        _mounting(data, 232, "yxz", 6),
        tuple(_mounting(channel, 48, "xyz", 6) for channel in channels if channel[0] == 3),
    )


def walk(window: Window, probe: Window, damaged: Damaged) -> Iterator[Packet]:
    """Yield the packets in order; after damage, resume at a packet that another one, or the file's end, follows.

    `probe` is the same file, read in small pieces, because the lengths that are tried after damage point anywhere.
    """
    offset = _first(window)
    sizes: dict[int, int] = {}  # by type, of the latest packet; one of equal size is credible without a next mark
    while offset < window.size:
        packet = _packet(window, offset)
        if packet and (_followed(window, packet) or sizes.get(packet.kind) == packet.size):
            sizes[packet.kind] = packet.size
            yield packet
            offset += packet.size
            continue
        begin, offset = offset, _resumed(window, probe, offset + 1)
        damaged(begin, offset, _kind(window, begin))


def clock(data: bytes | memoryview, offset: int) -> float:
    """Return the time in year, month, day, hour, minute, second at an offset, s UTC since 1970; NaN if impossible."""
    year, month, day, hour, minute, second = _CLOCK.unpack_from(data, offset)
    if hour > 23 or minute > 59 or second > 60:
        return float("nan")
    return _midnight(year, month, day) + 3600.0 * hour + 60.0 * minute + second


@functools.lru_cache
def _midnight(year: int, month: int, day: int) -> float:
    if year < 100:
        year += 1900 if year >= _CENTURY else 2000
    if year not in _YEARS:
        return float("nan")
    try:
        return (datetime.date(year, month, day).toordinal() - 719_163) * _DAY_S
    except ValueError:
        return float("nan")


def _mounting(data: bytes, start: int, order: str, count: int) -> Mounting:
    values = [_sane(value) for value in struct.unpack_from(f"<{count}f", data, start)]
    offset = dict(zip(order, values, strict=False))
    yaw, pitch, roll = [*values[3:], 0.0, 0.0][:3]
    return Mounting(offset["y"], offset["x"], offset["z"], roll, pitch, yaw)


def _sane(value: float) -> float:
    return value if abs(value) <= 360.0 else 0.0  # also what is not a number


def _first(window: Window) -> int:
    """Return where the first packet is expected: after the header's blocks of 1024 bytes."""
    for offset in range(_BLOCK, _BLOCK * (_BLOCKS + 1), _BLOCK):
        if bytes(window.read(offset, 2)) == _PACKET_MARK:
            return offset
    return min(_BLOCK, window.size)


def _packet(window: Window, offset: int) -> Packet | None:
    data = window.read(offset, _START.size)
    if len(data) < _START.size:
        return None
    mark, kind, channel, _, _, _, size = _START.unpack(data)
    good = mark == _PACKET_MARK and _SMALLEST <= size <= min(_LARGEST, window.size - offset)
    return Packet(offset, kind, channel, size) if good else None


def _followed(window: Window, packet: Packet) -> bool:
    end = packet.offset + packet.size
    return _PACKET_MARK.startswith(bytes(window.read(end, len(_PACKET_MARK)))) if end < window.size else True


def _resumed(window: Window, probe: Window, begin: int) -> int:
    for candidate, _ in candidates(window, _MARK, begin, window.size):
        packet = _packet(window, candidate)
        if packet and _followed(probe, packet):
            return candidate
    return window.size


def _kind(window: Window, offset: int) -> int:
    data = window.read(offset, 3)
    return data[2] if len(data) == 3 and bytes(data[:2]) == _PACKET_MARK else -1
