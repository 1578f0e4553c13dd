"""How a survey is corrected: section `correct` of the parameters, and the options of the command."""

import dataclasses
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from pointnetkl import readers
from pointnetkl.correction.result import CorrectionError
from pointnetkl.readers import cleaning
from pointnetkl.registration import pair
from pointnetkl.slam.closing import drift, survey
from pointnetkl.workflow.parameters import require_positive, require_seed, require_within

# What navigation is, and whose rates it has where nothing else is said of it.
DEAD_RECKONING = "dead-reckoning"
NAVIGATION = {DEAD_RECKONING: "gyrocompass", "gnss": "gnss", "usbl": "usbl"}

_LEAST_SHARE = 1e-3  # of a submap, that an overlap can be told by
_MOST_SHARE = 0.3  # of a submap of few points, that is asked for
_PAIR = re.compile(r"\s*(\w+)\s*=\s*([-+.\w]+)\s*")


@dataclass(frozen=True)
class Settings:
    """How a survey is corrected.

    Raises:
        ValueError: a setting is out of its range.
    """

    # dead-reckoning: it drifts; gnss, usbl: positions are absolute and wander; empty: as the data suggest
    navigation: str = ""
    drift: str = ""  # a preset, a name of section `navigation`, or rates such as scale_error=0.003; empty: measured
    submap_length_m: float = 0.0  # along the track; 0: chosen from the data
    point_spacing_m: float = 0.0  # of submaps' points; 0: chosen from the data
    cell_m: float = 0.0  # of the maps; 0: about five soundings each
    overlap_points: int = 150  # of a submap, expected over earlier ones together: with fewer none is registered
    target_points: int = 50  # and over each of them
    max_gap_m: float = 0.0  # a longer step between two pings ends a line; 0: ten times the usual step
    max_turn_rad: float = 1.0  # of the course over a submap's length, beyond which a line ends
    left_out_gain: float = 0.1  # of closures left out in turn: applied if so much of their error goes ...
    left_out_p: float = 0.05  # ... and it is not by chance
    seed: int = 1  # of the points that thinning keeps
    closing: survey.Settings = field(default_factory=lambda: survey.Settings(rounds=4))
    outliers: cleaning.Settings = field(default_factory=lambda: cleaning.Settings(8.0, 0.05))
    utm_zone: str = "auto"
    sbet_clock: str = "gps"

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        if self.navigation and self.navigation not in NAVIGATION:
            raise ValueError(f"navigation is {self.navigation!r}, must be one of {', '.join(NAVIGATION)}")
        require_within(self, 0.0, 1e6, "submap_length_m", "point_spacing_m", "cell_m", "max_gap_m")
        require_within(self, 0.0, 1.0, "left_out_gain", "left_out_p")
        require_positive(self, "overlap_points", "target_points", "max_turn_rad")
        require_seed(self.seed)
        readers.Settings(self.utm_zone, self.sbet_clock)

    @property
    def reading(self) -> readers.Settings:
        """Return how raw files are read."""
        return readers.Settings(self.utm_zone, self.sbet_clock, self.outliers)

    def close(self, spacing_m: float, points: float) -> survey.Settings:
        """Return how closures are found among submaps of so many points, so far apart.

        A share of a submap stands for the area of overlap: what the ground there holds is for the registration to say.
        """
        share = float(np.clip(self.overlap_points / points, _LEAST_SHARE, _MOST_SHARE))
        each = float(np.clip(self.target_points / points, _LEAST_SHARE, max(share / 3, _LEAST_SHARE)))
        variance = max(self.closing.search.search_variance_m2, spacing_m**2)
        searching = dataclasses.replace(
            self.closing.search, coverage=share, target_coverage=each, search_variance_m2=variance
        )
        return dataclasses.replace(self.closing, search=searching)


def registration(spacing_m: float) -> pair.Settings:
    """Return how pairs are registered, whose points are so far apart."""
    return pair.Settings(
        neighbours=20,
        plane_epsilon=1e-3,
        max_distance_m=6 * spacing_m,
        tolerance_m=min(1e-3, 1e-3 * spacing_m),
        max_iterations=50,
        dof="xy",
        method="map",
    )


def rates(settings: Settings, stated: Mapping[str, drift.Settings]) -> drift.Settings:
    """Return the rates of navigation's drift that are asked for: those of a name, or rates one by one.

    Rates one by one change those of the navigation's preset; `_deg` stands for `_rad` in a name.

    Raises:
        CorrectionError: there is no such rate, or it is out of its range.
        DriftError: there is no such name.
    """
    usual = drift.PRESETS[NAVIGATION[settings.navigation or DEAD_RECKONING]]
    if "=" not in settings.drift:
        return drift.named(settings.drift, stated, "drift") if settings.drift else usual
    values: dict[str, float] = {}
    for words in settings.drift.split(","):
        name, value = _rate(words)
        values[name] = value
    try:
        return dataclasses.replace(usual, **values)
    except ValueError as error:
        raise CorrectionError(f"drift: {error}") from error


def words(values: drift.Settings) -> str:
    """Return rates of drift in words."""
    parts = []
    if values.scale_error:
        parts.append(f"{100 * values.scale_error:.2g} % of the distance")
    if values.heading_bias_rad or values.heading_walk_rad:
        bias, walk = (math.degrees(v) for v in (values.heading_bias_rad, values.heading_walk_rad))
        parts.append(f"heading off by {bias:.2g} deg and wandering by {walk:.2g} deg")
    if values.velocity_walk_mps:
        parts.append(f"velocity by {1000 * values.velocity_walk_mps:.2g} mm/s")
    if values.position_walk_m:
        parts.append(f"positions off by {values.position_walk_m:.2g} m, for {values.position_correlation_s:g} s alike")
    return "; ".join(parts) or "none"


def _rate(text: str) -> tuple[str, float]:
    known = [f.name for f in dataclasses.fields(drift.Settings)]
    found = _PAIR.fullmatch(text)
    name = found[1] if found else ""
    in_radians = re.sub("_deg$", "_rad", name)
    try:
        if found is None or in_radians not in known:
            raise ValueError
        value = float(found[2])
        return in_radians, value if in_radians == name else math.radians(value)
    except ValueError:
        raise CorrectionError(
            f"drift: {text.strip()!r} is no rate; write name=number, with a name of {', '.join(known)}"
            " (or _deg for _rad)"
        ) from None
