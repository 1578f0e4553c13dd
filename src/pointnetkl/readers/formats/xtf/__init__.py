"""XTF, the eXtended Triton Format: ranges and angles of multibeam sonars, from which soundings are computed here.

The packets that are read are those of R2Sonic (65 and 68), RESON's 7k (61, with records 7027 or 7006) and QINSy's for
any sonar (28). Other packets with soundings are counted and reported.
"""

import struct
from array import array
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pointnetkl.readers import projection
from pointnetkl.readers.formats.recording import PART, Problems, Recording
from pointnetkl.readers.formats.window import Window
from pointnetkl.readers.formats.xtf import packets as xtf_packets
from pointnetkl.readers.formats.xtf import qps, r2sonic, reson7k
from pointnetkl.readers.formats.xtf import streams as xtf_streams
from pointnetkl.readers.formats.xtf import swaths as xtf_swaths
from pointnetkl.readers.formats.xtf.packets import (
    ATTITUDE,
    DEGREES,
    GYRO,
    HEADER,
    METRES,
    NAVIGATION,
    Q_MULTIBEAM,
    QINSY_R2SONIC,
    R2SONIC,
    RAW_NAVIGATION,
    RESON,
    TIMED_GYRO,
    FileHeader,
    Packet,
)
from pointnetkl.readers.formats.xtf.raytrace import SPEEDS, Fan
from pointnetkl.readers.formats.xtf.streams import SIZE, Samples, Sources, Streams
from pointnetkl.readers.formats.xtf.swaths import RangePing
from pointnetkl.surveys.survey import SurveyError

SUFFIXES = (".xtf",)

_DECODERS = {QINSY_R2SONIC: r2sonic.fan, R2SONIC: r2sonic.fan, RESON: reson7k.fan, Q_MULTIBEAM: qps.fan}
_STREAMED = (RAW_NAVIGATION, NAVIGATION, GYRO, TIMED_GYRO, ATTITUDE)
_WALKED, _PROBED = 1 << 16, 1 << 6  # bytes that are read at once where only headers are needed
_BATCH = 1 << 15  # soundings that are computed at once
_POSE = struct.Struct("<ff2d")  # at byte 120: speed, gyro, ship's y and x
_SENSOR = struct.Struct("<2d")  # at byte 160: y and x
_MOTION = struct.Struct("<4f")  # at byte 204: pitch, roll, heading, heave
_DAY_S = 86_400.0
_SAME_S = 1.0  # by which the sonar's clock may differ from the recorder's
_SPEED = 1500.0  # m/s, of sound where the file has none


class XtfError(SurveyError):
    """A file is not XTF, or has no whole packet."""


def begins(head: bytes) -> bool:
    """Return whether a file's first bytes are those of an XTF file."""
    return xtf_packets.begins(head)


def read(path: Path) -> Iterator[Recording]:
    """Yield the soundings of an XTF file, after a first pass that gathers positions and motion.

    Raises:
        XtfError: the file cannot be opened, ends within its header, or has no whole packet.
    """
    try:
        walked, probed, window = Window(path, _WALKED), Window(path, _PROBED), Window(path)
    except OSError as error:
        raise XtfError(f"{path}: cannot be read ({error.strerror})") from error
    with walked, probed, window:
        header = xtf_packets.header(walked)
        if header is None:
            raise XtfError(f"{path}: ends at byte {walked.size}, within the header of 1024 bytes; copy it again")
        gathered = _Gathered(path.name, header)
        for packet in xtf_packets.walk(walked, probed, gathered.damaged):
            gathered.take(packet, walked.read(packet.offset, min(packet.size, HEADER)))
        if not gathered.kinds:
            raise XtfError(f"{path}: has no packet (0xFACE) from byte 1024 on that is whole; is this an XTF file?")
        gathered.close()
        yield from _parts(gathered, window)


