"""The datagrams of a .kmall file (Kongsberg document 410224, revisions F to J): where they are and what they hold."""

import re
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from pointnetkl.readers.formats.window import Window

PING, ATTITUDE, INSTALLATION = b"#MRZ", b"#SKM", b"#IIP"

_HEADER = struct.Struct("<I4sBBHII")  # size, type, version, system, echo sounder, seconds, nanoseconds
_SIZE = struct.Struct("<I")  # again at the end: the one check that the format has
_KIND = re.compile(rb"#[A-Z][A-Z0-9]{2}")
_LARGEST = 1 << 26  # bytes; 256 packets of 64 kB by the format
_STRETCH = 1 << 20
_SECOND = 1_000_000_000

_PARTITION, _PAIR = struct.Struct("<HH"), struct.Struct("<HH")
_MOST_PARTS, _PACKET = 256, 1 << 16
_WHOLE_COMMON = 3  # version of #MRZ from which each part repeats what its ping's datagrams have in common

_NAVIGATION = struct.Struct("<f8xf12x2d")  # heading, water line below the reference point, latitude, longitude
_RECEIVER = struct.Struct("<HHxxH18xHHH")  # size; soundings of the seabed; bytes of each; extra ones, classes, bytes
_COMMON, _INFO, _SECTORS, _MOTION = 12, 140, 92, 96  # sizes and places that every version of #MRZ has
_FLAGS, _PLACES, _SOUNDING = slice(3, 5), slice(88, 108), 108

_SENSOR = struct.Struct("<HBBHHHH")  # size, system, status, format, samples, bytes of each, contents
_SAMPLE, _SAMPLES, _ACTIVE, _NO_ATTITUDE = 48, 1024, 1, 2
_MODEL, _UNIT = re.compile(r"\bEMXV:(\w{1,20})"), re.compile(r"\bSN=(\w{1,20})")
_TRANSDUCER = re.compile(r"\bTRAI_\w{1,4}:(?:[^,;]{0,60};){0,30}N=([1-9]\w{0,19})")


@dataclass(frozen=True)
class Datagram:
    """A datagram's place in the file, and its header; two copies of its size agree."""

    offset: int
    size: int
    kind: bytes
    version: int
    sounder: int  # model, such as 2040
    time_s: float  # UTC since 1970; NaN where the nanoseconds are none

    def content(self, window: Window) -> memoryview:
        """Return what stands between the header and the last four bytes."""
        return window.read(self.offset + _HEADER.size, self.size - _HEADER.size - _SIZE.size)


@dataclass(frozen=True)
class Ping:
    """What a #MRZ datagram tells of a swath, or of the part of it that one head or one of two swaths has."""

    time_s: float
    longitude: float  # degrees, of the vessel's reference point; beyond 180 where there is none
    latitude: float  # degrees; beyond 90 where there is none
    heading_deg: float
    water_m: float  # the water line below the reference point; negative where the vehicle is below the water
    main: int  # soundings of the seabed; what comes after them are extra detections
    flags: np.ndarray  # (n, 2) type and method of detection
    places: np.ndarray  # (n, 5) from that point: degrees of latitude and longitude; metres down, starboard, forward


def begins(head: bytes) -> bool:
    """Return whether a file's first bytes are those of a datagram."""
    if len(head) < _HEADER.size or not _KIND.match(head, 4):
        return False
    (size,) = _SIZE.unpack_from(head)
    whole = _HEADER.size + _SIZE.size <= size <= _LARGEST
    return whole and (size > len(head) or _SIZE.unpack_from(head, size - _SIZE.size) == (size,))


def walk(window: Window, damaged: Callable[[int, int, int], None]) -> Iterator[Datagram]:
    """Yield the datagrams in order; `damaged` is told of bytes that are none: first, one after the last, pings lost.

    Only headers are looked at, so a window with a small stretch passes over what is not to be read.
    """
    at = 0
    while at < window.size:
        if datagram := _datagram(window, at):
            yield datagram
            at += datagram.size
        else:
            begin = at
            at, pings = _resumed(window, at)
            damaged(begin, at, pings)


def _datagram(window: Window, at: int) -> Datagram | None:
    header = window.read(at, _HEADER.size)
    if len(header) < _HEADER.size:
        return None
    size, kind, version, _, sounder, seconds, nanoseconds = _HEADER.unpack(header)
    credible = _HEADER.size + _SIZE.size <= size <= min(_LARGEST, window.size - at) and _KIND.match(kind)
    if not credible or _SIZE.unpack(window.read(at + size - _SIZE.size, _SIZE.size)) != (size,):
        return None
    time_s = seconds + nanoseconds * 1e-9 if nanoseconds < _SECOND else np.nan
    return Datagram(at, size, kind, version, sounder, time_s)


def _resumed(window: Window, at: int) -> tuple[int, int]:
    """Return where the next datagram begins, and how many headers of pings were passed on the way."""
    pings = 0
    while at + _HEADER.size < window.size:
        stretch = bytes(window.read(at, _STRETCH))
        for found in _KIND.finditer(stretch, 4):
            begin = at + found.start() - 4
            if _datagram(window, begin):
                return begin, pings
            pings += found[0] == PING
        at += max(1, len(stretch) - 7)  # a mark may be cut in two, and has four bytes before it
    return window.size, pings


