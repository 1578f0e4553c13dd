"""Soundings of Kongsberg's XYZ 88 datagrams and of the older depth datagrams (160692, "Multibeam data").

Depths are from the transmit transducer down, whose own depth is below the water line; distances forward and to
starboard are from the active positioning system's reference point. Roll, pitch and heave are corrected.
"""

import struct
from typing import NamedTuple

import numpy as np

from pointnetkl.readers.formats.kongsberg_all.datagrams import BIG, LITTLE, Datagram
from pointnetkl.readers.formats.recording import IMPOSSIBLE, REJECTED

XYZ88, DEPTH = b"X", b"D"

_ORDERS = (LITTLE, BIG)
_UNSIGNED = (120, 300)  # models whose older depths have no sign, to reach deeper
_DEEPEST_M = 12_000.0
_UNDETECTED, _REASON = 0x80, 0x0F  # bits of a beam's detection
_NO_DETECTION = 4  # reason: nothing was detected
_FULL_TURN = 36_000  # hundredths of a degree; beyond it the heading is unknown

_XYZ88_HEADS = {order: struct.Struct(order + "HHfHHfB3x") for order in _ORDERS}
_DEPTH_HEADS = {order: struct.Struct(order + "HHHBBBBH") for order in _ORDERS}
_XYZ88_BEAMS = {
    order: np.dtype(
        {
            "names": ["down", "across", "along", "detection", "cleaning"],
            "formats": [order + "f4", order + "f4", order + "f4", "u1", "i1"],
            "offsets": [0, 4, 8, 16, 17],
            "itemsize": 20,
        }
    )
    for order in _ORDERS
}
_DEPTH_BEAMS = {
    order: np.dtype(
        {
            "names": ["down", "across", "along", "number"],
            "formats": [order + "i2", order + "i2", order + "i2", "u1"],
            "offsets": [0, 2, 4, 15],
            "itemsize": 16,
        }
    )
    for order in _ORDERS
}
BEAM_BYTES = {XYZ88: 20, DEPTH: 16}


class AllPing(NamedTuple):
    """A ping's header, all in numbers, so that many pings are an array."""

    time_s: float
    heading_rad: float  # NaN: not known
    depth_m: float  # of the transmit transducer at the ping, below the water line
    start: int  # byte of the file at which its beams begin
    beams: int
    down_step_m: float  # metres per unit
    level_step_m: float
    unsigned: bool


def column(pings: np.ndarray, name: str) -> np.ndarray:
    """Return one of the numbers of pings (n, len(Ping))."""
    return pings[:, AllPing._fields.index(name)]


def ping(datagram: Datagram, order: str) -> AllPing | str:
    """Return the ping of an XYZ 88 or depth datagram, or the reason under which an unusable one is counted."""
    if len(datagram.content) < _XYZ88_HEADS[order].size:
        return "pings too short for what they hold"
    decoded = (_xyz88 if datagram.kind == XYZ88 else _depth)(datagram, order)
    if decoded is None:
        return "pings too short for what they hold"
    if not abs(decoded.depth_m) < _DEEPEST_M or not decoded.down_step_m or not decoded.level_step_m:
        return "pings with an impossible transducer depth or resolution"
    return decoded if np.isfinite(decoded.time_s) else "pings without a time"


def _xyz88(datagram: Datagram, order: str) -> AllPing | None:
    head = _XYZ88_HEADS[order]
    heading, _, depth, beams, *_ = head.unpack_from(datagram.content)
    if head.size + beams * BEAM_BYTES[XYZ88] > len(datagram.content):
        return None
    return AllPing(datagram.time_s, _heading(heading), depth, datagram.start + head.size, beams, 1.0, 1.0, False)


def _depth(datagram: Datagram, order: str) -> AllPing | None:
    head = _DEPTH_HEADS[order]
    heading, _, depth, _, beams, down_cm, level_cm, _ = head.unpack_from(datagram.content)
    end = head.size + beams * BEAM_BYTES[DEPTH]
    if end >= len(datagram.content):
        return None
    (turns,) = struct.unpack_from("b", datagram.content, end)  # of the transducer's depth, which overflows at 655.36 m
    depth_m = depth / 100.0 + 655.36 * turns
    steps = (down_cm / 100.0, level_cm / 100.0)
    unsigned = datagram.model in _UNSIGNED
    return AllPing(datagram.time_s, _heading(heading), depth_m, datagram.start + head.size, beams, *steps, unsigned)


def _heading(hundredths: int) -> float:
    return float(np.deg2rad(hundredths / 100.0)) if hundredths <= _FULL_TURN else np.nan


def soundings(kind: bytes, order: str, raw: bytearray, pings: np.ndarray) -> dict[str, np.ndarray]:
    """Return the columns of recording.SOUNDING_COLUMNS from the beams of pings (n, len(Ping)), one after the other."""
    beams = column(pings, "beams").astype(np.int64)
    number = np.repeat(np.arange(len(pings)), beams)
    if kind == XYZ88:
        table = np.frombuffer(raw, _XYZ88_BEAMS[order])
        beam = np.arange(len(number)) - np.repeat(np.cumsum(beams) - beams, beams)
        places = {name: table[name].astype(np.float64) for name in ("along", "across", "down")}
        quality = _xyz88_quality(table)
    else:
        table = np.frombuffer(raw, _DEPTH_BEAMS[order])
        beam = table["number"].astype(np.int64) - 1
        places = _scaled(table, pings[number])
        quality = np.where(table["down"] == 0, IMPOSSIBLE, 0).astype(np.int8)
    with np.errstate(invalid="ignore"):
        quality[~(np.abs(places["along"] + places["across"] + places["down"]) < np.inf)] = IMPOSSIBLE
        quality[np.abs(places["down"]) > _DEEPEST_M] = IMPOSSIBLE
    return {"ping": number, "beam": beam, **{name + "_m": place for name, place in places.items()}, "quality": quality}


def _xyz88_quality(table: np.ndarray) -> np.ndarray:
    detection = table["detection"]
    quality = np.zeros(len(table), np.int8)
    quality[(detection >= _UNDETECTED) | (table["cleaning"] < 0)] = REJECTED
    quality[(detection >= _UNDETECTED) & (detection & _REASON == _NO_DETECTION)] = IMPOSSIBLE
    quality[(table["down"] == 0) & (table["across"] == 0) & (table["along"] == 0)] = IMPOSSIBLE
    return quality


def _scaled(table: np.ndarray, pings: np.ndarray) -> dict[str, np.ndarray]:
    down = table["down"].astype(np.float64)
    unsigned = column(pings, "unsigned") > 0
    down[unsigned & (down < 0)] += 1 << 16
    level = column(pings, "level_step_m")
    return {
        "along": table["along"] * level,
        "across": table["across"] * level,
        "down": down * column(pings, "down_step_m"),
    }
