"""Kongsberg .kmall: soundings relative to the vessel's reference point, whose place and depth are in each ping."""

from collections import Counter, deque
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from pointnetkl.readers import projection
from pointnetkl.readers.formats import interpolation
from pointnetkl.readers.formats.kmall import datagrams as kmall_datagrams
from pointnetkl.readers.formats.kmall.datagrams import ATTITUDE, INSTALLATION, PING, Datagram, MrzPing
from pointnetkl.readers.formats.recording import IMPOSSIBLE, PART, PING_COLUMNS, REJECTED, Problems, Recording
from pointnetkl.readers.formats.window import Window
from pointnetkl.surveys.survey import SurveyError

SUFFIXES = (".kmall", ".kmwcd")

_VERTICAL = "below the water line; tide not applied"
_HEADERS = 1 << 12  # bytes that are read at once where only headers are needed
_GAP_S = 1.0  # between samples of attitude
_ATTITUDES, _ATTITUDES_KEPT = 1 << 14, 64  # datagrams of about a second: the most in a part, and for the next part
_PING_ROWS = 64  # soundings that take as much memory as a ping's header
_DAY_S = 86_400.0
_NORMAL, _UNDETECTED = 0, 0  # type and method of detection
_DEGREE_M = 111_195.0  # on a sphere; right to 0.6 % on the ellipsoid
_APART_M, _APART = 1.0, 0.02  # by how much two places of a sounding may differ: metres, and share of its distance


class KmallError(SurveyError):
    """A .kmall file cannot be read, or holds no datagram."""


def begins(head: bytes) -> bool:
    """Return whether a file's first bytes are those of a .kmall file."""
    return kmall_datagrams.begins(head)


def read(path: Path) -> Iterator[Recording]:
    """Yield the soundings of all #MRZ datagrams; each datagram is a ping, so that heads and swaths of one stay apart.

    Positions and depths are those of the vessel's reference point, on WGS84 and below the water line. Roll and
    pitch are those of the sensor in use. A .kmwcd file has no soundings and gives one part, whose problems say so.

    Raises:
        KmallError: the file cannot be opened, or has no datagram that is whole.
    """
    try:
        window, headers = Window(path), Window(path, _HEADERS)
    except OSError as error:
        raise KmallError(f"{path}: cannot be read ({error.strerror})") from error
    with window, headers:
        gathered = _Gathered(path.name)
        for datagram in kmall_datagrams.walk(headers, gathered.damaged):
            gathered.take(datagram, window)
            if gathered.full:
                yield gathered.part()
    if not gathered.kinds:
        raise KmallError(
            f"{path}: none of its {window.size} bytes from byte 0 on is in a whole datagram; give a .kmall file"
        )
    gathered.close()
    if gathered.pings or gathered.problems or gathered.skipped or not gathered.kinds[PING]:
        yield gathered.part()


class _Gathered:
    """What was read since the last part."""

    def __init__(self, name: str) -> None:
        self.name, self.sensor = name, ""
        self.kinds: Counter[bytes] = Counter()  # of the whole file
        self.pings: list[MrzPing] = []
        self.problems = Problems(name)
        self.skipped: Counter[str] = Counter()
        self._rows = 0
        self._parts = kmall_datagrams.Parts()
        self._attitude: deque[np.ndarray] = deque(maxlen=_ATTITUDES)

    @property
    def full(self) -> bool:
        """Whether a part is complete: it has enough soundings, and the attitude at its last ping if that ever comes."""
        if self._rows < PART:
            return False
        latest = next((samples[-1, 0] for samples in reversed(self._attitude)), np.inf)
        return bool(latest >= self.pings[-1].time_s) or self._rows >= 2 * PART

    def take(self, datagram: Datagram, window: Window) -> None:
        self.kinds[datagram.kind] += 1
        if datagram.kind == PING:
            if joined := self._parts.join(datagram, datagram.content(window)):
                self._ping(*joined)
        elif datagram.kind == ATTITUDE:
            if len(samples := kmall_datagrams.attitude(datagram.content(window))):
                self._attitude.append(samples)
        elif datagram.kind == INSTALLATION:
            self.sensor = kmall_datagrams.sensor(datagram.content(window)) or self.sensor
        self.sensor = self.sensor or f"Kongsberg EM{datagram.sounder}"

    def damaged(self, begin: int, end: int, pings: int) -> None:
        self._skip("pings in damaged bytes", pings)
        self.problems.add(f"{end - begin} bytes from byte {begin} on are damaged or cut off")

    def close(self) -> None:
        self._parts.close()
        self._skip("pings of which a part is missing", self._parts.lost)
        if not self.kinds[PING]:
            counts = ", ".join(f"{count} {kind.decode()}" for kind, count in self.kinds.most_common(5))
            self.problems.add_first(
                f"has no #MRZ datagram, hence no soundings, but {counts}; give the .kmall file of the same line"
            )

    def part(self) -> Recording:
        pings, soundings = _ping_table(self.pings, self._attitude), _sounding_table(self.pings)
        skipped, problems = dict(self.skipped), self.problems.drain()
        self.pings, self._rows, self.skipped = [], 0, Counter()
        while len(self._attitude) > _ATTITUDES_KEPT:
            self._attitude.popleft()
        sentences, omitted = problems.sentences, problems.omitted
        tables = (pings, soundings, skipped, sentences)
        return Recording(self.name, projection.GEOGRAPHIC, *tables, self.sensor, _VERTICAL, problems_omitted=omitted)

    def _ping(self, datagram: Datagram, content: bytes | memoryview) -> None:
        ping = kmall_datagrams.ping(datagram, content)
        if isinstance(ping, str):
            self._skip("pings with impossible lengths", 1)
            self.problems.add(f"the ping at byte {datagram.offset} cannot be used: {ping}")
            return
        self.pings.append(ping)
        self._rows += _PING_ROWS + len(ping.flags)

    def _skip(self, reason: str, count: int) -> None:
        if count:
            self.skipped[reason] += count


