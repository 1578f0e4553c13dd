"""Damage to raw files, and checks of what a reader makes of it."""

import random
import struct
from collections import Counter
from pathlib import Path

import numpy as np
import pandas as pd

from pointnetkl import readers
from pointnetkl.readers.spool import UnforeseenError
from pointnetkl.surveys.survey import Survey
from pointnetkl.workflow import parameters
from pointnetkl.workflow.errors import PointNetKLError

SETTINGS = parameters.read(Path(__file__).parents[2] / "params.yaml", "ingest", readers.Settings)
REPORTED, REFUSED, READ = "reported", "refused", "read"  # the report names damage; an error; nothing noticed

_ODD = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 1 << 24, 1000, 65537)
_FLOATS = (float("nan"), float("inf"), -float("inf"), 1e308, -1e30, 1e-320, -1.0)


def mutated(content: bytes, rng: random.Random) -> bytes:
    """Return the bytes with one to eight changes: as bad disks, links and writers make them, and as no one does."""
    changed = bytearray(content)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 8))):
        if changed:
            rng.choice((_flip, _flip, _byte, _number, _number, _float, _cut, _delete, _repeat, _insert, _move))(
                changed, rng
            )
    return bytes(changed)


def corrupted(content: bytes, rng: np.random.Generator) -> bytes:
    """Return bytes with some flipped, and sometimes cut off or cut out."""
    changed = bytearray(content)
    for offset in rng.integers(0, len(changed), rng.integers(1, 10)):
        changed[offset] = rng.integers(0, 256) if rng.random() < 0.7 else rng.choice([0, 127, 128, 255])
    if rng.random() < 0.3:
        del changed[int(rng.integers(1, len(changed))) :]
    if rng.random() < 0.2:
        offset = int(rng.integers(0, len(changed)))
        del changed[offset : offset + int(rng.integers(1, 60))]
    return bytes(changed)


def outcome(path: Path) -> str:
    """Read a file of any kind; return REPORTED, REFUSED or READ.

    Raises:
        AssertionError: what came out is not what the report declares.
    """
    parts: list[pd.DataFrame] = []
    try:
        survey = readers.read(path, SETTINGS, parts.append, path.parent)
    except PointNetKLError as error:
        if isinstance(error, UnforeseenError):
            raise
        return named(path, error)
    _check(survey, parts)
    return REPORTED if survey.report["problems"] or survey.report["skipped"] else READ


def named(path: Path, error: PointNetKLError) -> str:
    """Return REFUSED where an error is a sentence that names the file."""
    sentence = str(error)
    assert "\n" not in sentence, sentence
    assert path.name in sentence, sentence
    assert len(sentence) < 1500, sentence
    return REFUSED


def _check(survey: Survey, parts: list[pd.DataFrame]) -> None:
    """What stands in the report is what came out, and nothing of it is beyond the sea."""
    report, skipped = survey.report, Counter(survey.report["skipped"])
    count, valid = sum(map(len, parts)), sum(int((part["quality"] == 0).sum()) for part in parts)
    lost = ("soundings without a place", "soundings of skipped pings", "soundings that stand twice")
    assert count == report["soundings"] - sum(skipped[reason] for reason in lost), report
    assert valid == report["valid"], report
    assert np.isfinite(survey.pings[["time_s", "x_m", "y_m", "z_m", "yaw_rad"]].to_numpy(float)).all()
    assert np.all(np.diff(survey.pings["time_s"]) >= 0)
    last = -1
    for part in parts:
        xyz = part[["x_m", "y_m", "z_m"]].to_numpy()
        assert np.isfinite(xyz).all()
        good = part["quality"].to_numpy() == 0
        if good.any():
            least, _, _, most = report["depth_m"]
            assert least <= -xyz[good, 2].max(), report
            assert most >= -xyz[good, 2].min(), report
            assert (-200 if survey.kind == "pings" else -9_100) < least <= most <= 12_000, report
        ping = part["ping"].to_numpy()
        assert np.all(np.diff(ping, prepend=last) >= 0) or survey.kind == "points"
        last = int(ping[-1]) if len(ping) else last
        assert survey.kind == "points" or ping.max(initial=0) < len(survey.pings)


def _offset(changed: bytearray, rng: random.Random) -> int:
    # heads and lengths stand early more often than late
    return min(int(rng.random() ** rng.choice((1, 1, 4)) * len(changed)), len(changed) - 1)


def _flip(changed: bytearray, rng: random.Random) -> None:
    changed[_offset(changed, rng)] ^= 1 << rng.randrange(8)


def _byte(changed: bytearray, rng: random.Random) -> None:
    changed[_offset(changed, rng)] = rng.randrange(256)


def _number(changed: bytearray, rng: random.Random) -> None:
    code = rng.choice(("<H", ">H", "<I", ">I", "<Q", ">Q"))
    size = struct.calcsize(code)
    offset = _offset(changed, rng)
    if offset + size <= len(changed):
        value = rng.choice(_ODD) if rng.random() < 0.7 else (len(changed) - offset + rng.randrange(-8, 9))
        struct.pack_into(code, changed, offset, value % (1 << 8 * size))


def _float(changed: bytearray, rng: random.Random) -> None:
    code = rng.choice(("<d", ">d"))
    offset = _offset(changed, rng)
    if rng.random() < 0.5 and offset + 8 <= len(changed):
        struct.pack_into(code, changed, offset, rng.choice(_FLOATS))
    elif offset + 4 <= len(changed):
        struct.pack_into(
            "<I", changed, offset, rng.choice((0x7FC00000, 0x7F800000, 0xFF800000, 0x7F7FFFFF, 0x00000001))
        )


def _cut(changed: bytearray, rng: random.Random) -> None:
    del changed[rng.randrange(len(changed)) :]


def _delete(changed: bytearray, rng: random.Random) -> None:
    offset = _offset(changed, rng)
    del changed[offset : offset + rng.choice((1, 2, 4, 30, 500))]


def _repeat(changed: bytearray, rng: random.Random) -> None:
    offset = _offset(changed, rng)
    changed[offset:offset] = changed[offset : offset + rng.choice((1, 4, 64, 3000))]


def _insert(changed: bytearray, rng: random.Random) -> None:
    offset = _offset(changed, rng)
    changed[offset:offset] = rng.randbytes(rng.choice((1, 2, 3, 16, 700)))


def _move(changed: bytearray, rng: random.Random) -> None:
    offset, size = _offset(changed, rng), rng.choice((4, 64, 2000))
    piece = changed[offset : offset + size]
    del changed[offset : offset + size]
    to = rng.randrange(len(changed) + 1)
    changed[to:to] = piece
