"""The page's curves: the correction along the track, and how far closures miss before and after it."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure

from pointnetkl.correction.page import words
from pointnetkl.correction.page.numbers import Curves
from pointnetkl.correction.page.theme import TEXT_PT, Theme, dress
from pointnetkl.correction.result import Corrected
from pointnetkl.reporting.drawing import plots
from pointnetkl.surveys.survey import SUBMAPS

_POINTS = 2000  # of a curve: more than its pixels
_GAP = 20.0  # times the usual step, that breaks a curve
_LEAST_GAP_S = 30.0
_SERIES = (  # label; columns of shift, variance after and before; factor from the column's unit, turned to the compass
    ("east (m)", "moved_x_m", "xx_m2", 1.0),
    ("north (m)", "moved_y_m", "yy_m2", 1.0),
    ("heading (°)", "moved_yaw_rad", "yaw_rad2", -180 / np.pi),
)


def shift(corrected: Corrected, theme: Theme) -> Figure:
    """Draw the correction along the track: east, north and heading, each with 2 sigma of what is left unknown."""
    figure = Figure((8.0, 5.6), layout="constrained", facecolor=theme.paper)
    grid = figure.subplots(3, 1, sharex=True)
    rows, along = _thinned(corrected)
    for axes, (label, column, variance, factor) in zip(grid, _SERIES, strict=True):
        sigma = [abs(factor) * np.sqrt(rows[f"{prefix}var_{variance}"]) for prefix in ("", "before_")]
        _series(axes, along, (factor * rows[column], *sigma), theme)
        dress(axes, theme)
        axes.set_ylabel(label, color=theme.ink)
    figure.align_ylabels(grid)
    _time_axis(grid[-1], corrected)
    handles = {str(artist.get_label()): artist for artist in (*grid[0].lines, *grid[0].collections)}
    handles = {label: artist for label, artist in handles.items() if not label.startswith("_")}
    figure.legend(
        handles.values(), handles.keys(), loc="outside upper left", ncols=3, frameon=False, fontsize=TEXT_PT,
        labelcolor=theme.ink,
    )  # fmt: skip
    return figure


def _series(axes: Axes, along: np.ndarray, curves: Sequence[pd.Series], theme: Theme) -> None:
    moved, sigma, before = (np.asarray(curve, np.float64) for curve in curves)
    same = np.array_equal(sigma, before, equal_nan=True)  # nothing was learnt: one band says it
    if not same:
        label = "navigation, ± 2 sigma"
        axes.fill_between(along, -2 * before, 2 * before, color=theme.before, alpha=0.18, linewidth=0, label=label)
    label, low, high = "± 2 sigma" if same else "± 2 sigma after", moved - 2 * sigma, moved + 2 * sigma
    axes.fill_between(along, low, high, color=theme.after, alpha=0.3, linewidth=0, label=label)
    axes.plot(along, moved, color=theme.after, linewidth=1.3, label="correction")
    axes.axhline(0, color=theme.before, linewidth=0.7)
    # what navigation says of itself may be far more than the correction, and would hide it
    ends = [np.nanmin([*low, *moved, 0.0]), np.nanmax([*high, *moved, 0.0])]
    room = max(0.15 * (ends[1] - ends[0]), 0.01)
    axes.set_ylim(ends[0] - room, ends[1] + room)
    axes.margins(x=0.01)


def _thinned(corrected: Corrected) -> tuple[pd.DataFrame, np.ndarray]:
    """Return some rows of the track and where they stand along the axis, with a row of NaN where the track breaks."""
    track = corrected.track.iloc[:: max(1, len(corrected.track) // _POINTS)]
    if not words.has_times(corrected):
        return track, track["ping"].to_numpy(np.float64)
    time = track["time_s"].to_numpy(np.float64)
    step = np.diff(time)
    breaks = np.flatnonzero(step > max(_GAP * float(np.median(step)), _LEAST_GAP_S)) + 1
    columns = [name for name in track.columns if name not in ("file", "ping")]
    values = np.insert(track[columns].to_numpy(np.float64), breaks, np.nan, axis=0)
    # dates of a break too, because an axis of dates takes no NaN
    dates = np.insert(time, breaks, time[breaks - 1]) if len(breaks) else time
    return pd.DataFrame(values, columns=columns), (dates * 1e6).astype("datetime64[us]")


def _time_axis(axes: Axes, corrected: Corrected) -> None:
    if not words.has_times(corrected):
        axes.set_xlabel("submap" if corrected.kind == SUBMAPS else "ping")
        return
    locator = AutoDateLocator(minticks=4, maxticks=8, tz="UTC")  # type: ignore[no-untyped-call]
    axes.xaxis.set_major_locator(locator)
    words_of_dates = ConciseDateFormatter(locator, tz="UTC", show_offset=False)  # type: ignore[no-untyped-call]
    axes.xaxis.set_major_formatter(words_of_dates)
    axes.set_xlabel(f"UTC, from {words.utc(corrected.track['time_s'].min())[:10]}")


def agreement(curves: Sequence[Curves], after: str, theme: Theme) -> Figure:
    """Draw the shares of cells, or of closures, that are off by at most so much, before and after."""
    figure = Figure((5.6, 2.75 * len(curves)), layout="constrained", facecolor=theme.paper)
    for axes, each in zip(figure.subplots(len(curves), 1, squeeze=False).flat, curves, strict=True):
        _shares(axes, each, after, theme)
        if each.in_sigmas:
            radius = np.geomspace(axes.get_xlim()[0], axes.get_xlim()[1], 100)
            expected = 1 - np.exp(-(radius**2) / 2)  # of two directions, each a standard normal
            axes.plot(radius, expected, ":", color=theme.ink, linewidth=1, label="errors as large as V says")
        dress(axes, theme)
        axes.set_xlabel(each.label, color=theme.ink)
        axes.set_ylabel(f"share of {each.of}", color=theme.ink)
        axes.legend(loc="best", fontsize=TEXT_PT - 1, frameon=False, labelcolor=theme.ink)
    return figure


def _shares(axes: Axes, curves: Curves, after: str, theme: Theme) -> None:
    values = curves.before, curves.after
    kinds = ((values[0], theme.before, "--", "at navigation"), (values[1], theme.after, "-", after))
    for of_kind, colour, style, label in kinds:
        ordered = np.sort(np.maximum(of_kind, _least(values)))
        shares = np.arange(1, len(ordered) + 1) / len(ordered)
        if len(ordered) > _POINTS:
            ordered, shares = np.quantile(ordered, grid := np.linspace(0, 1, _POINTS)), grid
        axes.step(ordered, shares, where="post", color=colour, linestyle=style, linewidth=1.6, label=label)
    low, high = _least(values), max(float(np.quantile(each, 0.999)) for each in values)
    axes.set(xscale="log", ylim=(0, 1.02), xlim=(low / 1.2, 1.2 * max(high, 2 * low)))
    plots.plain_log(axes, "x")
    axes.yaxis.set_major_formatter(lambda share, _: f"{100 * share:.0f} %")


def _least(values: tuple[np.ndarray, np.ndarray]) -> float:
    """Return where a logarithmic axis begins: at a hundredth of what is typical before, or the smallest value."""
    smallest = min(float(each.min()) for each in values)
    return max(smallest, float(np.median(values[0])) / 100, 1e-4)
