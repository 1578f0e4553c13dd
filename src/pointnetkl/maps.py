"""Figures of the seabed and of trajectories over it: a figure is a function of arrays, in metres."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LightSource
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D

from pointnetkl import paper, plots

DEPTHS = "viridis_r"  # perceptually even; deep is dark
_CELLS = 260  # of a depth map along its longer side, at most
_SPACINGS = 2.5  # between nearest neighbours, to a cell: fewer leave holes


@dataclass(frozen=True)
class Graph:
    """A pose graph to draw: (n, 2) positions in metres by trajectory, (m, 2) node pairs by kind of edge."""

    positions: Mapping[str, np.ndarray]
    dead_reckoning: np.ndarray
    loop_closures: np.ndarray


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


def bathymetry(surveys: Mapping[str, tuple[np.ndarray, float]]) -> Figure:
    """Draw a depth map of each survey from points (n, 3) in the map frame and their spacing, metres."""
    rasters = {survey: raster(*points) for survey, points in surveys.items()}
    sizes = [(extent[1] - extent[0], extent[3] - extent[2]) for _, extent in rasters.values()]
    figure, grid = _grid(sizes, 1.5)
    for axes, (survey, (depth, extent)) in zip(grid, rasters.items(), strict=True):
        drawn = axes.imshow(depth, origin="lower", extent=extent, cmap=DEPTHS, interpolation="nearest")
        axes.imshow(_shade(depth, extent), origin="lower", extent=extent, cmap="gray", alpha=0.35, vmin=0, vmax=1)
        _map_axes(axes, paper.title(survey))
        figure.colorbar(drawn, ax=axes, label="depth (m)", orientation="horizontal", shrink=0.8)
    return figure


def trajectories(surveys: Mapping[str, Graph]) -> Figure:
    """Draw each survey's trajectories with their edges, all of one survey on one scale."""
    panels = [(name, graph, which) for name, graph in surveys.items() for which in graph.positions]
    limits = {name: _limits(graph) for name, graph in surveys.items()}
    figure, grid = _grid([tuple(np.ptp(limits[name], axis=0)) for name, *_ in panels], 0.8)
    for axes, (name, graph, which) in zip(grid, panels, strict=True):
        positions = graph.positions[which]
        _edges(axes, positions, graph.loop_closures, plots.ORANGE, 0.5, "loop closure")
        _edges(axes, positions, graph.dead_reckoning, plots.BLUE, 1.1, "dead reckoning")
        _map_axes(axes, f"{paper.title(name)}: {paper.title(which)}")
        axes.set(xlim=limits[name][:, 0], ylim=limits[name][:, 1])
    figure.legend(*grid[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    return figure


def raster(points: np.ndarray, spacing: float) -> tuple[np.ndarray, tuple[float, float, float, float]]:
    """Return the mean depth of points (n, 3) in square cells, NaN where there are none, and its extent, metres.

    A cell is some point `spacing`s wide, so that a full swath has no holes, or wider on a large map.
    """
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    size = max(float((high - low).max()) / _CELLS, _SPACINGS * spacing)
    columns, rows = (int(n) for n in np.floor((high - low) / size) + 1)
    column, row = np.floor((points[:, :2] - low) / size).astype(int).T
    flat = row * columns + column
    count = np.bincount(flat, minlength=rows * columns)
    total = np.bincount(flat, -points[:, 2], minlength=rows * columns)
    depth = np.divide(total, count, out=np.full(rows * columns, np.nan), where=count > 0).reshape(rows, columns)
    return depth, (float(low[0]), float(low[0] + columns * size), float(low[1]), float(low[1] + rows * size))


def _shade(depth: np.ndarray, extent: tuple[float, float, float, float]) -> np.ndarray:
    # light from the north-west: where a cliff takes all the colours, flat ground still shows its forms
    cell = (extent[1] - extent[0]) / depth.shape[1]
    # turned over, because LightSource takes the first row for the northernmost
    return np.asarray(LightSource(315, 40).hillshade(-depth[::-1], vert_exag=4, dx=cell, dy=cell))[::-1]


def _grid(sizes: Sequence[tuple[float, float]], extra_in: float) -> tuple[Figure, np.ndarray]:
    """Return a figure and a panel for each map of these sizes (width, height), two in a row, as high as need be."""
    heights = [float(np.clip(3.5 * high / max(wide, 1e-9), 1.0, 4.2)) + extra_in for wide, high in sizes]
    rows = [max(heights[i : i + 2]) for i in range(0, len(heights), 2)]
    figure = Figure((plots.WIDTH_IN, sum(rows)), layout="constrained")
    grid = figure.subplots(len(rows), min(2, len(sizes)), squeeze=False, height_ratios=rows).ravel()
    for axes in grid[len(sizes) :]:
        axes.remove()
    return figure, grid[: len(sizes)]


def _limits(graph: Graph) -> np.ndarray:
    # one scale a survey, or the eye would take a turned map for a small error
    every = np.concatenate(list(graph.positions.values()))
    margin = 0.03 * np.ptp(every, axis=0).max() + 1.0
    return np.stack([every.min(axis=0) - margin, every.max(axis=0) + margin])


def _map_axes(axes: Axes, title: str) -> None:
    axes.set_title(title, fontsize="medium")
    axes.set(xlabel="east (m)", ylabel="north (m)", aspect="equal")
    axes.tick_params(labelsize="small")
    axes.locator_params(nbins=4)


def _edges(axes: Axes, positions: np.ndarray, pairs: np.ndarray, colour: str, width: float, label: str) -> None:
    axes.add_collection(LineCollection(positions[pairs], colors=colour, linewidths=width, label=label))
