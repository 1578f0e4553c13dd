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

# a, b, c: metres along, across and down; of a file of points: east, north and up
SOUNDING = np.dtype([("beam", "<i4"), ("a", "<f8"), ("b", "<f8"), ("c", "<f8"), ("quality", "i1")])

_SWATH, _POINT = ("along_m", "across_m", "down_m"), ("east", "north", "up_m")


class SpoolError(SurveyError):
    """A raw file cannot be read, or the disk for its soundings is full."""


class UnforeseenError(SpoolError):
    """A reader failed on a file in a way that it does not know: a fault of the reader."""


@dataclass(frozen=True)
class Spool:
    """One raw file. `pings` has PING_COLUMNS, and which soundings of `path` are a ping's: `first` and `count`.

    Pings of the same soundings have the same `digest`, and others another one, as good as surely. `middle_m` is the
    mean of the soundings across track, and `spread_m` how far they are from it on average.
    """

    path: Path  # of SOUNDING records
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
    untold: int = 0  # problems beside those


def fill(task: tuple[Path, Path]) -> Spool:
    """Read a raw file, the first of the two, and put its soundings into the second.

    Raises:
        SurveyError: the file is of no known format, damaged beyond use, or cannot be read or kept.
    """
    source, target = task
    name, module = formats.of(source)
    try:
        with target.open("wb") as kept:
            parts, held, first, problems = [], [], 0, Problems()
            for part in _watched(source, module.read(source)):
                pings, records = _records(part, first)
                records.tofile(kept)
                first += len(records)
                held.append(pings)
                parts.append(_light(part))
                problems.add(part.problems, part.untold)
        size = source.stat().st_size
    except OSError as error:
        raise SpoolError(f"{source}: cannot be read, or {target.parent} is full ({error.strerror or error})") from error
    except SurveyError:
        raise
    except Exception as error:  # whatever a file holds, its user is to be told which one it was
        cause = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise UnforeseenError(f"{source}: the reader of {name} fails on it ({cause}); please report it") from error
    pings = pd.concat(held, ignore_index=True)
    skipped = sum((Counter(part.skipped) for part in parts), Counter[str]())
    sensor = next((part.sensor for part in parts if part.sensor), "")
    vertical = next((part.vertical for part in parts if part.vertical), "")
    of = (parts[0].crs, parts[0].kind, sensor, vertical)
    told = (skipped, problems.told, problems.untold)
    return Spool(target, source.name, name, size, *of, pings, first, *told)


def _watched(source: Path, parts: Iterable[Recording]) -> Iterator[Recording]:
    """Yield the parts of a file; where it takes its time a progress bar counts their soundings."""
    # of several files read at once each is a step of their own bar
    alone = multiprocessing.parent_process() is None
    bar = {"unit": " soundings", "unit_scale": True, "delay": 2.0, "leave": False, "disable": not alone}
    with tqdm(desc=f"reading {source.name}", dynamic_ncols=True, **bar) as progress:
        for part in parts:
            progress.update(len(part.soundings))
            yield part


def gather(spools: Sequence[Spool], source: np.ndarray, first: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Return the SOUNDING records of pings, one after the other: of each its spool, its first record, and how many."""
    begins = np.ones(len(first), bool)
    begins[1:] = (np.diff(source) != 0) | (first[1:] != first[:-1] + count[:-1])
    runs = np.flatnonzero(begins)
    total = np.add.reduceat(count, runs) if len(runs) else count
    pieces = [
        np.fromfile(spools[source[run]].path, SOUNDING, number, offset=int(first[run]) * SOUNDING.itemsize)
        for run, number in zip(runs, total.tolist(), strict=True)
    ]
    return np.concatenate(pieces) if pieces else np.empty(0, SOUNDING)


def _records(part: Recording, first: int) -> tuple[pd.DataFrame, np.ndarray]:
    """Return a part's pings, with where their soundings stand after the `first` ones, and its soundings by ping."""
    table, points = part.soundings, part.kind == POINTS
    records = np.empty(len(table), SOUNDING)
    for name, column in zip("abc", _POINT if points else _SWATH, strict=True):
        records[name] = table[column].to_numpy()
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
    middle, spread = _extent(records["b"], where["count"])
    return pd.DataFrame(columns | where | {"middle_m": middle, "spread_m": spread}), records


def _digest(records: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Return a number (n,) made of the soundings between each two edges."""
    mixed = records["beam"].astype(np.uint64)
    for name in "abc":
        mixed = (mixed ^ records[name].view(np.uint64)) * np.uint64(0x9E3779B97F4A7C15)
        mixed ^= mixed >> np.uint64(32)
    return np.diff(np.concatenate([np.zeros(1, np.uint64), np.cumsum(mixed)])[edges])


def _extent(across: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean of each ping's soundings across track, and their mean distance from it."""
    some, size = np.maximum(count, 1), len(count)
    ping = np.repeat(np.arange(size), count)
    with np.errstate(invalid="ignore", over="ignore"):
        middle = np.bincount(ping, across, size) / some
        return middle, np.bincount(ping, np.abs(across - middle[ping]), size) / some


def _light(part: Recording) -> Recording:
    """Return what is said of a part, without its tables."""
    empty = part.pings.head(0)
    return replace(part, pings=empty, soundings=empty, problems=[])
