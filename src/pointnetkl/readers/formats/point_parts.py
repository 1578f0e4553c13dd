"""Points without pings, as parts of a recording: blocks are gathered, and z is turned into a height."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd

from pointnetkl.readers import projection
from pointnetkl.readers.formats import recording
from pointnetkl.readers.formats.recording import Problems, Recording
from pointnetkl.surveys.survey import POINTS

_NO_DATA = (9999.0, 99999.0, 32767.0, 32768.0, 1e6)  # numbers that mean "no data", with either sign
_BEYOND_TURNS = "soundings without a position on the earth"


@dataclass
class Points:
    """What a file of points says of its points, and what was skipped; filled while the file is read."""

    file: str
    crs: str = projection.LOCAL
    down: bool | None = None  # whether z counts down; None: the first points decide
    unit_m: float = 1.0  # metres per unit of z
    datum: str = ""  # the level that z is measured from
    sensor: str = ""
    skipped: dict[str, int] = field(default_factory=dict)
    problems: Problems = field(init=False)

    def __post_init__(self) -> None:
        """Name the file in every problem."""
        self.problems = Problems(self.file)

    def skip(self, reason: str, count: int) -> None:
        """Count points that are left out."""
        if count:
            self.skipped[reason] = self.skipped.get(reason, 0) + count


Block = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]  # x, y, z in the file's units, quality; (n,) each


def parts(points: Points, blocks: Iterable[Block]) -> Iterator[Recording]:
    """Yield recordings of about PART points, at least one; the last one has the skipped counts and the problems."""
    ready: Recording | None = None
    for block in _gathered(blocks):
        table = _table(points, block)
        if ready is not None:
            yield ready
        ready = _recording(points, table)
    last = ready if ready is not None else _recording(points, _table(points, (np.empty(0),) * 4))
    problems = points.problems
    yield replace(last, skipped=points.skipped, problems=problems.sentences, problems_omitted=problems.omitted)


def _gathered(blocks: Iterable[Block]) -> Iterator[Block]:
    waiting: list[Block] = []
    for block in blocks:
        waiting.append(block)
        if sum(len(x) for x, *_ in waiting) >= recording.PART:
            yield _joined(waiting)
            waiting = []
    if waiting:
        yield _joined(waiting)


def _joined(blocks: list[Block]) -> Block:
    x, y, z, quality = (np.concatenate(columns) for columns in zip(*blocks, strict=True))
    return x, y, z, quality


def _table(points: Points, block: Block) -> pd.DataFrame:
    x, y, z, quality = block
    placed = np.isfinite(x) & np.isfinite(y) & np.isfinite(z)
    points.skip("points that are not finite", int(np.sum(~placed)))
    if points.crs == projection.GEOGRAPHIC:
        on_earth = placed & (np.abs(x) <= 360) & (np.abs(y) <= 90)
        points.skip(_BEYOND_TURNS, int(np.sum(placed & ~on_earth)))
        x, placed = np.mod(x + 180.0, 360.0) - 180.0 if np.any(np.abs(x[on_earth]) > 180) else x, on_earth
    x, y, z, quality = x[placed], y[placed], z[placed], quality[placed].astype(np.int8)
    quality[np.isin(np.abs(z), _NO_DATA) & (quality == 0)] = recording.IMPOSSIBLE
    return pd.DataFrame({"east": x, "north": y, "up_m": _up(points, z, quality), "quality": quality})


def _up(points: Points, z: np.ndarray, quality: np.ndarray) -> np.ndarray:
    """Return z as heights in metres; decide by the first points whether z counts down if the file does not say."""
    if points.down is None and len(z):
        good = z[quality == 0] if np.any(quality == 0) else z
        points.down = bool(np.median(good) > 0)
        reading = "depth, because most are above" if points.down else "height, because most are not above"
        points.datum = f"z taken as {reading} zero; " + (points.datum or "its datum is not stated")
    up = z * (-points.unit_m if points.down else points.unit_m)
    return up + 0.0  # no minus zero


def _recording(points: Points, table: pd.DataFrame) -> Recording:
    pings = pd.DataFrame({name: np.empty(0) for name in recording.PING_COLUMNS})
    return Recording(points.file, points.crs, pings, table, sensor=points.sensor, vertical=points.datum, kind=POINTS)
