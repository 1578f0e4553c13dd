"""The corrected navigation as MB-System reads it: a file `.na0` per raw file, and one `.fnv` of the survey."""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from pointnetkl.correction.products import placed
from pointnetkl.correction.products.placed import Placed
from pointnetkl.workflow import artifacts
from pointnetkl.workflow.errors import printable

_KM_H = 3.6  # a metre per second
_CHUNK = 1 << 15  # lines formatted at once
# date and time; seconds since 1970, longitude, latitude, heading, km/h, draft, roll, pitch, heave, offset of z
_FNV = "%s\t%.6f\t%.10f\t%.10f\t%.2f\t%.2f\t%.3f\t%.2f\t%.2f\t%.2f"
_NA0 = _FNV + "\t%.3f"
_HEADER = (
    "# Corrected navigation by pointnetkl",
    "# year month day hour minute second, epoch (s), longitude (deg), latitude (deg), heading (deg), speed (km/h),",
    "# draft (m), roll (deg), pitch (deg), heave (m), z offset (m)",
)
_PARTS = re.compile("[-T:Z]")


def write(folder: Path, fnv: Path, track: Placed) -> list[str]:
    """Write `<raw file>.na0` for each raw file into a folder, and the file `fnv`; return what is left out and why.

    Raises:
        CorrectionError: the track cannot be placed on the earth.
        ArtifactError: a file cannot be written.
    """
    if track.earth is None:
        return ["no files for MB-System: the survey has no place on the earth"]
    if not (track.has_times and np.isfinite(track.time_s).all()):
        return ["no files for MB-System: the survey has no times"]
    if len(track.moments) < 2:
        return ["no files for MB-System: the survey has pings at one time only, which gives no speed"]
    dates, numbers = _dates(track), _numbers(track)
    artifacts.write_bytes(fnv, _text(_FNV, dates, numbers, "\n").encode())
    return _write_na0(folder, dates, numbers, track.files[track.moments])


def _write_na0(folder: Path, dates: list[str], numbers: np.ndarray, files: np.ndarray) -> list[str]:
    sentences = []
    names, number = np.unique(files.astype(str), return_inverse=True)
    order = np.argsort(number, kind="stable")
    ends = np.searchsorted(number[order], np.arange(1, len(names)))
    for name, rows in zip(names.tolist(), np.split(order, ends), strict=True):
        if Path(name).name != name or name in ("", ".", ".."):
            sentences.append(f"no .na0 of {printable(name) or 'pings without a file'}: it is not the name of a file")
            continue
        zeros = np.zeros((len(rows), 1))
        lines = _text(_NA0, [dates[row] for row in rows], np.hstack([numbers[rows], zeros]), "\r\n")
        header = "".join(f"{line}\r\n" for line in _HEADER)
        artifacts.write_bytes(folder / f"{name}.na0", (header + lines).encode())
    return sentences


def _dates(track: Placed) -> list[str]:
    return [_PARTS.sub(" ", date or "").strip() for date in placed.iso(track.time_s[track.moments])]


def _numbers(track: Placed) -> np.ndarray:
    """Return all columns after the date, without the last; NaN where roll and pitch are not recorded."""
    rows, earth = track.moments, track.earth
    assert earth is not None
    speed = np.hypot(*track.velocity[:, :2].T) * _KM_H
    roll, pitch = np.rad2deg(track.column("roll_rad")[rows]), np.rad2deg(track.column("pitch_rad")[rows])
    heading = np.rad2deg(track.heading_rad[rows])
    places = earth.longitude_deg[rows], earth.latitude_deg[rows]
    # heave is in the depth of the vehicle already
    return np.column_stack(
        [track.time_s[rows], *places, heading, speed, -track.z_m[rows], roll, pitch, np.zeros(len(rows))]
    )


def _text(form: str, dates: list[str], numbers: np.ndarray, end: str) -> str:
    return "".join(_chunks(form + end, dates, numbers))


def _chunks(form: str, dates: list[str], numbers: np.ndarray) -> Iterator[str]:
    for first in range(0, len(dates), _CHUNK):
        rows = zip(dates[first : first + _CHUNK], numbers[first : first + _CHUNK].tolist(), strict=True)
        yield "".join([form % (date, *row) for date, row in rows])
