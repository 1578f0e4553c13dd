"""A survey before and after its loops are closed: its track and closures, and its error along the track."""

from collections.abc import Iterator, Mapping

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from pointnetkl.registration.covariance.catalogue import NAVIGATION, TRUTH
from pointnetkl.reporting import paper
from pointnetkl.reporting.closing.numbers import Closings
from pointnetkl.reporting.drawing import plots, sheet
from pointnetkl.reporting.results import Test
from pointnetkl.slam.closing.schemas import State

_REFUSED = (State.RESIDUALS, State.PREDICTION, State.OUTVOTED, State.UNMATCHED)
_COLOURS = {"accepted": plots.GREEN, "flat": "#bbbbbb", "refused": plots.RED}


def every(closings: Closings, tests: Mapping[str, Test]) -> Iterator[tuple[str, Figure]]:
    """Yield the figure of stage close, by name."""
    yield "closing", tracks(closings, tests)


def tracks(closings: Closings, tests: Mapping[str, Test]) -> Figure:
    """Draw a row a survey: its track with the closures, and its error along the track before and after."""
    surveys = list(closings.poses["survey"].unique())
    if not surveys:
        return sheet.no_track()
    figure = Figure((plots.WIDTH_IN, 0.5 + 3.2 * len(surveys)), layout="constrained")
    grid = figure.subplots(len(surveys), 2, squeeze=False, width_ratios=[1, 1.3])
    for (plan, along), survey in zip(grid, surveys, strict=True):
        poses = closings.poses[closings.poses["survey"] == survey].sort_values("submap")
        closures = closings.closures[closings.closures["survey"] == survey]
        trajectories = tests[survey].trajectories
        before, truth = (_positions(trajectories, name) for name in (NAVIGATION, TRUTH))
        _plan(plan, poses, closures, before)
        plan.set_title(paper.title(survey), fontsize=10)
        _along(along, poses, before, truth)
    for axes in grid[:1].ravel():
        axes.legend(fontsize=7, frameon=False)
    return figure


def _positions(trajectories: pd.DataFrame, name: str) -> np.ndarray:
    rows = trajectories[trajectories["which"] == name].sort_values("submap")
    return rows[["x_m", "y_m"]].to_numpy()


def _plan(axes: Axes, poses: pd.DataFrame, closures: pd.DataFrame, before: np.ndarray) -> None:
    after = poses[["x_m", "y_m"]].to_numpy()
    place = dict(zip(poses["submap"], after, strict=True))
    axes.plot(*before.T, color=plots.GREY, linewidth=0.7, label="navigation")
    axes.plot(*after.T, color=plots.BLUE, linewidth=0.9, label="closed")
    kind = closures["state"].where(~closures["state"].isin([str(state) for state in _REFUSED]), "refused")
    for name, colour in _COLOURS.items():
        pairs = closures[kind == name]
        ends = [[place[s], place[t]] for s, t in zip(pairs["source"], pairs["target"], strict=True)]
        axes.add_collection(LineCollection(ends, colors=colour, linewidths=1.4, label=f"closure, {name}"))
    axes.set_aspect("equal", "datalim")
    axes.set_xlabel("x (m)", fontsize=8)
    axes.set_ylabel("y (m)", fontsize=8)
    axes.tick_params(labelsize=7)


def _along(axes: Axes, poses: pd.DataFrame, before: np.ndarray, truth: np.ndarray) -> None:
    after = poses[["x_m", "y_m"]].to_numpy()
    number = poses["submap"].to_numpy()
    sigma = np.hypot(poses["sigma_x_m"], poses["sigma_y_m"])
    reference, what = (truth, "error") if len(truth) else (before, "moved")
    axes.fill_between(number, 0, 2 * sigma, color=plots.SKY, alpha=0.3, linewidth=0, label="2 sigma, closed")
    if len(truth):
        axes.plot(number, np.hypot(*(before - reference).T), color=plots.GREY, label="navigation")
    axes.plot(number, np.hypot(*(after - reference).T), color=plots.BLUE, label="closed")
    axes.set_xlabel("submap", fontsize=8)
    axes.set_ylabel(f"{what} in the plane (m)", fontsize=8)
    axes.set_ylim(bottom=0)
    axes.tick_params(labelsize=7)
    axes.grid(alpha=0.3)
