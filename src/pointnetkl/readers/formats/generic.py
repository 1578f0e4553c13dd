"""Generic raw pings: a long table, one row a sounding, as Parquet or CSV. Any sonar's data can be written so.

Columns: time_s (UTC, seconds since 1970; the same in all rows of a ping); longitude_deg and latitude_deg (WGS84), or
x_m and y_m (projected; the CRS in the Parquet metadata `crs`, a column `crs` or a file `.crs` beside it), which are
used if both pairs are present; depth_m (of the vehicle, positive down), heading_rad (clockwise from true north, or
from grid north with x_m); along_m (forward), across_m (to starboard), down_m (down from the vehicle). Optional:
roll_rad, pitch_rad, beam, quality (0: good).
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from pointnetkl.readers import projection
from pointnetkl.readers.formats.recording import PART, REJECTED, Recording
from pointnetkl.surveys.survey import SurveyError
from pointnetkl.workflow.errors import printable

SUFFIXES = (".parquet", ".csv")
_NEEDED = ("time_s", "depth_m", "heading_rad", "along_m", "across_m", "down_m")
_OPTIONAL = ("roll_rad", "pitch_rad", "beam", "quality")
_PROJECTED, _GEOGRAPHIC = ("x_m", "y_m"), ("longitude_deg", "latitude_deg")
_SOUNDING = ("along_m", "across_m", "down_m")
_HEADER_BYTES, _BLOCK = 1 << 16, 1 << 21  # bytes of text that are read at once: for its header, and for its rows
_LARGE, _BUFFER = 1 << 26, 1 << 20  # bytes of a large file, and bytes of its columns that are read at once
_LATEST_S = 1e10  # in the year 2286
_SAME = 1e-6  # by which navigation may differ within a ping through rounding, metres or radians
Columns = dict[str, np.ndarray]


class GenericError(SurveyError):
    """A file of generic pings lacks a column, or a column has no numbers or another unit."""


def begins(head: bytes) -> bool:
    """Whether the first bytes of a file are those of generic pings."""
    names = head.split(b"\n", 1)[0]
    # any name that no table of points has: else a table without a time would pass for points at the vehicle
    return head.startswith(b"PAR1") or any(name in names for name in (b"time_s", b"along_m", b"across_m", b"down_m"))


def read(path: Path) -> Iterator[Recording]:
    """Read one file of generic pings in parts of whole pings; a ping's rows may be anywhere within one part.

    Raises:
        GenericError: the file is damaged, lacks a column, or a column is not numeric or not in its unit.
    """
    order, crs = _Order(), ""
    for columns, part_crs, last in _with_last(_read_parquet(path) if _is_parquet(path) else _read_csv(path)):
        if crs not in ("", part_crs):
            raise GenericError(f"{path}: column crs must name one coordinate system, it has {[crs, part_crs]}")
        crs, skipped = part_crs, dict[str, int]()
        _check_units(path, columns := order.whole_pings(_timed(columns, skipped), last))
        begin = np.flatnonzero(np.diff(columns["time_s"], prepend=-np.inf) > 0)
        ping = np.repeat(np.arange(len(begin)), np.diff(np.append(begin, len(columns["time_s"]))))
        pings, soundings = _pings(path, columns, begin, ping), _soundings(columns, begin, ping)
        yield Recording(path.name, crs, pings, soundings, skipped, order.problems(path) if last else [])


@dataclass
class _Order:
    """Sorts rows by time, and keeps a block's last ping for the next block, where it may continue."""

    rest: Columns = field(default_factory=dict)
    latest: float = -np.inf  # time of the row before
    early: int = 0  # rows that went back in time

    def whole_pings(self, columns: Columns, last: bool) -> Columns:
        """Return the rows of complete pings, in order."""
        time = columns["time_s"]
        if len(time):
            self.early += int(np.sum(np.diff(time, prepend=self.latest) < 0))
            self.latest = float(time[-1])
        if self.rest:
            columns = {name: np.concatenate([self.rest[name], column]) for name, column in columns.items()}
        time = columns["time_s"]
        if np.any(np.diff(time) < 0):
            order = np.argsort(time, kind="stable")
            columns = {name: column[order] for name, column in columns.items()}
            time = columns["time_s"]
        count = len(time) if last or not len(time) else int(np.searchsorted(time, time[-1]))
        self.rest = {name: column[count:] for name, column in columns.items()}
        return {name: column[:count] for name, column in columns.items()}

    def problems(self, path: Path) -> list[str]:
        """Return a sentence if rows were out of order."""
        return [f"{path.name}: its rows went back in time {self.early} times, and were sorted"] if self.early else []


