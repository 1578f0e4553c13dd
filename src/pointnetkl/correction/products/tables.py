"""The corrected track and the loop closures as CSV."""

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import csv

from pointnetkl.correction.products import placed
from pointnetkl.correction.products.placed import Placed
from pointnetkl.correction.result import CLOSURES, Corrected
from pointnetkl.workflow import artifacts

# decimals: 1e-10 degrees are 0.01 mm on the ground; _EXACT is of closures
_DEGREES, _METRES, _ANGLES, _SECONDS, _EXACT = 10, 4, 6, 6, 9


def write_track(path: Path, track: Placed) -> None:
    """Write a line per ping: where the correction puts it, how it moved it, and how sure both are.

    Raises:
        CorrectionError: the track cannot be placed on the earth.
        ArtifactError: the file cannot be written.
    """
    known = track.has_times
    columns: dict[str, Any] = {"ping": track.track["ping"].to_numpy(), "file": track.track["file"].to_numpy(object)}
    columns["utc"] = placed.iso(track.time_s if known else np.full(len(track.time_s), np.nan))
    columns["time_s"] = np.round(track.time_s, _SECONDS)
    columns |= _geographic(track.earth, len(track.time_s)) | _metres(x_m=track.place[:, 0], y_m=track.place[:, 1])
    columns |= _metres(depth_m=-track.z_m) | _angles(heading_deg=track.heading_rad)
    columns |= _metres(moved_x_m=track.column("moved_x_m"), moved_y_m=track.column("moved_y_m"))
    columns |= _angles(moved_heading_deg=-track.column("moved_yaw_rad"))
    columns |= _sigmas(track.covariance()) | _angles(sigma_heading_deg=np.sqrt(track.column("var_yaw_rad2")))
    before, sigmas = track.before[:, :2] + track.origin, np.sqrt(_variances(track.covariance("before_")))
    columns |= _metres(before_x_m=before[:, 0], before_y_m=before[:, 1])
    columns |= _metres(before_sigma_x_m=sigmas[:, 0], before_sigma_y_m=sigmas[:, 1])
    _write(path, columns)


def write_closures(path: Path, corrected: Corrected) -> None:
    """Write a line per loop closure, accepted or refused, with its place on the map and on the earth.

    Raises:
        CorrectionError: the closures cannot be placed on the earth.
        ArtifactError: the file cannot be written.
    """
    table = artifacts.to_arrow(path, corrected.closures, CLOSURES)
    columns: dict[str, Any] = {}
    where = np.column_stack([_numbers(table, "x_m"), _numbers(table, "y_m")]) + corrected.origin
    earth = placed.on_earth(corrected.crs, where)
    for name in CLOSURES.names:
        if name == "x_m":
            columns |= _geographic(earth, len(where)) | _metres(x_m=where[:, 0])
        elif name == "y_m":
            columns |= _metres(y_m=where[:, 1])
        elif pa.types.is_floating(CLOSURES.field(name).type):
            columns[name] = np.round(_numbers(table, name), _SECONDS if name.endswith("_s") else _EXACT)
        else:
            columns[name] = table[name]
    _write(path, columns)


def _numbers(table: pa.Table, name: str) -> np.ndarray:
    return np.asarray(table[name].to_numpy(zero_copy_only=False), np.float64)


def _geographic(earth: placed.Earth | None, count: int) -> dict[str, np.ndarray]:
    nowhere = np.full(count, np.nan)
    longitude, latitude = (earth.longitude_deg, earth.latitude_deg) if earth else (nowhere, nowhere)
    return {"lon_deg": np.round(longitude, _DEGREES), "lat_deg": np.round(latitude, _DEGREES)}


def _metres(**columns: np.ndarray) -> dict[str, np.ndarray]:
    return {name: np.round(values, _METRES) + 0.0 for name, values in columns.items()}  # + 0.0: there is no -0


def _angles(**columns: np.ndarray) -> dict[str, np.ndarray]:
    return {name: np.round(np.rad2deg(values), _ANGLES) + 0.0 for name, values in columns.items()}


def _variances(covariances: np.ndarray) -> np.ndarray:
    return np.diagonal(covariances, axis1=1, axis2=2)


def _sigmas(covariances: np.ndarray) -> dict[str, np.ndarray]:
    sigma_x, sigma_y = np.sqrt(_variances(covariances)).T
    known = sigma_x * sigma_y > 0
    correlation = np.divide(covariances[:, 0, 1], sigma_x * sigma_y, out=np.full(len(known), np.nan), where=known)
    return _metres(sigma_x_m=sigma_x, sigma_y_m=sigma_y) | {"correlation_xy": np.round(correlation, 6)}


def _write(path: Path, columns: Mapping[str, Any]) -> None:
    arrays = {
        # what is not known, NaN, is an empty field
        name: values if isinstance(values, pa.ChunkedArray) else pa.array(values, from_pandas=True)
        for name, values in columns.items()
    }
    buffer = io.BytesIO()
    csv.write_csv(pa.table(arrays), buffer, csv.WriteOptions(quoting_style="needed", quoting_header="none"))
    artifacts.write_bytes(path, buffer.getvalue())
