"""Positions and motion of an XTF file, which are in packets of their own between the pings."""

import struct
from array import array

import numpy as np

from pointnetkl.readers.formats.xtf.packets import ATTITUDE, GYRO, NAVIGATION, RAW_NAVIGATION, TIMED_GYRO, Packet, clock
from pointnetkl.readers.formats.xtf.raytrace import Motion

SIZE = 64  # bytes of each such packet

_GAP_S = 2.0  # between samples of motion
_POSITION_GAP_S, _BEYOND_S = 30.0, 5.0  # between samples of position, and beyond the first and the last
_HELD_S = 0.1  # beyond them, below which the vessel's movement does not matter
_FARTHEST_M = 1e8
_DAY_S = 86_400.0
_HOUR_S = 3600.0
_TILT, _TURN, _HEAVE_M = 90.0, 360.0, 100.0


class Samples:
    """Samples of a few numbers by time, of a whole file."""

    def __init__(self, width: int, turn: int | None = None) -> None:
        """Take samples of `width` numbers; the one at index `turn` is an angle in degrees."""
        self._values, self._width, self._turn = array("d"), 1 + width, turn
        self._table: np.ndarray | None = None

    def add(self, *values: float) -> None:
        """Take a sample: its time, then its numbers."""
        self._values.extend(values)

    @property
    def table(self) -> np.ndarray:
        """Samples (m, 1 + width) in order of time, finite, each time once; dates that lag at midnight are corrected."""
        if self._table is None:
            table = np.frombuffer(self._values, float).reshape(-1, self._width)
            table = table[np.isfinite(table).all(1)]
            table[:, 0] = unbroken(table[:, 0])
            table = table[np.argsort(table[:, 0], kind="stable")]
            table = table[np.diff(table[:, 0], prepend=-np.inf) > 0]
            if self._turn is not None:  # so that there is no jump from 360 degrees to 0
                table[:, 1 + self._turn] = np.unwrap(table[:, 1 + self._turn], period=_TURN)
            self._table = table
        return self._table

    def beyond(self, time: np.ndarray) -> np.ndarray:
        """Return how far times are before the first sample or after the last, s; negative between them."""
        if not len(self.table):
            return np.full(time.shape, np.inf)
        return np.maximum(self.table[0, 0] - time, time - self.table[-1, 0])

    def interpolate(self, time: np.ndarray, gap_s: float, beyond_s: float) -> np.ndarray:
        """Return the numbers (width, ...) at times of any shape, interpolated between the samples on either side.

        NaN where these are more than `gap_s` apart; the first and the last sample hold for `beyond_s` beyond them.
        """
        table = self._near(float(np.min(time)), float(np.max(time)))
        if len(table) < 2:
            near = self.beyond(time) <= beyond_s
            values = table[0, 1:] if len(table) else np.full(self._width - 1, np.nan)
            return np.stack([np.where(near, value, np.nan) for value in values])
        sampled = table[:, 0]
        after = np.searchsorted(sampled, time).clip(1, len(sampled) - 1)
        begin, end = sampled[after - 1], sampled[after]
        share = ((time - begin) / (end - begin)).clip(0.0, 1.0)
        outside = self.beyond(time)
        near = np.where(outside > 0.0, outside <= beyond_s, (end - begin <= gap_s) | (time == begin) | (time == end))
        share = np.where(near, share, np.nan)
        return np.stack([(1.0 - share) * column[after - 1] + share * column[after] for column in table[:, 1:].T])

    def _near(self, begin: float, end: float) -> np.ndarray:
        first, last = np.searchsorted(self.table[:, 0], [begin, end])
        return self.table[max(first - 1, 0) : last + 1]


class Sources:
    """Samples of one quantity by the type of their packets; each type may be from a different sensor."""

    def __init__(self, samples: dict[int, Samples]) -> None:
        """Take samples by type; of types with equally many the first is preferred."""
        self._samples = samples

    def add(self, kind: int, *values: float) -> None:
        """Take a sample of a type of packets."""
        self._samples[kind].add(*values)

    @property
    def of_most(self) -> Samples:
        """The samples of the type that has most: two antennas must not be mixed."""
        return max(self._samples.values(), key=lambda samples: len(samples.table))

    def notes(self, quantity: str) -> str:
        """Return a sentence on which of several types is used; empty if there is only one."""
        counts = {kind: len(samples.table) for kind, samples in self._samples.items() if len(samples.table)}
        most = sorted(counts, key=lambda kind: -counts[kind])
        listed = " and ".join(f"{kind} ({counts[kind]})" for kind in most)
        return f"has {quantity} in packets {listed}; those of {most[0]} are taken" if len(most) > 1 else ""