def _is_parquet(path: Path) -> bool:
    with path.open("rb") as file:  # a Parquet file with a damaged head is no text either
        return path.suffix.lower() == ".parquet" or file.read(4) == b"PAR1"


def _with_last(blocks: Iterator[tuple[Columns, str]]) -> Iterator[tuple[Columns, str, bool]]:
    before = next(blocks)
    for block in blocks:
        yield *before, False
        before = block
    yield *before, True


def _read_parquet(path: Path) -> Iterator[tuple[Columns, str]]:
    try:
        # with a buffer, a page whose size is damaged is allocated in that size; without, a row group is read at once
        buffer = _BUFFER if path.stat().st_size > _LARGE else 0
        with pq.ParquetFile(path, page_checksum_verification=True, pre_buffer=False, buffer_size=buffer) as file:
            schema = file.schema_arrow
            names = _wanted(path, schema.names)
            for name in names:
                if not (pa.types.is_integer(dtype := schema.field(name).type) or pa.types.is_floating(dtype)):
                    raise GenericError(f"{path}: column {name} holds {dtype}, must hold numbers")
            crs = (schema.metadata or {}).get(b"crs")
            columns = [*names, *(["crs"] if crs is None and "crs" in schema.names else [])]
            empty = True
            for batch in file.iter_batches(batch_size=PART, columns=columns):
                yield _numbers(batch, names), _crs(path, batch, crs, names)
                empty = False
            if empty:
                table = schema.empty_table()
                yield _numbers(table, names), _crs(path, table, crs, names)
    except (pa.ArrowException, OSError, MemoryError, UnicodeError) as error:
        raise GenericError(f"{path}: is a damaged Parquet file ({printable(error)}); copy or make it again") from error


def _read_csv(path: Path) -> Iterator[tuple[Columns, str]]:
    from pyarrow import csv

    with path.open("rb") as file:
        header = file.read(_HEADER_BYTES).split(b"\n", 1)[0].decode("utf-8-sig", "replace")
    header_names = [name.strip().strip('"') for name in header.split(",")]
    names = _wanted(path, header_names)
    crs_column = ["crs"] if "crs" in header_names else []
    types = dict.fromkeys(names, pa.float64()) | dict.fromkeys(crs_column, pa.string())
    convert = csv.ConvertOptions(column_types=types, include_columns=list(types))
    # with names given and threads off, an error has the number of its row
    reading = csv.ReadOptions(column_names=header_names, skip_rows=1, use_threads=False, block_size=_BLOCK)
    try:
        with csv.open_csv(path, read_options=reading, convert_options=convert) as blocks:
            empty = True
            for block in blocks:
                yield _numbers(block, names), _crs(path, block, None, names)
                empty = False
            if empty:
                yield {name: np.empty(0) for name in names}, projection.LOCAL
    except (pa.ArrowException, OSError, MemoryError, UnicodeError) as error:
        raise GenericError(f"{path}: is not a table of numbers ({printable(error)})") from error


def _wanted(path: Path, present: list[str]) -> list[str]:
    position = _PROJECTED if set(_PROJECTED) <= set(present) else _GEOGRAPHIC
    for name in (*_NEEDED, *position):
        if present.count(name) != 1:
            or_projected = " (or x_m and y_m)" if name in _GEOGRAPHIC else ""
            trouble = "stands twice" if name in present else "is missing"
            listed = printable(", ".join(present[:30]))
            raise GenericError(f"{path}: column {name}{or_projected} {trouble}; it has {listed}")
    return [*_NEEDED, *position, *(name for name in _OPTIONAL if name in present)]


def _numbers(table: pa.Table | pa.RecordBatch, names: list[str]) -> Columns:
    cast = {name: table[name].cast(pa.float64(), safe=False) for name in names}
    return {name: column.to_numpy(zero_copy_only=False) for name, column in cast.items()}  # empty cells are NaN


