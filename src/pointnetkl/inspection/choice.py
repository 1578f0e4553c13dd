"""The files that `inspect` describes, and the reader of each."""

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path

from pointnetkl import readers
from pointnetkl.inspection import navigation, raw
from pointnetkl.inspection.facts import Inspection
from pointnetkl.readers import formats, sbet
from pointnetkl.readers.formats import Content
from pointnetkl.surveys.survey import SurveyError
from pointnetkl.workflow.errors import PointNetKLError


class ChoiceError(PointNetKLError):
    """A file is missing, or is not raw data."""


class _DepthGrid:
    """Recognises grids of depths; imports `simulation` late, because numba takes a second."""

    @property
    def SUFFIXES(self) -> tuple[str, ...]:
        from pointnetkl.simulation import depth_grid

        return depth_grid.SUFFIXES

    def begins(self, head: bytes) -> bool:
        from pointnetkl.simulation import depth_grid

        return depth_grid.begins(head)


_GRID, _SBET = "grid", "SBET"
_BESIDE_SURVEYS: Mapping[str, Content] = {_GRID: _DepthGrid(), _SBET: sbet}
_OTHERS = {".pt": "a trained model, which `predict` takes", ".g2o": "a pose graph, which `solve` takes"}


def files(paths: Sequence[Path]) -> list[Path]:
    """Return the files to describe; of a folder those of a known format, in natural order of names.

    Missing paths and folders without such a file stay in the list, to be reported like a damaged file.
    """
    return [file for path in paths for file in (_raw_files(path) if path.is_dir() else [path])]


def names(paths: Sequence[Path]) -> dict[Path, str]:
    """Return a name for the plots of each file: its stem, its whole name, or its whole name with a number."""
    taken: set[str] = set()
    names_by_path: dict[Path, str] = {}
    for path in dict.fromkeys(paths):
        numbered = (f"{path.name}_{number}" for number in itertools.count(2))
        names_by_path[path] = next(
            name for name in itertools.chain([path.stem, path.name], numbered) if name not in taken
        )
        taken.add(names_by_path[path])
    return names_by_path


def inspect(path: Path, settings: readers.Settings) -> Inspection:
    """Return the facts and the drawing of a file.

    Raises:
        ChoiceError: the file is missing, or is for another command.
        PointNetKLError: it cannot be read, is of no known format, or is damaged beyond use.
    """
    if path.is_dir():
        raise ChoiceError(f"{path}: has no raw files; put some there")
    if not path.is_file():
        raise ChoiceError(f"{path}: is missing; give a raw file or a folder of raw files")
    kind = format_name(path)
    if kind == _GRID:
        from pointnetkl.inspection import grids

        return grids.inspect(path)
    if kind == _SBET:
        return navigation.inspect(path, settings.utm_zone)
    if kind is None and (other := _OTHERS.get(path.suffix.lower())):
        raise ChoiceError(f"{path}: is no raw data but {other}")
    return raw.inspect(path, settings)


def format_name(file: Path) -> str | None:
    """Return the format of a file by its content, else by its extension (to report damage); None for neither."""
    if not file.is_file():
        return None
    try:
        return formats.identify(file)
    except SurveyError:
        pass
    try:
        return formats.identify(file, _BESIDE_SURVEYS)
    except SurveyError:
        modules = {**formats.FORMATS, **_BESIDE_SURVEYS}  # of an empty file there is only the name
        return next((name for name, module in modules.items() if file.suffix.lower() in module.SUFFIXES), None)


def _raw_files(folder: Path) -> list[Path]:
    try:
        return readers.files(folder, _BESIDE_SURVEYS)[0]
    except readers.ReaderError:
        return [folder]
