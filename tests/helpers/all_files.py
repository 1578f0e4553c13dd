"""Small Kongsberg .all files, written datagram by datagram as the format's definition (160692) has them."""

import datetime
import struct
from collections.abc import Sequence

import numpy as np

BEGIN = datetime.datetime(2020, 5, 17, 10, tzinfo=datetime.UTC).timestamp()
ACROSS = np.linspace(-40, 40, 21)


def datagram(kind: str, content: bytes, time_s: float, order: str = "<", model: int = 2040, serial: int = 7) -> bytes:
    """Return a datagram with its length before it and its checksum behind."""
    ms = round(time_s * 1000)
    day = datetime.datetime.fromtimestamp(ms // 1000, datetime.UTC)
    date = day.year * 10_000 + day.month * 100 + day.day
    inner = struct.pack(order + "BHIIHH", ord(kind), model, date, ms % 86_400_000, 1, serial) + content
    content = b"\x02" + inner + b"\x03" + struct.pack(order + "H", sum(inner) & 0xFFFF)
    return struct.pack(order + "I", len(content)) + content


def position(time_s: float, east: float, north: float, descriptor: int = 0x81, order: str = "<") -> bytes:
    """Return a position datagram: degrees; by default of system 1, and active."""
    head = struct.pack(order + "iiHHHHBB", round(north * 2e7), round(east * 1e7), 10, 200, 9000, 9000, descriptor, 4)
    return datagram("P", head + b"NMEA", time_s, order)


def attitude(
    time_s: float, roll: Sequence[float], pitch: Sequence[float], descriptor: int = 0, order: str = "<"
) -> bytes:
    """Return an attitude datagram: degrees, ten samples a second; by default of the sensor in use."""
    samples = [
        struct.pack(order + "HHhhhH", 100 * number, 0, round(roll_deg * 100), round(pitch_deg * 100), 0, 9000)
        for number, (roll_deg, pitch_deg) in enumerate(zip(roll, pitch, strict=True))
    ]
    return datagram("A", struct.pack(order + "H", len(roll)) + b"".join(samples) + bytes([descriptor]), time_s, order)


def xyz88(
    time_s: float,
    down: np.ndarray,
    across: np.ndarray = ACROSS,
    along: float = 2.0,
    *,
    detection: Sequence[int] = (),
    cleaning: Sequence[int] = (),
    heading: float = 90.0,
    transducer: float = 1.5,
    order: str = "<",
    model: int = 2040,
    serial: int = 7,
) -> bytes:
    """Return an XYZ 88 datagram of a ping: metres, degrees; by default every beam is detected."""
    detection, cleaning = detection or [0] * len(down), cleaning or [0] * len(down)
    head = struct.pack(order + "HHfHHfB3x", round(heading * 100), 15000, transducer, len(down), len(down), 1e4, 0)
    beams = [
        struct.pack(order + "fffHBbBbhx", *place)[:20]
        for place in zip(
            down, across, [along] * len(down), [9] * len(down), [3] * len(down), [0] * len(down), detection, cleaning,
            [-250] * len(down), strict=True,
        )
    ]  # fmt: skip
    return datagram("X", head + b"".join(beams) + b"\0", time_s, order, model, serial)


def depths(
    time_s: float,
    down: np.ndarray,
    across: np.ndarray = ACROSS,
    along: float = 2.0,
    *,
    steps_cm: tuple[int, int] = (1, 2),
    transducer_cm: int = 150,
    turns: int = 0,
    order: str = "<",
    model: int = 3000,
    serial: int = 7,
) -> bytes:
    """Return a depth datagram of the older sonars: metres, which it holds in whole steps of centimetres."""
    head = struct.pack(order + "HHHBBBBH", 9000, 15000, transducer_cm, 254, len(down), *steps_cm, 9000)
    places = zip(
        np.round(down * 100 / steps_cm[0]).astype(int) & 0xFFFF, np.round(across * 100 / steps_cm[1]).astype(int),
        [round(along * 100 / steps_cm[1])] * len(down), range(1, len(down) + 1), strict=True,
    )  # fmt: skip
    beams = [struct.pack(order + "HhhhHHBBbB", *place, 0, 0, 0, 3, 9, -50, beam) for *place, beam in places]
    return datagram("D", head + b"".join(beams) + struct.pack("b", turns), time_s, order, model, serial)


def survey(pings: int = 12, order: str = "<", begin: float = BEGIN, seabed: float = 45.0) -> bytes:
    """Return a file: a ship heads east at 10 N at about 1 m/s, the seabed rises to starboard by an eighth."""
    parts = [datagram("I", b"\0\0WLZ=-1.5,SMH=7,", begin, order)]
    for number in range(pings):
        time = begin + number
        parts.append(attitude(time, [1.0] * 10, [-1.0] * 10, order=order))
        parts.append(position(time, 5.0 + 1e-5 * number, 10.0, order=order))
        parts.append(xyz88(time, seabed - ACROSS / 8, order=order))
        parts.append(datagram("Y", bytes(40), time, order))
    return b"".join(parts)


def starts(content: bytes, kind: str, order: str = "<") -> list[int]:
    """Return the byte at which each datagram of a type begins."""
    offset, starts_ = 0, []
    while offset < len(content):
        starts_ += [offset] if content[offset + 5] == ord(kind) else []
        offset += 4 + struct.unpack_from(order + "I", content, offset)[0]
    return starts_
