"""The output of a format's reader: navigation, and soundings relative to the vehicle, before they are on a map."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import pandas as pd

from pointnetkl.surveys.survey import SWATHS

# quality of a sounding: refused by the sonar or its operator; by our limits; by comparison with its neighbours
REJECTED, IMPOSSIBLE, OUTLIER = 1, 2, 3

PART = 1 << 18  # soundings after which a reader hands over a part, so that memory does not grow with the file

PING_COLUMNS = ("time_s", "east", "north", "depth_m", "roll_rad", "pitch_rad", "heading_rad")
SOUNDING_COLUMNS = ("ping", "beam", "along_m", "across_m", "down_m", "quality")
POINT_COLUMNS = ("east", "north", "up_m", "quality")

_MOST_SENTENCES = 20  # of a file: all are in memory and in reports


@dataclass
class Problems:
    """Sentences on what is wrong with a file: the first of them, and the number of those omitted."""

    file: str = ""
    sentences: list[str] = field(default_factory=list)
    omitted: int = 0

    def add(self, sentence: str) -> None:
        """Keep a sentence with the file's name before it, or count it if there are many already."""
        self.extend([f"{self.file}: {sentence}"])

    def add_first(self, sentence: str) -> None:
        """Keep a sentence on the whole file, before those on places in the file."""
        later, self.sentences = self.sentences, []
        self.extend([f"{self.file}: {sentence}", *later])

    def extend(self, sentences: Sequence[str], omitted: int = 0) -> None:
        """Keep sentences as they are while there is room, and count the rest and those already `omitted`."""
        room = max(0, _MOST_SENTENCES - len(self.sentences))
        self.sentences += sentences[:room]
        self.omitted += len(sentences[room:]) + omitted

    def drain(self) -> "Problems":
        """Return the problems that were added since the last call, and forget them."""
        drained = Problems(self.file, self.sentences, self.omitted)
        self.sentences, self.omitted = [], 0
        return drained

    def __bool__(self) -> bool:
        """Whether there is a problem."""
        return bool(self.sentences)

    @property
    def summary(self) -> list[str]:
        """The sentences for a report; the last one says how many were omitted."""
        return [*self.sentences, *([f"and {self.omitted} more"] if self.omitted else [])]


@dataclass(frozen=True)
class Recording:
    """One part of a raw file; a file is one part or several, in the order of the file.

    `pings` has PING_COLUMNS: time_s, UTC since 1970; east, north (longitude and latitude in degrees where crs is
    projection.GEOGRAPHIC, else metres); depth_m (of the vehicle, positive down); roll_rad, pitch_rad (NaN: not
    recorded); heading_rad (clockwise from true north, or from grid north where the crs is projected).
    `soundings` has SOUNDING_COLUMNS: ping (row of this part's `pings`), beam, along_m (forward), across_m (to
    starboard), down_m (below the vehicle), quality; they are levelled, but not turned by the heading. A recording of
    kind POINTS has no pings, and its `soundings` have POINT_COLUMNS. A file of kind SUBMAPS is one ping at time NaN.
    """

    file: str
    crs: str
    pings: pd.DataFrame
    soundings: pd.DataFrame
    skipped: dict[str, int] = field(default_factory=dict)  # counts by reason, of this part alone
    problems: list[str] = field(
        default_factory=list
    )  # sentences that name file, byte and cause; the first, see Problems
    sensor: str = ""  # maker, model and serial numbers, as far as the file names them
    vertical: str = ""  # the level that depths are below, and the corrections applied
    kind: str = SWATHS
    problems_omitted: int = 0  # problems without a sentence above
