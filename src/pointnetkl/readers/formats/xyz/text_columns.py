"""The layout of a text of points: its separator, its columns by name, and the byte where its numbers begin."""

import re
from dataclasses import dataclass

_NUMBER = re.compile(r"[-+]?(\d+[.,]?\d*|[.,]\d+)(e[-+]?\d+)?|[-+]?(nan|inf)", re.IGNORECASE)
_DECIMAL_COMMAS = re.compile(r"\s*[-+]?\d*,\d+(\s+[-+]?\d*,\d+)+\s*")
_UNIT = re.compile(r"\s*(?:\[(.*?)\]|\((.*?)\))|[_ ]+(m|ft|feet|deg|degrees|metres?|meters?)\b", re.IGNORECASE)
_COMMENT = re.compile(r"\s*(#|//|%|!)\s*")
_SEARCHED = 100  # most lines before the first line of numbers
_WIDEST = 64  # columns of a text of points

_EAST = ("x", "easting", "east", "e", "utmx", "xcoordinate", "footprintx", "pointx")
_NORTH = ("y", "northing", "north", "n", "utmy", "ycoordinate", "footprinty", "pointy")
_LONGITUDE, _LATITUDE = ("longitude", "lon", "long", "lng"), ("latitude", "lat")
_DEPTH = ("depth", "waterdepth", "depthm", "d")
_HEIGHT = ("elevation", "elev", "height", "altitude", "alt", "h", "up")
_Z = ("z", "footprintz", "pointz", "zcoordinate")
_FEET = {"ft", "feet", "foot", "us ft", "ftus", "us survey foot"}


@dataclass(frozen=True)
class Columns:
    """The columns of x, y and z in a text, and their meaning."""

    separator: str  # comma, semicolon, or a blank, which means any run of blanks and tabs
    decimal: str  # point or comma
    width: int  # columns of a line
    x: int
    y: int
    z: int
    geographic: bool  # x and y are longitude and latitude, by their names
    named: bool
    down: bool | None  # whether z counts down, by its name; None: unknown
    unit_m: float  # metres per unit of z
    first: int  # byte where the numbers begin
    declared: int | None  # number of points, if the file begins with it


def find(head: bytes) -> Columns | None:
    """Return the columns of a text by its first bytes, None if it has no line of three numbers or more.

    Raises:
        ValueError: the names of the columns are not those of points, or x and y are in feet.
    """
    offset, above, declared = (3 if head.startswith(b"\xef\xbb\xbf") else 0), list[str](), None
    for raw in re.findall(rb"[^\r\n]*(?:\r\n|\r|\n|$)", head[offset:])[:_SEARCHED]:
        line = raw.decode("utf-8", "replace").strip()
        if layout := _numbers(line):
            return _columns(layout, above, offset, declared)
        if line.isdigit() and not above:
            declared = int(line) if len(line) < 16 else None
        elif line:
            above.append(line)
        offset += len(raw)
    return None


def _numbers(line: str) -> tuple[str, str, int] | None:
    """Return separator, decimal sign and number of columns of a line of numbers; None if it is none."""
    bare = line.replace('"', "")
    if _DECIMAL_COMMAS.fullmatch(bare) and len(bare.split()) > 2:
        return " ", ",", len(bare.split())
    separator = next((sign for sign in ";," if sign in bare), " ")
    words = [word.strip() for word in (bare.split() if separator == " " else bare.split(separator))]
    numeric = [bool(_NUMBER.fullmatch(word)) for word in words]
    if len(words) < 3 or sum(numeric) < 3 or not any(numeric[:3]):
        return None
    commas = separator == ";" and any("," in word for word in words) and not any("." in word for word in words)
    return separator, "," if commas else ".", len(words)


def _columns(layout: tuple[str, str, int], above: list[str], first: int, declared: int | None) -> Columns:
    separator, decimal, width = layout
    if width > _WIDEST or any(line.lower().startswith("ncols") for line in above):
        raise ValueError("is a grid in text; convert it to GeoTIFF, or to lines of x, y and z")
    named = [_named(_COMMENT.sub("", line, count=1), separator) for line in above]
    for line, names in zip(reversed(above), reversed(named), strict=True):
        axes = _axes([name for name, _ in names])
        if axes is None and len(names) == width and not _COMMENT.match(line):
            raise ValueError(
                f"its columns are {', '.join(name for name, _ in names)[:100]}; name those of the points x, y and z"
            )
        if axes is not None:
            x, y, z, geographic, down = axes
            if {names[x][1], names[y][1]} & _FEET:
                raise ValueError("its columns x and y are in feet, must be in metres or degrees; reproject it")
            unit_m = 0.3048 if names[z][1] in _FEET else 1.0
            return Columns(
                separator, decimal, max(width, z + 1), x, y, z, geographic, True, down, unit_m, first, declared
            )
    return Columns(separator, decimal, width, 0, 1, 2, False, False, None, 1.0, first, declared)


def _named(line: str, separator: str) -> list[tuple[str, str]]:
    """Return the names of a line and their units, in lower case."""
    sign = separator if separator in line else "," if "," in line else None
    if sign is None or sign == " ":
        # a unit after a blank is not a column
        words = line.split("\t") if "\t" in line else re.sub(r"\s+(\[.*?\]|\(.*?\))", r"\1", line).split()
    else:
        words = line.split(sign)
    return [_name(word.strip().strip('"').strip()) for word in words]


def _name(word: str) -> tuple[str, str]:
    unit = _UNIT.search(word)
    name_of_unit = next((group for group in unit.groups() if group), "") if unit else ""
    return re.sub(r"[\s_.-]+", "", _UNIT.sub("", word).lower()), name_of_unit.strip().lower()


def _axes(names: list[str]) -> tuple[int, int, int, bool, bool | None] | None:
    for east, north, geographic in ((_EAST, _NORTH, False), (_LONGITUDE, _LATITUDE, True)):
        x, y = _place(names, east), _place(names, north)
        for kinds, down in ((_DEPTH, True), (_Z, None), (_HEIGHT, False)):
            z = _place(names, kinds)
            if x is not None and y is not None and z is not None:
                return x, y, z, geographic, down
    return None


def _place(names: list[str], kinds: tuple[str, ...]) -> int | None:
    return next((names.index(kind) for kind in kinds if kind in names), None)
