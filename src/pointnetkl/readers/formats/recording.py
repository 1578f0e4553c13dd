"""What a reader gives of a raw file: navigation and soundings relative to the vehicle, before they have a place."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import pandas as pd

from pointnetkl.surveys.survey import SWATHS

REJECTED, IMPOSSIBLE, OUTLIER = 1, 2, 3  # quality: refused by the sonar or its operator; by checks of ours; by its ping

PART = 1 << 18  # soundings, some, after which a reader hands over what it has: memory does not grow with the file

PING_COLUMNS = ("time_s", "east", "north", "depth_m", "roll_rad", "pitch_rad", "heading_rad")
SOUNDING_COLUMNS = ("ping", "beam", "along_m", "across_m", "down_m", "quality")
POINT_COLUMNS = ("east", "north", "up_m", "quality")

_MOST_TOLD = 20  # sentences on what is wrong: each stands in memory and in reports


@dataclass
class Problems:
    """Sentences on what is wrong with a file: the first of them, and how many more there are."""

    file: str = ""
    told: list[str] = field(default_factory=list)
    untold: int = 0

    def tell(self, sentence: str) -> None:
        """Keep a sentence, with the file's name before it; count it where there are many already."""
        self.add([f"{self.file}: {sentence}"])

    def tell_first(self, sentence: str) -> None:
        """Keep a sentence on the whole file, which stands before those on places in it."""
        told, self.told = self.told, []
        self.add([f"{self.file}: {sentence}", *told])

    def add(self, told: Sequence[str], untold: int = 0) -> None:
        """Keep sentences as they are, as far as there is room, and count others."""
        room = max(0, _MOST_TOLD - len(self.told))
        self.told += told[:room]
        self.untold += len(told[room:]) + untold

    def taken(self) -> "Problems":
        """Return what has been told since this was called last."""
        taken = Problems(self.file, self.told, self.untold)
        self.told, self.untold = [], 0
        return taken

    def __bool__(self) -> bool:
        """Whether there is anything to tell."""
        return bool(self.told)

    @property
    def sentences(self) -> list[str]:
        """Return what a reader of a report is told: the sentences, and how many more there are."""
        return [*self.told, *([f"and {self.untold} more"] if self.untold else [])]


@dataclass(frozen=True)
class Recording:
    """What a part of a raw file holds; a file is one part or several, in the order in which they stand in it.

    `pings` has PING_COLUMNS: time_s, UTC since 1970; east, north (longitude and latitude in degrees where crs is
    projection.GEOGRAPHIC, else metres); depth_m (of the vehicle, positive down); roll_rad, pitch_rad (NaN: not
    recorded); heading_rad (clockwise from true north, or from grid north where the crs is projected).
    `soundings` has SOUNDING_COLUMNS: ping (row of this part's `pings`), beam, along_m (forward), across_m (to
    starboard), down_m (below the vehicle), quality; levelled, not turned by the heading. Of kind POINTS there are no
    pings, and `soundings` has POINT_COLUMNS. Of kind SUBMAPS a file is one ping, whose time is NaN.
    """

    file: str
    crs: str
    pings: pd.DataFrame
    soundings: pd.DataFrame
    skipped: dict[str, int] = field(default_factory=dict)  # counts by reason, of this part alone
    problems: list[str] = field(default_factory=list)  # sentences that name file, byte and cause: some, see Problems
    sensor: str = ""  # maker, model and serial numbers, as far as the file names them
    vertical: str = ""  # what depths are below, and which corrections they have
    kind: str = SWATHS
    untold: int = 0  # problems beside those
