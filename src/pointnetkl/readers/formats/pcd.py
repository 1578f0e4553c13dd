"""PCD: a submap cut by another program, with its pose in VIEWPOINT; without a pose, a surface of points.

A submap's points are in the frame of its pose, from which roll and pitch are removed: x of the pose is along, y to
port, z up. The pose is in metres east, north and up; its time is unknown.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from pointnetkl.readers import projection
from pointnetkl.readers.formats import clouds
from pointnetkl.readers.formats.clouds import CloudFileError, Layout
from pointnetkl.readers.formats.point_parts import Block, Points, parts
from pointnetkl.readers.formats.recording import PART, Recording
from pointnetkl.readers.formats.window import Window
from pointnetkl.readers.formats.xyz.number_lines import NumberLines
from pointnetkl.surveys import pose
from pointnetkl.surveys.survey import SUBMAPS, SurveyError

SUFFIXES = (".pcd", ".pdc")

_HEAD_BYTES = 1 << 16
_WIDEST = 1 << 12  # words or bytes of a point


class PcdError(SurveyError):
    """A file is no PCD, or is damaged beyond use."""


def begins(head: bytes) -> bool:
    """Whether the first bytes of a file are those of PCD."""
    lines = [line.strip() for line in head.splitlines()]
    return next((line.split()[0] for line in lines if line and line[:1] != b"#"), b"") in (b"VERSION", b"FIELDS")


def read(path: Path) -> Iterator[Recording]:
    """Read a submap as one ping, or a surface in parts.

    Raises:
        PcdError: the file is no PCD, or is damaged beyond use.
    """
    try:
        with Window(path) as window:
            head = bytes(window.read(0, _HEAD_BYTES))
            layout, begin = clouds.pcd_layout(path, head)
            points = Points(path.name, projection.beside(path))
            blocks = _blocks(path, window, layout, begin, points)
            T = clouds.viewpoint(path, head) if b"VIEWPOINT" in head[:begin] else np.eye(4)
            if np.array_equal(T, np.eye(4)):
                yield from parts(points, blocks)
            else:
                yield _submap(points, blocks, T)
    except CloudFileError as error:
        raise PcdError(str(error)) from error
    except OSError as error:
        raise PcdError(f"{path}: cannot be read ({error.strerror})") from error


def _blocks(path: Path, window: Window, layout: Layout, begin: int, points: Points) -> Iterator[Block]:
    count = 0
    for xyz in _rows(path, window, layout, begin, points):
        xyz = xyz[: max(0, layout.rows - count)]
        count += len(xyz)
        x, y, z = xyz.T
        yield x, y, z, np.zeros(len(z), np.int8)
    if count != layout.rows:
        points.problems.add(f"its header says {layout.rows} points, it has {count}")
    if not count:
        raise PcdError(f"{path}: byte {begin}: has none of the {layout.rows} points that its header says")


def _rows(path: Path, window: Window, layout: Layout, begin: int, points: Points) -> Iterator[np.ndarray]:
    axes = clouds.axes_of(path, layout)
    words = clouds.columns_of(layout.row)
    if not 0 < layout.row.itemsize <= _WIDEST:
        raise PcdError(f"{path}: a point of {layout.row.itemsize} bytes is none; the header of its PCD is damaged")
    if layout.encoding == "ascii":
        width = int(sum(np.prod(layout.row[name].shape) for name in layout.row.names or ()))
        lines = NumberLines(path, begin, " ", width, words)
        yield from lines
        points.skip("lines that are not numbers", lines.bad)
    elif layout.encoding == "binary":
        size = layout.row.itemsize
        available = min(max(0, layout.rows), (window.size - begin) // size)
        for first in range(0, available, PART):
            rows = np.frombuffer(window.read(begin + first * size, min(PART, available - first) * size), layout.row)
            with np.errstate(all="ignore"):  # damaged numbers
                xyz = np.column_stack([rows[axis].reshape(-1) for axis in axes]).astype(np.float64)
            yield xyz
    elif layout.encoding == "binary_compressed":
        body = bytes(window.read(begin, window.size - begin))
        yield clouds.uncompressed(path, body, layout).astype(np.float64)
    else:
        raise PcdError(f"{path}: DATA {layout.encoding[:20]} is not known, must be ascii, binary or binary_compressed")


def _submap(points: Points, blocks: Iterator[Block], T: np.ndarray) -> Recording:
    """Return the submap as a ping, with its points in the frame of the pose's position and yaw."""
    xyz = np.concatenate([np.column_stack(block[:3]) for block in blocks])
    placed = np.isfinite(xyz).all(axis=1)
    points.skip("points that are not finite", int(np.sum(~placed)))
    level = pose.matrix(T[:3, 3], pose.yaw_of(T))
    along, port, up = pose.transform(np.linalg.inv(level) @ T, xyz[placed]).T
    east, north, z = T[:3, 3]
    heading = np.mod(np.pi / 2 - pose.yaw_of(T), 2 * np.pi)
    ping = {"time_s": np.nan, "east": east, "north": north, "depth_m": -z, "roll_rad": np.nan, "pitch_rad": np.nan}
    count = np.arange(len(up))
    soundings = {"ping": 0 * count, "beam": count.astype(np.int32), "along_m": along, "across_m": -port, "down_m": -up}
    return Recording(
        points.file,
        points.crs,
        pd.DataFrame([ping | {"heading_rad": heading}]),
        pd.DataFrame(soundings).assign(quality=np.zeros(len(up), np.int8)),
        points.skipped,
        points.problems.sentences,
        vertical="z of the submap's pose, up; its datum is not stated",
        kind=SUBMAPS,
        problems_omitted=points.problems.omitted,
    )
