"""Readers of raw surveys: files of any supported format become pings and soundings in one map frame."""

import re
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq

from pointnetkl.readers import cleaning, formats, georeference, navigation, sbet, spool
from pointnetkl.readers.formats import FORMATS, Content
from pointnetkl.readers.georeference import Sink
from pointnetkl.readers.spool import Spool
from pointnetkl.surveys.survey import TRAJECTORY, Survey, SurveyError
from pointnetkl.workflow import artifacts, compute, errors

__all__ = ["FORMATS", "ReaderError", "Settings", "files", "read", "read_truth"]

_COMPANIONS = (".dvc", ".crs")  # extensions of files that belong to a raw file
_NAVIGATION: Mapping[str, Content] = {"SBET": sbet}
_NAMED = 3  # ignored files that a message names; it counts the others
_SPOOL = ".spool-"
_SMALL_BYTES = 1 << 26  # of all files together, below which other processes are not worth their start


class ReaderError(SurveyError):
    """A raw survey is missing or of no known format, or its truth does not fit it."""


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
        """Refuse a wrong value before any file is read."""
        if not re.fullmatch(r"auto|EPSG:\d{4,6}", self.utm_zone):
            raise ValueError(f"utm_zone is {self.utm_zone!r}, must be auto or a code such as EPSG:32633")
        if self.sbet_clock not in (sbet.GPS, sbet.UTC):
            raise ValueError(f"sbet_clock is {self.sbet_clock!r}, must be {sbet.GPS} or {sbet.UTC}")


def read(paths: Path | Sequence[Path], settings: Settings, sink: Sink, scratch: Path | None = None) -> Survey:
    """Read a raw survey: files, and all files of folders, which may be of several formats.

    Soundings may not fit in memory. Until all files are read they are kept in a folder below `scratch`, 29 bytes each;
    then `sink` gets them part by part (survey.SOUNDINGS), in order of ping and beam. With `utm_zone` auto, longitudes
    and latitudes are projected to the UTM zone of the first position. The survey's report says what was read, what was
    skipped, and why.

    Raises:
        ReaderError: the path is missing, or a folder without raw files.
        SurveyError: a file is empty, of no known format or damaged beyond use, or no file has a usable ping.
    """
    listed = [files(path) for path in ([paths] if isinstance(paths, Path) else paths)]
    raw, ignored = (list(dict.fromkeys(file for part in parts for file in part)) for parts in zip(*listed, strict=True))
    if scratch is not None:
        scratch.mkdir(parents=True, exist_ok=True)
        for abandoned in scratch.glob(f"{_SPOOL}*"):  # as large as a survey, of a run that was killed
            shutil.rmtree(abandoned, ignore_errors=True)
    with tempfile.TemporaryDirectory(prefix=_SPOOL, dir=scratch) as folder:
        tracks = [file for file in raw if navigation.is_navigation(file)]
        spools = _spools([file for file in raw if file not in tracks], Path(folder))
        if tracks:
            spools = navigation.replace_navigation(spools, tracks, settings.sbet_clock)
        survey = georeference.survey(spools, settings.utm_zone, sink, settings.outliers)
    problems = [f"passed over: {_ignored_files(ignored)}"] * bool(ignored) + survey.report["problems"]
    return replace(survey, report=survey.report | {"problems": problems})


def files(path: Path, others: Mapping[str, Content] = _NAVIGATION) -> tuple[list[Path], list[Path]]:
    """Return the raw files of a folder and the files that are ignored, both in natural order of names.

    Raw files are those of formats.FORMATS or `others`. Hidden files, and files that belong to a raw file, are in
    neither list. A path to a file is returned as the one raw file.

    Raises:
        ReaderError: the path is missing, or a folder without raw files.
    """
    if not path.exists():
        raise ReaderError(f"{path}: is missing; give a raw file or a folder of raw files")
    if path.is_file():
        return [path], []
    candidates = [file for file in path.rglob("*") if file.is_file() and _may_be_raw(file.relative_to(path))]
    raw = [file for file in sorted(candidates, key=_natural) if formats.is_raw(file, {**formats.FORMATS, **others})]
    ignored = sorted(set(candidates) - set(raw), key=_natural)
    if not raw:
        also = f", and {_ignored_files(ignored)}" if ignored else ""
        raise ReaderError(f"{path}: has no raw files{also}; put some there, or run dvc pull")
    return raw, ignored


def read_truth(path: Path, survey: Survey) -> pd.DataFrame:
    """Read the true trajectory of a survey into its map frame (schema TRAJECTORY); data/none gives no rows.

    The file's x_m and y_m are in the survey's CRS; a CRS in the file's metadata must be the same.

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
    if not_finite := int(np.sum(~np.isfinite(truth.to_numpy()).all(axis=1))):
        raise ReaderError(f"{path}: {not_finite} of its {len(truth)} rows are not finite; take them out")
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
    return not any(part.startswith(".") for part in file.parts) and file.suffix.lower() not in _COMPANIONS


def _ignored_files(files: Sequence[Path]) -> str:
    names = ", ".join(errors.printable(file.name) for file in files[:_NAMED])
    more = f", and {len(files) - _NAMED} more" if len(files) > _NAMED else ""
    noun = "file" if len(files) == 1 else "files"
    return f"{len(files)} {noun} of no known format, {names}{more}"


def _natural(file: Path) -> tuple[list[str | int], str]:
    """Return a key that sorts line_2 before line_10."""
    words = re.split(r"(\d+)", str(file))
    return [int(word) if word.isdecimal() else word for word in words], str(file)
