"""The datagrams of a Kongsberg .all or .wcd file: where each is, and whether its bytes can be trusted.

After Kongsberg's "EM Series Multibeam echo sounders, Datagram formats" (160692): a length, then that many bytes, from
STX to ETX and the sum of the bytes between these two; either byte order.
"""

import datetime
import functools
import re
import struct
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from pointnetkl.readers.formats.window import Window

LITTLE, BIG = "<", ">"

_STX, _ETX = 2, 3
_LENGTH, _HEADER, _TAIL = 4, 20, 3  # bytes: of the length; with it to the serial number; of ETX and the sum
_SMALLEST, _LARGEST = _HEADER - _LENGTH + _TAIL, 1 << 20  # of what a length counts; the sonars stay below 64 KiB
_STRETCH = 1 << 22  # bytes that are summed at once
_DAY_MS = 86_400_000
_YEARS = range(1985, 2100)
_HEADERS = {order: struct.Struct(order + "IBBHIIHH") for order in (LITTLE, BIG)}
_SUMS = {order: struct.Struct(order + "BH") for order in (LITTLE, BIG)}
_KINDS = [bytes((kind,)) for kind in range(256)]
# STX, a type, the model, and a date from 1985 to 2100: 0x012EE2F5 to 0x01406C33
_BEGINS = {
    LITTLE: re.compile(rb"\x02(?=[\x1f-\x7f].{4}[\x2e-\x40]\x01)", re.DOTALL),
    BIG: re.compile(rb"\x02(?=[\x1f-\x7f].{2}\x01[\x2e-\x40])", re.DOTALL),
}


class Datagram(NamedTuple):
    """A datagram whose checksum is right."""

    offset: int
    kind: bytes  # its type, one letter
    model: int
    time_s: float  # UTC since 1970; NaN where date or time of day are impossible
    serial: int
    content: memoryview  # what stands between its header and ETX

    @property
    def start(self) -> int:
        """Byte at which the content begins."""
        return self.offset + _HEADER


Damaged = Callable[[int, int, bytes], None]  # told of each damage: first byte, byte after, type if one datagram's


def begins(head: bytes) -> bool:
    """Return whether a file's first bytes are those of a datagram, in either byte order."""
    return any(_starts(head, order) for order in (LITTLE, BIG))


def byte_order(window: Window) -> str:
    """Return LITTLE or BIG, whichever has the first datagram that is whole; nothing where neither has one."""
    readers = {order: _Reader(window, order) for order in (LITTLE, BIG)}
    for order, reader in readers.items():
        if reader.datagram(0):
            return order
    first = readers[LITTLE].found(0, window.size)
    if readers[BIG].found(0, first) < first:
        return BIG
    return LITTLE if first < window.size else ""


def walk(window: Window, order: str, damaged: Damaged) -> Iterator[Datagram]:
    """Yield all datagrams that are whole, in the order of the file, of known and unknown types alike."""
    reader, at = _Reader(window, order), 0
    while at < window.size:
        if datagram := reader.datagram(at):
            yield datagram
            at += _HEADER + len(datagram.content) + _TAIL
            continue
        claimed = reader.claimed_end(at)  # a length may be the damage, and hide others that are whole
        end = reader.found(at + 1, claimed or window.size)
        damaged(at, end, reader.kind(at) if end == claimed else b"")
        at = end


class _Reader:
    """Bytes of a file, and whether those between two places are a datagram."""

    def __init__(self, window: Window, order: str) -> None:
        self._window, self._order = window, order
        self._unpack, self._unpack_sum = _HEADERS[order].unpack_from, _SUMS[order].unpack_from
        self._begin = self._end = 0
        self._bytes = memoryview(b"")
        self._sums: np.ndarray | None = None  # of all bytes before each that is held
        self._wary = 0  # bytes of the file before which they are used

    def datagram(self, at: int) -> Datagram | None:
        """Return the datagram there, if it is whole and its checksum right; its date is not looked at."""
        if at + _SMALLEST + _LENGTH > self._window.size:
            return None
        self._load(at, _SMALLEST + _LENGTH)
        first = at - self._begin
        length, stx, kind, model, date, clock, _, serial = self._unpack(self._bytes, first)
        if stx != _STX or not _SMALLEST <= length <= _LARGEST or at + _LENGTH + length > self._window.size:
            return None
        self._load(at, _LENGTH + length)
        first = at - self._begin
        last = first + _LENGTH + length - _TAIL
        etx, told = self._unpack_sum(self._bytes, last)
        if etx != _ETX or self._sum(first + _LENGTH + 1, last) & 0xFFFF != told:
            return None
        return Datagram(at, _KINDS[kind], model, _time(date, clock), serial, self._bytes[first + _HEADER : last])

    def kind(self, at: int) -> bytes:
        """Return the type of the datagram that seems to begin there."""
        return bytes(self._window.read(at + _LENGTH + 1, 1))

    def claimed_end(self, at: int) -> int:
        """Return where the datagram ends by its own length, if its header and what follows can be right; else 0."""
        end = _claim(self._window.read(at, _HEADER), self._order)
        end += at if end else 0
        if end == self._window.size:
            return end
        return end if end and _claim(self._window.read(end, _HEADER), self._order) else 0

    def found(self, at: int, before: int) -> int:
        """Return where the next whole datagram begins, at `at` or after it; `before` where none does before."""
        while at + _HEADER < before:
            stretch = self._window.read(at, min(_STRETCH, before - at))
            for match in _BEGINS[self._order].finditer(stretch, _LENGTH):
                place = at + match.start() - _LENGTH
                self._wary = place + _STRETCH
                if self.datagram(place):
                    return place
            at += max(1, len(stretch) - _HEADER)
        return before

    def _load(self, at: int, count: int) -> None:
        if self._begin <= at and at + count <= self._end:
            return
        self._bytes = self._window.read(at, _STRETCH)
        self._begin, self._end = at, at + len(self._bytes)
        self._sums = None

    def _sum(self, first: int, last: int) -> int:
        """Return the sum of bytes that are held; after damage by subtraction, where lengths may be long and many."""
        if self._begin + first >= self._wary:
            return int(np.frombuffer(self._bytes[first:last], np.uint8).sum(dtype=np.uint32))
        if self._sums is None:
            self._sums = np.zeros(len(self._bytes) + 1, np.uint32)
            np.cumsum(np.frombuffer(self._bytes, np.uint8), dtype=np.uint32, out=self._sums[1:])
        return int(self._sums[last]) - int(self._sums[first])


def _starts(head: bytes, order: str) -> bool:
    size = _claim(memoryview(head), order)
    return bool(size) and (size > len(head) or head[size - _TAIL] == _ETX)


def _claim(header: memoryview, order: str) -> int:
    """Return how many bytes a datagram takes by its header, 0 if the header cannot be one."""
    if len(header) < _HEADER:
        return 0
    length, stx, kind, _, date, clock, *_ = _HEADERS[order].unpack_from(header)
    known = stx == _STX and _SMALLEST <= length <= _LARGEST and 0x1F <= kind <= 0x7F
    return _LENGTH + length if known and np.isfinite(_time(date, clock)) else 0


def _time(date: int, clock: int) -> float:
    return _midnight(date) + clock / 1000.0 if clock < _DAY_MS else np.nan


@functools.lru_cache(maxsize=64)
def _midnight(date: int) -> float:
    year, month, day = date // 10_000, date // 100 % 100, date % 100
    if year not in _YEARS:
        return np.nan
    try:
        return datetime.datetime(year, month, day, tzinfo=datetime.UTC).timestamp()
    except ValueError:
        return np.nan
