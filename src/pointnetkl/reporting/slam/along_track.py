"""Figure of the position error along the track, before and after SLAM, as it is and aligned in SE(2)."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pointnetkl.registration.covariance import catalogue
from pointnetkl.reporting import paper
from pointnetkl.reporting.drawing import plots
from pointnetkl.reporting.slam.trajectories import Tracks
from pointnetkl.slam.graph import trajectory_error

_STYLES: dict[str, dict[str, Any]] = {  # network is widest and lowest, because the methods' lines hide each other
    catalogue.CORRUPTED: {"color": "black", "linestyle": ":", "linewidth": 1.0},
    catalogue.NAVIGATION: {"color": plots.PURPLE, "linewidth": 1.0},
    catalogue.GT: {"color": "black", "linewidth": 1.0},
    catalogue.NETWORK: {"color": plots.RED, "linewidth": 3.5, "alpha": 0.6},
    catalogue.MONTE_CARLO: {"color": plots.GREEN, "linewidth": 1.8},
    catalogue.CONSTANT: {"color": plots.GREY, "linewidth": 0.9},
    catalogue.NAIVE_GICP: {"color": plots.SKY, "linewidth": 0.9},
    catalogue.POINTNETKL: {"color": plots.ORANGE, "linewidth": 0.9},
}
_LEAST_M = 0.01  # smaller errors are drawn as this one: the first submap is held, and its error is zero


def along(surveys: Mapping[str, Tracks]) -> Figure:
    """Draw the position error in x and y by submap, and below it the same aligned in SE(2): two panels a survey.

    The errors are against the truth, or against GT where the truth is not known. Ticks at the bottom mark submaps that
    close a loop.
    """
    figure = Figure((plots.WIDTH_IN, 0.5 + 3.6 * len(surveys)), layout="constrained")
    grid = figure.subplots(2 * len(surveys), 1, squeeze=False).ravel()
    for i, (name, tracks) in enumerate(surveys.items()):
        reference = "GT" if tracks.reference == catalogue.GT else tracks.reference
        title = f"{paper.title(name)}, against {reference}"
        for axes, aligned in zip(grid[2 * i : 2 * i + 2], (False, True), strict=True):
            _panel(axes, tracks, aligned)
            axes.set_title(f"{title}{', aligned (SE(2))' if aligned else ''}", fontsize=9)
    grid[-1].set_xlabel("submap")
    lines = {str(line.get_label()): line for axes in grid for line in axes.lines}
    figure.legend(lines.values(), lines.keys(), loc="outside upper center", ncols=5, frameon=False, fontsize=8)
    return figure


def errors(tracks: Tracks, name: str, aligned: bool) -> np.ndarray:
    """Return the distance (n,) of each submap from the reference in x and y, metres."""
    positions, reference = tracks.positions[name], tracks.positions[tracks.reference]
    if aligned:
        positions = trajectory_error.align_se2(positions, reference)
    return np.asarray(np.linalg.norm((positions - reference)[:, :2], axis=1))


def _panel(axes: Axes, tracks: Tracks, aligned: bool) -> None:
    for name, style in _STYLES.items():
        if name in tracks.positions and name != tracks.reference:
            axes.plot(np.maximum(errors(tracks, name, aligned), _LEAST_M), label=paper.title(name), **style)
    closing = np.unique(tracks.closures[:, 1])
    bottom = axes.get_xaxis_transform()
    axes.plot(closing, np.full(len(closing), 0.03), "|", color=plots.GREY, transform=bottom, label="closes a loop")
    axes.set(yscale="log", ylabel="error (m)", xlim=(0, len(tracks.positions[tracks.reference]) - 1))
    axes.tick_params(labelsize=8)
    plots.plain_log(axes, "y")
    axes.grid(alpha=0.3)
