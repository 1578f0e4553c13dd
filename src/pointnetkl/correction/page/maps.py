"""The page's maps: the seabed before and after, loop closures on it, and the difference."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from scipy import ndimage

from pointnetkl.correction.page.rasters import Raster
from pointnetkl.correction.page.theme import STATES
from pointnetkl.correction.result import Corrected
from pointnetkl.reporting.drawing import maps, sheet
from pointnetkl.slam.closing.schemas import State

DIFFERENCE = "RdBu_r"
NOTHING = "#eceff2"  # where there is no sounding
_WIDTH_IN, _HEIGHT_IN, _TEXT_PT = 6.6, 4.7, 13.0  # of a map, at most; and of its letters
_FLATTEST, _HIGHEST = 0.42, 1.15  # height over width of a map, so that two of any survey fit on a screen
_WHITE = 0.2  # mixed in, or the colours would hide the shade
_LIGHT = np.array([-0.5, 0.5, 0.7]) / np.linalg.norm([0.5, 0.5, 0.7])  # from the north-west
_SLOPE = 0.35  # that steep slopes of the survey are drawn with, however flat or rugged it is


@dataclass(frozen=True)
class Look:
    """What the maps of a survey have in common, so that they can be compared."""

    corners: np.ndarray  # [[x, y], [x, y]], metres
    depths: tuple[float, float]  # least and most, metres: the ends of the colours
    steeper: float  # times, for the shade
    width_in: float
    scale: float  # of the maps' size


def look(rasters: Sequence[Raster], scale: float = 1.0) -> Look:
    """Return the look of maps that show all rasters; `scale` makes them smaller, and the page with them."""
    corners = sheet.limits(np.concatenate([raster.corners for raster in rasters]), _FLATTEST, _HIGHEST)
    width = min(_WIDTH_IN, _HEIGHT_IN / sheet.height(corners, 1.0))
    values = np.concatenate([raster.values[np.isfinite(raster.values)] for raster in rasters])
    low, high = np.percentile(values, [1, 99])
    slopes = np.concatenate([_slopes(raster) for raster in rasters])
    steep = float(np.percentile(slopes, 90)) if len(slopes) else 0.0
    steeper = float(np.clip(_SLOPE / max(steep, 1e-6), 0.5, 15.0))  # flat ground: not the noise alone
    return Look(corners, (float(low), float(max(high, low + 0.1))), steeper, scale * width, scale)


def seabed(raster: Raster, look: Look, corrected: Corrected, after: bool) -> Figure:
    """Draw depths as colours, slopes as shade, and the submaps' track."""
    figure, axes = _map(look)
    _draw(axes, raster, pale(_share(raster, look)) * _shade(raster, look)[..., None])
    for line in _lines(corrected, after):
        axes.plot(*line.T, color="black", linewidth=0.9, alpha=0.55)
    _scale(axes, look)
    return figure


def _share(raster: Raster, look: Look) -> np.ndarray:
    low, high = look.depths
    return np.asarray((np.nan_to_num(raster.values) - low) / (high - low))


def pale(depths: np.ndarray) -> np.ndarray:
    """Return the colours (..., 3) of depths from 0, the least, to 1, as all maps have them on level ground."""
    return np.asarray(_WHITE + (1 - _WHITE) * colormaps[maps.DEPTHS](np.clip(depths, 0, 1))[..., :3])


def closures(raster: Raster, look: Look, corrected: Corrected) -> Figure:
    """Draw closures where they lie, each with a line from its source to its target, by what became of them."""
    figure, axes = _map(look)
    _draw(axes, raster, np.repeat(0.86 * _shade(raster, look)[..., None] + 0.08, 3, axis=-1))
    for line in _lines(corrected, corrected.verdict.applied):
        axes.plot(*line.T, color="#333333", linewidth=0.8, alpha=0.6)
    for state in reversed(State):  # accepted last, above the others
        _state(axes, corrected, state)
    _scale(axes, look)
    return figure


def _state(axes: Axes, corrected: Corrected, state: State) -> None:
    rows = corrected.closures[corrected.closures["state"] == state]
    marker, colour = STATES[state]
    ends = np.array([_ends(row.source, row.target, corrected) for row in rows.itertuples()]).reshape(-1, 2, 2)
    middles = rows[["x_m", "y_m"]].astype(float).to_numpy() + corrected.origin
    places = np.where(np.isfinite(middles), middles, ends[:, 0])
    solid = state == State.ACCEPTED
    lines = LineCollection(list(ends), colors=colour, linewidths=1.3 if solid else 1.0, alpha=0.9, zorder=3)
    lines.set_linestyle("-" if solid else (0, (4, 2)))
    axes.add_collection(lines, autolim=False)
    edge: Any = None if marker == "x" else "white"  # a cross is all edge
    width = 2.0 if marker == "x" else 0.8
    axes.scatter(places[:, 0], places[:, 1], s=52, c=colour, marker=marker, linewidths=width, edgecolors=edge, zorder=4)


