"""The seabed before and after SLAM: depth maps of the submaps at several trajectories, and how far each is off."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from pointnetkl.reporting import paper
from pointnetkl.reporting.drawing import maps, plots, sheet

_GAP_IN, _LINE_IN, _BAR_IN = 0.12, 0.2, 0.95  # between panels, of text, and for the bar of colours at the right
_TITLES = {"corrupted": "corrupted", "navigation": "navigation", "truth": "truth", "gt": "GT"}
_DIFFERENCE = "RdBu_r"
_TYPICAL = 95.0  # percentile of the absolute differences that fills the scale


@dataclass(frozen=True)
class Seabed:
    """One survey's points (n, 3) in the map frame by trajectory, the best one last, and their spacing; metres."""

    points: Mapping[str, np.ndarray]
    spacing_m: float

    @property
    def best(self) -> str:
        """Return the trajectory that the others are compared with."""
        return list(self.points)[-1]


def bathymetry(surveys: Mapping[str, Seabed]) -> Figure:
    """Draw each survey's depths by trajectory on one scale, and below it the differences from the last one's map."""
    across = max(len(each.points) for each in surveys.values())
    width = (plots.WIDTH_IN - 0.2 - _BAR_IN) / across - _GAP_IN
    corners = {name: _corners(each) for name, each in surveys.items()}
    heights = {name: 2 * (sheet.height(c, width) + _LINE_IN) + 0.5 for name, c in corners.items()}
    figure, top = sheet.sheet(0.05 + sum(heights.values())), 0.05
    for name, each in surveys.items():
        sheet.write(figure, 0.1, top, paper.title(name), 10)
        _survey(figure, each, corners[name], top + 0.2, width)
        top += heights[name]
    return figure


def _survey(figure: Figure, seabed: Seabed, corners: np.ndarray, top: float, width: float) -> None:
    depths = {which: maps.raster(points, seabed.spacing_m, corners) for which, points in seabed.points.items()}
    high, step = sheet.height(corners, width), width + _GAP_IN
    below = top + _LINE_IN + high + 0.05
    best, (truth, extent) = seabed.best, depths[seabed.best]
    off = {which: depth - truth for which, (depth, _) in depths.items() if which != best}
    colours = Normalize(np.nanmin(truth), np.nanmax(truth)), _symmetric(list(off.values()))
    for i, (which, (depth, _)) in enumerate(depths.items()):
        axes = _panel(figure, (i, top), width, corners, _TITLES.get(which, f"solved with {which}"))
        axes.imshow(depth, origin="lower", extent=extent, cmap=maps.DEPTHS, norm=colours[0], aspect="auto")
        shade = maps.shade(depth, extent)
        axes.imshow(shade, origin="lower", extent=extent, cmap="gray", alpha=0.35, clim=(0, 1), aspect="auto")
    for i, (which, difference) in enumerate(off.items()):
        both = difference[np.isfinite(difference)]
        rms = f": rms {np.sqrt(np.mean(both**2)):.2g} m" if both.size else " where they meet: nowhere"
        said = f"{_TITLES.get(which, which)} less {_TITLES.get(best, best)}{rms}"
        axes = _panel(figure, (i, below), width, corners, said)
        axes.set_facecolor("#eeeeee")
        axes.imshow(difference, origin="lower", extent=extent, cmap=_DIFFERENCE, norm=colours[1], aspect="auto")
    _bar(figure, (len(depths) * step, top, high), ScalarMappable(colours[0], maps.DEPTHS), "depth (m)")
    _bar(figure, (len(off) * step, below, high), ScalarMappable(colours[1], _DIFFERENCE), "deeper by (m)")


def _panel(figure: Figure, place: tuple[int, float], width: float, corners: np.ndarray, title: str) -> Axes:
    (column, top), left = place, 0.1 + place[0] * (width + _GAP_IN)
    sheet.write(figure, left, top, title)
    axes = sheet.panel(figure, left, top + _LINE_IN, width, corners)
    if column == 0:
        sheet.scale_bar(axes)
    return axes


def _bar(figure: Figure, place: tuple[float, float, float], of: ScalarMappable, label: str) -> None:
    left, top, high = place
    corners = np.array([[0.0, 0.0], [1.0, min(high, 1.0) / 0.12]])
    bar = sheet.panel(figure, left + 0.15, top + _LINE_IN, 0.12, corners)
    figure.colorbar(of, cax=bar).set_label(label, fontsize=sheet.TEXT_PT)
    bar.tick_params(labelsize=sheet.TEXT_PT - 1)
    bar.ticklabel_format(axis="y", useOffset=False)  # flat ground far down: "1530.2", not "+1.53e3" above the bar


def _symmetric(differences: Sequence[np.ndarray]) -> Normalize:
    every = np.concatenate([each[np.isfinite(each)] for each in differences] or [np.zeros(1)])
    most = max(float(np.percentile(np.abs(every), _TYPICAL)), 1e-3) if len(every) else 1e-3
    return Normalize(-most, most)


def _corners(seabed: Seabed) -> np.ndarray:
    ends = [[points.min(axis=0), points.max(axis=0)] for points in seabed.points.values()]
    return sheet.limits(np.concatenate(ends)[:, :2])
