"""Segmentation: cut a survey along its track into submaps of equal length, each in a frame of its own.

Submaps that another program has cut are kept as they are, and points without pings are cut by `tiles`. What is left
out is counted in `Segmentation.dropped`.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from pointnetkl.segmentation import soundings, spacing, track
from pointnetkl.segmentation.soundings import XYZ, Forward
from pointnetkl.surveys import pose
from pointnetkl.surveys.submap import POSES, Submap
from pointnetkl.workflow import parameters
from pointnetkl.workflow.errors import PointNetKLError

Take = Callable[[Submap], None]

FEWEST = 50  # points of a submap, twice those of a half: a normal needs 20 neighbours


class SegmentationError(PointNetKLError):
    """A survey cannot be cut into submaps."""


@dataclass(frozen=True)
class Settings:
    """Section `segment` of the parameters.

    Raises:
        ValueError: the gap or the turn is not positive, or the seed is negative.
    """

    seed: int
    max_gap_m: float
    max_turn_rad: float = 1.0  # of the course, over a submap's length

    def __post_init__(self) -> None:
        """Refuse a gap or a turn of zero, which would end a line at every ping."""
        parameters.require_positive(self, "max_gap_m", "max_turn_rad")
        parameters.require_seed(self.seed)


@dataclass(frozen=True)
class Segmentation:
    """Poses of a survey's submaps by navigation (schema POSES), and counts of what was left out, by reason."""

    poses: pd.DataFrame
    dropped: dict[str, int]


def segment(
    survey: str,
    pings: pd.DataFrame,
    parts: Iterable[pd.DataFrame],
    length_m: float,
    spacing_m: float,
    settings: Settings,
    take: Take,
) -> Segmentation:
    """Cut a survey (tables of schemas survey.PINGS and SOUNDINGS) into submaps, numbered from 0 along its track.

    `take` is called with each submap, because a survey's submaps may not fit in memory. A submap holds its soundings of
    quality 0 that do not stand alone, one drawn at random from each square cell of `spacing_m`. Its halves hold those
    of every other ping and those of the other pings, thinned in the same way; pings of the same time count as one.
    Soundings are read in parts of any size, in order of ping, with a few parts in memory at a time.

    Raises:
        SegmentationError: the survey has no usable pings, or is too short for one submap.
        SoundingsError: it has no usable soundings, or they are not those of its pings.
    """
    dropped: Counter[str] = Counter()
    pings = _checked_pings(survey, pings)
    # by time, because a sonar's two heads ping at once, each on its side: a half for each head would share no ground
    instant = np.unique(pings["time_s"], return_inverse=True)[1]
    stretches = _stretches(survey, pings, length_m, settings, dropped)
    return _cut(survey, pings, parts, stretches, instant, spacing_m, settings.seed, dropped, take)


def keep(
    survey: str, pings: pd.DataFrame, parts: Iterable[pd.DataFrame], spacing_m: float, settings: Settings, take: Take
) -> Segmentation:
    """Call `take` with submaps that another program has cut, each a ping with its pose, thinned as by `segment`.

    Their frames are levelled. They have no pings to alternate, so their halves are those of `spacing.alternate`. A
    pose's track_m is the distance to the next submap, and NaN for the last.

    Raises:
        SegmentationError, SoundingsError: as by segment.
    """
    pings = _checked_pings(survey, pings)
    distances = np.append(np.hypot(*np.diff(pings[XYZ[:2]].to_numpy(np.float64), axis=0).T), np.nan)
    places = zip(range(len(pings)), distances.tolist(), pings["yaw_rad"].tolist(), strict=True)
    stretches = [track.Stretch(i, i + 1, i, 0, length_m, yaw, straight=True) for i, length_m, yaw in places]
    return _cut(survey, pings, parts, stretches, None, spacing_m, settings.seed, Counter(), take)


def _cut(
    survey: str,
    pings: pd.DataFrame,
    parts: Iterable[pd.DataFrame],
    stretches: Sequence[track.Stretch],
    instant: np.ndarray | None,
    spacing_m: float,
    seed: int,
    dropped: Counter[str],
    take: Take,
) -> Segmentation:
    """Cut a submap from each stretch; its halves are alternate instants (k,) of its pings, or of points if None."""
    forward = Forward(survey, pings["ping"].to_numpy(), parts, dropped)
    poses: list[dict[str, float]] = []
    for stretch in stretches:
        row, xyz = forward.between(stretch.first, stretch.last)
        T_map_submap = pose.matrix(pings.loc[stretch.middle, XYZ].to_numpy(np.float64), stretch.yaw)
        points = pose.transform(np.linalg.inv(T_map_submap), xyz)
        alone = standing_alone(points, spacing_m, dropped)
        points, row = points[~alone], row[~alone]
        rng = np.random.default_rng([seed, len(poses)])
        if instant is None:
            second = spacing.alternate(points, spacing_m, rng)
        else:
            second = (instant[row] - instant[stretch.first]) % 2 == 1
        cut = thinned(survey, len(poses), points, second, spacing_m, rng)
        if too_few(cut):
            dropped["submaps of too few points"] += 1
            continue
        take(cut)
        poses.append(_pose_row(cut.number, stretch, T_map_submap, pings, len(points)))
    forward.finish()
    if not poses:
        raise SegmentationError(_nothing_left(survey, dropped))
    return Segmentation(pd.DataFrame(poses, columns=POSES.names), dict(dropped))


