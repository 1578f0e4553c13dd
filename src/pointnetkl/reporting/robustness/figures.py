"""Charts of SLAM with wrong loop closures: error, precision and recall against the share that is false."""

from collections.abc import Iterator

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pointnetkl.reporting import paper
from pointnetkl.reporting.drawing import plots, sheet
from pointnetkl.reporting.robustness import numbers as robustness

_COLOURS = (plots.GREEN, plots.RED, plots.ORANGE, plots.GREY, plots.BLUE, plots.PURPLE, plots.SKY)
_MARKERS = "*oDs^vX"
_NO_CLOSURES = "no test survey has loop closures"


def figures(found: robustness.Found) -> Iterator[tuple[str, Figure]]:
    """Yield the figures of stage stress, by name."""
    cells = robustness.summarised(robustness.judged(found.rows))
    yield "robustness", error(cells)
    yield "robustness_gate", gate(cells)


def error(cells: pd.DataFrame) -> Figure:
    """Draw the error against the share of false closures: a row of panels a survey, a column a kernel, a line a method.

    `cells` are robustness.summarised; the error is against the truth, against GT where that is not known. Surveys
    without loop closures are not shown.
    """
    if cells.empty:
        return sheet.no_track()
    cells = _with_closures(cells)
    surveys, kernels = list(cells["survey"].unique()), list(cells["kernel"].unique())
    if not surveys:
        return sheet.nothing(_NO_CLOSURES)
    figure = Figure((plots.WIDTH_IN, 0.8 + 2.1 * len(surveys)), layout="constrained")
    grid = figure.subplots(len(surveys), len(kernels), squeeze=False, sharex=True, sharey="row")
    for line, survey in zip(grid, surveys, strict=True):
        rows = cells[cells["survey"] == survey]
        known = rows["truth_rmse_xyz_m"].notna().any()
        column, against = ("truth_rmse_xyz_m", "truth") if known else ("rmse_xyz_m", "GT")
        for axes, kernel in zip(line, kernels, strict=True):
            _lines(axes, rows[rows["kernel"] == kernel], "method", [column])
            axes.set_yscale("log")
            axes.set_title(kernel, fontsize=9)
        plots.plain_log(line[0], "y")
        line[0].set_ylabel(f"{paper.title(survey)}\nRMSE, {against} (m)", fontsize=9)
    figure.supxlabel("loop closures that are false (% of all)", fontsize=9)
    _legend(figure, grid[0, 0])
    return figure


def gate(cells: pd.DataFrame) -> Figure:
    """Draw precision and recall of each estimator as a gate: a column of panels a survey, a line a kernel.

    Mean over the methods; the band spans them. Surveys without loop closures are not shown.
    """
    if cells.empty:
        return sheet.no_track()
    cells = _with_closures(cells)
    surveys = list(cells["survey"].unique())
    if not surveys:
        return sheet.nothing(_NO_CLOSURES)
    figure = Figure((plots.WIDTH_IN, 4.6), layout="constrained")
    grid = figure.subplots(2, len(surveys), squeeze=False, sharex=True, sharey=True)
    for column, survey in zip(grid.T, surveys, strict=True):
        for axes, name in zip(column, ("precision", "recall"), strict=True):
            of = cells[cells["survey"] == survey].groupby(["kernel", "share"], sort=False)[name]
            spread = of.agg(["mean", "min", "max"]).reset_index()
            _lines(axes, spread, "kernel", ["mean", "min", "max"])
            axes.set_ylim(-0.04, 1.04)
        column[0].set_title(paper.title(survey), fontsize=10)
    for axes, name in zip(grid[:, 0], ("precision", "recall"), strict=True):
        axes.set_ylabel(name, fontsize=9)
    figure.supxlabel("loop closures that are false (% of all)", fontsize=9)
    _legend(figure, grid[0, 0])
    return figure


def _with_closures(cells: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of surveys with loop closures: a gate has nothing to judge where there are none."""
    judged = cells.loc[cells[["precision", "recall"]].notna().any(axis=1), "survey"]
    return cells[cells["survey"].isin(judged)]


def _lines(axes: Axes, rows: pd.DataFrame, by: str, columns: list[str]) -> None:
    for place, (name, of) in enumerate(rows.groupby(by, sort=False)):
        colour, marker = (kinds[place % len(kinds)] for kinds in (_COLOURS, _MARKERS))
        # a little apart, because most lie upon each other
        x, values = 100 * of["share"] + 0.5 * place, of[columns].astype(float)
        axes.plot(x, values[columns[0]], marker=marker, color=colour, linewidth=1, markersize=5, label=name)
        if len(columns) > 1:
            axes.fill_between(x, values[columns[1]], values[columns[2]], color=colour, alpha=0.15, linewidth=0)
    axes.tick_params(labelsize=8)
    axes.grid(alpha=0.3)


def _legend(figure: Figure, axes: Axes) -> None:
    handles, names = axes.get_legend_handles_labels()
    if handles:
        figure.legend(handles, names, loc="outside upper center", ncols=len(names), frameon=False, fontsize=9)