class _Gathered:
    """The result of the first pass: the places of the pings, and positions and motion of the whole file."""

    def __init__(self, name: str, header: FileHeader) -> None:
        self.name, self.header = name, header
        self.kinds: Counter[int] = Counter()
        self.skipped: Counter[str] = Counter()
        self.problems = Problems(name)
        self.streams = Streams(header.latency_s, header.units != METRES)
        self.pings = array("q")  # offset, size, type, channel
        self._poses = Samples(2, 0 if header.units != METRES else None)  # from the headers of the pings
        self._motion = Samples(4, 2)

    @property
    def crs(self) -> str:
        return projection.GEOGRAPHIC if self.header.units != METRES else projection.LOCAL

    def take(self, packet: Packet, data: bytes | memoryview) -> None:
        self.kinds[packet.kind] += 1
        if packet.kind in _STREAMED and packet.size >= SIZE:
            self.streams.take(packet, data)
        elif packet.kind in _DECODERS and packet.size >= HEADER:
            self.pings.extend((packet.offset, packet.size, packet.kind, packet.channel))
            self._header(bytes(data))

    def damaged(self, begin: int, end: int, kind: int) -> None:
        if kind in _DECODERS:
            self.skip("pings in damaged bytes", 1)
        self.add_problem(f"{end - begin} bytes from byte {begin} on are damaged or cut off")

    def skip(self, reason: str, count: int) -> None:
        if count:
            self.skipped[reason] += count

    def add_problem(self, sentence: str) -> None:
        self.problems.add(sentence)

    def close(self) -> None:
        """Report what the file lacks, and take positions and motion from the pings where no packets have them."""
        if not len(self.streams.positions.of_most.table):
            self.streams.positions = Sources({0: self._poses})
        if not len(self.streams.attitude.table):
            self.streams.attitude = self._motion
            if self.pings and not np.any(self._motion.table[:, 1:3]):
                self.add_problem("has no roll and pitch: its soundings are not levelled")
        if self.header.units not in (METRES, DEGREES):
            self.add_problem(f"has positions in the unknown unit {self.header.units}, which are taken as degrees")
        if self.kinds[Q_MULTIBEAM]:
            self.add_problem(
                "has beam angles of packet 28, which are taken as degrees to starboard; the format does not say"
            )
        for sentence in (*self.streams.notes(), *xtf_swaths.unapplied(self.header)):
            self.add_problem(sentence)
        self._unread()

    def _unread(self) -> None:
        unread = {
            kind: count
            for kind, count in sorted(self.kinds.items())
            if kind in xtf_packets.NAMES and kind not in _DECODERS
        }
        listed = ", ".join(
            f"{count} packets of type {kind} ({xtf_packets.NAMES[kind]})" for kind, count in unread.items()
        )
        if listed:
            self.add_problem(f"holds {listed}, which are not read")
        self.skip("pings of a kind that is not read", sum(unread.values()))
        if not self.pings and not listed:
            most = ", ".join(f"{count} of type {kind}" for kind, count in self.kinds.most_common(5))
            self.add_problem(f"has no pings; of its packets are {most}")

    def _header(self, data: bytes) -> None:
        time = xtf_packets.clock(data, 14) + data[21] / 100.0
        _, gyro, north, east = _POSE.unpack_from(data, 120)
        sensor_place = _SENSOR.unpack_from(data, 160)
        north, east = sensor_place if any(sensor_place) else (north, east)
        if xtf_streams.positioned(east, north, self.header.units != METRES):
            self._poses.add(time, east, north)
        pitch, roll, heading, heave = _MOTION.unpack_from(data, 204)
        self._motion.add(time, *xtf_streams.motion(roll, pitch, heading or gyro, heave))


@dataclass
class _Summary:
    """The sensor of a file, and doubts about its pings."""

    sensor: str = ""
    assumed: int = 0  # pings whose sound speed is not known


def _parts(gathered: _Gathered, window: Window) -> Iterator[Recording]:
    summary, swaths = _Summary(), xtf_swaths.Swaths(gathered.header, gathered.streams)
    for batch in _batches(gathered, window, summary):
        lost = swaths.add(batch)
        gathered.skip("pings without time or attitude", lost)
        if swaths.count >= PART:
            yield _part(gathered, swaths, summary)
    if summary.assumed:
        gathered.add_problem(f"has no sound speed in {summary.assumed} pings, for which {_SPEED:.0f} m/s is taken")
    for sentence in swaths.notes():
        gathered.add_problem(sentence)
    if swaths.count or gathered.skipped or gathered.problems or not len(gathered.pings):
        yield _part(gathered, swaths, summary)


def _part(gathered: _Gathered, swaths: xtf_swaths.Swaths, summary: _Summary) -> Recording:
    skipped, problems = dict(gathered.skipped), gathered.problems.drain()
    gathered.skipped.clear()
    pings, soundings = swaths.tables()
    vertical = xtf_swaths.vertical(gathered.header)
    tables = (pings, soundings, skipped, problems.sentences)
    return Recording(gathered.name, gathered.crs, *tables, summary.sensor, vertical, problems_omitted=problems.omitted)


def _batches(gathered: _Gathered, window: Window, summary: _Summary) -> Iterator[list[RangePing]]:
    """Yield runs of pings with equal numbers of beams."""
    batch: list[RangePing] = []
    for offset, size, kind, channel in np.frombuffer(gathered.pings, np.int64).reshape(-1, 4).tolist():
        data = bytes(window.read(offset, size))
        fan = _DECODERS[kind](data[HEADER:])
        if isinstance(fan, str):
            gathered.skip("pings that cannot be used", 1)
            gathered.add_problem(f"the ping at byte {offset} cannot be used: it {fan}")
            continue
        summary.sensor = summary.sensor or fan.sensor
        if batch and (len(batch[0].fan.angle) != len(fan.angle) or len(batch) * len(fan.angle) >= _BATCH):
            yield batch
            batch = []
        batch.append(_ping(data, fan, channel, summary))
    if batch:
        yield batch


def _ping(data: bytes, fan: Fan, channel: int, summary: _Summary) -> RangePing:
    recorded = xtf_packets.clock(data, 14) + data[21] / 100.0
    time = _time(recorded, fan.time_s)
    speed = fan.speed if np.isfinite(fan.speed) else _speed(data)
    summary.assumed += int(np.isnan(speed))
    (depth,) = struct.unpack_from("<f", data, 192)
    depth = depth if 0.0 < depth < 12_000.0 else 0.0
    return RangePing(time, fan, _SPEED if np.isnan(speed) else speed, depth, channel)


def _time(recorded: float, sonar: float) -> float:
    """Return the sonar's time, which is finer, unless its clock is not set; the recorder's date may be a day behind."""
    off = abs(sonar - recorded)
    return sonar if off < _SAME_S or abs(off - _DAY_S) < _SAME_S else recorded


def _speed(data: bytes) -> float:
    """Return the sound speed in a ping's header, which may be half the true one; NaN if there is none."""
    for offset in (32, 72):
        (speed,) = struct.unpack_from("<f", data, offset)
        for value in (speed, 2.0 * speed):
            if SPEEDS[0] < value < SPEEDS[1]:
                return float(value)
    return float("nan")
