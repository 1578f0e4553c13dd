"""The bathymetry of R2Sonic's sonars: a BTH0 packet, two-way travel times and angles of a ping's beams.

After the format in R2Sonic's "Sonic 2026/2024/2022 Operation Manual": sections of a name, a size and data, big-endian.
"""

import struct

import numpy as np

from pointnetkl.readers.formats.recording import IMPOSSIBLE, REJECTED
from pointnetkl.readers.formats.xtf.raytrace import MOST_BEAMS, SPEEDS, Fan

_PACKET, _SECTION = struct.Struct(">4sII"), struct.Struct(">2sH")
_HEAD = struct.Struct(">12s12sIIIff")  # model, serial, seconds, nanoseconds, ping, period, sound speed
# bytes in H0: steering of the transmitted fan, positive forward; tilt of the receiver's mount; number of beams
_STEERING, _MOUNT, _POINTS = 68, 104, 114
_STEEPEST = 1.5  # radians
_PHASE, _MAGNITUDE, _COLLINEAR, _BRIGHT = 8, 4, 2, 1  # bits of Q0: detection methods, then tests passed


def fan(content: bytes | memoryview) -> Fan | str:
    """Return the ping in a BTH0 packet, or the reason why it cannot be used."""
    sections = _sections(content)
    if isinstance(sections, str):
        return sections
    head, ranges = sections.get(b"H0", b""), sections.get(b"R0", b"")
    if len(head) < _POINTS + 2 or len(ranges) < 8:
        return "has no whole section H0 or R0"
    count = int.from_bytes(head[_POINTS : _POINTS + 2], "big")
    if not 0 < count <= MOST_BEAMS or len(ranges) < 8 + 2 * count:
        return f"says that it has {count} beams, which do not fit"
    angle = _angles(sections, count)
    if angle is None:
        return "has no section A0 or A2 with angles of its beams"
    scale = struct.unpack_from(">f", ranges, 4)[0]
    if not 0.0 < scale < 1.0:
        return f"has the range scale {scale:.3g}"
    tilt, mount = (struct.unpack_from(">f", head, offset)[0] for offset in (_STEERING, _MOUNT))
    if not abs(tilt) < _STEEPEST:
        return f"is steered by {tilt:.3g} rad"
    model, serial, seconds, nanoseconds, _, _, speed = _HEAD.unpack_from(head, 4)
    travel = np.frombuffer(ranges, ">u2", count, 8) * float(scale)
    time = seconds + nanoseconds * 1e-9 if nanoseconds < 1_000_000_000 else float("nan")
    speed = speed if SPEEDS[0] < speed < SPEEDS[1] else float("nan")
    quality = _quality(sections.get(b"Q0", b""), travel)
    mount = mount if abs(mount) < np.pi else 0.0
    return Fan(time, travel, angle, tilt, speed, quality, f"R2Sonic {_name(model)}, serial {_name(serial)}", mount)


def _sections(content: bytes | memoryview) -> dict[bytes, bytes] | str:
    if len(content) < _PACKET.size:
        return "is cut off"
    mark, size, _ = _PACKET.unpack_from(content)
    if mark != b"BTH0" or not _PACKET.size <= size <= len(content):
        return f"is no BTH0 packet that fits: it says {size} bytes and has {len(content)}"
    data, offset, sections = bytes(content[:size]), _PACKET.size, dict[bytes, bytes]()
    while offset + _SECTION.size <= size:
        name, length = _SECTION.unpack_from(data, offset)
        if length < _SECTION.size or offset + length > size:
            return f"has a section {name!r} of {length} bytes, which does not fit"
        sections.setdefault(name, data[offset : offset + length])
        offset += length
    return sections


def _angles(sections: dict[bytes, bytes], count: int) -> np.ndarray | None:
    """Return the angles (b,) in radians, evenly spaced (A0) or each a step from the one before (A2)."""
    if len(even := sections.get(b"A0", b"")) >= 12:
        first, last = struct.unpack_from(">2f", even, 4)
        return np.linspace(first, last, count)
    if len(steps := sections.get(b"A2", b"")) >= 36 + 2 * count:
        first, scale = struct.unpack_from(">2f", steps, 4)
        return np.asarray(first + scale * np.cumsum(np.frombuffer(steps, ">u2", count, 36), dtype=np.int64))
    return None


def _quality(section: bytes, travel: np.ndarray) -> np.ndarray:
    quality = np.zeros(len(travel), np.int8)
    if len(section) >= 4 + (len(travel) + 1) // 2:
        pairs = np.frombuffer(section, np.uint8, (len(travel) + 1) // 2, 4)
        flags = np.stack([pairs >> 4, pairs & 15], 1).ravel()[: len(travel)]
        tests = flags & (_COLLINEAR | _BRIGHT)
        # older sonars do not fill in the tests
        quality[(tests != (_COLLINEAR | _BRIGHT)) & tests.any()] = REJECTED
        quality[flags & (_PHASE | _MAGNITUDE) == 0] = IMPOSSIBLE
    quality[travel <= 0.0] = IMPOSSIBLE
    return quality


def _name(letters: bytes) -> str:
    return "".join(chr(byte) for byte in letters.split(b"\0")[0] if 32 < byte < 127) or "unknown"
