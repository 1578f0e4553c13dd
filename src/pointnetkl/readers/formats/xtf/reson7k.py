"""The bathymetry of RESON's 7k sonars: record 7027, raw detections, or 7006 followed by the beams' angles, 7004.

By Teledyne RESON's "SeaBat 7k Data Format, Data Format Definition", version 3, as QINSy writes it into XTF.
"""

import datetime
import struct

import numpy as np

from pointnetkl.readers.formats.recording import IMPOSSIBLE, REJECTED
from pointnetkl.readers.formats.xtf.raytrace import MOST_BEAMS, SPEEDS, Fan

_SYNC, _RAW_DETECTIONS, _BATHYMETRY = 0x0000_FFFF, 7027, 7006
_FRAME = 64  # bytes of the frame before a record
_TIME = struct.Struct("<HHfBB")  # year, day of the year, seconds, hours, minutes
_HEAD, _HEAD_BYTES = struct.Struct("<QIHIIBIff"), 99
_BATHYMETRY_HEAD, _GEOMETRY_HEAD = struct.Struct("<QIHIBBf"), struct.Struct("<QI")
# of a raw detection: beam, sample, angle, method of detection, tests passed
_NAMES, _FORMATS = ["beam", "sample", "angle", "flags", "quality"], ["<u2", "<f4", "<f4", "<u4", "<u4"]
_OFFSETS = [0, 2, 6, 10, 14]
_TESTS, _FOUND = 3, 3  # bits of quality: brightness, collinearity; of flags: by magnitude, by phase
_STEEPEST = 1.5  # radians
_YEARS = range(1990, 2100)


def fan(content: bytes | memoryview) -> Fan | str:
    """Return the ping in a record 7027, or 7006 and 7004, or the reason why it cannot be used.

    Only 7006 has the sound speed.
    """
    if len(content) < _FRAME + _HEAD_BYTES:
        return "is cut off"
    _, start, sync, size = struct.unpack_from("<HHII", content)
    (kind,) = struct.unpack_from("<I", content, 32)
    if sync != _SYNC or kind not in (_RAW_DETECTIONS, _BATHYMETRY):
        return f"holds no record 7027 or 7006, but {kind if sync == _SYNC else 'something else'}"
    # the offset of the record's own header counts from the end of the first two numbers
    if 4 + start != _FRAME or not _FRAME < size <= len(content):
        return f"has a record of {size} bytes with its header at byte {4 + start}, which does not fit"
    return _raw_detections(content, size) if kind == _RAW_DETECTIONS else _bathymetry(content, size)


def _raw_detections(content: bytes | memoryview, size: int) -> Fan | str:
    _, _, _, count, detection_bytes, _, _, rate, tilt = _HEAD.unpack_from(content, _FRAME)
    begin = _FRAME + _HEAD_BYTES
    if not 0 < count <= MOST_BEAMS or not 18 <= detection_bytes <= 256 or begin + count * detection_bytes > size:
        return f"says that it has {count} detections of {detection_bytes} bytes, which do not fit"
    if not 100.0 < rate < 10_000_000.0 or not abs(tilt) < _STEEPEST:
        return f"has the sampling rate {rate:.3g} Hz and the transmit angle {tilt:.3g} rad"
    layout = np.dtype({"names": _NAMES, "formats": _FORMATS, "offsets": _OFFSETS, "itemsize": detection_bytes})
    beams = np.frombuffer(content, layout, count, begin)
    with np.errstate(invalid="ignore"):  # NaN becomes impossible later
        travel, angle = beams["sample"].astype(float) / rate, beams["angle"].astype(float)
    detected = (beams["flags"] & _FOUND) != 0
    return _fan(content, travel, angle, tilt, float("nan"), _quality(beams["quality"], detected, travel))


def _bathymetry(content: bytes | memoryview, size: int) -> Fan | str:
    _, _, _, count, _, _, speed = _BATHYMETRY_HEAD.unpack_from(content, _FRAME)
    begin, angles = _FRAME + _BATHYMETRY_HEAD.size, size + _GEOMETRY_HEAD.size
    (extra,) = struct.unpack_from("<I", content, 12)
    end = extra if _FRAME < extra < size else size - 4  # optional data, or a checksum, follow the beams
    # older versions have a shorter header, so the length must be right to the byte
    if not 0 < count <= MOST_BEAMS or end - begin not in (9 * count, 17 * count) or angles + 8 * count > len(content):
        return f"says that it has {count} beams, which do not fit its {size} bytes"
    if (other := _GEOMETRY_HEAD.unpack_from(content, size)[1]) != count:
        return f"has {count} beams and the angles of {other}"
    with np.errstate(invalid="ignore"):
        travel = np.frombuffer(content, "<f4", count, begin).astype(float)
        along, across = np.frombuffer(content, "<f4", 2 * count, angles).astype(float).reshape(2, count)
    quality = np.frombuffer(content, np.uint8, count, begin + 4 * count)
    tilt = float(np.median(along)) if np.all(np.abs(along) < _STEEPEST) else 0.0
    speed = speed if SPEEDS[0] < speed < SPEEDS[1] else float("nan")
    return _fan(content, travel, across, tilt, speed, _quality(quality, (quality & 15) != 0, travel))


def _fan(
    content: bytes | memoryview, travel: np.ndarray, angle: np.ndarray, tilt: float, speed: float, quality: np.ndarray
) -> Fan:
    (device,) = struct.unpack_from("<I", content, 36)
    return Fan(_time(content), travel, angle, tilt, speed, quality, f"RESON SeaBat {device}")


def _quality(tests: np.ndarray, detected: np.ndarray, travel: np.ndarray) -> np.ndarray:
    quality = np.where((tests & _TESTS) == _TESTS, 0, REJECTED).astype(np.int8)
    quality[~detected | ~(travel > 0.0)] = IMPOSSIBLE
    return quality


def _time(content: bytes | memoryview) -> float:
    year, day, seconds, hours, minutes = _TIME.unpack_from(content, 20)
    if year not in _YEARS or not 1 <= day <= 366 or not 0.0 <= seconds < 61.0 or hours > 23 or minutes > 59:
        return float("nan")
    days = datetime.date(year, 1, 1).toordinal() - 719_163 + day - 1
    return days * 86_400.0 + hours * 3600.0 + minutes * 60.0 + seconds
