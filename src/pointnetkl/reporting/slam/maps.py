"""Figure of the seabed before and after SLAM: depth maps at several trajectories, and their differences."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from pointnetkl.registration.covariance import catalogue
from pointnetkl.reporting import paper
from pointnetkl.reporting.drawing import maps, plots, sheet

_GAP_IN, _LINE_IN, _BAR_IN = 0.12, 0.2, 0.95  # between panels, of text, and for the bar of colours at the right
_TITLES = {name: "GT" if name == catalogue.GT else name for name in catalogue.REFERENCES}
_DIFFERENCE = "RdBu_r"
_TYPICAL = 95.0  # percentile of the absolute differences, where the scale ends


@dataclass(frozen=True)
class Seabed:
    """One survey's points (n, 3) in the map frame by trajectory, the best one last, and their spacing; metres."""

    points: Mapping[str, np.ndarray]
    spacing_m: float

    @property
    def best(self) -> str:
        """Return the trajectory to compare the others with."""
        return list(self.points)[-1]


def bathymetry(surveys: Mapping[str, Seabed]) -> Figure:
    """Draw each survey's depths by trajectory on one scale, and below it the differences from the last one's map."""
    across = max(len(seabed.points) for seabed in surveys.values())
    width = (plots.WIDTH_IN - 0.2 - _BAR_IN) / across - _GAP_IN
    corners = {name: _corners(seabed) for name, seabed in surveys.items()}
    heights = {name: 2 * (sheet.height(c, width) + _LINE_IN) + 0.5 for name, c in corners.items()}
    figure, top = sheet.sheet(0.05 + sum(heights.values())), 0.05
    for name, seabed in surveys.items():
        sheet.write(figure, 0.1, top, paper.title(name), 10)
        _survey(figure, seabed, corners[name], top + 0.2, width)
        top += heights[name]
    return figure


def _survey(figure: Figure, seabed: Seabed, corners: np.ndarray, top: float, width: float) -> None:
    depths = {name: maps.raster(points, seabed.spacing_m, corners) for name, points in seabed.points.items()}
    high, step = sheet.height(corners, width), width + _GAP_IN
    below = top + _LINE_IN + high + 0.05
    best, (best_depth, extent) = seabed.best, depths[seabed.best]
    differences = {name: depth - best_depth for name, (depth, _) in depths.items() if name != best}
    colours = Normalize(np.nanmin(best_depth), np.nanmax(best_depth)), _symmetric(list(differences.values()))
    for i, (name, (depth, _)) in enumerate(depths.items()):
        axes = _panel(figure, (i, top), width, corners, _TITLES.get(name, f"solved with {name}"))
        axes.imshow(depth, origin="lower", extent=extent, cmap=maps.DEPTHS, norm=colours[0], aspect="auto")
        shade = maps.shade(depth, extent)
        axes.imshow(shade, origin="lower", extent=extent, cmap="gray", alpha=0.35, clim=(0, 1), aspect="auto")
    for i, (name, difference) in enumerate(differences.items()):
        common = difference[np.isfinite(difference)]
        rms = f": rms {np.sqrt(np.mean(common**2)):.2g} m" if common.size else " where they meet: nowhere"
        title = f"{_TITLES.get(name, name)} less {_TITLES.get(best, best)}{rms}"
        axes = _panel(figure, (i, below), width, corners, title)
        axes.set_facecolor("#eeeeee")
        axes.imshow(difference, origin="lower", extent=extent, cmap=_DIFFERENCE, norm=colours[1], aspect="auto")
    _bar(figure, (len(depths) * step, top, high), ScalarMappable(colours[0], maps.DEPTHS), "depth (m)")
    _bar(figure, (len(differences) * step, below, high), ScalarMappable(colours[1], _DIFFERENCE), "deeper by (m)")


def _panel(figure: Figure, place: tuple[int, float], width: float, corners: np.ndarray, title: str) -> Axes:
    (column, top), left = place, 0.1 + place[0] * (width + _GAP_IN)
    sheet.write(figure, left, top, title)
    axes = sheet.panel(figure, left, top + _LINE_IN, width, corners)
    if column == 0:
        sheet.scale_bar(axes)
    return axes


def _bar(figure: Figure, place: tuple[float, float, float], colours: ScalarMappable, label: str) -> None:
    left, top, high = place
    corners = np.array([[0.0, 0.0], [1.0, min(high, 1.0) / 0.12]])
    bar = sheet.panel(figure, left + 0.15, top + _LINE_IN, 0.12, corners)
    figure.colorbar(colours, cax=bar).set_label(label, fontsize=sheet.TEXT_PT)
    bar.tick_params(labelsize=sheet.TEXT_PT - 1)
    bar.ticklabel_format(axis="y", useOffset=False)  # flat ground far down: "1530.2", not "+1.53e3" above the bar


def _symmetric(differences: Sequence[np.ndarray]) -> Normalize:
    values = np.concatenate([image[np.isfinite(image)] for image in differences] or [np.zeros(1)])
    largest = max(float(np.percentile(np.abs(values), _TYPICAL)), 1e-3) if len(values) else 1e-3
    return Normalize(-largest, largest)


def _corners(seabed: Seabed) -> np.ndarray:
    ends = [[points.min(axis=0), points.max(axis=0)] for points in seabed.points.values()]
    return sheet.limits(np.concatenate(ends)[:, :2])
