"""The error of every submap along the track, before and after SLAM, as it is and with the common motion taken out."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pointnetkl.reporting import paper
from pointnetkl.reporting.drawing import plots
from pointnetkl.reporting.slam.trajectories import Tracks
from pointnetkl.slam.graph import trajectory_error

_STYLES: dict[str, dict[str, Any]] = {  # what is drawn; network widest and below, because methods hide each other
    "corrupted": {"color": "black", "linestyle": ":", "linewidth": 1.0},
    "navigation": {"color": plots.PURPLE, "linewidth": 1.0},
    "gt": {"color": "black", "linewidth": 1.0},
    "network": {"color": plots.RED, "linewidth": 3.5, "alpha": 0.6},
    "monte_carlo": {"color": plots.GREEN, "linewidth": 1.8},
    "constant": {"color": plots.GREY, "linewidth": 0.9},
    "naive_gicp": {"color": plots.SKY, "linewidth": 0.9},
    "pointnetkl": {"color": plots.ORANGE, "linewidth": 0.9},
}
_LEAST_M = 0.01  # drawn: the first submap is held, and its error is none


def along(surveys: Mapping[str, Tracks]) -> Figure:
    """Draw |position error| in x, y by submap, and below it the same aligned by SE(2), in two panels a survey.

    The errors are against the truth, or GT where that is not known. Ticks at the bottom: submaps that close a loop.
    """
    figure = Figure((plots.WIDTH_IN, 0.5 + 3.6 * len(surveys)), layout="constrained")
    grid = figure.subplots(2 * len(surveys), 1, squeeze=False).ravel()
    for i, (name, tracks) in enumerate(surveys.items()):
        whose = f"{paper.title(name)}, against {'GT' if tracks.reference == 'gt' else tracks.reference}"
        for axes, aligned in zip(grid[2 * i : 2 * i + 2], (False, True), strict=True):
            _panel(axes, tracks, aligned)
            axes.set_title(f"{whose}{', aligned (SE(2))' if aligned else ''}", fontsize=9)
    grid[-1].set_xlabel("submap")
    named = {str(line.get_label()): line for axes in grid for line in axes.lines}
    figure.legend(named.values(), named.keys(), loc="outside upper center", ncols=5, frameon=False, fontsize=8)
    return figure


def errors(tracks: Tracks, which: str, aligned: bool) -> np.ndarray:
    """Return how far each submap is from the reference in x and y, (n,) metres."""
    position, reference = tracks.positions[which], tracks.positions[tracks.reference]
    placed = trajectory_error.align_se2(position, reference) if aligned else position
    return np.asarray(np.linalg.norm((placed - reference)[:, :2], axis=1))


def _panel(axes: Axes, tracks: Tracks, aligned: bool) -> None:
    for which in _STYLES:
        if which in tracks.positions and which != tracks.reference:
            error = np.maximum(errors(tracks, which, aligned), _LEAST_M)
            axes.plot(error, label=paper.title(which), **_STYLES[which])
    closing = np.unique(tracks.closures[:, 1])
    bottom = axes.get_xaxis_transform()
    axes.plot(closing, np.full(len(closing), 0.03), "|", color=plots.GREY, transform=bottom, label="closes a loop")
    axes.set(yscale="log", ylabel="error (m)", xlim=(0, len(tracks.positions[tracks.reference]) - 1))
    axes.tick_params(labelsize=8)
    plots.plain_log(axes, "y")
    axes.grid(alpha=0.3)
