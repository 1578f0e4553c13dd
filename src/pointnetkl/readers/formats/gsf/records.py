"""The records of a GSF file: where each begins, and where records form a chain again after damage.

A record has no mark at its beginning. After damage, a place is credible if sizes lead from it to several more records.
"""

import re
import struct
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from pointnetkl.readers.formats.window import Window

PING, PARAMETERS, SINGLE_BEAM = 2, 4, 10  # types of the records that are read

_RECORD_TYPES, _LARGEST = 12, 524_288  # limits of the format
_WORDS = struct.Struct(">II")  # size of the data; checksum flag, registry and type
_CHECKSUM, _KIND, _REGISTRY = 0x8000_0000, 0x003F_FFFF, 12
_CHAIN = 3  # consecutive records that make a beginning credible
_LONGEST = _WORDS.size + _LARGEST
_AHEAD = 1 << 16  # bytes that are searched at once for equal records
_STEPS = 1 << 12, 1 << 20  # bytes that are searched at once for a beginning: at first, and at most


class Record(NamedTuple):
    """A record's place in the file."""

    offset: int
    size: int  # of the data
    word: int
    lost: bool = False  # whether the bytes between it and the record before are damaged

    @property
    def checksummed(self) -> bool:
        """Whether a checksum stands before the data."""
        return bool(self.word & _CHECKSUM)

    @property
    def start(self) -> int:
        """Byte at which the data begin."""
        return self.offset + (12 if self.checksummed else 8)

    @property
    def end(self) -> int:
        """Byte after the data."""
        return self.start + self.size

    @property
    def kind(self) -> int:
        """Type of the record, with the number of a private registry in its higher bits."""
        return self.word & _KIND


def version(head: bytes) -> int | None:
    """Return the major version of the format, None if the first bytes of the file are not those of GSF."""
    match = re.match(rb"GSF-v0?([123])[.]", head[8:20]) or re.match(rb"GSF-v0?([123])[.]", head[12:24])
    return int(match[1]) if match else None


def records(window: Window, report: Callable[[str], None]) -> Iterator[Record]:
    """Yield the records in order; `report` gets a sentence on each damage, and reading resumes where records chain.

    Of consecutive records that are not used and have the same size and type, only the first is yielded.
    """
    offset, lost = 0, False
    while offset < window.size:
        record = _record(window, offset)
        if record is None:
            begin, offset = offset, _resumed(window, offset + 1)
            report(f"{offset - begin} bytes from byte {begin} on are damaged or cut off")
            lost = True
            continue
        yield record._replace(lost=True) if lost else record
        lost = False
        offset = record.end if record.kind in (PING, PARAMETERS, SINGLE_BEAM) else _passed(window, record)


def content(window: Window, record: Record) -> memoryview | None:
    """Return the data of a record, None if their checksum does not match."""
    data = window.read(record.offset + _WORDS.size, record.end - record.offset - _WORDS.size)
    if not record.checksummed:
        return data
    stored, data = int.from_bytes(data[:4], "big"), data[4:]
    return data if stored == int(np.frombuffer(data, np.uint8).sum(dtype=np.uint32)) else None


def _record(window: Window, offset: int) -> Record | None:
    words = window.read(offset, _WORDS.size)
    if len(words) < _WORDS.size:
        return None
    size, word = _WORDS.unpack(words)
    length, kind = size + 4 * (word >= _CHECKSUM), word & _KIND
    # records of private registries may be in any file, and are skipped
    standard = 1 <= kind <= _RECORD_TYPES or kind >> _REGISTRY
    good = standard and 8 < length <= _LARGEST and offset + _WORDS.size + length <= window.size
    return Record(offset, size, word) if good else None


def _passed(window: Window, record: Record) -> int:
    """Return where the records like this one end: thousands of attitude records may lie between two pings."""
    length = record.end - record.offset
    if window.read(record.end, _WORDS.size) != _WORDS.pack(record.size, record.word):
        return record.end
    ahead = window.read(record.end, max(1, _AHEAD // length) * length)
    words: np.ndarray = np.ndarray(len(ahead) // length, ">u8", ahead, 0, (length,))
    unlike = np.flatnonzero(words != (record.size << 32 | record.word))
    return record.end + length * int(unlike[0] if len(unlike) else len(words))


def _resumed(window: Window, offset: int) -> int:
    """Return where a chain of records begins next; the step grows with the search, whose time is linear."""
    step, most = _STEPS
    while offset < window.size:
        data = np.frombuffer(window.read(offset, step + _CHAIN * _LONGEST), np.uint8)
        places = _standard(data[: step + _WORDS.size - 1])
        credible = places[_chained(data, places, window.size - offset)]
        if len(credible):
            return offset + int(credible[0])
        offset, step = offset + step, min(2 * step, most)
    return window.size


def _standard(data: np.ndarray) -> np.ndarray:
    """Return the places in the bytes whose second word is that of a standard record."""
    count = max(0, len(data) - _WORDS.size + 1)
    flag, high, low, kind = (data[byte : byte + count] for byte in range(4, 8))
    standard = (kind >= 1) & (kind <= _RECORD_TYPES)
    return np.flatnonzero(standard & (high == 0) & (low == 0) & ((flag == 0) | (flag == _CHECKSUM >> 24)))


def _chained(data: np.ndarray, places: np.ndarray, remaining: int) -> np.ndarray:
    """Return which places begin a chain of records, or a shorter chain to the file's end after `remaining` bytes."""
    for _ in range(_CHAIN):
        places = _ends(data, places, remaining)
    return places >= 0


def _ends(data: np.ndarray, places: np.ndarray, remaining: int) -> np.ndarray:
    """Return where the records at these places would end, -1 where there can be none; the file's end stays itself."""
    inside = (places >= 0) & (places + _WORDS.size <= len(data))
    eight = np.where(inside, places, 0)[:, None] + np.arange(_WORDS.size)
    words = data[np.minimum(eight, len(data) - 1)].view(">u4").astype(np.int64)
    size, kind = words[:, 0] + 4 * (words[:, 1] >= _CHECKSUM), words[:, 1] & _KIND
    ends = places + _WORDS.size + size
    readable = ((kind >= 1) & (kind <= _RECORD_TYPES)) | (kind >> _REGISTRY > 0)
    good = inside & readable & (size > 8) & (size <= _LARGEST) & (ends <= remaining)
    return np.where(places == remaining, places, np.where(good, ends, -1))