def _crs(path: Path, table: pa.Table | pa.RecordBatch, stored: bytes | None, names: list[str]) -> str:
    if "longitude_deg" in names:
        return projection.GEOGRAPHIC
    if stored is not None:
        return stored.decode("utf-8", "replace")
    if "crs" in table.schema.names:
        crs_names = table["crs"].unique().to_pylist()
        if len(crs_names) != 1 or not crs_names[0]:
            raise GenericError(f"{path}: column crs must name one coordinate system, it has {crs_names[:3]}")
        return str(crs_names[0])
    return projection.beside(path)


def _timed(columns: Columns, skipped: dict[str, int]) -> Columns:
    timed = np.isfinite(columns["time_s"])
    if timed.all():
        return columns
    skipped["soundings without a time"] = int(np.sum(~timed))
    return {name: column[timed] for name, column in columns.items()}


def _check_units(path: Path, columns: Columns) -> None:
    if not len(columns["time_s"]):
        return
    if (latest := float(columns["time_s"].max())) > _LATEST_S:
        raise GenericError(f"{path}: time_s reaches {latest:.4g}, must be seconds since 1970, not milliseconds")
    largest = float(np.nanmax(np.abs(columns["heading_rad"]), initial=0.0))
    if largest > 2 * np.pi + _SAME:
        raise GenericError(f"{path}: heading_rad reaches {largest:.4g}, must be radians within one turn")
    depth, down = (_middle(columns[name]) for name in ("depth_m", "down_m"))
    if depth < -1.0:
        raise GenericError(f"{path}: depth_m is {depth:.4g} m in the middle, must be positive below the surface")
    if down <= 0.0:
        raise GenericError(f"{path}: down_m is {down:.4g} m in the middle, must be positive below the vehicle")
    if "latitude_deg" in columns:
        _check_degrees(path, columns)


def _check_degrees(path: Path, columns: Columns) -> None:
    # single positions out of range are skipped and counted; if most are, the columns are wrong
    for name, limit in (("longitude_deg", 180.0), ("latitude_deg", 90.0)):
        if abs(middle := _middle(columns[name])) > limit:
            raise GenericError(f"{path}: {name} is {middle:.6g} in the middle, must lie within -{limit:g} to {limit:g}")


def _middle(column: np.ndarray) -> float:
    numbers = column[np.isfinite(column)]
    return float(np.median(numbers)) if len(numbers) else float("nan")


def _pings(path: Path, columns: Columns, begin: np.ndarray, ping: np.ndarray) -> pd.DataFrame:
    east, north = _PROJECTED if "x_m" in columns else _GEOGRAPHIC
    sources = {"time_s": "time_s", "east": east, "north": north}
    sources |= {name: name for name in ("depth_m", "heading_rad", "roll_rad", "pitch_rad")}
    table: dict[str, Any] = {}
    for name, source in sources.items():
        column = columns.get(source, np.full(len(ping), np.nan))  # NaN: roll and pitch not recorded
        first = column[begin].copy()
        differs = np.abs(column - first[ping])
        scale = 1e-5 if source in _GEOGRAPHIC else 1.0  # a degree is some 1e5 m
        if (worst := float(np.nanmax(differs, initial=0.0))) > _SAME * scale:
            worst_time = columns["time_s"][int(np.nanargmax(differs))]
            raise GenericError(
                f"{path}: {source} differs by {worst:.3g} within the ping at time_s {worst_time:.6f}; give one value"
            )
        first[ping[~np.isfinite(column)]] = np.nan  # a ping with a gap in its navigation is not used
        table[name] = first
    return pd.DataFrame(table)


def _soundings(columns: Columns, begin: np.ndarray, ping: np.ndarray) -> pd.DataFrame:
    table = {"ping": ping} | {name: columns[name] for name in _SOUNDING}
    order_in_ping = np.arange(len(ping)) - begin[ping]
    beam = columns.get("beam", order_in_ping)
    table["beam"] = np.where(np.isfinite(beam) & (np.abs(beam) < 2**31), beam, order_in_ping).astype(np.int32)
    quality = columns.get("quality", np.zeros(len(ping)))
    small = np.where(np.abs(quality) <= 127, quality, REJECTED)  # also where it is empty
    table["quality"] = np.where((small != 0) & (np.trunc(small) == 0), REJECTED, small).astype(np.int8)
    return pd.DataFrame(table)