class Parts:
    """Puts a ping together that was logged in the packets in which the sonar sent it."""

    def __init__(self) -> None:
        """Begin with nothing held."""
        self.lost = 0  # pings of which a part is missing
        self._first: Datagram | None = None
        self._held: list[bytes] = []
        self._lost_s = np.nan

    def whole(self, datagram: Datagram, content: memoryview) -> tuple[Datagram, bytes | memoryview] | None:
        """Return a ping's first datagram and its content behind the partition; None until all parts are there."""
        if len(content) < _PARTITION.size:
            return datagram, b""
        parts, number = _PARTITION.unpack_from(content)
        if parts <= 1:
            return datagram, content[_PARTITION.size :]
        if number == 1 or (self._first is not None and self._first.time_s != datagram.time_s):
            self.close()
        if number == 1:
            self._first = datagram
        if not self._next(parts, number, len(content)):
            self._lose(datagram.time_s)
            return None
        self._held.append(bytes(content[_PARTITION.size + self._repeated(datagram, content, number) :]))
        if number < parts or self._first is None:
            return None
        whole = (self._first, b"".join(self._held))
        self._first, self._held = None, []
        return whole

    def close(self) -> None:
        """Give up what is held."""
        if self._first is not None:
            self._lose(self._first.time_s)

    def _next(self, parts: int, number: int, size: int) -> bool:
        fits = parts <= _MOST_PARTS and size <= _PACKET and number <= parts
        return fits and self._first is not None and number == len(self._held) + 1

    def _repeated(self, datagram: Datagram, content: memoryview, number: int) -> int:
        if number == 1 or datagram.version < _WHOLE_COMMON:
            return 0
        return int.from_bytes(content[_PARTITION.size : _PARTITION.size + 2], "little")

    def _lose(self, time_s: float) -> None:
        self.lost += time_s != self._lost_s
        self._first, self._held, self._lost_s = None, [], time_s


def ping(datagram: Datagram, content: bytes | memoryview) -> Ping | str:
    """Return what a #MRZ datagram holds behind its partition, or why that cannot be used.

    Every block is as long as it says itself, so that what newer revisions add is passed over.
    """
    info = int.from_bytes(content[:2], "little")
    if info < _COMMON or info + _INFO > len(content):
        return "it ends before its position"
    sectors, sector_bytes = _PAIR.unpack_from(content, info + _SECTORS)
    info_bytes = int.from_bytes(content[info : info + 2], "little")
    receiver = info + info_bytes + sectors * sector_bytes
    if info_bytes < _INFO or receiver + _RECEIVER.size > len(content):
        return f"its {sectors} sectors go beyond it"
    size, main, each, extra, classes, class_bytes = _RECEIVER.unpack_from(content, receiver)
    begin, count = receiver + size + classes * class_bytes, main + extra
    if size < _RECEIVER.size or begin + count * each > len(content) or (count and each < _SOUNDING):
        return f"its {count} soundings of {each} bytes do not fit"
    rows = np.frombuffer(memoryview(content)[begin : begin + count * each], np.uint8).reshape(count, each or _SOUNDING)
    heading, water, latitude, longitude = _NAVIGATION.unpack_from(content, info + _MOTION)
    places = rows[:, _PLACES].copy().view("<f4")
    return Ping(datagram.time_s, longitude, latitude, heading, water, main, rows[:, _FLAGS].copy(), places)


def attitude(content: memoryview) -> np.ndarray:
    """Return what a #SKM datagram holds, (n, 3): time_s, roll and pitch in radians; none unless its sensor is used."""
    nothing = np.empty((0, 3))
    if len(content) < _SENSOR.size:
        return nothing
    begin, _, status, _, count, each, _ = _SENSOR.unpack_from(content)
    fits = count <= _SAMPLES and each >= _SAMPLE and begin >= _SENSOR.size and begin + count * each <= len(content)
    if not fits or not status & _ACTIVE:
        return nothing
    rows = np.frombuffer(content[begin : begin + count * each], np.uint8).reshape(count, each)
    seconds, nanoseconds, doubts = rows[:, 8:20].copy().view("<u4").T
    with np.errstate(invalid="ignore"):
        angles = np.deg2rad(rows[:, 40:48].copy().view("<f4").astype(float))
    good = (nanoseconds < _SECOND) & (doubts & _NO_ATTITUDE == 0) & (np.abs(angles) < np.pi / 2).all(1)
    return np.column_stack([seconds + nanoseconds * 1e-9, angles])[good]


def sensor(content: memoryview) -> str:
    """Return the model that a #IIP datagram's text names, with the serial numbers of its transducers or of its unit."""
    text = bytes(content).decode("ascii", "replace")
    model, serials = _MODEL.search(text), _TRANSDUCER.findall(text) or _UNIT.findall(text)
    if not model:
        return ""
    return f"Kongsberg {model[1]}" + (f", serial {', '.join(dict.fromkeys(serials))}" if serials else "")
