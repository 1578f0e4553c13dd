"""Charts with a line for each method and a panel for each survey, the best method on top: KL, calibration, SLAM."""

import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pointnetkl.registration.covariance import catalogue
from pointnetkl.reporting import paper, text_table
from pointnetkl.reporting.drawing import families, plots, sheet

_NEES = (0.25, 4.0)  # shown; a value beyond is drawn at the border with its number
_GOOD_NEES = (0.85, 1.15)  # shaded
_REFERENCES = ("navigation", "corrupted", "gt")  # rows of the SLAM table that are of no covariance
_FAR = 4.0  # of the axis, in multiples of what most differences stay below
_MEASURES = {
    "truth_rmse_xyz_m": "not aligned",
    "truth_rmse_se2_m": "aligned (SE(2))",
    "truth_relative_m": "pairs that closures join",
}
_LETTERS = 112  # that fit side by side across the panels of a figure
_GOAL = 0.95  # nominal coverage of the ellipses that are drawn


@dataclass(frozen=True)
class _Panel:
    survey: str
    axes: Axes
    rows: pd.DataFrame
    heights: np.ndarray  # of the rows' methods


def divergence(kl: pd.DataFrame) -> Figure:
    """Draw each method's mean KL divergence to the labels with its interval.

    `kl` has a row per survey and method: mean, ci_low, ci_high, paper (nats).
    """
    order = _order(kl, kl["mean"].astype(float))
    figure, grid = _grid(kl, order, 1)
    for panel in _panels(kl, order, grid[0]):
        panel.axes.set_xscale("log")
        _whiskers(panel)
        _points(panel, "mean")
        published = panel.rows["paper"].notna().to_numpy()
        panel.axes.plot(panel.rows["paper"][published], panel.heights[published], "o", mfc="none", mec="black", ms=9)
        plots.plain_log(panel.axes, "x")
    figure.supxlabel(
        "mean KL(label || Q) and 95 % interval (nats); ring: the paper's, on its own data\n"
        "from top to bottom: by mean rank over all surveys",
        fontsize=9,
    )
    families.legend(figure, order)
    return figure


