"""Text of points without pings: columns of x, y and z, or of longitude, latitude and depth, with any separators."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from pointnetkl.readers import projection
from pointnetkl.readers.formats.point_parts import Block, Points, parts
from pointnetkl.readers.formats.recording import Recording
from pointnetkl.readers.formats.xyz import text_columns
from pointnetkl.readers.formats.xyz.number_lines import NumberLines
from pointnetkl.readers.formats.xyz.text_columns import Columns
from pointnetkl.surveys.survey import SurveyError
from pointnetkl.workflow.errors import printable

SUFFIXES = (".xyz", ".txt", ".csv", ".pts")

_HEAD_BYTES = 1 << 16
_ENOUGH = 100  # points; so many within one metre are no seabed


class XyzError(SurveyError):
    """A file is no text of points, or its columns are not known."""


def begins(head: bytes) -> bool:
    """Whether the first bytes of a file are a text with lines of numbers that is no other format's."""
    if b"time_s" in head or b"VIEWPOINT" in head or b"\0" in head:
        return False
    try:
        return text_columns.find(head) is not None
    except ValueError:  # columns with unknown names may be points
        return True


def read(path: Path) -> Iterator[Recording]:
    """Read a text of points in parts.

    Raises:
        XyzError: the file is no text of points, or its columns are not known.
    """
    try:
        columns = _columns(path)
        crs = projection.GEOGRAPHIC if columns.geographic else projection.beside(path)
        points = Points(path.name, crs, columns.down, columns.unit_m)
        yield from parts(points, _blocks(path, columns, points))
    except OSError as error:
        raise XyzError(f"{path}: cannot be read ({error.strerror})") from error


def _columns(path: Path) -> Columns:
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    try:
        columns = text_columns.find(head[: head.rfind(b"\n") + 1] if len(head) == _HEAD_BYTES else head)
    except ValueError as error:
        raise XyzError(f"{path}: {printable(error)}") from error
    if columns is None:
        raise XyzError(f"{path}: byte 0: begins with {head[:16]!r}; a text of points has lines of x, y and z")
    return columns


def _blocks(path: Path, columns: Columns, points: Points) -> Iterator[Block]:
    axes = [columns.x, columns.y, columns.z]
    lines = NumberLines(path, columns.first, columns.separator, columns.width, axes, columns.decimal)
    first = True
    for numbers in lines:
        if first and len(numbers):
            _understand(points, columns, numbers)
            first = False
        x, y, z = numbers.T
        yield x, y, z, np.zeros(len(z), np.int8)
    points.skip("lines that are not numbers", lines.bad)
    if lines.bad:
        points.problems.add(f"{lines.bad} lines are not numbers, the first after byte {lines.first_bad}")
    if columns.declared not in (None, lines.read):
        points.problems.add(f"its first line says {columns.declared} points, it has {lines.read}")
    if not lines.read:
        raise XyzError(f"{path}: byte {columns.first}: has no line of {columns.width} numbers; it is no text of points")


def _understand(points: Points, columns: Columns, numbers: np.ndarray) -> None:
    """Decide by the first points whether z counts down, and whether columns without a name are degrees."""
    x, y, z = numbers[np.isfinite(numbers).all(axis=1)].T
    if points.down and len(z) and np.median(z) < 0:  # a depth is not negative
        points.down = False
        points.datum = "its column is named depth but is negative, and was taken as height; its datum is not stated"
    elif points.down is not None:
        points.datum = f"z is {'depth' if points.down else 'height'} by the name of its column; its datum is not stated"
    if columns.unit_m != 1.0:
        points.datum = f"in feet, brought to metres; {points.datum}".removesuffix("; ")
    small = len(x) >= _ENOUGH and max(np.ptp(x), np.ptp(y)) < 1.0 and np.abs(x).max() <= 360 and np.abs(y).max() <= 90
    if small and not columns.named and points.crs == projection.LOCAL:
        points.crs = projection.GEOGRAPHIC
        points.problems.add(
            "its columns have no names and its points lie within one unit: they were taken as longitude"
            " and latitude; name the columns x, y and z if they are metres"
        )
