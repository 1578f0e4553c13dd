"""Accuracy against time: the Pareto front, with every method's name where it covers no other."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, LogLocator

from pointnetkl.registration.covariance import catalogue
from pointnetkl.reporting import paper
from pointnetkl.reporting.drawing import families, plots

_FASTEST_S = 1e-4  # faster methods are drawn here: microseconds need not be told apart
_NAME_PT = 8.0
_DISTANCES_PT = (5.0, 12.0, 20.0, 30.0, 42.0, 56.0, 72.0)  # of a name from its point: the nearest free place is taken
_DIRECTIONS = np.arange(16) * np.pi / 8


def accuracy_time(kl: pd.DataFrame, seconds: Mapping[str, float]) -> Figure:
    """Draw mean KL divergence (nats) and its interval against seconds per submap; lower left is better.

    `kl` has a row per survey and method: mean, ci_low, ci_high. A method without a time is left out. The labels'
    own method has KL 0 by definition and stands on the lower border.
    """
    timed = kl[kl["method"].isin(list(seconds)) & (kl["method"] != catalogue.MONTE_CARLO)]
    surveys = list(dict.fromkeys(timed["survey"]))
    figure = Figure((plots.WIDTH_IN, 0.5 + 4.2 * max(1, len(surveys))), layout="constrained")
    grid = figure.subplots(max(1, len(surveys)), 1, squeeze=False, sharex=True).ravel()
    gold = {name: max(seconds[name], _FASTEST_S) for name in (catalogue.MONTE_CARLO,) if name in seconds}
    rows = [timed[timed["survey"] == name] for name in surveys]
    named = [_panel(axes, survey_rows, seconds, gold) for axes, survey_rows in zip(grid, rows, strict=False)]
    grid[-1].set_xlabel(f"time per submap, one thread (s); leftmost: {1e6 * _FASTEST_S:g} µs or less")
    families.legend(figure, [*gold, *timed["method"]])
    # names are placed last: where they fit is known only once the layout stands
    FigureCanvasAgg(figure)
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    for axes, (names, places) in zip(grid, named, strict=False):
        _name(figure, axes, names, places)
    return figure


def _panel(
    axes: Axes, rows: pd.DataFrame, seconds: Mapping[str, float], gold: Mapping[str, float]
) -> tuple[list[str], np.ndarray]:
    """Draw a survey's methods; return the names to be written, and their points (n, 2) in the axes' units."""
    times = np.maximum(rows["method"].map(seconds).to_numpy(float), _FASTEST_S)
    means, low, high = (rows[name].to_numpy(float) for name in ("mean", "ci_low", "ci_high"))
    for method, time, mean, bottom, top in zip(rows["method"], times, means, low, high, strict=True):
        style = families.style(method)
        axes.plot([time, time], [bottom, top], color=style.colour, linewidth=1.2, alpha=0.6)
        axes.plot(time, mean, style.marker, color=style.colour, markersize=6, zorder=3)
    axes.set(xscale="log", yscale="log", ylabel="mean KL(label || Q), 95 % interval (nats)")
    axes.set_title(paper.title(str(rows["survey"].iloc[0])), fontsize=10)
    axes.margins(0.12)
    bottom = axes.get_ylim()[0]
    axes.set_ylim(bottom=bottom)
    for time in gold.values():
        marker, colour = families.GOLD.marker, families.GOLD.colour
        axes.plot(time, bottom, marker, color=colour, markersize=13, zorder=4, clip_on=False)
    _front(axes, np.append(times, list(gold.values())), np.append(means, [bottom] * len(gold)))
    _time_axis(axes)
    names = [*rows["method"], *(f"{name} (KL 0 by definition)" for name in gold)]
    return names, np.column_stack([[*times, *gold.values()], [*means, *([bottom] * len(gold))]])


def _front(axes: Axes, times: np.ndarray, means: np.ndarray) -> None:
    order = np.lexsort((means, times))
    best = np.minimum.accumulate(means[order])
    along, down = np.repeat(times[order], 2)[1:], np.repeat(best, 2)[:-1]
    axes.plot(along, down, color="black", linestyle="--", linewidth=1, zorder=1, label="Pareto front")


def _time_axis(axes: Axes) -> None:
    axes.xaxis.set_major_locator(LogLocator(numticks=30))
    axes.xaxis.set_major_formatter(EngFormatter(unit="s"))
    axes.tick_params(labelbottom=True)
    axes.grid(alpha=0.3)
    plots.plain_log(axes, "y")


def _name(figure: Figure, axes: Axes, names: Sequence[str], places: np.ndarray) -> None:
    """Write each name beside its point, where it meets no point, line or name; with a thread where it is far."""
    to_points = 72 / figure.dpi
    points = axes.transData.transform(places) * to_points
    window = np.array(axes.get_window_extent().extents) * to_points
    drawn = [axes.transData.transform(np.asarray(line.get_xydata())) * to_points for line in axes.lines]
    lines = np.concatenate([_segments(corners) for corners in drawn])
    taken = np.hstack([points - 4, points + 4])
    # the crowded first: they have the fewest places to choose from
    crowd = [np.sum(np.hypot(*(points - point).T) < 60) for point in points]
    for i in np.argsort(crowd, kind="stable")[::-1]:
        size = _size(axes, names[i]) * to_points
        boxes = _around(points[i], size)
        outside = (boxes[:, :2] < window[:2]).any(axis=1) | (boxes[:, 2:] > window[2:]).any(axis=1)
        box = boxes[np.argmin(4 * outside + 2 * _meets(boxes, taken) + _meets(boxes, lines))]
        taken = np.vstack([taken, box])
        _write(axes, names[i], places[i], (box[:2] + box[2:]) / 2 - points[i], size)


def _segments(corners: np.ndarray) -> np.ndarray:
    """Return boxes (n - 1, 4) around the pieces of a line (n, 2), which all run along an axis."""
    low, high = np.minimum(corners[:-1], corners[1:]), np.maximum(corners[:-1], corners[1:])
    return np.hstack([low - 0.5, high + 0.5])


def _size(axes: Axes, name: str) -> np.ndarray:
    """Return the width and height of a name, pixels."""
    text = axes.text(0, 0, name, fontsize=_NAME_PT)
    size = np.array(text.get_window_extent().size)
    text.remove()
    return size


def _around(point: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Return boxes (n, 4) of a size beside a point (left, bottom, right, top), the near ones first."""
    away = np.array(_DISTANCES_PT)[:, None, None] + size / 2
    centres = point + (away * np.stack([np.cos(_DIRECTIONS), np.sin(_DIRECTIONS)], -1)).reshape(-1, 2)
    return np.hstack([centres - size / 2, centres + size / 2])


def _meets(boxes: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return which of the boxes (n, 4) have ground in common with any of the others (m, 4)."""
    low, high = boxes[:, None, :2], boxes[:, None, 2:]
    common = (low < others[None, :, 2:]) & (high > others[None, :, :2])
    return np.any(np.all(common, axis=2), axis=1)


def _write(axes: Axes, name: str, place: np.ndarray, offset: np.ndarray, size: np.ndarray) -> None:
    gap = np.hypot(*np.maximum(np.abs(offset) - size / 2, 0))
    thread = {"arrowstyle": "-", "color": plots.GREY, "lw": 0.6, "shrinkA": 0, "shrinkB": 3}
    (x, y), (across, up) = place, offset
    axes.annotate(
        name, (x, y), (across, up), textcoords="offset points", fontsize=_NAME_PT, ha="center", va="center",
        arrowprops=thread if gap > 8 else None,
    )  # fmt: skip
