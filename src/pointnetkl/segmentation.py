"""Segmentation: a survey cut along its track into submaps of equal length, each in a frame of its own.

Nothing is left out without being counted, see `Segmentation.dropped`.
"""

from collections import Counter
from dataclasses import dataclass

import numpy as np
import pandas as pd

from pointnetkl import pose, settings, spacing, track
from pointnetkl.errors import PointNetKLError
from pointnetkl.submap import POSES, Submap

_FEWEST = 50  # points of a submap, and half of that in each of its halves: a normal needs 20 neighbours
_FARTHEST_M = 1e7  # from the map's origin: beyond it is no place on earth
_XYZ = ["x_m", "y_m", "z_m"]


class SegmentationError(PointNetKLError):
    """A survey cannot be cut into submaps."""


@dataclass(frozen=True)
class Settings:
    """Parameters of section `segment`.

    Raises:
        ValueError: the gap is not positive, or the seed is negative.
    """

    seed: int
    max_gap_m: float

    def __post_init__(self) -> None:
        """Refuse a gap that would end a line at every ping."""
        settings.require_positive(self, "max_gap_m")
        settings.require_seed(self.seed)


@dataclass(frozen=True)
class Segmentation:
    """A survey's submaps, their poses by navigation (schema POSES), and counts of what was left out, by reason."""

    submaps: list[Submap]
    poses: pd.DataFrame
    dropped: dict[str, int]


def segment(
    survey: str, pings: pd.DataFrame, soundings: pd.DataFrame, length_m: float, spacing_m: float, how: Settings
) -> Segmentation:
    """Cut a survey (tables of schemas survey.PINGS and SOUNDINGS) into submaps, numbered from 0 along its track.

    A submap holds its soundings of quality 0 that do not stand alone, one drawn at random from each square cell
    of `spacing_m`; its halves hold those of every other ping, and of the others, thinned alike. Pings of one time
    count as one here. The order of rows in the tables does not matter.

    Raises:
        SegmentationError: the survey has no usable pings or soundings, or is too short for one submap.
    """
    dropped: Counter[str] = Counter()
    pings = _checked_pings(survey, pings)
    row, xyz = _good_soundings(survey, pings, soundings, dropped)
    # by time, because a sonar's two heads ping at once, each on its side: apart, the halves would share no ground
    instant = np.unique(pings["time_s"], return_inverse=True)[1]
    submaps: list[Submap] = []
    poses = []
    for stretch in _stretches(survey, pings, length_m, how.max_gap_m, dropped):
        rows = slice(*np.searchsorted(row, [stretch.first, stretch.last]))
        T_map_submap = pose.matrix(pings.loc[stretch.middle, _XYZ].to_numpy(np.float64), stretch.yaw)
        points, odd = _company(xyz[rows], instant[row[rows]] - instant[stretch.first], T_map_submap, spacing_m, dropped)
        rng = np.random.default_rng([how.seed, len(submaps)])
        found = Submap(survey, len(submaps), *_thinned(points, odd, spacing_m, rng))
        if _too_few(found):
            dropped["submaps of too few points"] += 1
            continue
        submaps.append(found)
        poses.append(_pose_row(found.number, stretch, T_map_submap, pings, len(points)))
    if not submaps:
        raise SegmentationError(_nothing_left(survey, dropped))
    return Segmentation(submaps, pd.DataFrame(poses, columns=POSES.names), dict(dropped))


def _stretches(
    survey: str, pings: pd.DataFrame, length_m: float, max_gap_m: float, dropped: Counter[str]
) -> list[track.Stretch]:
    found = track.cut(pings[_XYZ[:2]].to_numpy(np.float64), pings["yaw_rad"].to_numpy(), length_m, max_gap_m)
    if not found.stretches:
        raise SegmentationError(
            f"{survey}: its longest line (of {found.lines}) is {found.longest_m:.4g} m, shorter than a submap of"
            f" {length_m:g} m; lower study.surveys.{survey}.submap_length_m or raise segment.max_gap_m"
        )
    straight = [stretch for stretch in found.stretches if stretch.straight]
    dropped["ends of lines shorter than 0.9 of a submap"] = found.remainders
    dropped["pings in them"] = found.pings_left
    dropped["submaps on a turn"] = len(found.stretches) - len(straight)
    return straight


def _company(
    xyz: np.ndarray, instant: np.ndarray, T_map_submap: np.ndarray, spacing_m: float, dropped: Counter[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Return soundings (n, 3) in the submap's frame but for those standing alone, and which are of odd instants."""
    points = pose.transform(np.linalg.inv(T_map_submap), xyz)
    alone = spacing.outlying(points, spacing_m)
    dropped["soundings standing alone"] += int(alone.sum())
    return points[~alone], instant[~alone] % 2 == 1


def _thinned(
    points: np.ndarray, odd: np.ndarray, spacing_m: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the points of the whole and of its two halves, each thinned on its own."""
    whole, first, second = (p[spacing.thin(p, spacing_m, rng)] for p in (points, points[~odd], points[odd]))
    return whole, first, second


def _too_few(found: Submap) -> bool:
    return len(found.points) < _FEWEST or min(len(found.first), len(found.second)) < _FEWEST // 2


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
    if (lost := ~_on_earth(pings)).any():
        raise SegmentationError(
            f"{survey}: {lost.sum()} of its {len(pings)} pings have no valid position, the first of them ping"
            f" {pings['ping'][lost].iloc[0]}; drop them from the raw data"
        )
    return pings


def _good_soundings(
    survey: str, pings: pd.DataFrame, soundings: pd.DataFrame, dropped: Counter[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Return each good sounding's ping as a row (n,), and its map position (n, 3), in order of ping and beam."""
    soundings = _in_order(soundings)
    accepted, placed = soundings["quality"].to_numpy() == 0, _on_earth(soundings)
    dropped["soundings of bad quality"] = int(np.sum(~accepted))
    dropped["soundings without a valid position"] = int(np.sum(accepted & ~placed))
    good = soundings[accepted & placed]
    if good.empty:
        raise SegmentationError(
            f"{survey}: none of its {len(soundings)} soundings has quality 0 and a valid position; check the"
            " quality flags of the raw data"
        )
    known, wanted = pings["ping"].to_numpy(), good["ping"].to_numpy()
    row = np.searchsorted(known, wanted).clip(max=len(known) - 1)
    if (lost := known[row] != wanted).any():
        raise SegmentationError(
            f"{survey}: {lost.sum()} soundings belong to no ping, the first to ping {wanted[lost][0]}; both"
            " tables must come from one run of ingest"
        )
    return row, good[_XYZ].to_numpy(np.float64)


def _in_order(soundings: pd.DataFrame) -> pd.DataFrame:
    ping, beam = np.diff(soundings["ping"]), np.diff(soundings["beam"])
    if np.all((ping > 0) | ((ping == 0) & (beam > 0))):
        return soundings  # as ingest writes them; sorting millions of rows again would take a second
    return soundings.sort_values(["ping", "beam", *_XYZ], ignore_index=True)


def _on_earth(table: pd.DataFrame) -> np.ndarray:
    return np.asarray((np.abs(table[_XYZ].to_numpy(np.float64)) < _FARTHEST_M).all(axis=1))  # false for NaN


def _nothing_left(survey: str, dropped: Counter[str]) -> str:
    counts = ", ".join(f"{count} {what}" for what, count in dropped.items() if count)
    return (
        f"{survey}: no submap has {_FEWEST} points or more (left out: {counts}); lower"
        f" study.surveys.{survey}.point_spacing_m or raise its submap_length_m"
    )
