"""Which files `inspect` tells of, and which reader each of them has."""

import itertools
from collections.abc import Sequence
from pathlib import Path

from pointnetkl import readers
from pointnetkl.inspection import navigation, raw
from pointnetkl.inspection.found import Found
from pointnetkl.readers import formats, sbet
from pointnetkl.simulation import depth_grid
from pointnetkl.surveys.survey import SurveyError
from pointnetkl.workflow.errors import PointNetKLError


class ChoiceError(PointNetKLError):
    """A file is of another kind than raw data."""


_GRID, _SBET = "grid", "SBET"
_BESIDE_SURVEYS = {_GRID: depth_grid, _SBET: sbet}
_OTHERS = {".pt": "a trained model, which `predict` takes", ".g2o": "a pose graph, which `solve` takes"}


def files(paths: Sequence[Path]) -> list[Path]:
    """Return the files to tell of, a folder's in the natural order of their names and only those of a known format.

    What is not there, and a folder without such a file, stay in the list: they are told like a damaged file.
    """
    return [file for path in paths for file in (_raw_files(path) if path.is_dir() else [path])]


def names(paths: Sequence[Path]) -> dict[Path, str]:
    """Return a name for what is written of each file: its stem, its whole name, or this with a number."""
    taken: set[str] = set()
    chosen: dict[Path, str] = {}
    for path in dict.fromkeys(paths):
        numbered = (f"{path.name}_{number}" for number in itertools.count(2))
        chosen[path] = next(name for name in itertools.chain([path.stem, path.name], numbered) if name not in taken)
        taken.add(chosen[path])
    return chosen


def look(path: Path, how: readers.Settings) -> Found:
    """Return what a file holds.

    Raises:
        ChoiceError: it is of a kind that another command takes.
        PointNetKLError: it cannot be read, is of no known format, or damaged beyond use.
    """
    if path.is_dir():
        raise ChoiceError(f"{path}: has no raw files; put some there")
    if not path.is_file():
        raise ChoiceError(f"{path}: is missing; give a raw file or a folder of raw files")
    kind = format_name(path)
    if kind == _GRID:
        from pointnetkl.inspection import grids

        return grids.look(path)
    if kind == _SBET:
        return navigation.look(path, how.utm_zone)
    if kind is None and (other := _OTHERS.get(path.suffix.lower())):
        raise ChoiceError(f"{path}: is no raw data but {other}")
    return raw.look(path, how)


def format_name(file: Path) -> str | None:
    """Return the format of a file by its content, else, so that damage is told, by its name; None for neither."""
    if not file.is_file():
        return None
    try:
        return formats.of(file)[0]
    except SurveyError:
        pass
    try:
        return formats.of(file, _BESIDE_SURVEYS)[0]
    except SurveyError:
        known = formats.FORMATS | _BESIDE_SURVEYS  # an empty file has nothing but its name
        return next((name for name, module in known.items() if file.suffix.lower() in module.SUFFIXES), None)


def _raw_files(folder: Path) -> list[Path]:
    try:
        return readers.files(folder, _BESIDE_SURVEYS)[0]
    except readers.ReaderError:
        return [folder]
