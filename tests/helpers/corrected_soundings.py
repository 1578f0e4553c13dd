"""Soundings of a small corrected survey, and their maps and clouds as independent readers see them."""

import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import rasterio

from pointnetkl.correction import maps
from pointnetkl.correction.result import TRACK, Corrected
from pointnetkl.surveys.survey import POINTS, SOUNDINGS

BEAMS, HALF_M = 41, 20.0


def plane(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return z of a tilted seabed."""
    return -30.0 + 0.02 * x - 0.03 * y


def swaths(track: pd.DataFrame, seed: int = 0) -> pd.DataFrame:
    """Return soundings of a plane, across each ping of a track; the last three beams are rejected, in three ways."""
    across = np.tile(np.linspace(-HALF_M, HALF_M, BEAMS), len(track))
    across += np.random.default_rng(seed).uniform(-0.3, 0.3, len(across))
    x, y, yaw = np.repeat(track[["x_m", "y_m", "yaw_rad"]].to_numpy(), BEAMS, axis=0).T
    x, y = x - np.sin(yaw) * across, y + np.cos(yaw) * across
    beam = np.tile(np.arange(BEAMS), len(track))
    columns = {"ping": np.repeat(track["ping"].to_numpy(), BEAMS), "beam": beam, "x_m": x, "y_m": y}
    columns |= {"z_m": plane(x, y), "quality": np.maximum(beam - BEAMS + 4, 0)}
    table = pd.DataFrame(columns)
    return table.astype({field.name: field.type.to_pandas_dtype() for field in SOUNDINGS})


def moved_by(survey: Corrected, x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> Corrected:
    """Return the survey with the same correction of all pings."""
    track = survey.track.assign(moved_x_m=x, moved_y_m=y, moved_yaw_rad=yaw)
    return dataclasses.replace(survey, track=track)


def without_pings(survey: Corrected) -> Corrected:
    """Return the survey as a surface of points, which nothing corrects."""
    verdict = dataclasses.replace(survey.verdict, applied=False)
    return dataclasses.replace(
        survey, kind=POINTS, track=TRACK.empty_table().to_pandas(), submaps=None, verdict=verdict
    )


def in_parts(table: pd.DataFrame, rows: int = 5000) -> Callable[[], Iterator[pd.DataFrame]]:
    """Return a function that yields a table some rows at a time."""
    return lambda: (table.iloc[begin : begin + rows] for begin in range(0, len(table), rows))


def write(folder: Path, survey: Corrected, table: pd.DataFrame, cell_m: float | None = 2.0) -> maps.MapNumbers:
    """Write all products of some soundings."""
    return maps.write(folder, survey, in_parts(table), cell_m)


def band(path: Path, name: str) -> tuple[np.ndarray, Any]:
    """Return a band of a GeoTIFF (rows, columns) by its name, and the open file's profile."""
    with rasterio.open(path) as file:
        return file.read(file.descriptions.index(name) + 1), file.profile


def centres(profile: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return easting and northing (rows, columns) of the middles of a raster's cells."""
    row, column = np.mgrid[: profile["height"], : profile["width"]] + 0.5
    to_map = profile["transform"]
    return to_map.c + to_map.a * column, to_map.f + to_map.e * row
