"""Soundings as LAZ (ASPRS LAS 1.4, point format 6, compressed), each where the corrected track has it.

Rejected soundings are withheld. Classes are those of the bathymetric domain profile: 40 for the seabed, and 7 (low
noise) for the impossible and for outliers; 1 (not classified) is what a sonar or its operator rejected.
"""

import contextlib
import datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import pandas as pd

from pointnetkl.correction.maps import reference
from pointnetkl.correction.result import Corrected, CorrectionError
from pointnetkl.readers import sbet
from pointnetkl.readers.formats.recording import REJECTED
from pointnetkl.surveys.survey import POINTS, SWATHS
from pointnetkl.workflow.artifacts import one_line

_GPS_EPOCH_S, _ADJUSTED_S = 315_964_800, 1_000_000_000  # of GPS time in UTC since 1970; what LAS subtracts from it
_SCALES_M, _STEPS = (0.001, 0.01), 2**31 - 1
_BATHYMETRY, _UNCLASSIFIED, _NOISE = 40, 1, 7
_ONLY_RETURN, _WITHHELD = 0x11, 0x04
_DAY_AT, _FORMAT = 90, 6  # byte of the header that has day and year of the file
_EXTRA = {  # what LAS has no place for: type and meaning
    "ping": (np.uint32, "as in track.csv"),
    "beam": (np.int32, "of the ping"),
    "quality": (np.uint8, "0 good, else why not"),
}


class CloudWriter:
    """A context that writes soundings part by part.

    Times are adjusted standard GPS time; they are 0 where there are none, and before 1999. A point's source is the
    number of its raw file, from 1 in the order of the track; 0: not known. Points without pings have no ping and beam.

    Raises:
        CorrectionError: the file cannot be written, or a sounding lies too far from the map frame's origin.
    """

    def __init__(self, path: Path, corrected: Corrected, farthest_m: float) -> None:
        """Take the path, and how far soundings may lie from the map frame's origin along an axis."""
        self._path = path
        self._time, self._source = gps_times(corrected), file_numbers(corrected.track)
        self._extra = [name for name in _EXTRA if name == "quality" or corrected.kind != POINTS]
        level = next((scale for scale in _SCALES_M if farthest_m < _STEPS * scale), _SCALES_M[-1])
        self._scales = np.array([level, level, _SCALES_M[0]])
        self._header = self._new_header(corrected)
        self._file: Any = None
        self._writer: Any = None

    def __enter__(self) -> Self:
        """Open the file and write its header."""
        import laspy

        with self._one_sentence():
            self._file = self._path.open("wb+")
            compression = {"do_compress": True, "laz_backend": laspy.LazBackend.LazrsParallel}
            self._writer = laspy.LasWriter(self._file, self._header, closefd=False, **compression)
        return self

    def write(self, part: pd.DataFrame, rows: np.ndarray, places: np.ndarray) -> None:
        """Add soundings (survey.SOUNDINGS) of rows (n,) of the track, at corrected places (n, 2) in the map frame."""
        import laspy

        points = laspy.ScaleAwarePointRecord.zeros(len(part), header=self._header)
        self._fill(points.array, part, rows, np.column_stack([places, part["z_m"].to_numpy()]))
        with self._one_sentence():
            self._writer.write_points(points)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """End the file."""
        with self._one_sentence(), self._file:
            if kind is None:
                self._writer.close()
                self._file.seek(_DAY_AT)
                self._file.write(self._day())

    def _fill(self, array: np.ndarray, part: pd.DataFrame, rows: np.ndarray, places: np.ndarray) -> None:
        steps = np.rint(places / self._scales)
        if not (np.abs(steps) <= _STEPS).all():  # nor are they a number
            raise CorrectionError(f"{self._path}: a sounding lies beyond the earth; flag it and run ingest again")
        for name, axis in zip("XYZ", steps.T, strict=True):
            array[name] = axis
        quality = part["quality"].to_numpy()
        array["bit_fields"] = _ONLY_RETURN
        array["classification_flags"] = np.where(quality == 0, 0, _WITHHELD)
        rejected = np.where(quality == REJECTED, _UNCLASSIFIED, _NOISE)
        array["classification"] = np.where(quality == 0, _BATHYMETRY, rejected)
        if len(self._time):
            array["gps_time"], array["point_source_id"] = self._time[rows], self._source[rows]
        for name in self._extra:
            array[name] = part[name].to_numpy()

    def _new_header(self, corrected: Corrected) -> Any:
        import laspy

        header = laspy.LasHeader(point_format=_FORMAT, version="1.4")
        header.scales, header.offsets = self._scales, np.array([*corrected.origin, 0.0])
        header.system_identifier, header.generating_software = "MODIFICATION", "pointnetkl"
        header.creation_date = datetime.date(1970, 1, 1)  # replaced in the end: laspy cannot leave it out
        header.add_extra_dims([laspy.ExtraBytesParams(name, *_EXTRA[name]) for name in self._extra])
        for stated in header.vlrs.get("ExtraBytesVlr")[0].extra_bytes_structs:
            stated.options &= ~(stated.MIN_BIT_MASK | stated.MAX_BIT_MASK)  # laspy 2.7 has those of first points only
        header.global_encoding.gps_time_type = int(bool(self._time.any()))
        header.global_encoding.wkt = True  # as point format 6 demands, also where the place on the earth is not known
        if corrected.crs != "local":
            header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(reference.wkt(corrected.crs)))
        return header

    def _day(self) -> bytes:
        """Return day of the year and year of the last ping, 0 where it is not known: two runs give the same bytes."""
        if not self._time.any():
            return bytes(4)
        last = datetime.datetime.fromtimestamp(self._time.max() + _GPS_EPOCH_S + _ADJUSTED_S, datetime.UTC)
        return np.array([last.timetuple().tm_yday, last.year], "<u2").tobytes()

    @contextlib.contextmanager
    def _one_sentence(self) -> Any:
        from lazrs import LazrsError

        try:
            yield
        except (OSError, LazrsError) as error:
            cause = getattr(error, "strerror", "") or one_line(error)
            raise CorrectionError(f"{self._path}: cannot be written ({cause}); is the disk full?") from error


def gps_times(corrected: Corrected) -> np.ndarray:
    """Return the adjusted standard GPS times (n,) of the track's pings; 0 where times or leap seconds are not known."""
    time = corrected.track["time_s"].to_numpy(np.float64)
    leap = np.full(len(time), np.nan)
    if corrected.kind == SWATHS:
        half_year = time.astype("datetime64[s]").astype("datetime64[M]").astype(np.int64) // 6
        for one in np.unique(half_year):
            here = half_year == one
            with contextlib.suppress(sbet.SbetError):  # before 1999
                leap[here] = sbet._leap_seconds(Path(), float(time[here][0]))
    return np.where(np.isfinite(leap), time + leap - _GPS_EPOCH_S - _ADJUSTED_S, 0.0)


def file_numbers(track: pd.DataFrame) -> np.ndarray:
    """Return the number (n,) of each ping's raw file, from 1 in the order of the track; 0 where it is not known."""
    numbers = pd.factorize(track["file"])[0] + 1
    return np.where(numbers <= np.iinfo(np.uint16).max, numbers, 0).astype(np.uint16)