def _ping_table(pings: list[MrzPing], attitude: deque[np.ndarray]) -> pd.DataFrame:
    table = np.array(
        [(ping.time_s, ping.longitude, ping.latitude, ping.water_m, ping.heading_deg) for ping in pings]
    ).reshape(-1, 5)
    time, east, north, water, heading = table.T
    time = np.where(_far_off(time), np.nan, time)
    heading = np.where((heading >= 0.0) & (heading <= 360.0), heading, np.nan)
    sampled, roll, pitch = np.concatenate([*attitude, np.empty((0, 3))]).T
    angles = (interpolation.linear(time, sampled, values, _GAP_S) for values in (roll, pitch))
    return pd.DataFrame(dict(zip(PING_COLUMNS, (time, east, north, -water, *angles, np.deg2rad(heading)), strict=True)))


def _far_off(time: np.ndarray) -> np.ndarray:
    """Return which times are more than a day off those of the neighbouring pings: a flipped bit makes decades."""
    off = np.zeros(len(time), bool)
    finite = np.isfinite(time)
    if finite.sum() > 2:
        around = np.lib.stride_tricks.sliding_window_view(np.pad(time[finite], 2, "reflect"), 5)
        off[finite] = np.abs(time[finite] - np.median(around, 1)) > _DAY_S
    return off


def _sounding_table(pings: list[MrzPing]) -> pd.DataFrame:
    counts = np.array([len(ping.flags) for ping in pings], int)
    number = np.repeat(np.arange(len(pings)), counts)
    beam = np.arange(len(number)) - np.repeat(np.cumsum(counts) - counts, counts)
    kind, method = np.concatenate([np.empty((0, 2), np.uint8), *(ping.flags for ping in pings)]).T
    with np.errstate(invalid="ignore"):
        places = np.concatenate([np.empty((0, 5), np.float32), *(ping.places for ping in pings)]).astype(float)
    _, _, down, starboard, forward = places.T
    extra = beam >= np.repeat(np.array([ping.main for ping in pings], int), counts)
    rejected = extra | (kind != _NORMAL)  # the sonar does not take the echo of an extra detection for the seabed
    impossible = (method == _UNDETECTED) | _misplaced(pings, number, places) | ~np.isfinite(places[:, 2:]).all(1)
    quality = np.where(rejected, REJECTED, np.where(impossible, IMPOSSIBLE, 0)).astype(np.int8)
    columns = {"ping": number, "beam": beam, "along_m": forward, "across_m": starboard, "down_m": down}
    return pd.DataFrame(columns | {"quality": quality})


def _misplaced(pings: list[MrzPing], number: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return which soundings (n,) have latitudes and longitudes that contradict their metres and heading.

    The format has no checksum, and this comparison replaces it: in a ping most of whose soundings are misplaced the
    heading or the position is damaged. If most pings are so, the sonar does not write one of the two: none counts.
    """
    heading, latitude = np.deg2rad([(ping.heading_deg, ping.latitude) for ping in pings]).reshape(-1, 2)[number].T
    to_north, to_east, _, starboard, forward = places.T
    with np.errstate(invalid="ignore", over="ignore"):
        own_east = to_east * np.cos(latitude + np.deg2rad(to_north) / 2) * _DEGREE_M
        east = forward * np.sin(heading) + starboard * np.cos(heading)
        north = forward * np.cos(heading) - starboard * np.sin(heading)
        apart = np.hypot(own_east - east, to_north * _DEGREE_M - north)
        off = ~(apart <= _APART_M + _APART * np.hypot(forward, starboard))
    mostly = 2 * np.bincount(number[off], minlength=len(pings)) > np.bincount(number, minlength=len(pings))
    return np.asarray((off | mostly[number]) & (2 * mostly.sum() < len(pings)))
