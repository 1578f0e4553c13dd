"""The formats of raw files that are read, and which of them a file is of."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Protocol

from pointnetkl.readers.formats import generic, gsf, kmall, kongsberg_all, las, pcd, xtf, xyz
from pointnetkl.readers.formats.recording import Recording
from pointnetkl.surveys.survey import SurveyError


class Content(Protocol):
    """A module that recognises the files of one format."""

    @property
    def SUFFIXES(self) -> tuple[str, ...]:
        """Extensions of the format's files, in lower case."""
        ...

    def begins(self, head: bytes) -> bool:
        """Whether the first bytes of a file, HEAD_BYTES or fewer, are those of the format."""
        ...


class Format(Content, Protocol):
    """A module that recognises and reads the raw files of one format."""

    def read(self, path: Path) -> Iterator[Recording]:
        """Yield a file in parts, at least one.

        Raises:
            SurveyError: the file is of another format, damaged beyond use, or cannot be read.
        """
        ...


FORMATS: Mapping[str, Format] = {
    "GSF": gsf,
    "Kongsberg .all": kongsberg_all,
    "Kongsberg .kmall": kmall,
    "XTF": xtf,
    "LAS/LAZ": las,
    "PCD": pcd,
    "generic pings": generic,
    "XYZ": xyz,  # last, because many texts begin with numbers
}

HEAD_BYTES = 1 << 12

_ANYTHING = (".txt", ".csv", ".out", ".pts")  # extensions that say nothing of the content


class FormatError(SurveyError):
    """A raw file cannot be opened, is empty, or is of no known format."""


def is_raw(file: Path, formats: Mapping[str, Content]) -> bool:
    """Whether a file of a folder is of one of the formats, by its content or by its extension.

    A file with the right extension and the wrong content counts, so that its reader reports the damage.
    """
    suffix = file.suffix.lower()
    if suffix not in _ANYTHING and any(suffix in module.SUFFIXES for module in formats.values()):
        return True
    try:
        head = _head(file)
    except FormatError:
        return True  # its reader says why it cannot be opened
    return any(module.begins(head) for module in formats.values())


def identify(file: Path, formats: Mapping[str, Content] = FORMATS) -> str:
    """Return the name of a file's format: by its content, else by its extension, so that damage is reported.

    Raises:
        FormatError: the file cannot be opened, is empty, or is of none of the formats.
    """
    head = _head(file)
    if not head:
        raise FormatError(f"{file}: is empty; copy it again or take it away")
    by_content = [name for name, module in formats.items() if module.begins(head)]
    by_name = [name for name, module in formats.items() if file.suffix.lower() in module.SUFFIXES]
    for name in (*by_content, *by_name):
        return name
    raise FormatError(f"{file}: is of no known format, it begins with {head[:8]!r}; known are {', '.join(formats)}")


def _head(file: Path) -> bytes:
    try:
        with file.open("rb") as opened:
            return opened.read(HEAD_BYTES)
    except OSError as error:
        raise FormatError(f"{file}: cannot be read ({error.strerror})") from error
