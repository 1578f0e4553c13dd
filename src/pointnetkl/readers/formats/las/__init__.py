"""LAS and LAZ (ASPRS LAS 1.0 to 1.4, LASzip 2 and 3): a surface of points, without pings.

Rejected are withheld points, noise (classes 7 and 18) and the water's surface (41, 42). Impossible are points without a
bottom (45), and points beyond the header's bounds if most are within. Heights are up in LAS; but without a vertical CRS
they are taken as depths if most are above zero.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from pointnetkl.readers.formats import recording
from pointnetkl.readers.formats.las import crs as las_crs
from pointnetkl.readers.formats.las import header as las_header
from pointnetkl.readers.formats.las.header import Header, LasError
from pointnetkl.readers.formats.las.laz_chunks import Chunks
from pointnetkl.readers.formats.point_parts import Block, Points, parts
from pointnetkl.readers.formats.recording import Recording
from pointnetkl.readers.formats.window import Window

SUFFIXES = (".las", ".laz")

_REJECTED_CLASSES, _NO_BOTTOM = (7, 18, 41, 42), 45
_BATCH = 1 << 17  # points


def begins(head: bytes) -> bool:
    """Whether the first bytes of a file are those of LAS or LAZ."""
    return head.startswith(b"LASF")


def read(path: Path) -> Iterator[Recording]:
    """Read a LAS or LAZ file in parts.

    Raises:
        LasError: the file is no LAS, is damaged beyond use, or its CRS is not in metres or degrees.
    """
    try:
        with Window(path) as window:
            header = las_header.read(path, window)
            reference = las_crs.reference(path, header)
            points = Points(path.name, reference.crs, reference.down, reference.unit_m, reference.vertical)
            points.sensor = header.system
            yield from parts(points, _blocks(path, window, header, points))
    except OSError as error:
        raise LasError(f"{path}: cannot be read ({error.strerror})") from error


def _blocks(path: Path, window: Window, header: Header, points: Points) -> Iterator[Block]:
    chunks = Chunks(path, window, header, points.problems) if header.compressed else None
    row = _row(header)
    bounds = _Bounds(header)
    count = 0
    for content in chunks or _batches(window, header):
        rows = np.frombuffer(content, row)
        count += len(rows)
        yield _block(rows, header, bounds)
    lost = chunks.lost if chunks else max(0, header.declared - count)
    points.skip("points cut off" if chunks is None else "points of damaged chunks", lost)
    bounds.report(points, count)
    capacity = (header.end - header.first) // header.record_bytes
    if not lost and header.declared != (count if chunks else capacity):
        available = count if chunks else f"room for {capacity}"
        points.problems.add(f"its header says {header.declared} points, and it has {available}; {count} are read")
    if not count:
        reasons = "; ".join(points.problems.sentences[:2]) or f"{header.declared} are declared"
        raise LasError(f"{path}: byte {header.first}: has no points that can be read ({reasons}); copy it again")


def _batches(window: Window, header: Header) -> Iterator[bytes]:
    """Yield the declared records, as far as the file has them; all records where none are declared."""
    capacity = (header.end - header.first) // header.record_bytes
    count = min(header.declared or capacity, capacity)
    for begin in range(0, count, _BATCH):
        size = min(_BATCH, count - begin) * header.record_bytes
        yield bytes(window.read(header.first + begin * header.record_bytes, size))


def _row(header: Header) -> np.dtype:
    kind = 16 if header.point_format > 5 else 15
    return np.dtype(
        {
            "names": ["xyz", "flags", "class"],
            "formats": [("<i4", 3), "u1", "u1"],
            "offsets": [0, 15, kind],
            "itemsize": header.record_bytes,
        }
    )


def _block(rows: np.ndarray, header: Header, bounds: "_Bounds") -> Block:
    x, y, z = (rows["xyz"] * header.scale + header.offset).T
    if header.point_format > 5:
        kind, withheld = rows["class"], rows["flags"] & 0x04
    else:
        kind, withheld = rows["class"] & 0x1F, rows["class"] & 0x80
    quality = np.where(np.isin(kind, _REJECTED_CLASSES) | (withheld > 0), recording.REJECTED, 0)
    quality[(quality == 0) & ((kind == _NO_BOTTOM) | bounds.beyond(x, y, z))] = recording.IMPOSSIBLE
    return x, y, z, quality


class _Bounds:
    """The bounds in a header: if few points are beyond them, these are damaged; if most are, the header is."""

    def __init__(self, header: Header) -> None:
        self._low, self._high = header.lowest - 2 * header.scale, header.highest + 2 * header.scale
        with np.errstate(invalid="ignore"):
            stated = bool(np.all(header.lowest <= header.highest) and np.any(header.lowest != header.highest))
        self._believed: bool | None = None if stated else False
        self._stated, self._beyond = bool(np.any(header.lowest != header.highest)), 0

    def beyond(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Return which points (n,) are impossible; the first points decide whether the bounds are believed."""
        outside = np.zeros(len(x), bool)
        for low, high, values in zip(self._low, self._high, (x, y, z), strict=True):
            outside |= ~((low <= values) & (values <= high))
        if self._believed is None:
            self._believed = bool(outside.mean() < 0.5) if len(x) else None
        self._beyond += int(outside.sum())
        return outside if self._believed else np.zeros(len(x), bool)

    def report(self, points: Points, count: int) -> None:
        """Report points beyond the bounds."""
        if not self._beyond or not self._stated:
            return
        kept = "they are flagged" if self._believed else "bounds, scales or offsets of its header are wrong"
        points.problems.add(f"{self._beyond} of {count} points lie beyond the bounds that its header states: {kept}")
