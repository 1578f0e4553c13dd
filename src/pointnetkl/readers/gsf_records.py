"""The records of a GSF file: where each begins, and whether its bytes can be trusted before they are decoded."""

import mmap
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

PING = 2  # type of a swath bathymetry ping

_RECORD_TYPES, _LARGEST = 12, 524_288  # limits of the format
_WORDS = struct.Struct(">II")  # size of the data; checksum flag, registry and type
_CHECKSUM = 0x8000_0000
_PLACE = re.compile(rb"(?=[\x00\x80]\x00\x00[\x01-\x0c])")  # second word of a standard record
_SCALE_FACTORS, _INTENSITIES, _ARRAYS = 100, 21, range(1, 32)
_USED = (1, 2, 3, 14)  # arrays of depth, across track, along track, nominal depth
_CHAIN = 3  # records in a row that make a new beginning credible


@dataclass(frozen=True)
class Record:
    """A record's place in the file, and what is known against it."""

    offset: int
    size: int  # of the data
    word: int
    fault: str = ""  # why the data cannot be used
    breaks: bool = False  # scale factors, which hold until others come, may be lost with what stood before

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
        return self.word & 0x003F_FFFF


def version(data: mmap.mmap) -> int | None:
    """Return the major version of the format, None if the data do not begin as GSF does."""
    found = re.match(rb"GSF-v0?([123])[.]", data[8:20]) or re.match(rb"GSF-v0?([123])[.]", data[12:24])
    return int(found[1]) if found else None


def checked(data: mmap.mmap, major: int, problems: list[str]) -> Iterator[Record]:
    """Yield the records in order, with the faults of pings; after damage, go on where records form a chain."""
    at, lost = 0, False
    while at < len(data):
        record = _record(data, at)
        if record is None:
            begin, at = at, _resumed(data, at + 1)
            problems.append(f"{at - begin} bytes from byte {begin} on are damaged or cut off")
            lost = True
            continue
        at = record.end
        if record.kind == PING:
            fault, breaks = _fault(data, record, major)
            yield replace(record, fault=fault, breaks=breaks or lost)
            lost = False
        else:
            yield record


def _record(data: mmap.mmap, at: int) -> Record | None:
    if at + _WORDS.size > len(data):
        return None
    record = Record(at, *_WORDS.unpack_from(data, at))
    whole = 8 < record.end - at - _WORDS.size <= _LARGEST and record.end <= len(data)
    # records of private registries may stand in any file, and are to be passed over
    known = 1 <= record.kind <= _RECORD_TYPES or record.kind >> 12
    return record if whole and known else None


def _resumed(data: mmap.mmap, at: int) -> int:
    for found in _PLACE.finditer(data, at + 4):
        if _credible(data, found.start() - 4):
            return found.start() - 4
    return len(data)


def _credible(data: mmap.mmap, at: int) -> bool:
    for _ in range(_CHAIN):
        record = _record(data, at)
        if record is None:
            return False
        if (at := record.end) == len(data):
            return True
    return True


def _fault(data: mmap.mmap, record: Record, major: int) -> tuple[str, bool]:
    """Return what is wrong with a ping's bytes, and whether scale factors may be lost with it."""
    content = data[record.start : record.end]
    if record.checksummed:
        (stored,) = struct.unpack_from(">I", data, record.start - 4)
        if stored != int(np.frombuffer(content, np.uint8).sum(dtype=np.uint32)):
            return "its checksum does not match", True
    at = 56 if major > 2 else 42  # end of the ping's header
    if len(content) < at:
        return f"{len(content)} bytes are too short for a ping", True
    (beams,) = struct.unpack_from(">H", content, 16)
    # a ping that begins with an array has no scale factors of its own to lose
    breaks = len(content) > at and content[at] not in _ARRAYS
    fault = _part_fault(content, at, beams)
    return fault, breaks and bool(fault)


def _part_fault(content: bytes, at: int, beams: int) -> str:
    while len(content) - at > 4:
        kind, size = content[at], int.from_bytes(content[at + 1 : at + 4], "big")
        size -= 4 if kind == _INTENSITIES else 0  # the one part that counts its own first word
        at += 4
        if size < 0 or at + size > len(content):
            return f"its part {kind} of {size} bytes goes beyond it"
        if kind == _SCALE_FACTORS and (fault := _scale_fault(content[at : at + size])):
            return fault
        if kind in _USED and size not in (beams, 2 * beams, 4 * beams):
            return f"its part {kind} has {size} bytes for {beams} beams"
        at += size
    return ""


def _scale_fault(table: bytes) -> str:
    count = int.from_bytes(table[:4], "big")
    if len(table) < 4 + 12 * count:
        return "its scale factors are cut off"
    for at in range(4, 4 + 12 * count, 12):
        kind, packing, _, multiplier, _ = struct.unpack_from(">BBHIi", table, at)
        if kind in _USED and (multiplier == 0 or packing & 0x0F):
            return f"the scale factor of its part {kind} is zero or its packing unknown"
    return ""
