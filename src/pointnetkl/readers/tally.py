"""Counts of soundings, kept part by part, because the soundings are not all in memory at once."""

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from pointnetkl.readers.arrangement import DEEPEST_M
from pointnetkl.readers.formats.recording import IMPOSSIBLE, OUTLIER

FLAGS = ("rejected", "impossible", "outliers")  # reasons why soundings are flagged, as a report has them

_BIN_M = 0.01  # of the histogram of depths, for quantiles


@dataclass
class Tally:
    """Counts of a survey: soundings left out, soundings flagged, and a histogram of the good depths."""

    skipped: Counter[str]
    highest_m: float  # z above which no sounding is good
    valid: int = 0
    flagged: Counter[str] = field(default_factory=Counter)
    shallowest_m: float = np.inf
    deepest_m: float = -np.inf
    bins: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        """Make bins for depths from the highest ground to the deepest."""
        self.bins = np.zeros(round((DEEPEST_M + self.highest_m) / _BIN_M) + 2, np.int64)

    def add(self, z_m: np.ndarray, quality: np.ndarray) -> None:
        """Count soundings by their quality, and the depths of the good ones."""
        depth = -z_m[quality == 0]
        self.valid += len(depth)
        counts = np.array([np.sum(quality == IMPOSSIBLE), np.sum(quality == OUTLIER)])
        rejected = len(quality) - len(depth) - int(counts.sum())
        self.flagged.update(dict(zip(FLAGS, [rejected, *counts.tolist()], strict=True)))
        if len(depth):
            self.shallowest_m = min(self.shallowest_m, float(depth.min()))
            self.deepest_m = max(self.deepest_m, float(depth.max()))
            bins = np.rint((depth + self.highest_m) / _BIN_M).astype(np.int64)
            self.bins += np.bincount(bins, minlength=len(self.bins))

    def quantile(self, share: float) -> float:
        """Return the depth above which a share of the good soundings lies, to a centimetre."""
        return float(np.searchsorted(self.bins.cumsum(), share * self.valid) * _BIN_M - self.highest_m)
