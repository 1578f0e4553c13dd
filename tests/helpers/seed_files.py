"""Small whole files of every raw format, to be damaged: built here, and the beginnings of real files if present."""

import io
import struct
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

import all_files
import damage
import grid_files
import gsf_files
import kmall_files
import las_files
import pcd_files
import sbet_files
import xtf_files
from generic_files import parquet, rows
from pointnetkl.readers import sbet
from pointnetkl.simulation import depth_grid
from pointnetkl.workflow.errors import PointNetKLError
from realdata import REALDATA

_REAL_BYTES = 60_000  # of a real file: enough for every kind of record


@dataclass(frozen=True)
class Seeds:
    """What to damage for one reader."""

    suffix: str
    builders: Callable[[], list[bytes]]
    real: str = ""  # pattern below the folder of real files
    mended: Callable[[bytes], bytes] = bytes  # with checksums that are right again
    outcome: Callable[[Path], str] = damage.outcome

    def contents(self) -> list[bytes]:
        """Return the files."""
        paths = sorted(REALDATA.glob(self.real)) if self.real else []
        return [*self.builders(), *(path.read_bytes()[:_REAL_BYTES] for path in paths)]


def _written(suffix: str, write: Callable[[Path], object]) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"a{suffix}"
        write(path)
        return path.read_bytes()


def _parquet() -> list[bytes]:
    return [_written(".parquet", lambda path, n=n: parquet(path, rows(pings=n))) for n in (3, 40)]


def _csv() -> list[bytes]:
    text = io.StringIO()
    rows(pings=20).to_csv(text, index=False)
    return [text.getvalue().encode()]


def _all() -> list[bytes]:
    old = b"".join(all_files.depths(all_files.BEGIN + n, 45 - all_files.ACROSS / 8) for n in range(3))
    places = b"".join(all_files.position(all_files.BEGIN + n, 5.0, 10.0) for n in range(3))
    return [all_files.survey(4), all_files.survey(3, ">"), places + old]


def _all_mended(content: bytes) -> bytes:
    """Return the datagrams that can be found by their lengths, with checksums that are right."""
    changed, offset = bytearray(content), 0
    order = "<" if content[2:4] == bytes(2) else ">"  # of a length below 64 KiB
    while offset + 20 < len(changed):
        end = offset + 4 + struct.unpack_from(order + "I", changed, offset)[0]
        if not offset + 20 < end <= len(changed):
            break
        struct.pack_into(order + "H", changed, end - 2, sum(changed[offset + 5 : end - 3]) & 0xFFFF)
        offset = end
    return bytes(changed)


def _kmall() -> list[bytes]:
    pings = [kmall_files.ping(kmall_files.TIME_S + n, version) for n, version in enumerate((0, 1, 2, 3))]
    return [b"".join([kmall_files.installation(), kmall_files.attitude(count=20), *pings])]


def _kmall_mended(content: bytes) -> bytes:
    """Return the datagrams with the size at their end that stands at their beginning."""
    changed, offset = bytearray(content), 0
    while offset + 20 < len(changed):
        size = struct.unpack_from("<I", changed, offset)[0]
        if not 20 < size <= len(changed) - offset:
            break
        struct.pack_into("<I", changed, offset + size - 4, size)
        offset += size
    return bytes(changed)


def _gsf() -> list[bytes]:
    pings = [gsf_files.swath(n, checksum=n == 2) for n in range(4)]
    single = [gsf_files.single_beam(n) for n in range(3)]
    head, more = gsf_files.header(), [gsf_files.parameters(), gsf_files.attitude()]
    old = [gsf_files.header("GSF-v02.09"), *(gsf_files.swath(n, major=2) for n in range(2))]
    return [b"".join([head, *more, *pings]), b"".join([head, *single]), b"".join(old)]


