"""Kongsberg .all: XYZ 88 and older depth datagrams, placed by the active positioning system at the time of each ping.

Depths are below the water line: each sounding's from the transmit transducer, and the transducer's own at the ping.
"""

from array import array
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from pointnetkl.readers import projection
from pointnetkl.readers.formats.kongsberg_all import datagrams as kongsberg_datagrams
from pointnetkl.readers.formats.kongsberg_all import pings as kongsberg_pings
from pointnetkl.readers.formats.kongsberg_all.datagrams import Datagram
from pointnetkl.readers.formats.kongsberg_all.navigation import Attitudes, Positions
from pointnetkl.readers.formats.kongsberg_all.pings import DEPTH, XYZ88, AllPing
from pointnetkl.readers.formats.recording import PART, PING_COLUMNS, SOUNDING_COLUMNS, Problems, Recording
from pointnetkl.readers.formats.window import Window
from pointnetkl.surveys.survey import SurveyError

SUFFIXES = (".all", ".wcd")

_VERTICAL = "below the water line; tide not applied"
_SPARSE = 1 << 18  # bytes read around a ping: most of a file is not soundings
_POSITION, _ATTITUDE, _WATER_COLUMN = b"P", b"A", b"k"
_NAMES = {850: "ME70", 2045: "EM2040C", 3020: "EM3002", **dict.fromkeys(range(3001, 3009), "EM3000D")}


class KongsbergError(SurveyError):
    """A .all file cannot be read, or holds no datagram."""


def begins(head: bytes) -> bool:
    """Return whether a file's first bytes are those of a Kongsberg datagram, in either byte order."""
    return kongsberg_datagrams.begins(head)


def read(path: Path) -> Iterator[Recording]:
    """Yield the soundings of all XYZ 88 datagrams, or of the older depth datagrams of a file that has none.

    Each datagram is a ping, so that the heads of a dual system stay apart. Positions are on WGS84. A .wcd file has no
    soundings and gives one part, whose problems say so.

    Raises:
        KongsbergError: the file cannot be opened, has no datagram that is whole, or changes while it is read.
    """
    try:
        window, sparse = Window(path), Window(path, _SPARSE)
    except OSError as error:
        raise KongsbergError(f"{path}: cannot be read ({error.strerror})") from error
    with window, sparse:
        order = kongsberg_datagrams.byte_order(window)
        if not order:
            raise KongsbergError(
                f"{path}: none of its {window.size} bytes from byte 0 on is in a whole Kongsberg datagram;"
                " is it another format?"
            )
        index = _Index(path.name, order)
        for datagram in kongsberg_datagrams.walk(window, order, index.damaged):
            index.take(datagram)
        yield from index.parts(sparse)


