"""The map of a raw file: its depths and its track, north up."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator

from pointnetkl.inspection import earth, swath_plots
from pointnetkl.inspection.facts import Drawing, Facts, Inspection
from pointnetkl.readers import projection
from pointnetkl.reporting.drawing import plots, sheet
from pointnetkl.reporting.drawing.maps import DEPTHS
from pointnetkl.workflow import artifacts

_LEFT_IN, _TOP_IN, _BELOW_IN = 0.95, 0.6, 0.55  # room for northings, the title, eastings
_BAR_IN, _BAR_LABEL_IN = 0.14, 0.7  # width of the colour bar, and of its numbers
_HIGHEST_IN, _NARROWEST_IN = 7.5, 4.5
_TICK_IN = 1.0  # at least, between numbers at an axis


def save(inspection: Inspection, folder: Path, name: str) -> Facts:
    """Save the plots of a file, and return its facts with the paths of the plots.

    Raises:
        ArtifactError: a figure cannot be written.
    """
    drawing = inspection.drawing
    if drawing is None:
        return inspection.facts
    title = _title(inspection.facts)
    drawn = {f"{name}_map.png": seabed(drawing, title, inspection.facts.crs or "")}
    if drawing.swaths is not None and drawing.pings is not None and len(drawing.swaths):
        drawn[f"{name}_swath.png"] = swath_plots.swaths(drawing.swaths, drawing.pings, title)
    for file, figure in drawn.items():
        artifacts.write_bytes(folder / file, plots.png(figure))
    return dataclasses.replace(inspection.facts, plots=[str(folder / file) for file in drawn])


def seabed(drawing: Drawing, title: str, crs: str) -> Figure:
    """Draw depths and track in metres of the CRS; the colour bar is below a wide map and beside a high one."""
    corners = sheet.limits(drawing.places, flattest=0.2, highest=4.0)
    flat = sheet.height(corners, 1.0) <= 1.0
    width = plots.WIDTH_IN - _LEFT_IN - 0.25 if flat else min(_HIGHEST_IN / sheet.height(corners, 1.0), 5.5)
    coloured = drawing.cells is not None or len(drawing.points) > 0
    height, room = sheet.height(corners, width), (_BAR_IN + _BAR_LABEL_IN) * coloured
    page = plots.WIDTH_IN if flat else max(_LEFT_IN + width + 0.2 + room, _NARROWEST_IN)
    figure = Figure((page, _TOP_IN + height + _BELOW_IN + room * flat))
    axes = sheet.panel(figure, _LEFT_IN, _TOP_IN, width, corners)
    drawn = _depths(axes, drawing)
    if drawn is not None:
        below = (_LEFT_IN, _TOP_IN + height + _BELOW_IN, width, _BAR_IN)
        beside = (_LEFT_IN + width + 0.2, _TOP_IN, _BAR_IN, height)
        _bar(swath_plots.placed(figure, *(below if flat else beside)), drawn, flat)
    _track(axes, drawing.track)
    _coordinates(axes, crs, width, height)
    sheet.write(figure, 0.1, 0.08, title, 10)
    return figure


def _depths(axes: Axes, drawing: Drawing) -> ScalarMappable | None:
    if drawing.cells is None:
        x, y, z = drawing.points.T
        return axes.scatter(x, y, c=-z, cmap=DEPTHS, s=8) if len(z) else None
    depth, extent = drawing.cells.depth_m, drawing.cells.extent
    # a single wrong sounding would set the range of the colours
    low, high = np.nanquantile(depth, [0.01, 0.99])
    style: dict[str, Any] = {"origin": "lower", "interpolation": "nearest", "aspect": "auto"}
    return axes.imshow(depth, cmap=DEPTHS, vmin=low, vmax=high, extent=extent, **style)


def _bar(axes: Axes, drawn: ScalarMappable, flat: bool) -> None:
    orientation = "horizontal" if flat else "vertical"
    axes.figure.colorbar(drawn, cax=axes, orientation=orientation, extend="both", label="depth (m)")
    if not flat:
        axes.invert_yaxis()
    axes.tick_params(labelsize=sheet.TEXT_PT)


def _track(axes: Axes, track: np.ndarray) -> None:
    if len(track):
        axes.plot(*track.T, color=plots.RED, linewidth=1.2, label="track")
        axes.plot(*track[0], "o", color="white", markeredgecolor=plots.RED, markersize=6, label="its beginning")
        above: dict[str, Any] = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.2}
        axes.legend(ncols=2, fontsize=sheet.TEXT_PT, frameon=False, **above)


def _coordinates(axes: Axes, crs: str, width: float, height: float) -> None:
    place = "of an unknown place" if crs == projection.LOCAL else f"in {crs if len(crs) < 20 else earth.name(crs)}"
    axes.set_xlabel(f"metres east {place}", fontsize=9)
    axes.set_ylabel("metres north", fontsize=9)
    for axis, room in ((axes.xaxis, width), (axes.yaxis, height)):
        axis.set_major_locator(MaxNLocator(max(2, min(8, int(room / _TICK_IN))), steps=[1, 2, 5, 10]))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.10g}"))
    axes.tick_params(labelsize=sheet.TEXT_PT)


def _title(facts: Facts) -> str:
    parts = [facts.format, facts.start and facts.start[:10], _size(facts)]
    return f"{Path(facts.file).name}: {', '.join(part for part in parts if part)}"


def _size(facts: Facts) -> str | None:
    if facts.kind == "navigation":
        return f"{facts.records:,} records"
    return f"{facts.valid:,} {'cells with a depth' if facts.kind == 'grid' else 'valid soundings'}"
