"""The datagrams of a .kmall file (Kongsberg document 410224, revisions F to J): their places and contents."""

import re
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from pointnetkl.readers.formats.window import Mark, Window, candidates

PING, ATTITUDE, INSTALLATION = b"#MRZ", b"#SKM", b"#IIP"

_HEADER = struct.Struct("<I4sBBHII")  # size, type, version, system, echo sounder, seconds, nanoseconds
_SIZE = struct.Struct("<I")  # repeated at the end of a datagram: the format's only check
_KIND = re.compile(rb"#[A-Z][A-Z0-9]{2}")
_MARK = Mark(_KIND, lead=4, length=4, header=20)
_LARGEST = 1 << 26  # bytes; 256 packets of 64 kB by the format

_SECOND = 1_000_000_000

_PARTITION, _PAIR = struct.Struct("<HH"), struct.Struct("<HH")
_MOST_PARTS, _PACKET = 256, 1 << 16
_WHOLE_COMMON = 3  # version of #MRZ from which every part repeats the block common to the parts of a ping

_NAVIGATION = struct.Struct("<f8xf12x2d")  # heading, water line below the reference point, latitude, longitude
_RECEIVER = struct.Struct("<HHxxH18xHHH")  # size; soundings of the seabed; bytes of each; extra ones, classes, bytes
_COMMON, _INFO, _SECTORS, _MOTION = 12, 140, 92, 96  # sizes and places common to all versions of #MRZ
_FLAGS, _PLACES, _SOUNDING = slice(3, 5), slice(88, 108), 108

_SENSOR = struct.Struct("<HBBHHHH")  # size, system, status, format, samples, bytes of each, contents
_SAMPLE, _SAMPLES, _ACTIVE, _NO_ATTITUDE = 48, 1024, 1, 2
_MODEL, _UNIT = re.compile(r"\bEMXV:(\w{1,20})"), re.compile(r"\bSN=(\w{1,20})")
_TRANSDUCER = re.compile(r"\bTRAI_\w{1,4}:(?:[^,;]{0,60};){0,30}N=([1-9]\w{0,19})")


@dataclass(frozen=True)
class Datagram:
    """A datagram's place in the file, and its header; the two copies of its size agree."""

    offset: int
    size: int
    kind: bytes
    version: int
    sounder: int  # model, such as 2040
    time_s: float  # UTC since 1970; NaN where the nanoseconds are impossible

    def content(self, window: Window) -> memoryview:
        """Return the bytes between the header and the last four."""
        return window.read(self.offset + _HEADER.size, self.size - _HEADER.size - _SIZE.size)


@dataclass(frozen=True)
class MrzPing:
    """A #MRZ datagram: a swath, or the part of it of one head or of one of two swaths."""

    time_s: float
    longitude: float  # degrees, of the vessel's reference point; beyond 180 where it is unknown
    latitude: float  # degrees; beyond 90 where it is unknown
    heading_deg: float
    water_m: float  # the water line below the reference point; negative where the vehicle is below the water
    main: int  # number of soundings of the seabed; those after them are extra detections
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
    """Yield the datagrams in order; call `damaged` for bytes of none: first byte, byte after the last, pings lost.

    Only headers are read, so that a window with a small stretch skips the contents.
    """
    offset = 0
    while offset < window.size:
        if datagram := _datagram(window, offset):
            yield datagram
            offset += datagram.size
        else:
            begin = offset
            offset, pings = _resumed(window, offset)
            damaged(begin, offset, pings)


def _datagram(window: Window, offset: int) -> Datagram | None:
    header = window.read(offset, _HEADER.size)
    if len(header) < _HEADER.size:
        return None
    size, kind, version, _, sounder, seconds, nanoseconds = _HEADER.unpack(header)
    credible = _HEADER.size + _SIZE.size <= size <= min(_LARGEST, window.size - offset) and _KIND.match(kind)
    if not credible or _SIZE.unpack(window.read(offset + size - _SIZE.size, _SIZE.size)) != (size,):
        return None
    time_s = seconds + nanoseconds * 1e-9 if nanoseconds < _SECOND else np.nan
    return Datagram(offset, size, kind, version, sounder, time_s)


def _resumed(window: Window, begin: int) -> tuple[int, int]:
    """Return where the next datagram begins, and how many headers of pings are before it."""
    pings = 0
    for candidate, kind in candidates(window, _MARK, begin, window.size):
        if _datagram(window, candidate):
            return candidate, pings
        pings += kind == PING
    return window.size, pings


