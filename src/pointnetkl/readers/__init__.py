"""Readers of raw surveys: files of any known format become the pings and soundings of one map frame."""

import re
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pyarrow.parquet as pq

from pointnetkl.readers import cleaning, formats, georeference, navigation, sbet, spool
from pointnetkl.readers.formats import FORMATS
from pointnetkl.readers.georeference import Take
from pointnetkl.readers.spool import Spool
from pointnetkl.surveys.survey import TRAJECTORY, Survey, SurveyError
from pointnetkl.workflow import artifacts, compute, errors

__all__ = ["FORMATS", "ReaderError", "Settings", "files", "read", "read_truth"]

_BESIDE = (".dvc", ".crs")  # what belongs to raw files and is none
_NAVIGATION = {"SBET": sbet}
_NAMED = 3  # of the files that are passed over, the others are only counted
_SPOOL = ".spool-"
_SMALL_BYTES = 1 << 26  # in all: not worth the start of another process


class ReaderError(SurveyError):
    """A raw survey cannot be found, or is of no known format."""


@dataclass(frozen=True)
class Settings:
    """Parameters of section `ingest`.

    Raises:
        ValueError: the zone is neither auto nor an EPSG code, or the clock is unknown.
    """

    utm_zone: str
    sbet_clock: str = sbet.GPS
    outliers: cleaning.Settings = cleaning.NONE

    def __post_init__(self) -> None:
        """Refuse a zone that is not one before any file is read."""
        if not re.fullmatch(r"auto|EPSG:\d{4,6}", self.utm_zone):
            raise ValueError(f"utm_zone is {self.utm_zone!r}, must be auto or a code such as EPSG:32633")
        if self.sbet_clock not in (sbet.GPS, sbet.UTC):
            raise ValueError(f"sbet_clock is {self.sbet_clock!r}, must be {sbet.GPS} or {sbet.UTC}")


def read(path: Path, how: Settings, take: Take, scratch: Path | None = None) -> Survey:
    """Read a raw survey: a file, or all files of a folder, which need not be of one format.

    Soundings may not fit in memory: `take` gets them part by part (survey.SOUNDINGS), in order of ping and beam,
    and meanwhile they stand in a folder below `scratch`, 29 bytes each. With `utm_zone` auto, longitudes and latitudes
    come into the UTM zone of the first position, and the whole survey stays in it. What was read and skipped, and why,
    is in the report.

    Raises:
        ReaderError: nothing is there.
        SurveyError: a file is empty, of no known format or damaged beyond use, or no file has a usable ping.
    """
    found, passed = files(path)
    if scratch is not None:
        scratch.mkdir(parents=True, exist_ok=True)
        for left in scratch.glob(f"{_SPOOL}*"):  # by a run that was killed; as large as the survey
            shutil.rmtree(left, ignore_errors=True)
    with tempfile.TemporaryDirectory(prefix=_SPOOL, dir=scratch) as folder:
        tracks = [file for file in found if navigation.known(file)]
        spools = _spools([file for file in found if file not in tracks], Path(folder))
        if tracks:
            spools = navigation.replaced(spools, tracks, how.sbet_clock)
        survey = georeference.survey(spools, how.utm_zone, take, how.outliers)
    problems = [f"passed over: {_counted(passed)}"] * bool(passed) + survey.report["problems"]
    return replace(survey, report=survey.report | {"problems": problems})


def files(path: Path, others: Mapping[str, ModuleType] = _NAVIGATION) -> tuple[list[Path], list[Path]]:
    """Return a raw file, or those of a folder that are of known formats, and its others; in natural order of names.

    Known are formats.FORMATS and `others`. Hidden files, and those that belong to a raw one, are neither.

    Raises:
        ReaderError: nothing is there.
    """
    if not path.exists():
        raise ReaderError(f"{path}: is missing; give a raw file or a folder of raw files")
    if path.is_file():
        return [path], []
    every = [file for file in path.rglob("*") if file.is_file() and _may_be_raw(file.relative_to(path))]
    raw = [file for file in sorted(every, key=_natural) if formats.is_raw(file, {**formats.FORMATS, **others})]
    passed = sorted(set(every) - set(raw), key=_natural)
    if not raw:
        beside = f", and {_counted(passed)}" if passed else ""
        raise ReaderError(f"{path}: has no raw files{beside}; put some there, or run dvc pull")
    return raw, passed


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
    if survey.pings.empty:
        raise ReaderError(f"{path}: is a trajectory, and the survey has points without pings; give data/none")
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


def _spools(files: Sequence[Path], folder: Path) -> list[Spool]:
    tasks = [(file, folder / str(number)) for number, file in enumerate(files)]
    if len(tasks) > 1 and sum(file.stat().st_size for file in files) > _SMALL_BYTES:
        return compute.over(spool.fill, tasks, "reading", unit="file")
    return [spool.fill(task) for task in tasks]


def _may_be_raw(file: Path) -> bool:
    return not any(part.startswith(".") for part in file.parts) and file.suffix.lower() not in _BESIDE


def _counted(files: Sequence[Path]) -> str:
    names = ", ".join(errors.printable(file.name) for file in files[:_NAMED])
    more = f", and {len(files) - _NAMED} more" if len(files) > _NAMED else ""
    return f"{len(files)} file{'s'[: len(files) > 1]} of no known format, {names}{more}"


def _natural(file: Path) -> tuple[list[str | int], str]:
    """Return the key by which line_2 stands before line_10."""
    words = re.split(r"(\d+)", str(file))
    return [int(word) if word.isdecimal() else word for word in words], str(file)
