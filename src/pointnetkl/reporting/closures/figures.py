"""Figures of how covariances describe loop closures: by method, by overlap and terrain, and by predicted size."""

from collections.abc import Iterator, Mapping

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pointnetkl.registration.covariance import catalogue
from pointnetkl.registration.covariance.catalogue import MAP, MEASURED_PAIR, PAIR, SPLIT
from pointnetkl.reporting import paper
from pointnetkl.reporting.closures import numbers
from pointnetkl.reporting.closures.numbers import Closures
from pointnetkl.reporting.drawing import families, plots
from pointnetkl.reporting.results import GOLD
from pointnetkl.slam.closures.schemas import BUILT, PLACED

_NEES = (0.1, 5000.0)  # range of the axis; values beyond it are drawn at its border
_COLOURS = (plots.BLUE, plots.ORANGE, plots.GREEN, plots.PURPLE, plots.RED, plots.SKY)  # of surveys
_METHODS = {
    GOLD: plots.GREEN,
    SPLIT: plots.BLUE,
    MEASURED_PAIR: "black",
    PAIR: plots.ORANGE,
    MAP: plots.PURPLE,
    catalogue.NETWORK: plots.RED,
    catalogue.CONSTANT: plots.GREY,
}
_BINS, _FEWEST = 8, 5  # bins with equally many registrations; the least number that makes one
_TERRAIN = {"overlap": "share of S_i that its targets cover", "patchiness": "patchiness of S_i's slopes"}
_MARKERS = {"": ("o", "black"), "placed_": ("|", "black"), "held_out_": ("o", "none")}  # by prefix of the columns
_KINDS = ("loop closures of the graph", "the same with every submap where it truly is", "held-out errors of labels")


def every(table: pd.DataFrame, surveys: Mapping[str, Closures]) -> Iterator[tuple[str, Figure]]:
    """Yield the figures by name; `table` is that of `by_method`, and `surveys` are the test surveys' closures."""
    yield "calibration_lc", by_method(table)
    yield "closure_ratios", ratios(surveys)
    yield "closure_sigmas", by_sigma(surveys)


def by_method(table: pd.DataFrame) -> Figure:
    """Draw each method's NEES and coverage on loop closures, beside placed registrations and held-out errors.

    `table` has a row per survey and method: nees, coverage_95, and both again with the prefixes placed_ and held_out_
    (None where not known). The best methods, by the column placed_log_likelihood, come first.
    """
    if table.empty:
        return _nothing()
    surveys, order = list(dict.fromkeys(table["survey"])), _order(table)
    figure = Figure((plots.WIDTH_IN, 1.6 + 0.38 * len(order)), layout="constrained")
    grid = figure.subplots(2, len(surveys), squeeze=False, sharey=True, sharex="row")
    for (nees, coverage), survey in zip(grid.T, surveys, strict=True):
        rows = table[table["survey"] == survey]
        heights = np.array([order.index(method) for method in rows["method"]])
        nees.set_title(paper.title(survey), fontsize=10)
        _dumbbells(nees, rows, heights, "nees", _NEES)
        _dumbbells(coverage, rows, heights, "coverage_95", (0.0, 1.0))
        nees.axvline(1.0, color=plots.GREY, linestyle=":", linewidth=1)
        coverage.axvline(0.95, color=plots.GREY, linestyle=":", linewidth=1)
        nees.set(xscale="log", xlim=(_NEES[0] / 1.3, _NEES[1] * 1.3))
        plots.plain_log(nees, "x")
        nees.set_xlabel("normalised NEES", fontsize=9)
        coverage.set_xlabel("inside the 95 % ellipse", fontsize=9)
    grid[0, 0].set_ylim(len(order) - 0.4, -0.6)
    for axes in grid.ravel():
        axes.set_yticks(range(len(order)), order)
        axes.tick_params(labelsize=8)
        axes.grid(alpha=0.3)
    handles = [grid[0, 0].plot([], [], marker, color="black", mfc=face, ls="")[0] for marker, face in _MARKERS.values()]
    figure.legend(handles, _KINDS, loc="outside upper center", ncols=3, frameon=False, fontsize=9)
    return figure


def ratios(surveys: Mapping[str, Closures]) -> Figure:
    """Draw the root trace of Q_ij over that of Q_i against overlap and patchiness, for the labels and copy split."""
    surveys = {name: closures for name, closures in surveys.items() if len(numbers.ratios(closures, GOLD))}
    if not surveys:
        return _nothing()
    figure = Figure((plots.WIDTH_IN, 6.0), layout="constrained")
    grid = figure.subplots(2, 2, sharey=True, sharex="col")
    for line, method in zip(grid, (GOLD, SPLIT), strict=True):
        for axes, (column, label) in zip(line, _TERRAIN.items(), strict=True):
            for colour, (name, closures) in zip(_COLOURS * len(surveys), surveys.items(), strict=False):
                rows = numbers.ratios(closures, method)
                axes.plot(rows[column], rows["ratio"], ".", color=colour, alpha=0.6, label=paper.title(name))
            axes.axhline(1.0, color="black", linewidth=0.8)
            axes.set(yscale="log")
            axes.grid(alpha=0.3)
            if method == SPLIT:
                axes.set_xlabel(label, fontsize=9)
        line[0].set_ylabel(f"root trace of Q_ij over that of Q_i,\nQ_i: {_label(method)}", fontsize=9)
    plots.plain_log(grid[0, 0], "y")
    figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False)
    return figure


