"""GSF, the Generic Sensor Format of processed sonar data (versions 1 to 3): swath and single-beam pings.

A record's place, size and checksum, and every size within a ping, are checked before anything is decoded, so that
damage costs only the damaged records. Depths include draught (of a submersible: its depth) and tide; across track is
positive to starboard.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from pointnetkl.readers import projection
from pointnetkl.readers.formats.gsf import parameters as gsf_parameters
from pointnetkl.readers.formats.gsf import pings as gsf_pings
from pointnetkl.readers.formats.gsf import records as gsf_records
from pointnetkl.readers.formats.gsf.pings import Decoder, PingError, SwathPing
from pointnetkl.readers.formats.gsf.records import PARAMETERS, PING, SINGLE_BEAM, Record
from pointnetkl.readers.formats.recording import (
    IMPOSSIBLE,
    PART,
    PING_COLUMNS,
    REJECTED,
    SOUNDING_COLUMNS,
    Problems,
    Recording,
)
from pointnetkl.readers.formats.window import Window
from pointnetkl.surveys.survey import SurveyError

SUFFIXES = (".gsf",)

_MOST_PINGS = PART // 16  # in a part: single-beam pings have few soundings and would fill memory
_UNREADABLE = "unreadable pings"


class GsfError(SurveyError):
    """A file is not GSF, or cannot be read."""


def begins(head: bytes) -> bool:
    """Whether the first bytes of a file are those of GSF."""
    return b"GSF-v" in head[8:24]


def read(path: Path) -> Iterator[Recording]:
    """Read the pings of a GSF file in parts; damaged records are counted, and reported with their byte offset.

    Raises:
        GsfError: the file does not begin as GSF does, or cannot be read.
    """
    try:
        with Window(path) as window:
            head = bytes(window.read(0, 24))
            major = gsf_records.version(head)
            if major is None:
                raise GsfError(
                    f"{path}: byte 8 must say GSF-v01 to GSF-v03, it has {head[8:20]!r}; is this a GSF file?"
                )
            yield from _File(path.name, window, major).parts()
    except OSError as error:
        raise GsfError(f"{path}: cannot be read ({error.strerror})") from error


class _File:
    """A file while it is read, and its next part so far."""

    def __init__(self, name: str, window: Window, major: int) -> None:
        self._name, self._window, self._decoder = name, window, Decoder(major)
        self._parameters: dict[str, str] = {}
        self._sensor = self._vertical = ""
        self._pings: list[SwathPing] = []
        self._soundings = self._unreadable = 0
        self._problems = Problems(name)

    def parts(self) -> Iterator[Recording]:
        empty = True
        for record in gsf_records.records(self._window, self._problems.add):
            self._take(record)
            if self._soundings >= PART or len(self._pings) >= _MOST_PINGS:
                yield self._part()
                empty = False
        if empty and not self._pings and not self._unreadable:
            self._problems.add("no ping is among its records")
        if empty or self._pings or self._problems or self._unreadable:
            yield self._part()

    def _take(self, record: Record) -> None:
        if record.lost:
            self._decoder.forget()
        if record.kind not in (PING, PARAMETERS, SINGLE_BEAM):
            return
        content = gsf_records.content(self._window, record)
        if record.kind == PARAMETERS:
            self._parameters = gsf_parameters.parameters(content or memoryview(b""))
            return
        try:
            self._add(self._ping(record, content))
        except PingError as fault:
            self._unreadable += 1
            self._problems.add(f"ping at byte {record.offset}: {fault}")

    def _ping(self, record: Record, content: memoryview | None) -> SwathPing:
        if content is None:
            self._decoder.forget()
            raise PingError("its checksum does not match")
        return gsf_pings.single(content) if record.kind == SINGLE_BEAM else self._decoder.swath(content)

    def _add(self, ping: SwathPing) -> None:
        if not self._vertical:
            self._vertical = gsf_parameters.vertical(self._parameters, ping.tide)
            for sentence in gsf_parameters.unapplied(self._parameters):
                self._problems.add_first(sentence)
        self._sensor = self._sensor or ping.sensor
        self._pings.append(ping)
        self._soundings += len(ping.depth_m)

    def _part(self) -> Recording:
        skipped = {_UNREADABLE: self._unreadable} if self._unreadable else {}
        pings = np.array([ping.navigation for ping in self._pings]).reshape(-1, len(PING_COLUMNS))
        problems = self._problems.drain()
        recording = Recording(
            self._name,
            projection.GEOGRAPHIC,
            pd.DataFrame(pings, columns=list(PING_COLUMNS)),
            _soundings(self._pings, pings[:, PING_COLUMNS.index("depth_m")]),
            skipped,
            problems.sentences,
            self._sensor,
            self._vertical,
            problems_omitted=problems.omitted,
        )
        self._pings, self._soundings, self._unreadable = [], 0, 0
        return recording


def _soundings(pings: list[SwathPing], vehicle_m: np.ndarray) -> pd.DataFrame:
    counts = np.array([len(ping.depth_m) for ping in pings], np.int64)
    number = np.repeat(np.arange(len(pings)), counts)
    beam = np.arange(len(number)) - np.repeat(np.cumsum(counts) - counts, counts)
    along, across, depth = (
        _joined([getattr(ping, name) for ping in pings]) for name in ("along_m", "across_m", "depth_m")
    )
    rejected = _joined([ping.rejected for ping in pings]).astype(bool)
    placed = np.array([ping.placed for ping in pings], bool)[number]
    unplaced = (depth == 0.0) | ~placed  # 0 means no depth
    quality = np.where(rejected, REJECTED, np.where(unplaced, IMPOSSIBLE, 0)).astype(np.int8)
    columns = (number, beam, along, across, depth - vehicle_m[number], quality)
    return pd.DataFrame(dict(zip(SOUNDING_COLUMNS, columns, strict=True)))


def _joined(arrays: list[np.ndarray]) -> np.ndarray:
    return np.concatenate(arrays) if arrays else np.empty(0)
