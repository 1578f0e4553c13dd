"""A survey with all its soundings in one table, for tests."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from pointnetkl import readers
from pointnetkl.segmentation import Segmentation
from pointnetkl.surveys.submap import Submap
from pointnetkl.surveys.survey import SOUNDINGS

SETTINGS = readers.Settings("auto")


@dataclass(frozen=True)
class Whole:
    """What `survey.Survey` holds, and the soundings."""

    pings: pd.DataFrame
    soundings: pd.DataFrame
    crs: str = "local"
    origin: tuple[float, float] = (0.0, 0.0)
    kind: str = "pings"
    report: dict[str, Any] = field(default_factory=dict)


def read(path: Path, settings: readers.Settings = SETTINGS) -> Whole:
    """Read a raw survey with all its soundings."""
    parts: list[pd.DataFrame] = []
    survey = readers.read(path, settings, parts.append)
    soundings = pd.concat(parts or [SOUNDINGS.empty_table().to_pandas()], ignore_index=True)
    return Whole(survey.pings, soundings, survey.crs, survey.origin, survey.kind, survey.report)


class Cut(NamedTuple):
    """What a segmentation gives, with its submaps."""

    submaps: list[Submap]
    poses: pd.DataFrame
    dropped: dict[str, int]


def cut(segment: Callable[..., Segmentation], *arguments: Any) -> Cut:
    """Return all submaps of a segmentation, which hands them over one by one."""
    submaps: list[Submap] = []
    segmentation = segment(*arguments, submaps.append)
    return Cut(submaps, segmentation.poses, segmentation.dropped)
