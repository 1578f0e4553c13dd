"""Readers of raw surveys, one module a format: `begins(head)` knows its files, `read(path)` returns a Recording."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pyarrow.parquet as pq

from pointnetkl import artifacts, settings
from pointnetkl.readers import generic, georeference, gsf
from pointnetkl.survey import TRAJECTORY, Survey, SurveyError

FORMATS: dict[str, ModuleType] = {"generic pings": generic, "GSF": gsf}

_PASSED_OVER = (".dvc", ".crs")  # what stands beside raw files and is none
_HEAD_BYTES = 1 << 12


class ReaderError(SurveyError):
    """A raw survey cannot be found, or is of no known format."""


@dataclass(frozen=True)
class Settings:
    """Parameters of section `ingest`.

    Raises:
        ValueError: the zone is neither auto nor an EPSG code, or the seed is negative.
    """

    seed: int
    utm_zone: str

    def __post_init__(self) -> None:
        """Refuse a zone that is not one before any file is read."""
        settings.require_seed(self.seed)
        if not re.fullmatch(r"auto|EPSG:\d{4,6}", self.utm_zone):
            raise ValueError(f"utm_zone is {self.utm_zone!r}, must be auto or a code such as EPSG:32633")


def read(path: Path, zone: str) -> Survey:
    """Read a raw survey: a file, or all files of a folder, which need not be of one format.

    `zone` is the projected CRS for longitudes and latitudes, as EPSG:32633; "auto" takes the UTM zone of the
    first position, and the whole survey stays in it. What was read and skipped, and why, is in the report.

    Raises:
        ReaderError: nothing is there, or a file is empty or of no known format.
        SurveyError: a file is damaged beyond use, or all of them have no usable ping.
    """
    recordings = [_format(file).read(file) for file in _files(path)]
    return georeference.survey(recordings, zone)


def read_truth(path: Path, survey: Survey) -> pd.DataFrame:
    """Read the true trajectory of a survey into its map frame (schema TRAJECTORY); no rows from data/none.

    Its x_m and y_m are in the survey's CRS, which its own metadata must name if they name one.

    Raises:
        ReaderError: the file is missing, in another CRS, not finite, or of another time than the survey.
        artifacts.ArtifactError: the file is not a table of a trajectory.
    """
    if not path.is_file():
        raise ReaderError(f"{path}: is missing; data/none says that the truth is unknown")
    if artifacts.is_none(path):
        return TRAJECTORY.empty_table().to_pandas()
    truth = artifacts.read_table(path, TRAJECTORY).sort_values("time_s", kind="stable", ignore_index=True)
    crs = (pq.read_schema(path).metadata or {}).get(b"crs", survey.crs.encode()).decode("utf-8", "replace")
    if crs != survey.crs:
        raise ReaderError(f"{path}: is in {crs} and the survey in {survey.crs}; bring both to one coordinate system")
    if lost := int(np.sum(~np.isfinite(truth.to_numpy()).all(axis=1))):
        raise ReaderError(f"{path}: {lost} of its {len(truth)} rows are not finite; take them out")
    begin, end = survey.pings["time_s"].iloc[[0, -1]]
    if truth.empty or truth["time_s"].iloc[0] > end or truth["time_s"].iloc[-1] < begin:
        raise ReaderError(
            f"{path}: has no time within the survey's, {begin:.3f} to {end:.3f} s; is it another survey's?"
        )
    return truth.assign(x_m=truth["x_m"] - survey.origin[0], y_m=truth["y_m"] - survey.origin[1])


def _files(path: Path) -> list[Path]:
    if not path.exists():
        raise ReaderError(f"{path}: is missing; give a raw file or a folder of raw files")
    if path.is_file():
        return [path]
    files = sorted(file for file in path.rglob("*") if file.is_file() and _is_raw(file.relative_to(path)))
    if not files:
        raise ReaderError(f"{path}: has no raw files; put some there, or run dvc pull")
    return files


def _is_raw(file: Path) -> bool:
    return not any(part.startswith(".") for part in file.parts) and file.suffix.lower() not in _PASSED_OVER


def _format(file: Path) -> ModuleType:
    """Return the module that reads a file: by its content, else, so that damage is told, by its extension."""
    try:
        with file.open("rb") as opened:
            head = opened.read(_HEAD_BYTES)
    except OSError as error:
        raise ReaderError(f"{file}: cannot be read ({error.strerror})") from error
    if not head:
        raise ReaderError(f"{file}: is empty; copy it again or take it away")
    for module in _candidates(file, head):
        return module
    raise ReaderError(f"{file}: is of no known format, it begins with {head[:8]!r}; known are {', '.join(FORMATS)}")


def _candidates(file: Path, head: bytes) -> Iterator[ModuleType]:
    yield from (module for module in FORMATS.values() if module.begins(head))
    yield from (module for module in FORMATS.values() if file.suffix.lower() in module.SUFFIXES)
