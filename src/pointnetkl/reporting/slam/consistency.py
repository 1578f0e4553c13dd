"""Figure of the map's consistency: the map-to-map error of each cell, a panel for each trajectory."""

from collections.abc import Iterable, Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from pointnetkl.registration.covariance import catalogue
from pointnetkl.reporting import paper
from pointnetkl.reporting.drawing import plots, sheet
from pointnetkl.reporting.results import Folders
from pointnetkl.slam.consistency import consistency_map
from pointnetkl.slam.consistency.consistency_map import Rasters

PERCENTILE = 95.0  # of a survey's cells, where its scale ends: a few cells at the map's edge are far worse
_TRAJECTORIES = (  # drawn, those that a survey has
    *(catalogue.TRUTH, catalogue.GT, catalogue.CORRUPTED),
    *(catalogue.CONSTANT, catalogue.NAIVE_GICP, catalogue.NETWORK),
)
_COLOURS = "magma_r"
_GAP_IN, _LINE_IN, _BAR_IN = 0.1, 0.2, 0.85  # between panels, of text, and for the bar of colours at the right
_PLAIN = "#e4ebf0"  # colour of ground that no two submaps share


def read_and_draw(folders: Folders, names: Iterable[str]) -> Figure:
    """Draw where each test survey's map disagrees with itself, at a few trajectories.

    Raises:
        ArtifactError: a GeoTIFF of stage slam is missing or damaged.
    """
    paths = {name: folders.reports / f"slam/{name}_consistency.tif" for name in names}
    if not paths:
        return sheet.no_track()
    return consistency({name: consistency_map.read(path, _TRAJECTORIES) for name, path in paths.items()})


def consistency(surveys: Mapping[str, Rasters]) -> Figure:
    """Draw each survey's rasters in a row, on one scale, with the root mean square of each raster's cells."""
    across = max(len(rasters.errors) for rasters in surveys.values())
    width = (plots.WIDTH_IN - 0.2 - _BAR_IN) / across - _GAP_IN
    heights = {name: sheet.height(_corners(rasters), width) + 2 * _LINE_IN + 0.2 for name, rasters in surveys.items()}
    figure, top = sheet.sheet(0.05 + sum(heights.values())), 0.05
    for name, rasters in surveys.items():
        sheet.write(figure, 0.1, top, paper.title(name), 10)
        _survey(figure, rasters, top + _LINE_IN + 0.05, width)
        top += heights[name]
    return figure


def _survey(figure: Figure, rasters: Rasters, top: float, width: float) -> None:
    corners, norm = _corners(rasters), Normalize(0.0, _end(rasters))
    for i, (trajectory, image) in enumerate(rasters.errors.items()):
        left = 0.1 + i * (width + _GAP_IN)
        sheet.write(figure, left, top, f"{paper.title(trajectory)}: {_rms(image)}")
        axes = sheet.panel(figure, left, top + _LINE_IN, width, corners)
        axes.set_facecolor(_PLAIN)
        axes.imshow(image, extent=rasters.extent, cmap=_COLOURS, norm=norm, interpolation="nearest", aspect="auto")
        if i == 0:
            sheet.scale_bar(axes)
    left = 0.1 + len(rasters.errors) * (width + _GAP_IN)
    _bar(figure, left, top + _LINE_IN, sheet.height(corners, width), ScalarMappable(norm, _COLOURS))


def _bar(figure: Figure, left: float, top: float, high: float, colours: ScalarMappable) -> None:
    bar: Axes = sheet.panel(figure, left + 0.1, top, 0.12, np.array([[0.0, 0.0], [1.0, high / 0.12]]))
    figure.colorbar(colours, cax=bar, extend="max", extendfrac=0.03).set_label("error (m)", fontsize=sheet.TEXT_PT)
    bar.tick_params(labelsize=sheet.TEXT_PT - 1)


def _end(rasters: Rasters) -> float:
    errors = np.concatenate([image[np.isfinite(image)] for image in rasters.errors.values()])
    return max(float(np.percentile(errors, PERCENTILE)), 1e-3) if len(errors) else 1.0


def _rms(image: np.ndarray) -> str:
    errors = image[np.isfinite(image)].astype(np.float64)
    return f"{np.sqrt(np.mean(errors**2)):.3g} m" if len(errors) else "no overlap"


def _corners(rasters: Rasters) -> np.ndarray:
    west, east, south, north = rasters.extent
    return sheet.limits(np.array([[west, south], [east, north]]), flattest=0.5)  # room for the bar of the scale
