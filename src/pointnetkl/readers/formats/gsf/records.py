"""The records of a GSF file: where each begins, and after damage where records form a chain again."""

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
_CHAIN = 3  # records in a row that make a new beginning credible
_LONGEST = _WORDS.size + _LARGEST
_AHEAD = 1 << 16  # bytes in which records alike are looked for
_STEPS = 1 << 12, 1 << 20  # bytes searched for a beginning at first, and at most, before the next ones are read


class Record(NamedTuple):
    """A record's place in the file."""

    offset: int
    size: int  # of the data
    word: int
    lost: bool = False  # whether damage lies between it and the record before

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
        """Type of the record, with the number of a private registry in front of it."""
        return self.word & _KIND


def version(head: bytes) -> int | None:
    """Return the major version of the format, None if the first bytes of the file are not those of GSF."""
    found = re.match(rb"GSF-v0?([123])[.]", head[8:20]) or re.match(rb"GSF-v0?([123])[.]", head[12:24])
    return int(found[1]) if found else None


def records(window: Window, tell: Callable[[str], None]) -> Iterator[Record]:
    """Yield the records in order; what is damaged is told, and reading goes on where records form a chain.

    Of records that are not read, and follow each other with the same size and type, only the first is yielded.
    """
    at, lost = 0, False
    while at < window.size:
        record = _record(window, at)
        if record is None:
            begin, at = at, _resumed(window, at + 1)
            tell(f"{at - begin} bytes from byte {begin} on are damaged or cut off")
            lost = True
            continue
        yield record._replace(lost=True) if lost else record
        lost = False
        at = record.end if record.kind in (PING, PARAMETERS, SINGLE_BEAM) else _passed(window, record)


def content(window: Window, record: Record) -> memoryview | None:
    """Return the data of a record, None if their checksum does not match."""
    data = window.read(record.offset + _WORDS.size, record.end - record.offset - _WORDS.size)
    if not record.checksummed:
        return data
    stored, data = int.from_bytes(data[:4], "big"), data[4:]
    return data if stored == int(np.frombuffer(data, np.uint8).sum(dtype=np.uint32)) else None


def _record(window: Window, at: int) -> Record | None:
    words = window.read(at, _WORDS.size)
    if len(words) < _WORDS.size:
        return None
    size, word = _WORDS.unpack(words)
    whole, kind = size + 4 * (word >= _CHECKSUM), word & _KIND
    # records of private registries may stand in any file, and are to be passed over
    known = 1 <= kind <= _RECORD_TYPES or kind >> _REGISTRY
    good = known and 8 < whole <= _LARGEST and at + _WORDS.size + whole <= window.size
    return Record(at, size, word) if good else None


def _passed(window: Window, record: Record) -> int:
    """Return where the records like this one end: attitude may stand in thousands of small ones between two pings."""
    length = record.end - record.offset
    if window.read(record.end, _WORDS.size) != _WORDS.pack(record.size, record.word):
        return record.end
    ahead = window.read(record.end, max(1, _AHEAD // length) * length)
    each: np.ndarray = np.ndarray(len(ahead) // length, ">u8", ahead, 0, (length,))
    unlike = np.flatnonzero(each != (record.size << 32 | record.word))
    return record.end + length * int(unlike[0] if len(unlike) else len(each))


def _resumed(window: Window, at: int) -> int:
    """Return where a chain of records begins next; the longer that takes, the larger the steps, in linear time."""
    step, most = _STEPS
    while at < window.size:
        data = np.frombuffer(window.read(at, step + _CHAIN * _LONGEST), np.uint8)
        places = _standard(data[: step + _WORDS.size - 1])
        credible = places[_chained(data, places, window.size - at)]
        if len(credible):
            return at + int(credible[0])
        at, step = at + step, min(2 * step, most)
    return window.size


def _standard(data: np.ndarray) -> np.ndarray:
    """Return the places in the bytes where the second word is one of a standard record."""
    count = max(0, len(data) - _WORDS.size + 1)
    flag, high, low, kind = (data[at : at + count] for at in range(4, 8))
    known = (kind >= 1) & (kind <= _RECORD_TYPES)
    return np.flatnonzero(known & (high == 0) & (low == 0) & ((flag == 0) | (flag == _CHECKSUM >> 24)))


def _chained(data: np.ndarray, places: np.ndarray, left: int) -> np.ndarray:
    """Return which places begin a chain of records, or one that ends with the file after `left` bytes."""
    for _ in range(_CHAIN):
        places = _ends(data, places, left)
    return places >= 0


def _ends(data: np.ndarray, places: np.ndarray, left: int) -> np.ndarray:
    """Return where the records at these places would end, -1 where none can be; the file's end stays itself."""
    inside = (places >= 0) & (places + _WORDS.size <= len(data))
    eight = np.where(inside, places, 0)[:, None] + np.arange(_WORDS.size)
    words = data[np.minimum(eight, len(data) - 1)].view(">u4").astype(np.int64)
    size, kind = words[:, 0] + 4 * (words[:, 1] >= _CHECKSUM), words[:, 1] & _KIND
    ends = places + _WORDS.size + size
    known = ((kind >= 1) & (kind <= _RECORD_TYPES)) | (kind >> _REGISTRY > 0)
    good = inside & known & (size > 8) & (size <= _LARGEST) & (ends <= left)
    return np.where(places == left, places, np.where(good, ends, -1))
