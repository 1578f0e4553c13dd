"""SMRMSG, the accuracy of an SBET trajectory (Applanix POSPac): what post-processed navigation says of its own errors.

A record is 10 little-endian doubles, 80 bytes, and there is no header: time (s of the GPS week), standard deviations of
position north, east and down (m), of velocity (m/s), and of roll, pitch and heading (arc minutes).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pointnetkl.surveys.survey import SurveyError

_DOUBLES, _BYTES = 10, 80
_MOST_M, _MOST_ARCMIN = 1e4, 180 * 60.0
_ARCMIN_RAD = np.pi / 180 / 60


class SmrmsgError(SurveyError):
    """A file is not SMRMSG."""


@dataclass(frozen=True)
class Accuracy:
    """Standard deviations of navigation, medians over a file."""

    position_m: float  # in the plane, each axis
    heading_rad: float  # NaN where it is not stated


def is_accuracy(file: Path) -> bool:
    """Whether a file is SMRMSG, by its name, as there is nothing in it to know it by."""
    return "smrmsg" in file.name.lower()


def read(path: Path) -> Accuracy:
    """Return the accuracy that a file states.

    Raises:
        SmrmsgError: the file cannot be read, or holds no possible record.
    """
    try:
        records = np.fromfile(path, "<f8", path.stat().st_size // _BYTES * _DOUBLES).reshape(-1, _DOUBLES)
    except OSError as error:
        raise SmrmsgError(f"{path}: cannot be read ({error.strerror})") from error
    with np.errstate(invalid="ignore"):
        plane = records[:, 1:3]
        good = ((plane > 0) & (plane < _MOST_M)).all(axis=1) & (records[:, 0] >= 0)
    if good.sum() * 2 < len(records) or not good.any():
        raise SmrmsgError(f"{path}: {len(records) - good.sum()} of its {len(records)} records cannot be; is it SMRMSG?")
    heading = records[good, 9]
    stated = heading[(heading > 0) & (heading < _MOST_ARCMIN)]
    position = float(np.median(np.sqrt((plane[good] ** 2).mean(axis=1))))
    return Accuracy(position, float(np.median(stated)) * _ARCMIN_RAD if len(stated) else float("nan"))
