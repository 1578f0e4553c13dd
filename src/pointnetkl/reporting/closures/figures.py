"""Figures of how covariances describe loop closures: by method, by overlap and terrain, and by their own size."""

from collections.abc import Iterator, Mapping

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pointnetkl.registration.covariance.catalogue import PAIR, SPLIT
from pointnetkl.reporting import paper
from pointnetkl.reporting.closures import numbers as closures
from pointnetkl.reporting.closures.numbers import Closures
from pointnetkl.reporting.drawing import families, plots
from pointnetkl.reporting.results import GOLD
from pointnetkl.slam.closures.tables import BUILT, PLACED

_NEES = (0.1, 5000.0)  # shown; what lies beyond stands at the border
_COLOURS = (plots.BLUE, plots.ORANGE, plots.GREEN, plots.PURPLE, plots.RED, plots.SKY)
_SHOWN = {GOLD: plots.GREEN, SPLIT: plots.BLUE, PAIR: "black", "network": plots.RED, "constant": plots.GREY}
_BINS, _FEWEST = 8, 5  # of equally many registrations; and how many make one
_TERRAIN = {"overlap": "share of S_i that its targets cover", "patchiness": "patchiness of S_i's slopes"}


def every(table: pd.DataFrame, found: Mapping[str, Closures]) -> Iterator[tuple[str, Figure]]:
    """Yield all of them by name; `table` as `by_method` takes it, the closures by test survey."""
    yield "calibration_lc", by_method(table)
    yield "closure_ratios", ratios(found)
    yield "closure_sigmas", by_sigma(found)


def by_method(table: pd.DataFrame) -> Figure:
    """Draw each method's NEES and coverage on loop closures, beside placed registrations and held-out errors.

    `table` has a row per survey and method: nees, coverage_95, each also as placed_ and held_out_ (None: unknown).
    """
    if table.empty:
        return _nothing()
    surveys, order = list(dict.fromkeys(table["survey"])), _order(table)
    figure = Figure((plots.WIDTH_IN, 1.6 + 0.38 * len(order)), layout="constrained")
    grid = figure.subplots(2, len(surveys), squeeze=False, sharey=True, sharex="row")
    for axes, survey in zip(grid.T, surveys, strict=True):
        rows = table[table["survey"] == survey]
        heights = np.array([order.index(method) for method in rows["method"]])
        axes[0].set_title(paper.title(survey), fontsize=10)
        _dumbbells(axes[0], rows, heights, "nees", _NEES)
        _dumbbells(axes[1], rows, heights, "coverage_95", (0.0, 1.0))
        axes[0].axvline(1.0, color=plots.GREY, linestyle=":", linewidth=1)
        axes[1].axvline(0.95, color=plots.GREY, linestyle=":", linewidth=1)
        axes[0].set(xscale="log", xlim=(_NEES[0] / 1.3, _NEES[1] * 1.3))
        plots.plain_log(axes[0], "x")
        axes[0].set_xlabel("normalised NEES", fontsize=9)
        axes[1].set_xlabel("inside the 95 % ellipse", fontsize=9)
    grid[0, 0].set_ylim(len(order) - 0.4, -0.6)
    for axes in grid.ravel():
        axes.set_yticks(range(len(order)), order)
        axes.tick_params(labelsize=8)
        axes.grid(alpha=0.3)
    handles = [grid[0, 0].plot([], [], marker, color="black", mfc=face, ls="")[0] for marker, face in _MARKERS.values()]
    figure.legend(handles, _SAID, loc="outside upper center", ncols=3, frameon=False, fontsize=9)
    return figure


_MARKERS = {"": ("o", "black"), "placed_": ("|", "black"), "held_out_": ("o", "none")}
_SAID = ("loop closures of the graph", "the same with every submap where it truly is", "held-out errors of labels")


def ratios(every: Mapping[str, Closures]) -> Figure:
    """Draw the root trace of Q_ij over that of Q_i, of the labels and of copy split, against overlap and patchiness."""
    found = {name: of for name, of in every.items() if len(closures.ratios(of, GOLD))}
    if not found:
        return _nothing()
    figure = Figure((plots.WIDTH_IN, 6.0), layout="constrained")
    grid = figure.subplots(2, 2, sharey=True, sharex="col")
    for line, method in zip(grid, (GOLD, SPLIT), strict=True):
        for axes, (column, label) in zip(line, _TERRAIN.items(), strict=True):
            for colour, (name, of) in zip(_COLOURS * len(found), found.items(), strict=False):
                rows = closures.ratios(of, method)
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


