"""Tie lists of MB-System's mbnavadjust, which mbnavadjustmerge imports and exports: loop closures set by hand.

A tie says by how much more the navigation of a second file must move at one time than that of a first file at another,
and a global tie by how much one must move: metres east, north and up. Files are compared by name, and a path must have
a slash. Status: 1 all of x, y, z; 2 x and y; 3 z; 5 to 7 the same, fixed. COV has the three axes of the offset's
covariance, each a standard deviation (m) and a unit vector.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pointnetkl.correction.products import placed
from pointnetkl.correction.products.accepted import LESS, REFERENCE, Measurement, counted, measurements
from pointnetkl.correction.products.placed import Placed
from pointnetkl.correction.result import Corrected, CorrectionError, Submaps
from pointnetkl.readers.formats import text_lines
from pointnetkl.surveys.survey import SUBMAPS
from pointnetkl.workflow import artifacts

TIE, COV, GLOBALTIE = "TIE", "COV", "GLOBALTIE"
XYZ, XY, Z = 1, 2, 3  # status
_STATUSES = (XYZ, XY, Z, 5, 6, 7)
_SIGMA_Z_M = 1000.0  # of z, which is not tied: the program divides by it
_UNIT = 1e-3  # from the length 1 of an axis: files have 8 decimals
_EAST_NORTH_UP = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
_WORDS = {TIE: 8, COV: 12, GLOBALTIE: 9}  # after the tag


class TieError(CorrectionError):
    """A file is not a list of ties."""


@dataclass(frozen=True)
class Tie:
    """A tie between two files, or a global tie of one; vectors are east, north, up."""

    files: tuple[str, ...]  # paths as the list has them
    status: int
    times_s: tuple[float, ...]  # UTC since 1970, one for each file
    offset_m: tuple[float, float, float]
    sigmas_m: tuple[float, float, float]  # standard deviations along the axes
    axes: tuple[tuple[float, ...], ...]  # three unit vectors; east, north and up in a global tie

    @property
    def is_global(self) -> bool:
        """Return whether the tie is of one file's own place."""
        return len(self.files) == 1

    @property
    def covariance(self) -> np.ndarray:
        """Return the covariance (3, 3) of the offset, m^2."""
        axes = np.array(self.axes)
        return np.asarray(axes.T @ np.diag(np.square(self.sigmas_m)) @ axes)


def write(path: Path, corrected: Corrected) -> list[str]:
    """Write accepted closures as ties of the target's file to the source's, those on a reference as global ties.

    Return what is left out and why.

    Raises:
        CorrectionError: the survey cannot be placed on the earth, or a closure is not of it.
        ArtifactError: the file cannot be written.
    """
    if corrected.submaps is None or corrected.kind == SUBMAPS or not len(corrected.track):
        return ["no tie list: the survey has no pings with times, by which ties are found"]
    if placed.on_earth(corrected.crs, np.zeros((0, 2))) is None:
        return ["no tie list: the survey has no place on the earth"]
    found, less = measurements(corrected, corrected.submaps)
    ties = of_closures(corrected, corrected.submaps, found)
    good = [tie for tie in ties if all(_is_word(file) for file in tie.files)]
    if good:
        artifacts.write_bytes(path, "".join(_lines(good)).encode())
    sentences = [] if good else ["no tie list: it would have no tie"]
    sentences += [f"{path.name} lacks {counted(less, LESS)}"] * bool(less)
    if odd := len(ties) - len(good):
        closures = counted(odd, "of files whose names have a blank or a letter beyond ASCII")
        sentences.append(f"{path.name} lacks {closures}")
    return sentences


def of_closures(corrected: Corrected, submaps: Submaps, closures: Sequence[Measurement]) -> list[Tie]:
    """Return closures as ties; their shifts are turned from the map's axes to east and north.

    Raises:
        CorrectionError: the survey cannot be placed on the earth.
    """
    if not closures:
        return []
    track = Placed(corrected)
    at = np.array([submaps.after[closure.source][:2, 3] for closure in closures]) + corrected.origin
    earth = placed.on_earth(corrected.crs, at)
    if earth is None:
        raise CorrectionError(f"{corrected.name}: has no place on the earth, and ties are in metres east and north")
    return [
        _tie(track, submaps, closure, to_ground) for closure, to_ground in zip(closures, earth.to_ground, strict=True)
    ]


def read(path: Path) -> list[Tie]:
    """Return the ties of a list; comments (#) are passed over.

    Raises:
        TieError: the file is missing or damaged, or has other lines.
    """
    lines = (line for line in text_lines.read(path, TieError) if line[1][0][0] != "#")
    return list(_ties(path, lines))


