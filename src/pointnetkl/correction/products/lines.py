"""A survey's lines before and after its correction, and its loop closures, as layers of a GeoPackage."""

import struct
import tempfile
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pointnetkl.correction.products import placed
from pointnetkl.correction.products.placed import Placed
from pointnetkl.correction.result import CLOSURES, Corrected, CorrectionError
from pointnetkl.readers import projection
from pointnetkl.workflow import artifacts
from pointnetkl.workflow.errors import printable

_POINT, _LINE = 1, 2  # of well-known binary
_EVERY_S = 1.0  # a vertex; the last ping of a line is one too
_UTC = 100  # GDAL's flag of a time zone
_CARTESIAN = "-1"  # GeoPackage's number of an undefined map


@dataclass(frozen=True)
class _Layer:
    name: str
    kind: str  # of geometries
    geometries: list[bytes | None]
    fields: dict[str, np.ndarray]


def write(path: Path, corrected: Corrected, track: Placed) -> None:
    """Write layers `before` and `after`, a line string per line and file, and `closures`, points.

    Raises:
        CorrectionError: the file cannot be made.
        ArtifactError: the file cannot be written.
    """
    lines = _lines_of(corrected, track)
    thinned = _thinned(track, lines)
    fields = _line_fields(track, lines)
    layers = [
        _Layer(name, "LineString", _strings(places[:, :2] + track.origin, lines, thinned), fields)
        for name, places in (("before", track.before), ("after", track.after))
    ]
    artifacts.write_bytes(path, _content(path, corrected, [*layers, _closures(corrected)]))


def _lines_of(corrected: Corrected, track: Placed) -> np.ndarray:
    """Return the line (n,) of each ping; -1 of one that is alone, which is no line."""
    submaps = corrected.submaps
    # submaps of another program are one file each, and have no times
    cut = not track.has_times and submaps is not None and len(submaps.line) == len(track.time_s)
    lines = submaps.line if cut and submaps is not None else track.lines
    _, number, count = np.unique(lines, return_inverse=True, return_counts=True)
    whole = np.cumsum(count > 1) - 1
    return np.where(count[number] > 1, whole[number], -1)


def _thinned(track: Placed, lines: np.ndarray) -> np.ndarray:
    """Return which pings (n,) are vertices: the first of each second of a line, and its last."""
    begin = np.append(True, lines[1:] != lines[:-1])[: len(lines)]
    first = np.maximum.accumulate(np.where(begin, np.arange(len(lines)), 0))
    second = np.floor((track.time_s - track.time_s[first]) / _EVERY_S)
    return begin | np.append(False, np.diff(second) != 0)[: len(lines)] | np.append(begin[1:], True)[: len(lines)]


def _strings(places: np.ndarray, lines: np.ndarray, thinned: np.ndarray) -> list[bytes | None]:
    """Return well-known binary of each line's vertices."""
    good = thinned & (lines >= 0)
    kept = places[good]
    ends = np.flatnonzero(np.diff(lines[good])) + 1
    parts = np.split(kept, ends) if len(kept) else []
    return [struct.pack("<BII", 1, _LINE, len(part)) + part.astype("<f8").tobytes() for part in parts]


def _line_fields(track: Placed, lines: np.ndarray) -> dict[str, np.ndarray]:
    rows = np.flatnonzero(lines >= 0)
    _, first, count = np.unique(lines[rows], return_index=True, return_counts=True)
    last = first + count - 1
    squares = (track.after[:, :2] - track.before[:, :2]) ** 2
    rms = np.sqrt(np.add.reduceat(squares[rows].sum(axis=1), first) / count) if len(rows) else np.zeros(0)
    times = placed.utc(track.time_s if track.has_times else np.full(len(lines), np.nan))[rows]
    files = track.files[rows] if track.has_times else np.full(len(rows), None)
    return {
        "file": files[first],
        "begin_utc": times[first].astype("M8[ms]"),  # what the format holds
        "end_utc": times[last].astype("M8[ms]"),
        "pings": count.astype(np.int32),
        "rms_moved_m": rms,
    }


def _closures(corrected: Corrected) -> _Layer:
    table = artifacts.to_arrow(Path("closures"), corrected.closures, CLOSURES).to_pandas()
    places = table[["x_m", "y_m"]].to_numpy(np.float64) + corrected.origin
    known = np.isfinite(places).all(axis=1)
    points = [
        struct.pack("<BIdd", 1, _POINT, *place) if good else None
        for place, good in zip(places.tolist(), known.tolist(), strict=True)
    ]
    fields = {name: table[name].to_numpy(np.int32) for name in ("source", "target")}
    fields["state"] = table["state"].to_numpy(object)
    fields |= {name: table[name].to_numpy(np.float64) for name in ("shift_x_m", "shift_y_m")}
    fields |= {f"sigma_{axis}_m": np.sqrt(table[f"v_{axis}{axis}_m2"].to_numpy(np.float64)) for axis in ("x", "y")}
    fields |= {name: table[name].to_numpy(np.float64) for name in ("sigmas_before", "sigmas_after")}
    return _Layer("closures", "Point", points, fields)


def _content(path: Path, corrected: Corrected, layers: list[_Layer]) -> bytes:
    """Return the bytes of a GeoPackage, which depend on the layers alone."""
    import pyogrio  # slow to import

    latest = placed.utc(corrected.track["time_s"].to_numpy(np.float64)[-1:])
    # GDAL would write the time of now as that of the last change
    pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": f"{np.datetime_as_string(latest, unit='ms')[0]}Z"})
    try:
        with tempfile.TemporaryDirectory() as folder:
            whole = Path(folder) / path.name
            for number, layer in enumerate(layers):
                _add(whole, layer, corrected.crs, append=number > 0)
            return whole.read_bytes()
    except (pyogrio.errors.DataSourceError, pyogrio.errors.DataLayerError, OSError) as error:
        raise CorrectionError(f"{path}: the GeoPackage cannot be made ({printable(error)})") from error
    finally:
        pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": None})


def _add(path: Path, layer: _Layer, crs: str, append: bool) -> None:
    import pyogrio

    is_local = crs == projection.LOCAL
    settings: dict[str, Any] = {"layer_options": {"SRID": _CARTESIAN}} if is_local else {}
    zones = {name: np.full(len(values), _UTC) for name, values in layer.fields.items() if values.dtype.kind == "M"}
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "'crs' was not provided", UserWarning)  # a local map has none
        pyogrio.raw.write(
            path,
            np.array(layer.geometries, object),
            list(layer.fields.values()),
            list(layer.fields),
            layer=layer.name,
            driver="GPKG",
            geometry_type=layer.kind,
            crs=None if is_local else crs,
            append=append,
            gdal_tz_offsets=zones,
            **settings,
        )