def _ends(source: int, target: int, corrected: Corrected) -> np.ndarray:
    """Return where a closure's source and target lie, (2, 2) metres in the CRS; a target that is no submap is NaN."""
    if corrected.submaps is None:
        return np.full((2, 2), np.nan)
    places = _places(corrected, corrected.verdict.applied)
    at = [np.flatnonzero(corrected.submaps.number == number) for number in (source, target)]
    return np.array([places[found[0]] if len(found) else [np.nan, np.nan] for found in at])


def difference(raster: Raster, look: Look) -> tuple[Figure, float]:
    """Draw how much deeper the ground is after; return with it the difference at the ends of the colours, metres."""
    figure, axes = _map(look)
    reach = max(float(np.nanpercentile(np.abs(raster.values), 97)), 0.01)
    axes.imshow(
        raster.values, origin="lower", extent=raster.extent, cmap=DIFFERENCE, clim=(-reach, reach), aspect="auto",
        interpolation="nearest",
    )  # fmt: skip
    _scale(axes, look)
    return figure, reach


def _map(look: Look) -> tuple[Figure, Axes]:
    figure = Figure((look.width_in, sheet.height(look.corners, look.width_in)))
    axes = sheet.panel(figure, 0.0, 0.0, look.width_in, look.corners)
    axes.set_facecolor(NOTHING)
    axes.spines[:].set_visible(False)
    return figure, axes


def _draw(axes: Axes, raster: Raster, rgb: np.ndarray) -> None:
    image = np.concatenate([np.clip(rgb, 0, 1), np.isfinite(raster.values)[..., None]], axis=-1)
    axes.imshow(image, origin="lower", extent=raster.extent, aspect="auto", interpolation="nearest")


def _scale(axes: Axes, look: Look) -> None:
    """Draw the scale bar, and an arrow to the north of the grid."""
    size = _TEXT_PT * look.scale
    sheet.scale_bar(axes)
    for text in axes.texts:
        text.set_fontsize(size)
    box = {"facecolor": "white", "alpha": 0.7, "linewidth": 0, "pad": 2.0}
    arrow = {"arrowstyle": "-|>", "color": "black", "linewidth": 1.4, "shrinkA": 0, "shrinkB": 0}
    axes.annotate(
        "N", (0.96, 0.975), (0.96, 0.86), "axes fraction", arrowprops=arrow, ha="center", va="center", fontsize=size,
        bbox=box, zorder=5,
    )  # fmt: skip


def _lines(corrected: Corrected, after: bool) -> list[np.ndarray]:
    """Return the track (n, 2) of each line through the middles of its submaps, metres in the CRS."""
    if corrected.submaps is None:
        return []
    places = _places(corrected, after)
    line = corrected.submaps.line
    return [places[line == number] for number in np.unique(line)]


def _places(corrected: Corrected, after: bool) -> np.ndarray:
    """Return where the submaps are, (n, 2) metres in the CRS."""
    assert corrected.submaps is not None
    poses = corrected.submaps.after if after else corrected.submaps.before
    return np.asarray(poses[:, :2, 3] + corrected.origin)


def _gradient(raster: Raster) -> tuple[np.ndarray, np.ndarray]:
    """Return the slopes of depth to the north and to the east."""
    west, east, south, north = raster.extent
    rows, columns = raster.values.shape
    if min(rows, columns) < 2:
        return np.zeros((rows, columns)), np.zeros((rows, columns))
    gaps = ~np.isfinite(raster.values)
    nearest = ndimage.distance_transform_edt(gaps, return_distances=False, return_indices=True)
    filled = raster.values[tuple(nearest)]  # or there would be no slope beside a gap
    down_north, down_east = np.gradient(filled, (north - south) / rows, (east - west) / columns)
    return down_north, down_east


def _slopes(raster: Raster) -> np.ndarray:
    return np.asarray(np.hypot(*_gradient(raster))[np.isfinite(raster.values)])


def _shade(raster: Raster, look: Look) -> np.ndarray:
    """Return how bright each cell is, 1 where the ground is level."""
    down_north, down_east = (look.steeper * slope for slope in _gradient(raster))
    normal = np.stack([down_east, down_north, np.ones_like(down_east)], -1)
    shade = normal @ _LIGHT / np.linalg.norm(normal, axis=-1) / _LIGHT[2]
    return np.asarray(np.clip(shade, 0.5, 1.3))
