"""GSF, the Generic Sensor Format of processed multibeam data (versions 1 to 3), decoded by gsfu.

A record's place and size are checked here before gsfu sees it, so a damaged file costs the damaged records.
Depths have draught (of a submersible: its depth) and tide added already; across track is positive to starboard.
"""

import datetime
import mmap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pointnetkl.readers import gsf_records, projection
from pointnetkl.readers.georeference import IMPOSSIBLE, REJECTED, Recording
from pointnetkl.readers.gsf_records import PING, Record
from pointnetkl.survey import SurveyError

SUFFIXES = (".gsf",)

_NO_DEPTH, _NO_ANGLE = 99.99, 99.0  # stand for values that are not known
_MOST_FAILURES = 100  # of gsfu itself, on records that looked sound
_PINGS = ("time_s", "east", "north", "depth_m", "roll_rad", "pitch_rad", "heading_rad")
_SOUNDINGS = ("ping", "beam", "along_m", "across_m", "down_m", "quality")


class GsfError(SurveyError):
    """A file is not GSF, or is damaged beyond use."""


def begins(head: bytes) -> bool:
    """Whether the first bytes of a file are those of GSF."""
    return b"GSF-v" in head[8:24]


def read(path: Path) -> Recording:
    """Read the swath bathymetry pings of a GSF file; damaged records are counted and told with their byte offset.

    Raises:
        GsfError: the file does not begin as GSF does, or gsfu fails on too many of its pings.
    """
    damage: list[str] = []
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        major = gsf_records.version(data)
        if major is None:
            raise GsfError(f"{path}: byte 8 must say GSF-v01 to GSF-v03, it has {data[8:20]!r}; is this a GSF file?")
        records = list(gsf_records.checked(data, major, damage))
    pings = [record for record in records if record.kind == PING]
    if not pings:
        damage.append(f"{len(records)} records and no swath bathymetry ping among them")
    gathered = _Gathered()
    for record, ping in _decoded(path, major, pings):
        if fault := ping if isinstance(ping, str) else gathered.add(ping):
            gathered.skipped["unreadable pings"] = gathered.skipped.get("unreadable pings", 0) + 1
            damage.append(f"ping at byte {record.offset}: {fault}")
    return gathered.recording(path.name, [f"{path.name}: {sentence}" for sentence in damage])


def _decoded(path: Path, major: int, records: list[Record]) -> Iterator[tuple[Record, Any]]:
    """Yield each ping as gsfu decodes it, or the reason why it cannot be."""
    import GSFU

    file = GSFU.gsf(str(path))
    file.gsfVersion = f"GSF-v{major:02d}.00"
    try:
        for run in _runs(records):
            yield from _decoded_run(path, file, run)
    finally:
        file.closeFile()


def _runs(records: list[Record]) -> Iterator[list[Record]]:
    """Cut the pings where scale factors may be lost: gsfu begins each run without any."""
    run: list[Record] = []
    for record in records:
        if record.breaks and run:
            yield run
            run = []
        run.append(record)
    if run:
        yield run


def _decoded_run(path: Path, file: Any, run: list[Record]) -> Iterator[tuple[Record, Any]]:
    yield from ((record, record.fault) for record in run if record.fault)
    sound, failures = [record for record in run if not record.fault], 0
    while sound:
        file.Index = _index(sound)
        done = 0
        try:
            for _, _, ping in file.iter_records(PING):
                yield sound[done], ping
                done += 1
            return
        except Exception as error:  # gsfu fails in ways of struct, numpy and datetime
            failures += 1
            if failures > _MOST_FAILURES:
                raise GsfError(
                    f"{path}: gsfu fails on {failures} pings, the last at byte {sound[done].offset}"
                ) from error
            yield sound[done], f"gsfu fails ({type(error).__name__}: {error})"
        sound = sound[done + 1 :]


def _index(records: list[Record]) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "RecordID": [record.kind for record in records],
            "ByteOffset": [record.offset for record in records],
            "RecordSize": [record.size for record in records],
            "ChecksumFlag": [record.checksummed for record in records],
        }
    )


class _Gathered:
    """The pings and soundings of a file, as they are decoded."""

    def __init__(self) -> None:
        self.pings: list[tuple[float, ...]] = []
        self.soundings: list[tuple[np.ndarray, ...]] = []
        self.skipped: dict[str, int] = {}

    def add(self, ping: dict[str, Any]) -> str:
        """Take a ping; return why it cannot be taken."""
        beams, count = ping["Beams"], int(ping["NumberBeams"])
        depth = beams["Depth_m"] if beams["Depth_m"] is not None else beams["NominalDepth_m"]
        if depth is None and count:
            return "; ".join(note for note in ping["Notes"] if "Depth_m" in note) or "has no depths"
        across, along, flags = beams["AcrossTrack_m"], beams["AlongTrack_m"], beams["BeamFlags"]
        columns = [np.zeros(count) if column is None else column for column in (depth, across, along, flags)]
        if any(len(column) != count for column in columns):
            return f"an array does not have {count} beams"
        depth, across_m, along_m, flags = columns
        # positive: a submersible's depth, or draught; negative: a ship's heave, and the ship is at the surface
        vehicle = max(0.0, ping["DepthCorrector_m"]) if ping["DepthCorrector_m"] != _NO_DEPTH else 0.0
        rejected = (flags.astype(np.uint8) & 1).astype(bool) | bool(ping["PingFlags"] & 1)
        unplaced = (depth == 0.0) | (across is None)  # 0 stands for no depth
        quality = np.where(rejected, REJECTED, np.where(unplaced, IMPOSSIBLE, 0)).astype(np.int8)
        number = np.full(count, len(self.pings))
        self.soundings.append((number, np.arange(count), along_m, across_m, depth - vehicle, quality))
        self.pings.append(_navigation(ping, vehicle))
        return ""

    def recording(self, name: str, problems: list[str]) -> Recording:
        pings = pd.DataFrame(np.array(self.pings).reshape(-1, len(_PINGS)), columns=list(_PINGS))
        empty = (np.empty(0),) * len(_SOUNDINGS)
        columns = [np.concatenate(column) for column in zip(*(self.soundings or [empty]), strict=True)]
        soundings = pd.DataFrame(dict(zip(_SOUNDINGS, columns, strict=True)))
        soundings["ping"] = soundings["ping"].astype(np.int64)
        return Recording(name, projection.GEOGRAPHIC, pings, soundings, self.skipped, problems)


def _navigation(ping: dict[str, Any], vehicle_depth: float) -> tuple[float, ...]:
    time = datetime.datetime.fromisoformat(ping["PingTime"]).timestamp()
    heading = float(ping["Heading_deg"])
    heading = heading if 0.0 <= heading <= 360.0 else np.nan  # 361 stands for none
    angles = [ping[name] if ping[name] != _NO_ANGLE else np.nan for name in ("Roll_deg", "Pitch_deg")]
    turned = (float(np.deg2rad(angle)) for angle in (*angles, heading))
    return (time, ping["Longitude_deg"], ping["Latitude_deg"], vehicle_depth, *turned)
