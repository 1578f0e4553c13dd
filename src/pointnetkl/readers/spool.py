"""A raw file as it was read: its pings in memory, its soundings on disk, because a survey's may not fit in memory."""

import multiprocessing
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from tqdm import tqdm

from pointnetkl.readers import formats
from pointnetkl.readers.formats.recording import PING_COLUMNS, Problems, Recording
from pointnetkl.surveys.survey import POINTS, SurveyError

SWATH_PLACE, POINT_PLACE = ("along_m", "across_m", "down_m"), ("east", "north", "up_m")


def _record_type(place: Sequence[str]) -> np.dtype:
    return np.dtype([("beam", "<i4"), *((name, "<f8") for name in place), ("quality", "i1")])


# a sounding on disk; of a file without pings the beam is 0
SOUNDING, POINT = _record_type(SWATH_PLACE), _record_type(POINT_PLACE)


class SpoolError(SurveyError):
    """A raw file cannot be read, or the disk for its soundings is full."""


class UnforeseenError(SpoolError):
    """A reader failed on a file with an error that is not its own: a fault of the reader."""


@dataclass(frozen=True)
class Spool:
    """One raw file. `pings` has PING_COLUMNS, and `first` and `count`: the records of `path` that belong to a ping.

    Pings with the same soundings have the same `digest`; two other pings almost surely differ in it. `middle_m` is the
    mean of a ping's soundings across track, `spread_m` their mean distance from it.
    """

    path: Path  # of SOUNDING records, or of POINT records if `kind` is POINTS
    file: str  # the raw file's name
    format: str
    size: int  # of the raw file, bytes
    crs: str
    kind: str
    sensor: str
    vertical: str
    pings: pd.DataFrame
    soundings: int
    skipped: Counter[str]
    problems: list[str]
    problems_omitted: int = 0  # problems without a sentence above


def fill(task: tuple[Path, Path]) -> Spool:
    """Read a raw file, the first path of `task`, and write its soundings to the second.

    Raises:
        SurveyError: the file is of no known format, damaged beyond use, or cannot be read or its soundings written.
    """
    source, target = task
    name = formats.identify(source)
    try:
        with target.open("wb") as stored:
            parts, tables, first, problems = [], [], 0, Problems()
            for part in _with_progress(source, formats.FORMATS[name].read(source)):
                pings, records = _records(part, first)
                records.tofile(stored)
                first += len(records)
                tables.append(pings)
                parts.append(_without_tables(part))
                problems.extend(part.problems, part.problems_omitted)
        size = source.stat().st_size
    except OSError as error:
        raise SpoolError(f"{source}: cannot be read, or {target.parent} is full ({error.strerror or error})") from error
    except SurveyError:
        raise
    except Exception as error:  # whatever goes wrong in a reader, the error must name the file
        cause = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise UnforeseenError(f"{source}: the reader of {name} fails on it ({cause}); please report it") from error
    pings = pd.concat(tables, ignore_index=True)
    skipped = sum((Counter(part.skipped) for part in parts), Counter[str]())
    sensor = next((part.sensor for part in parts if part.sensor), "")
    vertical = next((part.vertical for part in parts if part.vertical), "")
    heading = (parts[0].crs, parts[0].kind, sensor, vertical)
    counted = (skipped, problems.sentences, problems.omitted)
    return Spool(target, source.name, name, size, *heading, pings, first, *counted)


def _with_progress(source: Path, parts: Iterable[Recording]) -> Iterator[Recording]:
    """Yield the parts of a file; after two seconds a progress bar counts their soundings."""
    # workers that read several files at once report to a common bar
    alone = multiprocessing.parent_process() is None
    bar = {"unit": " soundings", "unit_scale": True, "delay": 2.0, "leave": False, "disable": not alone}
    with tqdm(desc=f"reading {source.name}", dynamic_ncols=True, **bar) as progress:
        for part in parts:
            progress.update(len(part.soundings))
            yield part


def gather(spools: Sequence[Spool], source: np.ndarray, first: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Return the records of n pings, one after the other, all of one kind.

    `source` (n,) is the index of a ping's spool, `first` (n,) its first record there, `count` (n,) how many it has.
    """
    begins = np.ones(len(first), bool)
    begins[1:] = (np.diff(source) != 0) | (first[1:] != first[:-1] + count[:-1])
    runs = np.flatnonzero(begins)
    total = np.add.reduceat(count, runs) if len(runs) else count
    record = POINT if len(source) and spools[source[0]].kind == POINTS else SOUNDING
    pieces = [
        np.fromfile(spools[source[run]].path, record, number, offset=int(first[run]) * record.itemsize)
        for run, number in zip(runs, total.tolist(), strict=True)
    ]
    return np.concatenate(pieces) if pieces else np.empty(0, record)


def _records(part: Recording, first: int) -> tuple[pd.DataFrame, np.ndarray]:
    """Return a part's pings, with the places of their soundings after `first` earlier ones, and its records by ping."""
    table, points = part.soundings, part.kind == POINTS
    records = np.empty(len(table), POINT if points else SOUNDING)
    for name in POINT_PLACE if points else SWATH_PLACE:
        records[name] = table[name].to_numpy()
    records["quality"] = table["quality"].to_numpy()
    records["beam"] = 0 if points else table["beam"].to_numpy()
    if points:
        return part.pings.assign(first=[], count=[], digest=[], middle_m=[], spread_m=[]), records
    ping = table["ping"].to_numpy()
    if np.any(np.diff(ping) < 0):
        order = np.argsort(ping, kind="stable")
        ping, records = ping[order], records[order]
    edges = np.searchsorted(ping, np.arange(len(part.pings) + 1))
    columns = {name: part.pings[name].to_numpy(np.float64) for name in PING_COLUMNS}
    where = {"first": first + edges[:-1], "count": np.diff(edges), "digest": _digest(records, edges)}
    middle, spread = _extent(records["across_m"], where["count"])
    return pd.DataFrame(columns | where | {"middle_m": middle, "spread_m": spread}), records


def _digest(records: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Return a number (n,) made of the soundings between each two edges."""
    mixed = records["beam"].astype(np.uint64)
    for name in SWATH_PLACE:
        mixed = (mixed ^ records[name].view(np.uint64)) * np.uint64(0x9E3779B97F4A7C15)
        mixed ^= mixed >> np.uint64(32)
    return np.diff(np.concatenate([np.zeros(1, np.uint64), np.cumsum(mixed)])[edges])


def _extent(across: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean of each ping's soundings across track, and their mean distance from it."""
    divisor, size = np.maximum(count, 1), len(count)
    ping = np.repeat(np.arange(size), count)
    with np.errstate(invalid="ignore", over="ignore"):
        middle = np.bincount(ping, across, size) / divisor
        return middle, np.bincount(ping, np.abs(across - middle[ping]), size) / divisor


def _without_tables(part: Recording) -> Recording:
    empty = part.pings.head(0)
    return replace(part, pings=empty, soundings=empty, problems=[])