def _gsf_mended(content: bytes) -> bytes:
    """Return the records that can be found by their sizes, with checksums that are right."""
    changed, offset = bytearray(content), 0
    while offset + 12 <= len(changed):
        size, word = struct.unpack_from(">II", changed, offset)
        begin = offset + (12 if word >> 31 else 8)
        if not 0 < size <= len(changed) - begin:
            break
        if word >> 31:
            struct.pack_into(">I", changed, offset + 8, sum(changed[begin : begin + size]))
        offset = begin + size
    return bytes(changed)


def _xtf() -> list[bytes]:
    contents = {65: xtf_files.bth0, 61: xtf_files.record_7027, 28: _beams_28}
    return [xtf_files.survey(xtf_files.Ship(), kind, content, pings=2) for kind, content in contents.items()]


def _beams_28(time_s: float, travel_s: np.ndarray, angle: np.ndarray) -> bytes:
    return xtf_files.beams_28(travel_s, angle)


def _las(suffix: str) -> list[bytes]:
    return [_written(suffix, lambda path, kind=kind: las_files.write(path, 60, kind)) for kind in (1, 6, 7)]


def _xyz() -> list[bytes]:
    texts = (
        "1.5 2 -3\n4 5 -6.25\n" * 20,
        "lon,lat,depth [m]\n5.25,10.5,30\n5.26,10.51,31\n",
        "x;y;z\n1,5;2,5;3,5\n" * 9,
    )
    return [text.encode() for text in texts]


def _pcd() -> list[bytes]:
    forms = pcd_files.FORMS
    return [_written(".pcd", lambda path, form=form: pcd_files.write(path, form)) for form in forms]


def _sbet() -> list[bytes]:
    return [sbet_files.records(1000.0 + np.arange(0, 3, 0.02)).tobytes()]


def _sbet_outcome(path: Path) -> str:
    """Read navigation alone; return what `damage.outcome` does."""
    try:
        result = sbet.read(path, 1.6e9)
    except PointNetKLError as error:
        return damage.named(path, error)
    assert all(np.isfinite(getattr(result, name)).all() for name in ("time_s", "east", "north", "heading_rad"))
    assert np.abs(result.north).max(initial=0) <= 90
    return damage.REPORTED if result.problems or result.skipped else damage.READ


def _grid(write: Callable[[Path], Path], suffix: str) -> list[bytes]:
    return [_written(suffix, write)]


def _grid_outcome(path: Path) -> str:
    """Describe a grid; return what `damage.outcome` does."""
    try:
        result = depth_grid.describe(path)
    except PointNetKLError as error:
        return damage.named(path, error)
    assert result.valid <= result.rows * result.columns
    assert not result.valid or -12_000 <= result.depth_min_m <= result.depth_max_m <= 12_000
    return damage.READ


FORMATS = {
    "generic Parquet": Seeds(".parquet", _parquet),
    "generic CSV": Seeds(".csv", _csv),
    "GSF": Seeds(".gsf", _gsf, "gsf/*.gsf", _gsf_mended),
    "Kongsberg .all": Seeds(".all", _all, "all/*.all", _all_mended),
    "Kongsberg .kmall": Seeds(".kmall", _kmall, "kmall/*_1.kmall", _kmall_mended),
    "XTF": Seeds(".xtf", _xtf, "xtf/*.xtf"),
    "LAS": Seeds(".las", partial(_las, ".las")),
    "LAZ": Seeds(".laz", partial(_las, ".laz"), "laz/*.laz"),
    "XYZ": Seeds(".xyz", _xyz),
    "PCD": Seeds(".pcd", _pcd, "pcd/submap_0_frame.pdc"),
    "SBET": Seeds(".sbet", _sbet, outcome=_sbet_outcome),
    "GeoTIFF": Seeds(".tif", partial(_grid, grid_files.geotiff, ".tif"), "grid/*.tif", outcome=_grid_outcome),
    "BAG": Seeds(".bag", partial(_grid, grid_files.bag, ".bag"), "grid/*.bag", outcome=_grid_outcome),
}
