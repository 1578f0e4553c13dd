"""Writes .kmall files, datagram by datagram, as Kongsberg's document 410224 defines them."""

import itertools
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np

TIME_S = 1_600_000_000.25
ACROSS = np.linspace(-40.0, 40.0, 21)
METRE_DEG = 1 / 111_195.0

SOUNDING = np.dtype(
    {
        "names": ["index", "type", "method", "class", "latitude", "longitude", "down", "starboard", "forward"],
        "formats": ["<u2", "u1", "u1", "u1", "<f4", "<f4", "<f4", "<f4", "<f4"],
        "offsets": [0, 3, 4, 8, 88, 92, 96, 100, 104],
        "itemsize": 120,
    }
)


def datagram(
    kind: bytes, content: bytes, time_s: float = TIME_S, version: int = 3, sounder: int = 304, nanoseconds: int = -1
) -> bytes:
    """Return content as a datagram, with its size at both ends."""
    fraction = round(time_s % 1 * 1e9) if nanoseconds < 0 else nanoseconds
    size = 20 + len(content) + 4
    return struct.pack("<I4s2BH2I", size, kind, version, 40, sounder, int(time_s), fraction) + content + _word(size)


def soundings(count: int = len(ACROSS), heading_deg: float = 90.0, latitude: float = 10.0, **fields: Any) -> np.ndarray:
    """Return soundings 2 m ahead, 50 m deep to port and 40 m to starboard, with their latitudes and longitudes."""
    rows = np.zeros(count, SOUNDING)
    across, heading = np.linspace(-40.0, 40.0, count), np.deg2rad(heading_deg)
    rows["index"], rows["method"] = np.arange(count), 1
    rows["starboard"], rows["forward"], rows["down"] = across, 2.0, 45.0 - across / 8
    rows["latitude"] = (2.0 * np.cos(heading) - across * np.sin(heading)) * METRE_DEG
    east = 2.0 * np.sin(heading) + across * np.cos(heading)
    rows["longitude"] = east * METRE_DEG / np.cos(np.deg2rad(latitude))
    for name, values in fields.items():
        rows[name] = values
    return rows


def body(
    rows: np.ndarray,
    extra: int = 0,
    classes: int = 0,
    sectors: int = 3,
    longer: Sequence[int] = (0, 0, 0, 0, 0, 0),
    info: int = 152,
    fan: tuple[int, int] = (1, 0),
    longitude: float = 5.0,
    latitude: float = 10.0,
    heading_deg: float = 90.0,
    water_m: float = -30.0,
    **receiver: int,
) -> bytes:
    """Return a #MRZ datagram's content behind its partition; `longer` adds bytes to each kind of block."""
    common = struct.pack("<2H8B", 12 + longer[0], 7, *fan, 1, 0, 0, fan[1], fan[0], 0) + _more(longer[0])
    ping = bytearray(info)
    struct.pack_into("<H", ping, 0, info + longer[1])
    struct.pack_into("<2H", ping, 92, sectors, 48 + longer[2])
    struct.pack_into("<6f4x2df", ping, 96, heading_deg, 1500.0, 1.0 - water_m, water_m, 0, 0, latitude, longitude, 45.0)
    counts = {"main": len(rows) - extra, "each": SOUNDING.itemsize + longer[5], "extra": extra} | receiver
    rx = struct.pack("<4H4f", 32 + longer[3], counts["main"], 0, counts["each"], 1e4, 1e4, -20.0, -20.0)
    rx += struct.pack("<4H", 0, counts["extra"], classes, 4 + longer[4]) + _more(longer[3])
    blocks = common + bytes(ping) + _more(longer[1]) + (bytes(48) + _more(longer[2])) * sectors
    return blocks + rx + (bytes(4) + _more(longer[4])) * classes + b"".join(bytes(r) + _more(longer[5]) for r in rows)


def ping(time_s: float = TIME_S, version: int = 3, nanoseconds: int = -1, count: int = 21, **fields: Any) -> bytes:
    """Return a #MRZ datagram; fields are those of `body`, and of soundings where they are named so."""
    ours = {
        name: fields.pop(name) for name in (*SOUNDING.names, "heading_deg") if name in fields and name != "latitude"
    }
    rows = soundings(count, **ours)
    fields = fields | {name: value for name, value in ours.items() if name == "heading_deg"}
    return datagram(b"#MRZ", _pair(1, 1) + body(rows, **fields), time_s, version, nanoseconds=nanoseconds)


def packets(content: bytes, parts: int, version: int, time_s: float = TIME_S) -> list[bytes]:
    """Return a ping as the packets in which a sonar sends it: from version 3 on each begins with the common block."""
    cuts = np.linspace(0, len(content), parts + 1).astype(int)
    pieces = [content[begin:end] for begin, end in itertools.pairwise(cuts)]
    pieces = [content[:12] * (version >= 3 and number > 0) + piece for number, piece in enumerate(pieces)]
    return [
        datagram(b"#MRZ", _pair(parts, number) + piece, time_s, version) for number, piece in enumerate(pieces, start=1)
    ]


def attitude(time_s: float = TIME_S, rate: float = 0.0, status: int = 1, doubts: int = 0, count: int = 101) -> bytes:
    """Return a #SKM datagram from half a second before a time to half a second after: roll 1 + rate dt, pitch -2."""
    samples = b""
    for step in np.linspace(-0.5, 0.5, count):
        sample_time = time_s + step
        samples += struct.pack("<4s2H3I", b"#KMB", 132, 1, int(sample_time), round(sample_time % 1 * 1e9), doubts)
        samples += struct.pack("<2d5f", 0, 0, 0, 1.0 + rate * step, -2.0, 90.0, 0).ljust(112, b"\0")
    return datagram(b"#SKM", struct.pack("<H2B4H", 12, 0, status, 1, count, 132, 127) + samples, time_s, 1)


def installation(text: str = "EMXV:EM304,\nSN=9,TRAI_TX1:N=123;X=1.0,TRAI_RX1:X=1.0;N=45,EMXI:SWLZ=0.7") -> bytes:
    """Return a #IIP datagram."""
    return datagram(b"#IIP", struct.pack("<3H", 6 + len(text), 1, 0) + text.encode(), version=0)


def _word(value: int) -> bytes:
    return struct.pack("<I", value)


def _pair(first: int, second: int) -> bytes:
    return struct.pack("<2H", first, second)


def _more(count: int) -> bytes:
    return b"\xa5" * count