class _Index:
    """The places of a file's pings, and its navigation, which must be complete before the first ping is placed."""

    def __init__(self, name: str, order: str) -> None:
        self._name, self._order = name, order
        self._positions, self._attitudes = Positions(order), Attitudes(order)
        self._pings = {XYZ88: array("d"), DEPTH: array("d")}
        self._kinds: Counter[bytes] = Counter()
        self._heads: set[tuple[int, int]] = set()  # model and serial number, as pings have them
        self._system: set[tuple[int, int]] = set()  # the same, as the first datagram has them
        self._skipped: Counter[str] = Counter()
        self._problems = Problems(name)

    def damaged(self, begin: int, end: int, kind: bytes) -> None:
        """Take note of damaged bytes; `kind` is the type if they are one datagram, else empty."""
        if kind in self._pings:
            self._kinds[kind] += 1
            self._skipped["pings with a wrong checksum"] += 1
        self._problems.add(f"{end - begin} bytes from byte {begin} on are damaged or cut off")

    def take(self, datagram: Datagram) -> None:
        """Take note of a datagram; those of other types are skipped."""
        self._kinds[datagram.kind] += 1
        self._system = self._system or {(datagram.model, datagram.serial)}
        if datagram.kind in self._pings:
            self._take_ping(datagram)
        elif datagram.kind == _POSITION:
            self._positions.take(datagram)
        elif datagram.kind == _ATTITUDE:
            self._attitudes.take(datagram)

    def parts(self, window: Window) -> Iterator[Recording]:
        """Yield the recordings; the first one has all problems."""
        kind = XYZ88 if self._pings[XYZ88] else DEPTH  # some sonars log every ping as both
        rows = np.frombuffer(self._pings[kind]).reshape(-1, len(AllPing._fields))
        pings = self._placed(rows)
        self._add_problems_of_file()
        last = np.cumsum(np.maximum(kongsberg_pings.column(rows, "beams"), 1))
        cuts = np.searchsorted(last, np.arange(PART, last[-1] if len(last) else 0, PART)) + 1
        cuts = cuts[cuts < len(rows)]
        for begin, end in zip([0, *cuts], [*cuts, len(rows)], strict=True):
            yield self._part(window, kind, rows[begin:end], pings[begin:end].reset_index(drop=True))

    def _take_ping(self, datagram: Datagram) -> None:
        ping = kongsberg_pings.ping(datagram, self._order)
        if isinstance(ping, str):
            self._skipped[ping] += 1
            self._problems.add(f"the ping at byte {datagram.offset} is one of the {ping}")
            return
        self._heads.add((datagram.model, datagram.serial))
        self._pings[datagram.kind].extend(ping)

    def _placed(self, rows: np.ndarray) -> pd.DataFrame:
        time, heading, depth, *_ = rows.T
        east, north, far = self._positions.interpolate(time)
        if extrapolated := int(np.sum(far > 0)):
            self._problems.add(
                f"{extrapolated} pings before the first position or after the last, by up to {far.max():.1f} s,"
                " have its place"
            )
        columns = (time, east, north, depth, *self._attitudes.interpolate(time), heading)
        return pd.DataFrame(dict(zip(PING_COLUMNS, columns, strict=True)))

    def _add_problems_of_file(self) -> None:
        positions, water = self._kinds[_POSITION], self._kinds[_WATER_COLUMN]
        if not self._kinds[XYZ88] + self._kinds[DEPTH]:
            beside = f", but {water} datagrams of water column; the soundings are in the .all file beside it"
            self._problems.add_first(f"holds {positions} positions and no ping{beside * bool(water)}")
        elif not positions:
            self._problems.add_first("holds pings and no position")

    def _part(self, window: Window, kind: bytes, rows: np.ndarray, pings: pd.DataFrame) -> Recording:
        raw = bytearray()
        starts, beams = (kongsberg_pings.column(rows, name).astype(int).tolist() for name in ("start", "beams"))
        for start, count in zip(starts, beams, strict=True):
            raw += window.read(start, count * kongsberg_pings.BEAM_BYTES[kind])
        if len(raw) != sum(beams) * kongsberg_pings.BEAM_BYTES[kind]:
            raise KongsbergError(f"{self._name}: was cut off near byte {starts[-1]} while it was read; read it again")
        columns = kongsberg_pings.soundings(kind, self._order, raw, rows)
        soundings = pd.DataFrame({name: columns[name] for name in SOUNDING_COLUMNS})
        skipped, problems, self._skipped = dict(self._skipped), self._problems.drain(), Counter()
        tables = (pings, soundings, skipped, problems.sentences)
        return Recording(
            self._name, projection.GEOGRAPHIC, *tables, self._sensor(), _VERTICAL, problems_omitted=problems.omitted
        )

    def _sensor(self) -> str:
        sonars = self._heads or self._system
        models = sorted({_NAMES.get(model, f"EM{model}") for model, _ in sonars})
        serials = [str(serial) for serial in sorted({serial for _, serial in sonars})]
        noun = "serials" if len(serials) > 1 else "serial"
        return f"Kongsberg {' and '.join(models)}, {noun} {' and '.join(serials)}"
