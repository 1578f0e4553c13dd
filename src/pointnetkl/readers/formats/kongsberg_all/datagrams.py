"""The datagrams of a Kongsberg .all or .wcd file: their places, and whether their bytes can be trusted.

By Kongsberg's "EM Series Multibeam echo sounders, Datagram formats" (160692) a datagram is a length, then as many
bytes: STX, the content, ETX and the sum of the bytes between STX and ETX. The byte order is either.
"""

import datetime
import functools
import re
import struct
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from pointnetkl.readers.formats.window import Mark, Window, candidates

LITTLE, BIG = "<", ">"

_STX, _ETX = 2, 3
_LENGTH, _HEADER, _TAIL = 4, 20, 3  # bytes: of the length; of the header with it; of ETX and the sum
_SMALLEST, _LARGEST = _HEADER - _LENGTH + _TAIL, 1 << 20  # values of a length; the sonars stay below 64 KiB
_STRETCH = 1 << 22  # bytes that are summed at once
_DAY_MS = 86_400_000
_YEARS = range(1985, 2100)
_HEADERS = {order: struct.Struct(order + "IBBHIIHH") for order in (LITTLE, BIG)}
_SUMS = {order: struct.Struct(order + "BH") for order in (LITTLE, BIG)}
_KINDS = [bytes((kind,)) for kind in range(256)]
# STX, a type, the model, and a date from 1985 to 2100: 0x012EE2F5 to 0x01406C33
_MARKS = {
    LITTLE: Mark(re.compile(rb"\x02(?=[\x1f-\x7f].{4}[\x2e-\x40]\x01)", re.DOTALL), _LENGTH, 8, _HEADER),
    BIG: Mark(re.compile(rb"\x02(?=[\x1f-\x7f].{2}\x01[\x2e-\x40])", re.DOTALL), _LENGTH, 6, _HEADER),
}


class Datagram(NamedTuple):
    """A datagram whose checksum is right."""

    offset: int
    kind: bytes  # its type, one letter
    model: int
    time_s: float  # UTC since 1970; NaN where date or time of day are impossible
    serial: int
    content: memoryview  # the bytes between its header and ETX

    @property
    def start(self) -> int:
        """Byte at which the content begins."""
        return self.offset + _HEADER


Damaged = Callable[[int, int, bytes], None]  # is called with damaged bytes: first, one after the last, type if known


def begins(head: bytes) -> bool:
    """Return whether a file's first bytes are those of a datagram, in either byte order."""
    return any(_starts(head, order) for order in (LITTLE, BIG))


def byte_order(window: Window) -> str:
    """Return LITTLE or BIG, by the first whole datagram; an empty text if there is none in either order."""
    readers = {order: _Reader(window, order) for order in (LITTLE, BIG)}
    for order, reader in readers.items():
        if reader.datagram(0):
            return order
    first = readers[LITTLE].next_datagram(0, window.size)
    if readers[BIG].next_datagram(0, first) < first:
        return BIG
    return LITTLE if first < window.size else ""


def walk(window: Window, order: str, damaged: Damaged) -> Iterator[Datagram]:
    """Yield all whole datagrams in the order of the file, of known and unknown types."""
    reader, offset = _Reader(window, order), 0
    while offset < window.size:
        if datagram := reader.datagram(offset):
            yield datagram
            offset += _HEADER + len(datagram.content) + _TAIL
            continue
        claimed = reader.claimed_end(offset)  # if the length is damaged, whole datagrams may be hidden within it
        end = reader.next_datagram(offset + 1, claimed or window.size)
        damaged(offset, end, reader.kind(offset) if end == claimed else b"")
        offset = end


class _Reader:
    """Finds and checks datagrams in the bytes of a file."""

    def __init__(self, window: Window, order: str) -> None:
        self._window, self._order = window, order
        self._unpack, self._unpack_sum = _HEADERS[order].unpack_from, _SUMS[order].unpack_from
        self._begin = self._end = 0
        self._bytes = memoryview(b"")
        self._sums: np.ndarray | None = None  # running sum of the bytes in memory
        self._wary = 0  # byte of the file before which the running sum is used

    def datagram(self, offset: int) -> Datagram | None:
        """Return the datagram at an offset if it is whole and its checksum right; its date is not checked."""
        if offset + _SMALLEST + _LENGTH > self._window.size:
            return None
        self._load(offset, _SMALLEST + _LENGTH)
        first = offset - self._begin
        length, stx, kind, model, date, clock, _, serial = self._unpack(self._bytes, first)
        if stx != _STX or not _SMALLEST <= length <= _LARGEST or offset + _LENGTH + length > self._window.size:
            return None
        self._load(offset, _LENGTH + length)
        first = offset - self._begin
        last = first + _LENGTH + length - _TAIL
        etx, checksum = self._unpack_sum(self._bytes, last)
        if etx != _ETX or self._sum(first + _LENGTH + 1, last) & 0xFFFF != checksum:
            return None
        return Datagram(offset, _KINDS[kind], model, _time(date, clock), serial, self._bytes[first + _HEADER : last])

    def kind(self, offset: int) -> bytes:
        """Return the type of a datagram that would begin at an offset."""
        return bytes(self._window.read(offset + _LENGTH + 1, 1))

    def claimed_end(self, offset: int) -> int:
        """Return where a datagram ends by its own length, if its header and the next one are credible; else 0."""
        end = _claim(self._window.read(offset, _HEADER), self._order)
        end += offset if end else 0
        if end == self._window.size:
            return end
        return end if end and _claim(self._window.read(end, _HEADER), self._order) else 0

    def next_datagram(self, begin: int, end: int) -> int:
        """Return where the next whole datagram begins, from `begin` on; `end` if there is none before."""
        for candidate, _ in candidates(self._window, _MARKS[self._order], begin, end):
            self._wary = candidate + _STRETCH
            if self.datagram(candidate):
                return candidate
        return end

    def _load(self, offset: int, count: int) -> None:
        if self._begin <= offset and offset + count <= self._end:
            return
        self._bytes = self._window.read(offset, _STRETCH)
        self._begin, self._end = offset, offset + len(self._bytes)
        self._sums = None

    def _sum(self, first: int, last: int) -> int:
        """Return the sum of bytes in memory; after damage by running sums, because many long lengths may be tried."""
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
    """Return the bytes of a datagram by its header; 0 if the header is not credible."""
    if len(header) < _HEADER:
        return 0
    length, stx, kind, _, date, clock, *_ = _HEADERS[order].unpack_from(header)
    credible = stx == _STX and _SMALLEST <= length <= _LARGEST and 0x1F <= kind <= 0x7F
    return _LENGTH + length if credible and np.isfinite(_time(date, clock)) else 0


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