def by_sigma(surveys: Mapping[str, Closures]) -> Figure:
    """Draw the registrations' errors against the size that Q predicts, a panel per survey; below, placed ones."""
    surveys = {name: closures for name, closures in surveys.items() if len(closures.rows)}
    if not surveys:
        return _nothing()
    figure = Figure((plots.WIDTH_IN, 1.0 + 2 * 8.0 / max(2.6, len(surveys))), layout="constrained")
    grid = figure.subplots(2, len(surveys), squeeze=False, sharex=True, sharey=True)
    for column, (name, closures) in zip(grid.T, surveys.items(), strict=True):
        column[0].set_title(paper.title(name), fontsize=10)
        for axes, kind in zip(column, (BUILT, PLACED), strict=True):
            _against_sigma(axes, closures, kind)
    for axes, label in zip(grid[:, 0], ("loop closures", "every submap where it truly is"), strict=True):
        axes.set_ylabel(f"rms error (m)\n{label}", fontsize=9)
    for axis in "xy":
        plots.plain_log(grid[0, 0], axis)
    figure.supxlabel("rms of what Q says (m); on the line: right, above it: Q is too sure of itself", fontsize=9)
    handles, labels = _legend(grid)
    figure.legend(handles, labels, loc="outside upper center", ncols=5, frameon=False, fontsize=9)
    return figure


def binned(errors: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return points (b, 2), metres in x and y: the rms that q predicts and the rms of the errors, by bins of q.

    Bins have equally many of the errors (r, M); registrations with the same predicted size stay in one bin.
    """
    predicted, squared = np.trace(q[:, :2, :2], axis1=1, axis2=2), (errors[:, :2] ** 2).sum(axis=1)
    edges = np.unique(np.quantile(predicted, np.linspace(0, 1, _BINS + 1))) if len(predicted) else np.empty(0)
    place = np.clip(np.searchsorted(edges, predicted, side="right") - 1, 0, max(len(edges) - 2, 0))
    bins = [place == number for number in np.unique(place)]
    return np.array(
        [(np.sqrt(predicted[b].mean()), np.sqrt(squared[b].mean())) for b in bins if b.sum() >= _FEWEST]
    ).reshape(-1, 2)


def _against_sigma(axes: Axes, closures: Closures, kind: str) -> None:
    for method, colour in _METHODS.items():
        if method in closures.methods and len(points := binned(*closures.described(method, kind))):
            marker = "s" if len(points) == 1 else "."
            axes.plot(*points.T, marker=marker, color=colour, linewidth=1.3, label=_label(method))
    axes.set(xscale="log", yscale="log")
    axes.axline((1.0, 1.0), (2.0, 2.0), color="black", linewidth=0.8)
    axes.grid(alpha=0.3)


def _dumbbells(axes: Axes, rows: pd.DataFrame, heights: np.ndarray, column: str, limits: tuple[float, float]) -> None:
    values = {kind: rows[f"{kind}{column}"].astype(float).clip(*limits).to_numpy() for kind in _MARKERS}
    colours = [families.style(method).colour for method in rows["method"]]
    axes.hlines(heights, values["held_out_"], values[""], colors=colours, linewidth=1.2, alpha=0.6)
    for kind, (marker, face) in _MARKERS.items():
        for value, height, colour in zip(values[kind], heights, colours, strict=True):
            axes.plot(value, height, marker, color=colour, mfc=face if face == "none" else colour, ms=6)


def _order(table: pd.DataFrame) -> list[str]:
    """Return the methods, the best first: by the mean log likelihood of placed errors, over all surveys."""
    likelihood = table["placed_log_likelihood"].astype(float).groupby(table["method"]).mean()
    return [str(method) for method in likelihood.sort_values(ascending=False, kind="stable").index]


def _label(method: str) -> str:
    labels = {GOLD: "label (monte_carlo)", SPLIT: "label, copy split", MEASURED_PAIR: "Q_ij (measured_pair, an oracle)"}
    return labels.get(method, method)


def _legend(grid: np.ndarray) -> tuple[list[Artist], list[str]]:
    handles: dict[str, Artist] = {}
    for axes in grid.ravel():
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    return list(handles.values()), list(handles)


def _nothing() -> Figure:
    figure = Figure((plots.WIDTH_IN, 0.6))
    figure.text(0.5, 0.5, "no survey here closes a loop", ha="center", va="center", fontsize=10)
    return figure