def _tie(track: Placed, submaps: Submaps, closure: Measurement, to_ground: np.ndarray) -> Tie:
    east, north = (to_ground @ closure.shift).tolist()
    V = to_ground @ closure.V @ to_ground.T
    w, v = np.linalg.eigh(V)
    nodes = [closure.source] if closure.target == REFERENCE else [closure.target, closure.source]
    times = submaps.time_s[nodes]
    files = tuple(f"./{track.files[_nearest(track.time_s, time)]}" for time in times)
    if closure.target == REFERENCE:  # has no room for a correlation
        sigmas, axes = np.sqrt(np.diag(V)), np.eye(2)
    else:
        sigmas, axes = np.sqrt(w[::-1]), v[:, ::-1].T
        axes = axes * np.where(axes[:, :1] < 0, -1.0, 1.0)  # either direction is right: one of them, for equal bytes
    whole = (*((*axis, 0.0) for axis in axes.tolist()), (0.0, 0.0, 1.0))
    return Tie(files, XY, tuple(times.tolist()), (east, north, 0.0), (*sigmas.tolist(), _SIGMA_Z_M), whole)


def _nearest(times: np.ndarray, time: float) -> int:
    after = int(np.searchsorted(times, time).clip(max=len(times) - 1))
    before = max(after - 1, 0)
    return before if abs(times[before] - time) < abs(times[after] - time) else after


def _is_word(text: str) -> bool:
    return text.isascii() and text.isprintable() and " " not in text


def _lines(ties: Sequence[Tie]) -> Iterator[str]:
    for tie in sorted(ties, key=lambda tie: tie.is_global):
        files, times = " ".join(tie.files), " ".join(f"{time:16.6f}" for time in tie.times_s)
        head = f"{GLOBALTIE if tie.is_global else TIE} {files} {tie.status} {times} {_eights(tie.offset_m)}"
        if tie.is_global:
            yield f"{head} {_eights(tie.sigmas_m)}\n"
        else:
            axes = zip(tie.sigmas_m, tie.axes, strict=True)
            yield f"{head}\n{COV} {' '.join(_eights((sigma, *axis)) for sigma, axis in axes)}\n"


def _eights(numbers: Sequence[float]) -> str:
    return " ".join(f"{number:13.8f}" for number in numbers)


def _ties(path: Path, lines: Iterator[tuple[int, list[str]]]) -> Iterator[Tie]:
    for line, words in lines:
        if words[0] == GLOBALTIE:
            files, status, rest = _head(path, line, words, GLOBALTIE, 1)
            yield Tie(files, status, (rest[0],), _three(rest[1:4]), _sigmas(path, line, rest[4:7]), _EAST_NORTH_UP)
        elif words[0] == TIE:
            files, status, rest = _head(path, line, words, TIE, 2)
            at, covariance = next(lines, (line, []))
            if not covariance or covariance[0] != COV:
                raise _error(path, at, f"{COV} must follow {TIE}")
            numbers = np.array(_numbers(path, at, covariance, COV, 1)).reshape(3, 4)
            axes = tuple(tuple(axis) for axis in numbers[:, 1:].tolist())
            if (np.abs(np.linalg.norm(numbers[:, 1:], axis=1) - 1) > _UNIT).any():
                raise _error(path, at, "an axis has not length 1; the order is sigma x y z, three times")
            sigmas = _sigmas(path, at, numbers[:, 0].tolist())
            yield Tie(files, status, (rest[0], rest[1]), _three(rest[2:5]), sigmas, axes)
        else:
            raise _error(path, line, f"it begins with {text_lines.shown(words[0])}, must be {TIE} or {GLOBALTIE}")


def _head(path: Path, line: int, words: list[str], tag: str, files: int) -> tuple[tuple[str, ...], int, list[float]]:
    """Return the files, the status and the numbers after it."""
    numbers = _numbers(path, line, words, tag, files + 2)
    if words[files + 1] not in map(str, _STATUSES):
        raise _error(path, line, f"its status is {text_lines.shown(words[files + 1])}, must be one of {_STATUSES}")
    return tuple(words[1 : files + 1]), int(words[files + 1]), numbers


def _numbers(path: Path, line: int, words: list[str], tag: str, first: int) -> list[float]:
    if len(words) != _WORDS[tag] + 1:
        raise _error(path, line, f"it has {len(words) - 1} words after {tag}, must have {_WORDS[tag]}")
    try:
        return text_lines.numbers(words[first:])
    except ValueError as error:
        raise _error(path, line, str(error)) from error


def _sigmas(path: Path, line: int, numbers: Sequence[float]) -> tuple[float, float, float]:
    if min(numbers) < 0:
        raise _error(path, line, "a standard deviation is below 0")
    return _three(numbers)


def _three(numbers: Sequence[float]) -> tuple[float, float, float]:
    x, y, z = numbers
    return x, y, z


def _error(path: Path, line: int, cause: str) -> TieError:
    return TieError(f"{path}: line {line}: {cause}")
