"""Which module reads a raw file: `begins(head)` knows its content, SUFFIXES its name, `read(path)` gives its parts."""

from collections.abc import Mapping
from pathlib import Path
from types import ModuleType

from pointnetkl.readers.formats import generic, gsf, kmall, kongsberg_all, las, pcd, xtf, xyz
from pointnetkl.surveys.survey import SurveyError

FORMATS: dict[str, ModuleType] = {
    "GSF": gsf,
    "Kongsberg .all": kongsberg_all,
    "Kongsberg .kmall": kmall,
    "XTF": xtf,
    "LAS/LAZ": las,
    "PCD": pcd,
    "generic pings": generic,
    "XYZ": xyz,  # last: many a text begins with numbers
}

HEAD_BYTES = 1 << 12  # that `begins` is given, fewer of a smaller file

_ANYTHING = (".txt", ".csv", ".out", ".pts")  # extensions that say nothing: of these the content must be known


class FormatError(SurveyError):
    """A raw file cannot be opened, is empty, or is of no known format."""


def is_raw(file: Path, known: Mapping[str, ModuleType]) -> bool:
    """Whether a file of a folder is of a known format, by its content or, so that damage is told, by its extension."""
    suffix = file.suffix.lower()
    if suffix not in _ANYTHING and any(suffix in module.SUFFIXES for module in known.values()):
        return True
    try:
        head = _head(file)
    except FormatError:
        return True  # who reads it tells why it cannot be opened
    return any(module.begins(head) for module in known.values())


def of(file: Path, known: Mapping[str, ModuleType] = FORMATS) -> tuple[str, ModuleType]:
    """Return a file's format and its module: by its content, else, so that damage is told, by its extension.

    Raises:
        FormatError: the file cannot be opened, is empty, or is of none of the known formats.
    """
    head = _head(file)
    if not head:
        raise FormatError(f"{file}: is empty; copy it again or take it away")
    named = [(name, module) for name, module in known.items() if file.suffix.lower() in module.SUFFIXES]
    for name, module in [*(item for item in known.items() if item[1].begins(head)), *named]:
        return name, module
    raise FormatError(f"{file}: is of no known format, it begins with {head[:8]!r}; known are {', '.join(known)}")


def _head(file: Path) -> bytes:
    try:
        with file.open("rb") as opened:
            return opened.read(HEAD_BYTES)
    except OSError as error:
        raise FormatError(f"{file}: cannot be read ({error.strerror})") from error
