"""The figures of a report: what of the results each one shows."""

from collections.abc import Container, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from pointnetkl.reporting import results
from pointnetkl.reporting.covariances import cases, ellipse_plots, method_plots, pareto_plots, reliability_plots
from pointnetkl.reporting.drawing import maps, sheet
from pointnetkl.reporting.labels import figures as label_plots
from pointnetkl.reporting.labels import numbers as label_study
from pointnetkl.reporting.results import Folders
from pointnetkl.surveys import pose, voxel

# What is shown of ellipses beside the label's: the first of each that is there
_COMPARED = (("network", "pointnetkl"), ("structure_tensor",), ("censi_calibrated", "naive_gicp"))
_SUBMAPS_ACROSS, _WORST = 4, 10
_RELIABLE = (
    *("monte_carlo", "network", "pointnetkl", "structure_tensor", "cello"),
    *("censi_calibrated", "unscented", "constant", "naive_gicp"),
)
_SWATH_M = (500.0, 40.0)  # of the paper's Fig. 2
_STEP_M = 50.0  # between the stretches looked at for one that is straight
_CANONICAL = ("baltic", "borno_1")  # of the paper's Fig. 3
_CANONICAL_POINTS = 25_000  # drawn of each survey's: more only blacken the figure


def swath(folders: Folders, name: str) -> Figure:
    """Draw the first straight piece of a survey's swath, as long and wide as the paper's; points have none."""
    pings = results.read_pings(folders, name)
    if pings.empty:
        return sheet.nothing(f"{name} has no pings")
    first, last = straight_stretch(pings[["x_m", "y_m"]].to_numpy(), _SWATH_M[0])
    start, end = pings.iloc[first], pings.iloc[last]
    soundings = results.read_soundings(folders, name, int(start["ping"]), int(end["ping"]))
    yaw = float(np.arctan2(end["y_m"] - start["y_m"], end["x_m"] - start["x_m"]))
    T_map_stretch = pose.matrix(np.array([start["x_m"], start["y_m"], 0.0]), yaw)
    points = pose.transform(np.linalg.inv(T_map_stretch), soundings)
    inside = (np.abs(points[:, 1]) <= _SWATH_M[1] / 2) & (points[:, 0] >= 0) & (points[:, 0] <= _SWATH_M[0])
    return maps.swath(points[inside], name)


def straight_stretch(track: np.ndarray, length_m: float) -> tuple[int, int]:
    """Return the first and last ping of a track's (n, 2) first straight stretch, a shorter one if there is none."""
    along = np.concatenate([[0.0], np.hypot(*np.diff(track, axis=0).T).cumsum()])
    starts = np.searchsorted(along, np.arange(0.0, max(along[-1] - length_m, 0.0) + 1e-9, _STEP_M))
    ends = np.minimum(np.searchsorted(along, along[starts] + length_m), len(track) - 1)
    straightness = np.hypot(*(track[ends] - track[starts]).T) / np.maximum(along[ends] - along[starts], 1e-9)
    good = np.flatnonzero(straightness > 0.99)
    if not len(good) and length_m > _STEP_M:
        return straight_stretch(track, length_m / 2)
    best = int(good[0]) if len(good) else int(straightness.argmax())
    return int(starts[best]), int(ends[best])


def canonical(clouds: Mapping[str, voxel.Clouds], rng: np.random.Generator) -> Figure:
    """Draw the normalised clouds of the paper's two surveys, or else of the first two."""
    names = [name for name in _CANONICAL if name in clouds] or list(clouds)[:2]
    return maps.canonical({name: _some(clouds[name].points, _CANONICAL_POINTS, rng) for name in names})


def labels(variations: pd.DataFrame, prior_m2: float, runtime: Mapping[str, Any]) -> Iterator[tuple[str, Figure]]:
    """Yield the figures of what a label depends on (results.VARIATIONS), by name."""
    runs = runtime.get("machine", {}).get("params", {}).get("runs")
    seconds = runtime["monte_carlo"]["mean_s"] / runs if runs and "monte_carlo" in runtime else None
    yield "cost_accuracy", label_plots.cost_accuracy(label_study.accuracy(variations), seconds)
    yield "spacing", label_plots.spacing(label_study.by_spacing(variations), prior_m2)
    yield "noise", label_plots.noise(label_study.by_noise(variations))


def charts(
    kl: pd.DataFrame,
    calibration: pd.DataFrame,
    slam: pd.DataFrame,
    runtime: Mapping[str, Any],
) -> Iterator[tuple[str, Figure]]:
    """Yield the charts of the test surveys' tables (`tables.divergences` and so on), by name."""
    seconds = {name: times["mean_s"] for name, times in runtime.items() if "mean_s" in times}
    yield "kl", method_plots.divergence(kl)
    yield "calibration", method_plots.calibration(calibration)
    yield "slam", method_plots.slam_error(slam)
    yield "accuracy_time", pareto_plots.accuracy_time(kl, seconds)


def submaps(surveys: Sequence[cases.Survey]) -> Figure:
    """Draw some submaps of each test survey, the largest label first, with its ellipse and those of a few methods."""
    there = set().union(*(survey.test.covariances for survey in surveys))
    methods = _first_there(_COMPARED, there)
    return ellipse_plots.gallery(
        {survey.name: cases.large_to_small(survey, methods, _SUBMAPS_ACROSS) for survey in surveys}
    )


def worst(surveys: Sequence[cases.Survey]) -> Iterator[tuple[str, Figure]]:
    """Yield each method's page of the submaps that it is most wrong about, by the method's name."""
    methods = dict.fromkeys(method for survey in surveys for method in survey.test.covariances)
    for method in methods:
        if method != results.GOLD:  # the labels themselves
            yield method, ellipse_plots.worst(method, cases.worst(surveys, method, _WORST))


def reliability(surveys: Sequence[cases.Survey]) -> Figure:
    """Draw the coverage of the main methods' ellipses on errors that no label has seen, at every level."""
    tables = [
        reliability_plots.coverage(
            each.name, each.test.held_out, {results.GOLD: each.labels.q, **each.test.covariances}, _RELIABLE
        )
        for each in surveys
        if each.test.held_out.size
    ]
    return reliability_plots.reliability(pd.concat([reliability_plots.EMPTY, *tables]))


def _first_there(choices: Sequence[Sequence[str]], there: Container[str]) -> list[str]:
    return [next(name for name in names if name in there) for names in choices if any(name in there for name in names)]


def _some(points: np.ndarray, most: int, rng: np.random.Generator) -> np.ndarray:
    if len(points) <= most:
        return points
    return points[np.sort(rng.choice(len(points), most, replace=False))]