def by_sigma(every: Mapping[str, Closures]) -> Figure:
    """Draw the errors of registrations against what Q said, a panel per survey; below, of placed registrations."""
    found = {name: of for name, of in every.items() if len(of.rows)}
    if not found:
        return _nothing()
    figure = Figure((plots.WIDTH_IN, 1.0 + 2 * 8.0 / max(2.6, len(found))), layout="constrained")
    grid = figure.subplots(2, len(found), squeeze=False, sharex=True, sharey=True)
    for column, (name, of) in zip(grid.T, found.items(), strict=True):
        column[0].set_title(paper.title(name), fontsize=10)
        for axes, kind in zip(column, (BUILT, PLACED), strict=True):
            _against_sigma(axes, of, kind)
    for axes, said in zip(grid[:, 0], ("loop closures", "every submap where it truly is"), strict=True):
        axes.set_ylabel(f"rms error (m)\n{said}", fontsize=9)
    for which in "xy":
        plots.plain_log(grid[0, 0], which)
    figure.supxlabel("rms of what Q says (m); on the line: right, above it: Q is too sure of itself", fontsize=9)
    handles, names = _legend(grid)
    figure.legend(handles, names, loc="outside upper center", ncols=5, frameon=False, fontsize=9)
    return figure


def _against_sigma(axes: Axes, of: Closures, kind: str) -> None:
    for method, colour in _SHOWN.items():
        if method in of.covariances and len(points := binned(*of.judged(method, kind))):
            marker = "s" if len(points) == 1 else "."
            axes.plot(*points.T, marker=marker, color=colour, linewidth=1.3, label=_label(method))
    axes.set(xscale="log", yscale="log")
    axes.axline((1.0, 1.0), (2.0, 2.0), color="black", linewidth=0.8)
    axes.grid(alpha=0.3)


def binned(errors: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return points (b, 2): rms predicted and rms found, metres in x, y, of bins of registrations by what Q says.

    Bins have equally many of the errors (r, M); registrations of one predicted size stay in one bin.
    """
    predicted, found = np.trace(q[:, :2, :2], axis1=1, axis2=2), (errors[:, :2] ** 2).sum(axis=1)
    edges = np.unique(np.quantile(predicted, np.linspace(0, 1, _BINS + 1))) if len(predicted) else np.empty(0)
    place = np.clip(np.searchsorted(edges, predicted, side="right") - 1, 0, max(len(edges) - 2, 0))
    bins = [place == each for each in np.unique(place)]
    return np.array(
        [(np.sqrt(predicted[b].mean()), np.sqrt(found[b].mean())) for b in bins if b.sum() >= _FEWEST]
    ).reshape(-1, 2)


def _dumbbells(axes: Axes, rows: pd.DataFrame, heights: np.ndarray, column: str, shown: tuple[float, float]) -> None:
    values = {which: rows[f"{which}{column}"].astype(float).clip(*shown).to_numpy() for which in _MARKERS}
    colours = [families.of(method).colour for method in rows["method"]]
    axes.hlines(heights, values["held_out_"], values[""], colors=colours, linewidth=1.2, alpha=0.6)
    for which, (marker, face) in _MARKERS.items():
        for value, height, colour in zip(values[which], heights, colours, strict=True):
            axes.plot(value, height, marker, color=colour, mfc=face if face == "none" else colour, ms=6)


def _order(table: pd.DataFrame) -> list[str]:
    """Return the methods, the best first: by how far from 95 % their ellipses are, over all surveys."""
    miss = (table["coverage_95"].astype(float) - 0.95).abs().groupby(table["method"]).mean()
    return [str(method) for method in miss.sort_values(kind="stable").index]


def _label(method: str) -> str:
    return {GOLD: "label (monte_carlo)", SPLIT: "label, copy split", PAIR: "Q_ij (pair, an oracle)"}.get(method, method)


def _legend(grid: np.ndarray) -> tuple[list[Artist], list[str]]:
    found: dict[str, Artist] = {}
    for axes in grid.ravel():
        for handle, name in zip(*axes.get_legend_handles_labels(), strict=True):
            found.setdefault(name, handle)
    return list(found.values()), list(found)


def _nothing() -> Figure:
    figure = Figure((plots.WIDTH_IN, 0.6))
    figure.text(0.5, 0.5, "no survey here closes a loop", ha="center", va="center", fontsize=10)
    return figure