def calibration(nees: pd.DataFrame) -> Figure:
    """Draw each method's normalised NEES on held-out errors, and below it the coverage of its 95 % ellipses.

    `nees` has a row per survey and method: nees, coverage_95.
    """
    if nees.empty:
        return sheet.no_held_out()
    order = _order(nees, np.abs(np.log(nees["nees"].astype(float))))
    figure, grid = _grid(nees, order, 2)
    for panel in _panels(nees, order, grid[0]):
        _nees(panel)
    for panel in _panels(nees, order, grid[1]):
        panel.axes.axvline(100 * _GOAL, color=plots.GREY, linestyle=":", linewidth=1)
        _gold_line(panel)
        _points(panel, "coverage_95", 100)
        panel.axes.set_xlabel("inside the 95 % ellipse (%)", fontsize=9)
    for axes in grid.ravel():
        axes.set_xlabel(textwrap.fill(axes.get_xlabel(), _LETTERS // grid.shape[1]))
    families.legend(figure, order)
    return figure


def slam_error(slam: pd.DataFrame) -> Figure:
    """Draw each method's trajectory error against GT (filled, with its interval) and against truth (hollow).

    `slam` has a row per survey and method, metres: rmse_xyz_m with ci_low and ci_high, truth_rmse_xyz_m. What no
    covariance made (navigation, corrupted, GT) would stretch the axis: its error stands in the panel's title.
    """
    judged = slam[~slam["method"].isin(_REFERENCES)]
    if judged.empty:
        return sheet.no_track()
    order = _order(judged, judged["rmse_xyz_m"].astype(float))
    figure, grid = _grid(judged, order, 1)
    for panel in _panels(judged, order, grid[0]):
        _whiskers(panel)
        _points(panel, "rmse_xyz_m")
        colours = [families.style(method).colour for method in panel.rows["method"]]
        truth = panel.rows["truth_rmse_xyz_m"].astype(float)
        panel.axes.scatter(truth, panel.heights + 0.2, facecolors="none", edgecolors=colours, s=16)
        references = slam[(slam["survey"] == panel.survey) & slam["method"].isin(_REFERENCES)]
        lines = [textwrap.fill(line, _LETTERS // grid.size) for line in _reference_lines(references)]
        panel.axes.set_title("\n".join([paper.title(panel.survey), *lines]), fontsize=8)
    figure.supxlabel(
        "RMSE of submap positions, no alignment (m); filled: against GT, hollow: against truth", fontsize=9
    )
    families.legend(figure, order)
    return figure


def slam_differences(differences: pd.DataFrame) -> Figure:
    """Draw network's error against the truth less each method's, with the 95 % interval: left of 0 network is better.

    `differences` is slam.numbers.differences: a column of panels for each survey, a row for each measure. What
    lies far beyond the others stands at the border, its number beside it.
    """
    if differences.empty:
        return sheet.nothing("no test survey has the truth and network's solutions")
    relative = differences[differences["measure"] == "truth_relative_m"]
    order = _order(relative, -relative["difference_m"].astype(float))
    figure, grid = _grid(differences, order, len(_MEASURES))
    surveys = differences["survey"].unique()
    for line, (measure, title) in zip(grid, _MEASURES.items(), strict=True):
        rows = differences[differences["measure"] == measure]
        measured = rows["survey"].unique()  # without loop closures there are no pairs
        for panel in _panels(rows, order, [axes for name, axes in zip(surveys, line, strict=True) if name in measured]):
            _differences(panel)
            panel.axes.set_title(f"{paper.title(panel.survey)}: {title}", fontsize=9)
            panel.axes.set_xlabel(f"network's {panel.rows['network_m'].iloc[0]:.4g} less the method's (m)", fontsize=9)
    families.legend(figure, order)
    return figure


def slam_both_ways(both: pd.DataFrame) -> Figure:
    """Draw each method's error against the truth as it should be (filled) and with the authors' slips (hollow).

    `both` is slam.numbers.both_ways.
    """
    if both.empty:
        return sheet.nothing("no test survey has the truth and was solved both ways")
    order = _order(both, both["table_m"])
    figure, grid = _grid(both, order, 1)
    for panel in _panels(both, order, grid[0]):
        colours = [families.style(method).colour for method in panel.rows["method"]]
        panel.axes.hlines(panel.heights, panel.rows["table_m"], panel.rows["authors_m"], colors=colours, linewidth=1)
        _points(panel, "table_m")
        panel.axes.scatter(
            panel.rows["authors_m"], panel.heights, s=45, facecolors="none", edgecolors=colours, zorder=4
        )
    figure.supxlabel("RMSE of submap positions against truth (m); hollow: with the authors' two slips", fontsize=9)
    families.legend(figure, order)
    return figure


def _differences(panel: _Panel) -> None:
    values = panel.rows["difference_m"].astype(float)
    ends = panel.rows[["ci_low", "ci_high", "difference_m"]].astype(float)
    far = _FAR * float(ends.abs().max(axis=1).quantile(0.75)) + 1e-9
    low, high = np.clip([min(0.0, ends.min().min()), max(0.0, ends.max().max())], -far, far)
    edge = 0.06 * (high - low) + 1e-9
    panel.axes.axvline(0, color=plots.GREY, linewidth=1)
    _whiskers(panel)
    _points(replace(panel, rows=panel.rows.assign(shown=values.clip(low, high))), "shown")
    for value, height in zip(values, panel.heights, strict=True):
        if not low <= value <= high:
            place, side = (high - edge, "right") if value > high else (low + edge, "left")
            panel.axes.annotate(f"{value:+.3g}", (place, height), fontsize=8, ha=side, va="center")
    panel.axes.set_xlim(low - edge, high + edge)


def _order(table: pd.DataFrame, badness: pd.Series) -> list[str]:
    """Return the methods from best to worst by the mean rank of their badness over the surveys, gold first."""
    ranks = badness.groupby(table["survey"]).rank().groupby(table["method"]).mean()
    return sorted(ranks.index, key=lambda method: (method != catalogue.MONTE_CARLO, ranks[method]))


def _grid(table: pd.DataFrame, order: Sequence[str], down: int) -> tuple[Figure, np.ndarray]:
    """Return a figure with `down` rows of panels, a column for each survey and a line for each method."""
    across = max(1, table["survey"].nunique())
    figure = Figure((plots.WIDTH_IN, down * (0.9 + 0.19 * max(1, len(order))) + 0.4), layout="constrained")
    grid = figure.subplots(down, across, squeeze=False, sharey=True)
    grid[0, 0].set_ylim(len(order) - 0.4, -0.6)
    grid[0, 0].set_yticks(range(len(order)), order)
    for axes in grid.ravel():
        axes.tick_params(labelsize=8)
        axes.grid(alpha=0.3)
    return figure, grid


def _panels(table: pd.DataFrame, order: Sequence[str], line: Sequence[Axes]) -> Iterator[_Panel]:
    for axes, (survey, rows) in zip(line, table.groupby("survey", sort=False), strict=False):
        axes.set_title(paper.title(str(survey)), fontsize=10)
        yield _Panel(str(survey), axes, rows, np.array([order.index(method) for method in rows["method"]]))


def _points(panel: _Panel, column: str, factor: float = 1.0) -> None:
    values = factor * panel.rows[column].astype(float)
    for method, value, height in zip(panel.rows["method"], values, panel.heights, strict=True):
        style = families.style(method)
        panel.axes.plot(value, height, style.marker, color=style.colour, markersize=6, zorder=3)


def _whiskers(panel: _Panel) -> None:
    low, high = panel.rows["ci_low"].astype(float), panel.rows["ci_high"].astype(float)
    colours = [families.style(method).colour for method in panel.rows["method"]]
    panel.axes.hlines(panel.heights, low, high, colors=colours, linewidth=1.5)


def _nees(panel: _Panel) -> None:
    low, high = _NEES
    values = panel.rows["nees"].astype(float)
    _points(replace(panel, rows=panel.rows.assign(nees=values.clip(low, high))), "nees")
    for value, height in zip(values, panel.heights, strict=True):
        number = _short(value)
        if value > high:
            panel.axes.annotate(f"{number} →", (high / 1.15, height), fontsize=8, ha="right", va="center")
        elif value < low:
            panel.axes.annotate(f"← {number}", (low * 1.15, height), fontsize=8, ha="left", va="center")
    panel.axes.axvspan(*_GOOD_NEES, color=plots.GREY, alpha=0.2, linewidth=0)
    panel.axes.set(xscale="log", xlim=(low / 1.1, high * 1.1))
    plots.plain_log(panel.axes, "x")
    panel.axes.set_xlabel("normalised NEES (1 is right)", fontsize=9)


def _short(value: float) -> str:
    number = text_table.cell(value, 2) if value < 1000 else f"{value:.0e}"
    return number.replace("e+0", "e").replace("e-0", "e-").replace("e+", "e")


def _gold_line(panel: _Panel) -> None:
    gold = panel.rows[panel.rows["method"] == catalogue.MONTE_CARLO]
    for value in gold["coverage_95"].astype(float):
        panel.axes.axvline(100 * value, color=families.GOLD.colour, linestyle="--", linewidth=1)


def _reference_lines(references: pd.DataFrame) -> Iterator[str]:
    """Yield the lines of a panel's title on trajectories that are of no covariance, metres."""
    against = {"rmse_xyz_m": "", "truth_rmse_xyz_m": "truth "}
    for _, row in references.iterrows():
        errors = [f"{word}{text_table.cell(row[name], 3)} m" for name, word in against.items() if pd.notna(row[name])]
        if errors:
            yield f"{row['method']}: {', '.join(errors)}"
