"""The header of a LAS file (ASPRS LAS 1.0 to 1.4), checked before anything in it is used."""

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pointnetkl.readers.formats.window import Window
from pointnetkl.surveys.survey import SurveyError

# bytes of a point record by its format, without the extra bytes that a writer may add
_RECORD_BYTES = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)
_COMPRESSED = 0x80  # bit of the point format that LASzip sets
_HEAD = struct.Struct("<4s20xBB32s32x4xHIIBHI")  # up to the legacy number of points
_GEOMETRY = struct.Struct("<12d")  # at byte 131: scales, offsets, then the highest and lowest x, y, z in pairs
_LONG = struct.Struct("<QIQ")  # at byte 235 of LAS 1.4: the first extended record, how many, the number of points
_SHORT_RECORD, _LONG_RECORD = struct.Struct("<2x16sHH32x"), struct.Struct("<2x16sHQ32x")
_SHORTEST = 227  # bytes of the header of LAS 1.0 to 1.2
_MOST_RECORDS, _LARGEST_RECORD = 10_000, 1 << 22  # variable length records that are read; bytes of one


class LasError(SurveyError):
    """A file is no LAS or LAZ file, is damaged beyond use, or in coordinates that are not read."""


@dataclass(frozen=True)
class Header:
    """What the header of a file declares."""

    point_format: int  # 0 to 10
    compressed: bool
    record_bytes: int
    first: int  # byte where the points begin
    end: int  # byte before which they end, because other data begins there or the file ends
    declared: int  # number of points
    scale: np.ndarray  # (3,)
    offset: np.ndarray  # (3,)
    lowest: np.ndarray  # (3,) bounds of x, y, z
    highest: np.ndarray  # (3,)
    system: str
    records: dict[tuple[str, int], bytes]  # variable length records by user and number; the first of each


def read(path: Path, window: Window) -> Header:
    """Return the header of a file.

    Raises:
        LasError: the file is not LAS, or its header contradicts itself or the file's size.
    """
    if window.size < _SHORTEST or bytes(window.read(0, 4)) != b"LASF":
        raise LasError(f"{path}: byte 0: must begin with LASF and have a header of 227 bytes; it is no LAS file")
    _, major, minor, system, size, first, count, kind, length, points = _HEAD.unpack_from(window.read(0, _HEAD.size))
    if major != 1 or not size <= first < window.size:
        raise LasError(
            f"{path}: byte 24: version {major}.{minor}, header of {size} bytes, points from byte {first} on, in a file"
            f" of {window.size} bytes; its header is damaged, or all points are cut off"
        )
    point_format = kind & 0x3F
    if point_format >= len(_RECORD_BYTES) or length < _RECORD_BYTES[point_format]:
        raise LasError(f"{path}: byte 104: points of format {point_format} in {length} bytes do not exist")
    scale, offset, extent = _geometry(path, window)
    records, end = _records(window, size, first, count), window.size
    if minor >= 4 and size >= 375:
        start, extended, total = _LONG.unpack(window.read(235, _LONG.size))
        points = total or points  # the short count is 0 if there are more points than it can hold
        if first < start < window.size:
            records, end = _extended(window, start, extended) | records, start
    compressed, low, high = bool(kind & _COMPRESSED), extent[:, 1], extent[:, 0]
    return Header(
        point_format, compressed, length, first, end, points, scale, offset, low, high, _text(system), records
    )


def _geometry(path: Path, window: Window) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    numbers = np.array(_GEOMETRY.unpack(window.read(131, _GEOMETRY.size)))
    scale, offset, extent = numbers[:3], numbers[3:6], numbers[6:].reshape(3, 2)
    if not (np.isfinite(numbers[:6]).all() and np.all(scale > 0) and np.all(scale < 1e3)):
        raise LasError(f"{path}: byte 131: scales {scale.tolist()} and offsets {offset.tolist()} give no coordinates")
    return scale, offset, extent


def _records(window: Window, offset: int, end: int, count: int) -> dict[tuple[str, int], bytes]:
    records: dict[tuple[str, int], bytes] = {}
    for _ in range(min(count, _MOST_RECORDS)):
        if offset + _SHORT_RECORD.size > end:
            break
        user, number, length = _SHORT_RECORD.unpack(window.read(offset, _SHORT_RECORD.size))
        offset += _SHORT_RECORD.size
        if offset + length <= end:
            records.setdefault((_text(user), number), bytes(window.read(offset, length)))
        offset += length
    return records


def _extended(window: Window, offset: int, count: int) -> dict[tuple[str, int], bytes]:
    records: dict[tuple[str, int], bytes] = {}
    for _ in range(min(count, _MOST_RECORDS)):
        if offset + _LONG_RECORD.size > window.size:
            break
        user, number, length = _LONG_RECORD.unpack(window.read(offset, _LONG_RECORD.size))
        offset += _LONG_RECORD.size
        if length <= min(_LARGEST_RECORD, window.size - offset):
            records.setdefault((_text(user), number), bytes(window.read(offset, length)))
        offset += length
    return records


def _text(field: bytes) -> str:
    text = field.split(b"\0", 1)[0].decode("latin-1").strip()
    return "".join(letter if letter.isprintable() else "?" for letter in text)