class Parts:
    """Joins the parts of a ping that was logged in the packets in which the sonar sent it."""

    def __init__(self) -> None:
        """Begin without parts."""
        self.lost = 0  # pings of which a part is missing
        self._first: Datagram | None = None
        self._pieces: list[bytes] = []
        self._lost_s = np.nan

    def join(self, datagram: Datagram, content: memoryview) -> tuple[Datagram, bytes | memoryview] | None:
        """Return a ping's first datagram, and its content after the partition; None until all parts are read."""
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
        self._pieces.append(bytes(content[_PARTITION.size + self._repeated(datagram, content, number) :]))
        if number < parts or self._first is None:
            return None
        joined = (self._first, b"".join(self._pieces))
        self._first, self._pieces = None, []
        return joined

    def close(self) -> None:
        """Give up a ping whose parts are not complete."""
        if self._first is not None:
            self._lose(self._first.time_s)

    def _next(self, parts: int, number: int, size: int) -> bool:
        fits = parts <= _MOST_PARTS and size <= _PACKET and number <= parts
        return fits and self._first is not None and number == len(self._pieces) + 1

    def _repeated(self, datagram: Datagram, content: memoryview, number: int) -> int:
        if number == 1 or datagram.version < _WHOLE_COMMON:
            return 0
        return int.from_bytes(content[_PARTITION.size : _PARTITION.size + 2], "little")

    def _lose(self, time_s: float) -> None:
        self.lost += time_s != self._lost_s
        self._first, self._pieces, self._lost_s = None, [], time_s


def ping(datagram: Datagram, content: bytes | memoryview) -> MrzPing | str:
    """Return the ping in a #MRZ datagram's content after the partition, or the reason why it cannot be used.

    Every block has the length that it states, so that additions of newer revisions are skipped.
    """
    info = int.from_bytes(content[:2], "little")
    if info < _COMMON or info + _INFO > len(content):
        return "it ends before its position"
    sectors, sector_bytes = _PAIR.unpack_from(content, info + _SECTORS)
    info_bytes = int.from_bytes(content[info : info + 2], "little")
    receiver = info + info_bytes + sectors * sector_bytes
    if info_bytes < _INFO or receiver + _RECEIVER.size > len(content):
        return f"its {sectors} sectors go beyond it"
    size, main, sounding_bytes, extra, classes, class_bytes = _RECEIVER.unpack_from(content, receiver)
    begin, count = receiver + size + classes * class_bytes, main + extra
    if size < _RECEIVER.size or begin + count * sounding_bytes > len(content) or (count and sounding_bytes < _SOUNDING):
        return f"its {count} soundings of {sounding_bytes} bytes do not fit"
    rows = np.frombuffer(memoryview(content)[begin : begin + count * sounding_bytes], np.uint8).reshape(
        count, sounding_bytes or _SOUNDING
    )
    heading, water, latitude, longitude = _NAVIGATION.unpack_from(content, info + _MOTION)
    places = rows[:, _PLACES].copy().view("<f4")
    return MrzPing(datagram.time_s, longitude, latitude, heading, water, main, rows[:, _FLAGS].copy(), places)


def attitude(content: memoryview) -> np.ndarray:
    """Return the samples (n, 3) of a #SKM datagram: time_s, roll and pitch in radians; none if its sensor is unused."""
    nothing = np.empty((0, 3))
    if len(content) < _SENSOR.size:
        return nothing
    begin, _, status, _, count, sample_bytes, _ = _SENSOR.unpack_from(content)
    fits = (
        count <= _SAMPLES
        and sample_bytes >= _SAMPLE
        and begin >= _SENSOR.size
        and begin + count * sample_bytes <= len(content)
    )
    if not fits or not status & _ACTIVE:
        return nothing
    rows = np.frombuffer(content[begin : begin + count * sample_bytes], np.uint8).reshape(count, sample_bytes)
    seconds, nanoseconds, doubts = rows[:, 8:20].copy().view("<u4").T
    with np.errstate(invalid="ignore"):
        angles = np.deg2rad(rows[:, 40:48].copy().view("<f4").astype(float))
    good = (nanoseconds < _SECOND) & (doubts & _NO_ATTITUDE == 0) & (np.abs(angles) < np.pi / 2).all(1)
    return np.column_stack([seconds + nanoseconds * 1e-9, angles])[good]


def sensor(content: memoryview) -> str:
    """Return the model in the text of a #IIP datagram, with the serial numbers of its transducers or of its unit."""
    text = bytes(content).decode("ascii", "replace")
    model, serials = _MODEL.search(text), _TRANSDUCER.findall(text) or _UNIT.findall(text)
    if not model:
        return ""
    return f"Kongsberg {model[1]}" + (f", serial {', '.join(dict.fromkeys(serials))}" if serials else "")
