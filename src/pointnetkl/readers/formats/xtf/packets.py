"""The packets of an XTF file: where each is, whether its length can be trusted, and what their common fields say.

After Triton Imaging's "eXtended Triton Format (XTF)", revisions 26 to 44: a file header of 1024 bytes or a multiple of
it, then packets in any order, each of which begins with 0xFACE, its type and its length.
"""

import datetime
import functools
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

from pointnetkl.readers.formats.window import Window

METRES, DEGREES = 0, 3  # units of positions
SONAR, BATHYMETRY, ATTITUDE, Q_MULTIBEAM, GYRO, NAVIGATION = 0, 2, 3, 28, 23, 42
RESON, QINSY_R2SONIC, R2SONIC, TIMED_GYRO, RAW_NAVIGATION = 61, 65, 68, 84, 107
HEADER = 256  # bytes of a ping's header, before what the sonar itself has said
# of pings that are not read: their number is told
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

_FILE_MARK, _MARK = 0x7B, b"\xce\xfa"
_BLOCK = 1024  # bytes, of which a file header is one or several
_BLOCKS = 16
_START = struct.Struct("<2sBBHHHI")
_SMALLEST, _LARGEST = 24, 1 << 26  # bytes of a packet
_STRETCH = 1 << 16  # bytes that are searched at once for the next packet
_DAY_S = 86_400.0
_YEARS = range(1980, 2100)
_CENTURY = 70  # years of two digits from it on are of the 20th
_CLOCK = struct.Struct("<HBBBBB")


class Packet(NamedTuple):
    """A packet whose length fits the file and what comes behind it."""

    offset: int
    kind: int
    channel: int  # of a ping: which of the file's sonars it is from
    size: int


@dataclass(frozen=True)
class Place:
    """Where a sensor is on the vessel, metres, and how it is turned, degrees."""

    forward: float = 0.0
    starboard: float = 0.0
    down: float = 0.0
    roll: float = 0.0  # starboard side down
    pitch: float = 0.0  # nose up
    yaw: float = 0.0  # to starboard

    @property
    def stated(self) -> bool:
        """Whether there is any offset: a header without one leaves it at zero."""
        return any((self.forward, self.starboard, self.down))


@dataclass(frozen=True)
class FileHeader:
    """What a file's header says of the vessel and of its units."""

    units: int  # of positions
    reference_m: float  # height of the reference point above the water line
    latency_s: float  # by which positions are late
    navigation: Place
    motion: Place
    sonars: tuple[Place, ...]  # of the bathymetry channels


Damaged = Callable[[int, int, int], None]  # told of each damage: first byte, byte after, type of a packet lost or -1


def begins(head: bytes) -> bool:
    """Return whether a file's first bytes are a header of XTF with a packet behind it."""
    return head[:1] == bytes([_FILE_MARK]) and any(
        head[at : at + 2] == _MARK for at in range(_BLOCK, len(head), _BLOCK)
    )


def header(window: Window) -> FileHeader | None:
    """Return what the file's header says, None where the file ends in it."""
    data = bytes(window.read(0, _BLOCK))
    if len(data) < _BLOCK:
        return None
    latency = struct.unpack_from("<i", data, 204)[0] / 1000.0
    channels = (data[at : at + 128] for at in range(256, _BLOCK, 128))
    return FileHeader(
        struct.unpack_from("<H", data, 164)[0],
        _sane(*struct.unpack_from("<f", data, 178)),
        latency if abs(latency) < 10.0 else 0.0,
        _place(data, 216, "yxz", 4),
        _place(data, 232, "yxz", 6),
        tuple(_place(channel, 48, "xyz", 6) for channel in channels if channel[0] == 3),
    )


def walk(window: Window, probe: Window, damaged: Damaged) -> Iterator[Packet]:
    """Yield the packets in order; after damage, go on where one is found that another, or the file's end, follows.

    `probe` is the same file, of which little is held: after damage what may be lengths point anywhere.
    """
    at = _first(window)
    sizes: dict[int, int] = {}  # of the latest packet of each type, whose next one need not be followed by a mark
    while at < window.size:
        packet = _packet(window, at)
        if packet and (_followed(window, packet) or sizes.get(packet.kind) == packet.size):
            sizes[packet.kind] = packet.size
            yield packet
            at += packet.size
            continue
        begin, at = at, _resumed(window, probe, at + 1)
        damaged(begin, at, _kind(window, begin))


def clock(data: bytes | memoryview, at: int) -> float:
    """Return the time of year, month, day, hour, minute and second at a place, s UTC since 1970; NaN if impossible."""
    year, month, day, hour, minute, second = _CLOCK.unpack_from(data, at)
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


def _place(data: bytes, at: int, order: str, count: int) -> Place:
    values = [_sane(value) for value in struct.unpack_from(f"<{count}f", data, at)]
    offset = dict(zip(order, values, strict=False))
    yaw, pitch, roll = [*values[3:], 0.0, 0.0][:3]
    return Place(offset["y"], offset["x"], offset["z"], roll, pitch, yaw)


def _sane(value: float) -> float:
    return value if abs(value) <= 360.0 else 0.0  # also what is not a number


def _first(window: Window) -> int:
    """Return where the first packet is: behind the header's blocks of 1024 bytes, else wherever one is credible."""
    for at in range(_BLOCK, _BLOCK * (_BLOCKS + 1), _BLOCK):
        if bytes(window.read(at, 2)) == _MARK:
            return at
    return min(_BLOCK, window.size)


def _packet(window: Window, at: int) -> Packet | None:
    data = window.read(at, _START.size)
    if len(data) < _START.size:
        return None
    mark, kind, channel, _, _, _, size = _START.unpack(data)
    good = mark == _MARK and _SMALLEST <= size <= min(_LARGEST, window.size - at)
    return Packet(at, kind, channel, size) if good else None


def _followed(window: Window, packet: Packet) -> bool:
    end = packet.offset + packet.size
    return _MARK.startswith(bytes(window.read(end, len(_MARK)))) if end < window.size else True


def _resumed(window: Window, probe: Window, at: int) -> int:
    while at + _START.size <= window.size:
        stretch = bytes(window.read(at, _STRETCH))
        found = stretch.find(_MARK)
        while found >= 0:
            packet = _packet(window, at + found)
            if packet and _followed(probe, packet):
                return packet.offset
            found = stretch.find(_MARK, found + 1)
        at += max(len(stretch) - 1, 1)
    return window.size


def _kind(window: Window, at: int) -> int:
    data = window.read(at, 3)
    return data[2] if len(data) == 3 and bytes(data[:2]) == _MARK else -1
