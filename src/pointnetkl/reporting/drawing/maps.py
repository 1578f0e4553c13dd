"""Figures of the seabed, and rasters of it to draw: a figure is a function of arrays, in metres."""

from collections.abc import Mapping

import numpy as np
from matplotlib.colors import LightSource
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D

from pointnetkl.reporting import paper
from pointnetkl.reporting.drawing import plots

DEPTHS = "viridis_r"  # perceptually even; deep is dark
_CELLS = 260  # of a depth map along its longer side, at most
_SPACINGS = 2.5  # between nearest neighbours, to a cell: fewer leave holes


def swath(soundings: np.ndarray, survey: str) -> Figure:
    """Draw a piece of a swath, as the paper's Fig. 2, from soundings (n, 3): along track, across, z; metres."""
    x, y, z = soundings.T
    height = (plots.WIDTH_IN - 0.8) * float(np.ptp(y) / np.ptp(x))
    figure = Figure((plots.WIDTH_IN, height + 1.5), layout="constrained")
    axes = figure.subplots()
    side_m = 1.5 * float(np.sqrt(np.ptp(x) * np.ptp(y) / len(x)))  # of a sounding's share of the area
    side_points = side_m * 72 * (plots.WIDTH_IN - 0.8) / float(np.ptp(x))
    drawn = axes.scatter(x, y, c=-z, s=side_points**2, marker="s", cmap=DEPTHS, lw=0)
    axes.set(xlabel="along the track (m)", ylabel="across (m)", title=paper.title(survey), aspect="equal")
    axes.margins(0)
    figure.colorbar(drawn, ax=axes, label="depth (m)", orientation="horizontal", aspect=50, shrink=0.7)
    return figure


def canonical(clouds: Mapping[str, np.ndarray]) -> Figure:
    """Draw all the normalised points (n, 3) of each survey in one unit sphere, as the paper's Fig. 3."""
    figure = Figure((plots.WIDTH_IN, 4.0))
    for i, (survey, points) in enumerate(clouds.items()):
        axes = Axes3D(figure, rect=(i / len(clouds), 0.02, 1 / len(clouds), 0.92))
        figure.add_axes(axes)
        axes.scatter(*points.T, c=points[:, 2], cmap="viridis", vmin=-0.6, vmax=0.6, s=1.2, lw=0, alpha=0.7)
        axes.set(xlim=(-1, 1), ylim=(-1, 1), zlim=(-1, 1), title=paper.title(survey))
        axes.set(xlabel="x / ρ along the track", ylabel="y / ρ to port", zlabel="z / ρ up")
        for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
            axis.set_ticks([-1, 0, 1])
        axes.set_box_aspect((1, 1, 1), zoom=0.9)
        axes.view_init(elev=18, azim=-60)
    return figure


def raster(
    points: np.ndarray, spacing: float, corners: np.ndarray
) -> tuple[np.ndarray, tuple[float, float, float, float]]:
    """Return the mean depth of points (n, 3) in square cells, NaN where there are none, and its extent, metres.

    The map is as large as `corners`, [[x, y], [x, y]], and the points must lie between them. A cell is some point
    `spacing`s wide, so that a full swath has no holes, or wider on a large map.
    """
    low, high = corners
    size = max(float((high - low).max()) / _CELLS, _SPACINGS * spacing)
    columns, rows = (int(n) for n in np.floor((high - low) / size) + 1)
    column, row = np.floor((points[:, :2] - low) / size).astype(int).T
    flat = row * columns + column
    count = np.bincount(flat, minlength=rows * columns)
    total = np.bincount(flat, -points[:, 2], minlength=rows * columns)
    depth = np.divide(total, count, out=np.full(rows * columns, np.nan), where=count > 0).reshape(rows, columns)
    return depth, (float(low[0]), float(low[0] + columns * size), float(low[1]), float(low[1] + rows * size))


def shade(depth: np.ndarray, extent: tuple[float, float, float, float]) -> np.ndarray:
    """Return how bright a raster's cells are, 0 to 1, in light from the north-west."""
    # where a cliff takes all the colours, flat ground still shows its forms
    cell = (extent[1] - extent[0]) / depth.shape[1]
    # turned over, because LightSource takes the first row for the northernmost
    return np.asarray(LightSource(315, 40).hillshade(-depth[::-1], vert_exag=4, dx=cell, dy=cell))[::-1]
