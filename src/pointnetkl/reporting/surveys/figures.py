"""Figures of a survey's soundings and of its submaps, as the paper's Figs. 2 and 3."""

from collections.abc import Iterator, Mapping

import numpy as np
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D

from pointnetkl.reporting import paper, results
from pointnetkl.reporting.drawing import plots, sheet
from pointnetkl.reporting.drawing.maps import DEPTHS
from pointnetkl.reporting.results import Folders
from pointnetkl.surveys import pose, voxel

_SWATH_M = (500.0, 40.0)  # of the paper's Fig. 2
_STEP_M = 50.0  # between the stretches looked at for one that is straight
_CANONICAL = ("baltic", "borno_1")  # of the paper's Fig. 3
_CANONICAL_POINTS = 25_000  # drawn of each survey's: more only blacken the figure


def every(
    folders: Folders, name: str, clouds: Mapping[str, voxel.Clouds], rng: np.random.Generator
) -> Iterator[tuple[str, Figure]]:
    """Yield the figures by name: the swath of one survey, and the normalised clouds of two."""
    yield "swath", swath(folders, name)
    yield "canonical", canonical(clouds, rng)


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
    return draw_swath(points[inside], name)


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
    return draw_canonical({name: _some(clouds[name].points, _CANONICAL_POINTS, rng) for name in names})


def draw_swath(soundings: np.ndarray, survey: str) -> Figure:
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


def draw_canonical(clouds: Mapping[str, np.ndarray]) -> Figure:
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


def _some(points: np.ndarray, most: int, rng: np.random.Generator) -> np.ndarray:
    if len(points) <= most:
        return points
    return points[np.sort(rng.choice(len(points), most, replace=False))]
