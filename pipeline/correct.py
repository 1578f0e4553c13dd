"""Correct a survey by its own overlaps: track, maps, soundings and a report of it, and the numbers that judge it.

Where its line in study.surveys does not say how its navigation drifts, its closures do.
"""

import pointnetkl.workflow.blas  # noqa: F401 - before NumPy is loaded

# isort: split
import argparse
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from pointnetkl import correction
from pointnetkl.correction import Corrected, Inputs, Settings
from pointnetkl.slam.closing import drift
from pointnetkl.surveys import survey
from pointnetkl.workflow import artifacts, command, parameters, study
from pointnetkl.workflow.study import StudySurvey

_DIGITS = 4


def main(arguments: argparse.Namespace) -> None:
    """Read the ingested survey and its submaps; write the folder of the corrected survey, and its numbers."""
    line = study.survey(arguments.params, arguments.name)
    rates = parameters.read(arguments.params, "navigation", dict[str, drift.Settings])
    settings = of_survey(parameters.read(arguments.params, "correct", Settings), line)
    source = Inputs([arguments.survey], submaps=(arguments.submaps, arguments.poses), rates=rates)
    corrected = correction.correct(source, arguments.out, settings, replace=True)
    truth = artifacts.read_table(arguments.survey / "truth.parquet", survey.TRAJECTORY)
    artifacts.write_json(arguments.numbers, {arguments.name: numbers(corrected, truth)})
    print(f"{arguments.name}: {corrected.verdict.sentence}")


def of_survey(settings: Settings, line: StudySurvey) -> Settings:
    """Return the settings for a survey of the study, whose line says what its navigation is."""
    absolute = line.navigation in ("gnss", "usbl")
    stated = line.navigation != study.UNSTATED
    return dataclasses.replace(
        settings,
        navigation=line.navigation if absolute else settings.navigation,
        drift=line.navigation if stated else settings.drift,
    )


def numbers(corrected: Corrected, truth: Any) -> dict[str, float | None]:
    """Return what judges the correction, rounded; errors of the pings are null where the truth is not known."""
    verdict, track = corrected.verdict, corrected.track
    values = {
        "applied": float(verdict.applied),
        "closures": float(verdict.closures),
        "accepted": float(verdict.accepted),
        "moved_m": corrected.rms_moved_m,
        "left_out_before_m": verdict.left_out_before_m,
        "left_out_after_m": verdict.left_out_after_m,
        "overlaps_before_m": verdict.disagreement_before_m,
        "overlaps_after_m": verdict.disagreement_after_m,
        "sigma_before_m": _sigma(track, "before_"),
        "sigma_after_m": _sigma(track, ""),
        "error_before_m": _error(track, truth, 0.0),
        "error_after_m": _error(track, truth, 1.0),
    }
    return {name: float(f"{v:.{_DIGITS}g}") if np.isfinite(v) else None for name, v in values.items()}


def _sigma(track: Any, prefix: str) -> float:
    variances = track[f"{prefix}var_xx_m2"] + track[f"{prefix}var_yy_m2"]
    return float(np.sqrt(variances.mean())) if len(track) else float("nan")


def _error(track: Any, truth: Any, share: float) -> float:
    """Return the rms error of pings in the plane, with a share of the correction."""
    if truth.empty or track.empty:
        return float("nan")
    apart = [
        track[f"{axis}_m"]
        + share * track[f"moved_{axis}_m"]
        - np.interp(track["time_s"], truth["time_s"], truth[f"{axis}_m"])
        for axis in ("x", "y")
    ]
    return float(np.sqrt(np.mean(np.square(apart[0]) + np.square(apart[1]))))


if __name__ == "__main__":
    parser = command.parser(__doc__)
    parser.add_argument("name", metavar="SURVEY", help="the survey's name in study.surveys")
    parser.add_argument("--survey", type=Path, required=True, help="folder of its pings, soundings and truth")
    parser.add_argument("--submaps", type=Path, required=True, help="points of its submaps")
    parser.add_argument("--poses", type=Path, required=True, help="their poses by navigation")
    parser.add_argument("--out", type=Path, required=True, help="folder of the corrected survey to make")
    parser.add_argument("--numbers", type=Path, required=True, help="JSON of the numbers that judge it, to write")
    command.run(main, parser)