def _stretches(
    survey: str, pings: pd.DataFrame, length_m: float, settings: Settings, dropped: Counter[str]
) -> list[track.Stretch]:
    xy, yaw = pings[XYZ[:2]].to_numpy(np.float64), pings["yaw_rad"].to_numpy()
    lines = track.cut(xy, yaw, length_m, settings.max_gap_m, settings.max_turn_rad)
    if not lines.stretches:
        raise SegmentationError(
            f"{survey}: its longest line (of {lines.lines}) is {lines.longest_m:.4g} m, shorter than a submap of"
            f" {length_m:g} m; lower study.surveys.{survey}.submap_length_m or raise segment.max_gap_m"
        )
    straight = [stretch for stretch in lines.stretches if stretch.straight]
    dropped["ends of lines shorter than 0.9 of a submap"] = lines.remainders
    dropped["pings in them"] = lines.pings_dropped
    dropped["pings on turns"] = lines.pings_turning
    dropped["gaps in lines"] = lines.gaps
    dropped["metres missed in gaps"] = round(lines.missed_m)
    dropped["submaps on a turn"] = len(lines.stretches) - len(straight)
    return straight


def standing_alone(points: np.ndarray, spacing_m: float, dropped: Counter[str]) -> np.ndarray:
    """Return which soundings (n, 3) of a submap stand alone (spacing.outlying), and count them in `dropped`."""
    alone = spacing.outlying(points, spacing_m)
    dropped["soundings standing alone"] += int(alone.sum())
    return alone


def thinned(
    survey: str, number: int, points: np.ndarray, second: np.ndarray, spacing_m: float, rng: np.random.Generator
) -> Submap:
    """Return the submap of points (n, 3) in its frame, thinned whole and in halves; `second` (n,) marks the second."""
    parts = (points, points[~second], points[second])
    return Submap(survey, number, *(part[spacing.thin(part, spacing_m, rng)] for part in parts))


def too_few(submap: Submap) -> bool:
    """Return whether a submap or one of its halves has too few points to be registered."""
    return len(submap.points) < FEWEST or min(len(submap.first), len(submap.second)) < FEWEST // 2


def _pose_row(
    number: int, stretch: track.Stretch, T_map_submap: np.ndarray, pings: pd.DataFrame, soundings: int
) -> dict[str, float]:
    x, y, z = T_map_submap[:3, 3].tolist()
    return {
        "submap": number,
        "time_s": float(pings["time_s"].iloc[stretch.middle]),
        "x_m": x,
        "y_m": y,
        "z_m": z,
        "yaw_rad": stretch.yaw,
        "track_m": stretch.length_m,
        "pings": stretch.last - stretch.first,
        "soundings": soundings,
        "line": stretch.line,
    }


def _checked_pings(survey: str, pings: pd.DataFrame) -> pd.DataFrame:
    pings = pings.sort_values("ping", kind="stable", ignore_index=True)
    if pings.empty:
        raise SegmentationError(f"{survey}: has no pings; see the report that ingest keeps with its tables")
    if (twice := pings["ping"].duplicated()).any():
        raise SegmentationError(f"{survey}: ping {pings['ping'][twice].iloc[0]} stands twice; run ingest again")
    if (invalid := ~soundings.on_earth(pings)).any():
        raise SegmentationError(
            f"{survey}: {invalid.sum()} of its {len(pings)} pings have no valid position, the first of them ping"
            f" {pings['ping'][invalid].iloc[0]}; drop them from the raw data"
        )
    return pings


def _nothing_left(survey: str, dropped: Counter[str]) -> str:
    counts = ", ".join(f"{count} {reason}" for reason, count in dropped.items() if count)
    return (
        f"{survey}: no submap has {FEWEST} points or more (left out: {counts}); lower"
        f" study.surveys.{survey}.point_spacing_m or raise its submap_length_m"
    )
