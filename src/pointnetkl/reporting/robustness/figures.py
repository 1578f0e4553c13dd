"""Charts of SLAM with false loop closures: error, precision and recall against the share that is false."""

from collections.abc import Iterator

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pointnetkl.reporting import paper
from pointnetkl.reporting.drawing import plots, sheet
from pointnetkl.reporting.robustness import numbers
from pointnetkl.reporting.robustness.numbers import StressTest

_COLOURS = (plots.GREEN, plots.RED, plots.ORANGE, plots.GREY, plots.BLUE, plots.PURPLE, plots.SKY)
_MARKERS = "*oDs^vX"
_NO_CLOSURES = "no test survey has loop closures"


def every(stress: StressTest) -> Iterator[tuple[str, Figure]]:
    """Yield the figures of stage stress, by name."""
    cases = numbers.summarise(numbers.from_standard_starts(stress.rows))
    yield "robustness", error(cases)
    yield "robustness_gate", gate(cases)


def error(cases: pd.DataFrame) -> Figure:
    """Draw the error against the share of false closures: a row of panels a survey, a column a kernel, a line a method.

    `cases` are those of `numbers.summarise`. The error is against the truth, or against GT where the truth is not
    known. Surveys without loop closures are not drawn.
    """
    if cases.empty:
        return sheet.no_track()
    cases = _with_closures(cases)
    surveys, kernels = list(cases["survey"].unique()), list(cases["kernel"].unique())
    if not surveys:
        return sheet.nothing(_NO_CLOSURES)
    figure = Figure((plots.WIDTH_IN, 0.8 + 2.1 * len(surveys)), layout="constrained")
    grid = figure.subplots(len(surveys), len(kernels), squeeze=False, sharex=True, sharey="row")
    for line, survey in zip(grid, surveys, strict=True):
        rows = cases[cases["survey"] == survey]
        has_truth = rows["truth_rmse_xyz_m"].notna().any()
        column, reference = ("truth_rmse_xyz_m", "truth") if has_truth else ("rmse_xyz_m", "GT")
        for axes, kernel in zip(line, kernels, strict=True):
            _lines(axes, rows[rows["kernel"] == kernel], "method", [column])
            axes.set_yscale("log")
            axes.set_title(kernel, fontsize=9)
        plots.plain_log(line[0], "y")
        line[0].set_ylabel(f"{paper.title(survey)}\nRMSE, {reference} (m)", fontsize=9)
    figure.supxlabel("loop closures that are false (% of all)", fontsize=9)
    _legend(figure, grid[0, 0])
    return figure


def gate(cases: pd.DataFrame) -> Figure:
    """Draw precision and recall of each estimator as a gate: a column of panels a survey, a line a kernel.

    A line is the mean over the methods, and its band spans them. Surveys without loop closures are not drawn.
    """
    if cases.empty:
        return sheet.no_track()
    cases = _with_closures(cases)
    surveys = list(cases["survey"].unique())
    if not surveys:
        return sheet.nothing(_NO_CLOSURES)
    figure = Figure((plots.WIDTH_IN, 4.6), layout="constrained")
    grid = figure.subplots(2, len(surveys), squeeze=False, sharex=True, sharey=True)
    for column, survey in zip(grid.T, surveys, strict=True):
        for axes, name in zip(column, ("precision", "recall"), strict=True):
            by_share = cases[cases["survey"] == survey].groupby(["kernel", "share"], sort=False)[name]
            _lines(axes, by_share.agg(["mean", "min", "max"]).reset_index(), "kernel", ["mean", "min", "max"])
            axes.set_ylim(-0.04, 1.04)
        column[0].set_title(paper.title(survey), fontsize=10)
    for axes, name in zip(grid[:, 0], ("precision", "recall"), strict=True):
        axes.set_ylabel(name, fontsize=9)
    figure.supxlabel("loop closures that are false (% of all)", fontsize=9)
    _legend(figure, grid[0, 0])
    return figure


def _with_closures(cases: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of surveys with loop closures: without any, a gate has nothing to judge."""
    surveys = cases.loc[cases[["precision", "recall"]].notna().any(axis=1), "survey"]
    return cases[cases["survey"].isin(surveys)]


def _lines(axes: Axes, rows: pd.DataFrame, by: str, columns: list[str]) -> None:
    """Draw a line for each value of column `by`; a second and third of the columns are the ends of its band."""
    for place, (label, line) in enumerate(rows.groupby(by, sort=False)):
        colour, marker = (kinds[place % len(kinds)] for kinds in (_COLOURS, _MARKERS))
        # a little apart, because most lines lie upon each other
        x, values = 100 * line["share"] + 0.5 * place, line[columns].astype(float)
        axes.plot(x, values[columns[0]], marker=marker, color=colour, linewidth=1, markersize=5, label=label)
        if len(columns) > 1:
            axes.fill_between(x, values[columns[1]], values[columns[2]], color=colour, alpha=0.15, linewidth=0)
    axes.tick_params(labelsize=8)
    axes.grid(alpha=0.3)


def _legend(figure: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), frameon=False, fontsize=9)
