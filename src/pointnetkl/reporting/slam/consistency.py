"""Where a map disagrees with itself: the map-to-map error of each cell, a panel for each trajectory."""

from collections.abc import Iterable, Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from pointnetkl.reporting import paper
from pointnetkl.reporting.drawing import plots, sheet
from pointnetkl.reporting.results import Folders
from pointnetkl.slam.consistency import consistency_map
from pointnetkl.slam.consistency.consistency_map import Rasters

PERCENTILE = 95.0  # of all of a survey's cells, that ends its scale: a few at the map's edge are far worse
_CONSISTENT = ("truth", "gt", "corrupted", "constant", "naive_gicp", "network")  # trajectories, as far as there
_COLOURS = "magma_r"
_GAP_IN, _LINE_IN, _BAR_IN = 0.1, 0.2, 0.85  # between panels, of text, and for the bar of colours at the right
_PLAIN = "#e4ebf0"  # of ground that no two submaps share


def read_and_draw(folders: Folders, names: Iterable[str]) -> Figure:
    """Draw where each test survey's map disagrees with itself, at a few trajectories."""
    paths = {name: folders.reports / f"slam/{name}_consistency.tif" for name in names}
    if not paths:
        return sheet.no_track()
    return consistency({n: consistency_map.read(path, _CONSISTENT) for n, path in paths.items()})


def consistency(surveys: Mapping[str, Rasters]) -> Figure:
    """Draw each survey's rasters in a row, on one scale, with the root mean square over each one's cells."""
    across = max(len(each.errors) for each in surveys.values())
    width = (plots.WIDTH_IN - 0.2 - _BAR_IN) / across - _GAP_IN
    heights = {name: sheet.height(_corners(each), width) + 2 * _LINE_IN + 0.2 for name, each in surveys.items()}
    figure, top = sheet.sheet(0.05 + sum(heights.values())), 0.05
    for name, each in surveys.items():
        sheet.write(figure, 0.1, top, paper.title(name), 10)
        _survey(figure, each, top + _LINE_IN + 0.05, width)
        top += heights[name]
    return figure


def _survey(figure: Figure, of: Rasters, top: float, width: float) -> None:
    corners, norm = _corners(of), Normalize(0.0, _end(of))
    for i, (which, image) in enumerate(of.errors.items()):
        left = 0.1 + i * (width + _GAP_IN)
        sheet.write(figure, left, top, f"{paper.title(which)}: {_said(image)}")
        axes = sheet.panel(figure, left, top + _LINE_IN, width, corners)
        axes.set_facecolor(_PLAIN)
        axes.imshow(image, extent=of.extent, cmap=_COLOURS, norm=norm, interpolation="nearest", aspect="auto")
        if i == 0:
            sheet.scale_bar(axes)
    left = 0.1 + len(of.errors) * (width + _GAP_IN)
    _bar(figure, left, top + _LINE_IN, sheet.height(corners, width), ScalarMappable(norm, _COLOURS))


def _bar(figure: Figure, left: float, top: float, high: float, of: ScalarMappable) -> None:
    bar: Axes = sheet.panel(figure, left + 0.1, top, 0.12, np.array([[0.0, 0.0], [1.0, high / 0.12]]))
    figure.colorbar(of, cax=bar, extend="max", extendfrac=0.03).set_label("error (m)", fontsize=sheet.TEXT_PT)
    bar.tick_params(labelsize=sheet.TEXT_PT - 1)


def _end(of: Rasters) -> float:
    every = np.concatenate([image[np.isfinite(image)] for image in of.errors.values()])
    return max(float(np.percentile(every, PERCENTILE)), 1e-3) if len(every) else 1.0


def _said(image: np.ndarray) -> str:
    found = image[np.isfinite(image)].astype(np.float64)
    return f"{np.sqrt(np.mean(found**2)):.3g} m" if len(found) else "no overlap"


def _corners(of: Rasters) -> np.ndarray:
    west, east, south, north = of.extent
    return sheet.limits(np.array([[west, south], [east, north]]), flattest=0.5)  # room for the bar of the scale
