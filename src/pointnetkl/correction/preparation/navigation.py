"""What a survey's positions are, where its user does not say: do they drift, or are they absolute?"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from pointnetkl.correction import settings as settings_module
from pointnetkl.correction.preparation import inputs
from pointnetkl.correction.preparation.inputs import Inputs
from pointnetkl.correction.settings import DEAD_RECKONING, Settings
from pointnetkl.readers import navigation as sbet_files
from pointnetkl.readers import projection, smrmsg
from pointnetkl.slam.closing import drift
from pointnetkl.surveys import survey

_SHIP_M = 8.0  # depth of a sonar below the surface, down to which a satellite receiver is near
_LEAST_M, _LEAST_RAD = 0.02, 1e-4  # of what a file may state


@dataclasses.dataclass(frozen=True)
class Kind:
    """What positions are, and how they drift or wander."""

    name: str  # of settings.NAVIGATION
    rates: drift.Settings
    reason: str  # in words


def kind(source: Inputs, settings: Settings, pings: pd.DataFrame, metadata: Mapping[str, Any]) -> Kind:
    """Return what a survey's navigation is: as it is said, else as the files beside it and its depth suggest.

    Raises:
        SmrmsgError: a file of accuracy is damaged.
        CorrectionError, DriftError: the rates that are asked for are none.
    """
    beside = [file for path in source.sources for file in inputs.files_of(path)]
    name, reason = _named(settings, pings, metadata, beside)
    rates = settings_module.rates(dataclasses.replace(settings, navigation=name), source.rates)
    stated = [file for file in beside if smrmsg.is_accuracy(file)]
    if stated and name == "gnss" and not settings.drift:
        accuracy = smrmsg.read(stated[0])
        known = max(accuracy.position_m, _LEAST_M)
        heading = accuracy.heading_rad if accuracy.heading_rad > _LEAST_RAD else rates.yaw_noise_rad
        rates = dataclasses.replace(rates, position_walk_m=known, yaw_noise_rad=heading)
        reason += f"; {stated[0].name} states {known:.2g} m"
    return Kind(name, rates, reason)


def _named(settings: Settings, pings: pd.DataFrame, metadata: Mapping[str, Any], files: list[Path]) -> tuple[str, str]:
    if settings.navigation:
        return settings.navigation, "as it was said"
    if any(sbet_files.is_navigation(file) for file in files):
        return "gnss", "an SBET trajectory is aided by satellites"
    on_earth = metadata.get("crs") != projection.LOCAL and metadata.get("kind") == survey.SWATHS
    if on_earth and abs(depth := -float(pings["z_m"].median())) < _SHIP_M:
        return "gnss", f"the sonar is {depth:.1f} m below the surface, as a ship's is, which has a satellite receiver"
    return DEAD_RECKONING, "no file says otherwise"
