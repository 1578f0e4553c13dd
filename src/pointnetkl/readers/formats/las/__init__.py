"""LAS and LAZ (ASPRS LAS 1.0 to 1.4, LASzip 2 and 3): a surface of points, without the pings that saw it.

Rejected are points withheld, noise (classes 7 and 18) and the water's surface (41, 42); impossible those without a
bottom (45), and those beyond the bounds that the header states, where most lie within. Heights are up in LAS; where no
vertical CRS says so and most are above zero, they are depths.
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
    found = 0
    for content in chunks or _batches(window, header):
        rows = np.frombuffer(content, row)
        found += len(rows)
        yield _block(rows, header, bounds)
    lost = chunks.lost if chunks else max(0, header.declared - found)
    points.skip("points cut off" if chunks is None else "points of damaged chunks", lost)
    bounds.tell(points, found)
    room = (header.end - header.first) // header.record_bytes
    if not lost and header.declared != (found if chunks else room):
        held = found if chunks else f"room for {room}"
        points.problems.tell(f"its header says {header.declared} points, and it has {held}; {found} are read")
    if not found:
        told = "; ".join(points.problems.told[:2]) or f"{header.declared} are declared"
        raise LasError(f"{path}: byte {header.first}: has no points that can be read ({told}); copy it again")


def _batches(window: Window, header: Header) -> Iterator[bytes]:
    """Yield the records that the file holds, so many as declared; all of them where none are declared."""
    room = (header.end - header.first) // header.record_bytes
    count = min(header.declared or room, room)
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
    """The bounds that a header states: few points beyond are damaged; if most are, the header is."""

    def __init__(self, header: Header) -> None:
        self._low, self._high = header.lowest - 2 * header.scale, header.highest + 2 * header.scale
        with np.errstate(invalid="ignore"):
            stated = bool(np.all(header.lowest <= header.highest) and np.any(header.lowest != header.highest))
        self._believed: bool | None = None if stated else False
        self._stated, self._beyond = bool(np.any(header.lowest != header.highest)), 0

    def beyond(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Return which points (n,) are impossible; none where the bounds are not believed, by the first points."""
        outside = np.zeros(len(x), bool)
        for low, high, values in zip(self._low, self._high, (x, y, z), strict=True):
            outside |= ~((low <= values) & (values <= high))
        if self._believed is None:
            self._believed = bool(outside.mean() < 0.5) if len(x) else None
        self._beyond += int(outside.sum())
        return outside if self._believed else np.zeros(len(x), bool)

    def tell(self, points: Points, found: int) -> None:
        """Tell where points and bounds do not agree."""
        if not self._beyond or not self._stated:
            return
        kept = "they are flagged" if self._believed else "bounds, scales or offsets of its header are wrong"
        points.problems.tell(f"{self._beyond} of {found} points lie beyond the bounds that its header states: {kept}")