class Streams:
    """Positions, attitude and gyro as the packets give them."""

    def __init__(self, latency_s: float, geographic: bool) -> None:
        """Take positions that are late by `latency_s`; they are longitudes and latitudes if `geographic`."""
        turn = 0 if geographic else None
        self.positions = Sources({RAW_NAVIGATION: Samples(2, turn), NAVIGATION: Samples(2, turn)})
        self.attitude, self.gyro = Samples(4, 2), Sources({TIMED_GYRO: Samples(1, 0), GYRO: Samples(1, 0)})
        self._latency_s, self._geographic = latency_s, geographic

    def take(self, packet: Packet, data: bytes | memoryview) -> None:
        """Take a packet of SIZE bytes, of any type."""
        if packet.kind == RAW_NAVIGATION:
            self._position(packet.kind, clock(data, 14) + struct.unpack_from("<H", data, 21)[0] * 1e-4, data, 23)
        elif packet.kind == NAVIGATION:
            self._position(packet.kind, clock(data, 14) + struct.unpack_from("<I", data, 21)[0] * 1e-6, data, 33)
        elif packet.kind in (GYRO, TIMED_GYRO):
            (heading,) = struct.unpack_from("<f", data, 33)
            time = clock(data, 14) + struct.unpack_from("<I", data, 21)[0] * 1e-6
            self.gyro.add(packet.kind, time, _within(heading, _TURN))
        elif packet.kind == ATTITUDE:
            pitch, roll, heave, _, _, heading = struct.unpack_from("<4fIf", data, 30)
            time = clock(data, 54) + struct.unpack_from("<H", data, 61)[0] * 1e-3
            self.attitude.add(time, *motion(roll, pitch, heading, heave))

    def place(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return eastings and northings, or longitudes and latitudes, at times (n,); NaN where none is near."""
        east, north = self.positions.of_most.interpolate(time, _POSITION_GAP_S, _BEYOND_S)
        return np.mod(east + 180.0, 360.0) - 180.0 if self._geographic else east, north

    def is_extrapolated(self, time: np.ndarray) -> np.ndarray:
        """Return at which times (n,) the first or the last position is used beyond its own time."""
        beyond = self.positions.of_most.beyond(time)
        return (beyond > _HELD_S) & (beyond <= _BEYOND_S)

    def motion(self, time: np.ndarray) -> Motion:
        """Return the motion at times of any shape; NaN where no sample is near."""
        roll, pitch, heading, heave = self.attitude.interpolate(time, _GAP_S, _GAP_S)
        if not self.turns:
            (heading,) = self.gyro.of_most.interpolate(time, _GAP_S, _GAP_S)
        roll, pitch, heading = np.deg2rad([roll, pitch, np.mod(heading, _TURN)])
        return Motion(roll, pitch, heading, heave)

    @property
    def turns(self) -> bool:
        """Whether the attitude has the heading; otherwise the gyro has it."""
        return not len(self.gyro.of_most.table) or bool(np.any(self.attitude.table[:, 3]))

    def notes(self) -> list[str]:
        """Return sentences on positions and headings that are not used."""
        headings = "" if self.turns else self.gyro.notes("headings")
        return [sentence for sentence in (self.positions.notes("positions"), headings) if sentence]

    def _position(self, kind: int, time: float, data: bytes | memoryview, offset: int) -> None:
        north, east = struct.unpack_from("<2d", data, offset)
        if positioned(east, north, self._geographic):
            self.positions.add(kind, time - self._latency_s, east, north)


def unbroken(time: np.ndarray) -> np.ndarray:
    """Return times (n,) with the date corrected where it changes before or after midnight."""
    step = np.diff(time, prepend=time[:1])
    days = np.where(np.abs(np.abs(step) - _DAY_S) < _HOUR_S, -np.sign(step), 0.0)
    return time + _DAY_S * np.maximum(np.cumsum(days), 0.0)


def positioned(east: float, north: float, geographic: bool) -> bool:
    """Return whether two coordinates are a position; zeros are none."""
    most = (_TURN, _TILT) if geographic else (_FARTHEST_M, _FARTHEST_M)
    return abs(east) <= most[0] and abs(north) <= most[1] and (east != 0.0 or north != 0.0)


def motion(roll: float, pitch: float, heading: float, heave: float) -> tuple[float, float, float, float]:
    """Return degrees and metres unchanged; NaN where a vessel cannot have them."""
    return _within(roll, _TILT), _within(pitch, _TILT), _within(heading, _TURN), _within(heave, _HEAVE_M)


def _within(value: float, most: float) -> float:
    return value if abs(value) <= most else float("nan")
