"""Figure of loop closures: the covariances' ellipses on a map of the survey, and some of them to scale."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from pointnetkl.reporting import paper
from pointnetkl.reporting.drawing import families, maps, plots, sheet

_CIRCLE = np.stack([np.cos(t := np.linspace(0, 2 * np.pi, 48, endpoint=False)), np.sin(t)])
_REACH = 0.03  # semi-axis of the larger ellipses on the map, over the map's longer side
_GAP_IN, _LINE_IN, _ZOOMS = 0.12, 0.2, 8
_INSIDE, _OUTSIDE = plots.BLUE, plots.ORANGE


@dataclass(frozen=True)
class ClosureMap:
    """The registrations of one survey's graph, and its seabed as a raster (`maps.raster`)."""

    submap: np.ndarray  # (r,) numbers
    position: np.ndarray  # (r, 2) of each submap, metres in the map frame
    yaw: np.ndarray  # (r,) of each submap, radians
    error: np.ndarray  # (r, 2) of each registration against the truth, metres in the submap's frame; NaN if not known
    covariances: Mapping[str, np.ndarray]  # by method, (r, 2, 2) in m^2 in the submap's frame
    seabed: tuple[np.ndarray, tuple[float, float, float, float]]


def closure_ellipses(surveys: Mapping[str, ClosureMap]) -> Figure:
    """Draw each registration's 95 % ellipse by method, magnified; below, some to scale with their errors."""
    if not surveys:
        return sheet.nothing("no test survey has loop closures")
    across = max(len(survey.covariances) for survey in surveys.values())
    width = (plots.WIDTH_IN - 0.2) / across - _GAP_IN
    corners = {name: _corners(survey) for name, survey in surveys.items()}
    heights = {name: sheet.height(c, width) + _zoom_width() + 3 * _LINE_IN + 0.25 for name, c in corners.items()}
    figure, top = sheet.sheet(0.3 + sum(heights.values())), 0.3
    _key(figure, dict.fromkeys(method for survey in surveys.values() for method in survey.covariances))
    for name, survey in surveys.items():
        _survey(figure, name, survey, (top, width), corners[name])
        top += heights[name]
    return figure


def ellipses(q: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """Return the 95 % ellipses (r, k, 2) in the map frame, metres, of covariances q (r, 2, 2) in submaps' frames."""
    c, s = np.cos(yaw), np.sin(yaw)
    R_map_submap = np.moveaxis(np.array([[c, -s], [s, c]]), -1, 0)
    return np.swapaxes(plots.RADIUS_95 * R_map_submap @ np.linalg.cholesky(q) @ _CIRCLE, 1, 2)


def inside(error: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return whether each error (r, 2) lies inside the 95 % ellipse of its covariance in q (r, 2, 2)."""
    whitened = np.linalg.solve(np.linalg.cholesky(q), error[..., None])[..., 0]
    return np.asarray(np.linalg.norm(whitened, axis=1) <= plots.RADIUS_95)


def _survey(figure: Figure, name: str, closures: ClosureMap, place: tuple[float, float], corners: np.ndarray) -> None:
    """Draw a survey's maps, side by side at `place` (top and width, inches), and below them some ellipses to scale."""
    top, width = place
    factor = _magnification(closures, corners)
    sheet.write(figure, 0.1, top, f"{paper.title(name)}: 95 % ellipses × {factor:g}", 10)
    for i, (method, q) in enumerate(closures.covariances.items()):
        left, held = 0.1 + i * (width + _GAP_IN), inside(closures.error, q)
        share = f": {held.mean():.0%} of {len(held)} errors inside" if np.isfinite(closures.error).all() else ""
        sheet.write(figure, left, top + _LINE_IN, method + share)
        axes = sheet.panel(figure, left, top + 2 * _LINE_IN, width, corners)
        _ground(axes, *closures.seabed)
        colours = np.where(np.isnan(closures.error[:, 0]), plots.GREY, np.where(held, _INSIDE, _OUTSIDE))
        outlines = closures.position[:, None] + factor * ellipses(q, closures.yaw)
        polygons = PolyCollection(list(outlines), facecolors="none", edgecolors=colours, linewidths=0.9)
        axes.add_collection(polygons, autolim=False)
        axes.scatter(closures.position[:, 0], closures.position[:, 1], c=colours, s=3, linewidths=0, zorder=4)
        sheet.scale_bar(axes)
    _zooms(figure, closures, top + 2 * _LINE_IN + sheet.height(corners, width) + 0.08)


def _ground(axes: Axes, depth: np.ndarray, extent: tuple[float, float, float, float]) -> None:
    shade = maps.shade(depth, extent)
    axes.imshow(shade, origin="lower", extent=extent, cmap="gray", clim=(-1.5, 1), aspect="auto")


def _zooms(figure: Figure, closures: ClosureMap, top: float) -> None:
    """Draw some registrations to scale, from the largest to the smallest covariance of the first method."""
    size = np.trace(next(iter(closures.covariances.values())), axis1=1, axis2=2)
    order = np.argsort(-size, kind="stable")
    some = order[np.linspace(0, len(order) - 1, min(_ZOOMS, len(order))).round().astype(int)]
    for column, i in enumerate(some):
        left = 0.1 + column * (_zoom_width() + _GAP_IN / 2)
        sheet.write(figure, left, top, f"submap {closures.submap[i]}", 7)
        outlines = {method: ellipses(q[[i]], closures.yaw[[i]])[0] for method, q in closures.covariances.items()}
        points = np.concatenate([*outlines.values(), np.nan_to_num(closures.error[[i]])])
        reach = 1.15 * np.linalg.norm(points, axis=-1).max()
        axes = sheet.panel(figure, left, top + 0.15, _zoom_width(), reach * np.array([[-1.0, -1.0], [1.0, 1.0]]))
        _zoom(axes, outlines, closures.error[i], closures.yaw[i])


def _zoom(axes: Axes, outlines: Mapping[str, np.ndarray], error: np.ndarray, yaw: float) -> None:
    for method, outline in outlines.items():
        axes.add_artist(Polygon(outline, fill=False, edgecolor=families.style(method).colour, linewidth=1.3))
    axes.plot(0, 0, "+", color=plots.GREY, markersize=5)
    c, s = np.cos(yaw), np.sin(yaw)
    axes.plot(*(np.array([[c, -s], [s, c]]) @ error), "o", color="black", markersize=3.5)
    sheet.scale_bar(axes)


def _magnification(closures: ClosureMap, corners: np.ndarray) -> float:
    largest = np.sqrt([np.linalg.eigvalsh(q)[:, -1] for q in closures.covariances.values()])
    reach = _REACH * float((corners[1] - corners[0]).max())
    return max(1.0, sheet.round_below(reach / (plots.RADIUS_95 * float(np.quantile(largest, 0.98)))))


def _corners(closures: ClosureMap) -> np.ndarray:
    left, right, low, high = closures.seabed[1]
    return sheet.limits(np.array([[left, low], [right, high]]), highest=1.4)


def _zoom_width() -> float:
    return (plots.WIDTH_IN - 0.2) / _ZOOMS - _GAP_IN / 2


def _key(figure: Figure, methods: Iterable[str]) -> None:
    words = [
        ("true error inside the ellipse", _INSIDE),
        ("outside", _OUTSIDE),
        ("Below, to scale: +: as registered;", "black"),
    ]
    words += [("dot: the truth; ellipses of", "black"), *((name, families.style(name).colour) for name in methods)]
    left = 0.1
    for text, colour in words:
        sheet.write(figure, left, 0.07, text, colour=colour)
        left += 0.12 + 0.055 * len(text)
