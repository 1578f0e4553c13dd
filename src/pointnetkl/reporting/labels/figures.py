"""Figures of labels: their eigenvalues, how networks learn them, and what a label depends on."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator
from numpy.typing import ArrayLike

from pointnetkl.reporting import paper, text_table
from pointnetkl.reporting.drawing import plots
from pointnetkl.reporting.labels import numbers as label_numbers
from pointnetkl.reporting.results import GOLD, Labels

_COPIES = ("same", "split")
_COLOURS = {"smaller": plots.BLUE, "larger": plots.ORANGE}
_SURVEYS = (plots.BLUE, plots.ORANGE, plots.PURPLE, plots.GREEN)
_LOWEST_M2 = 1e-7  # of an axis: a registration stops at steps of 1 mm, so less means nothing


def every(
    labels: Mapping[str, Labels],
    variations: pd.DataFrame,
    losses: Mapping[str, pd.DataFrame],
    runtime: Mapping[str, Any],
    floor_m2: float,
) -> Iterator[tuple[str, Figure]]:
    """Yield the figures by name; `variations` has the schema label_table.VARIATIONS, `losses` are by model."""
    prior_m2 = float(next(iter(labels.values())).parameters["label"]["prior_variance_m2"])
    yield "training", training(losses)
    yield "labels", eigenvalues({name: each.eigenvalues for name, each in labels.items()}, prior_m2, floor_m2)
    yield from dependence(variations, prior_m2, runtime)


def eigenvalues(labels: Mapping[str, np.ndarray], prior_m2: float, floor_m2: float) -> Figure:
    """Draw the spread of the labels' eigenvalues: {survey: (k, 2) m^2, smaller first}.

    Boxes span the quartiles, whiskers 5 to 95 %. Crosses are the same quantiles of the authors' network's Q.
    """
    figure = Figure((plots.WIDTH_IN, 1.1 + 0.75 * len(labels)), layout="constrained")
    axes = figure.subplots()
    axes.use_sticky_edges = False  # of boxes: on a logarithmic axis they would cut whiskers off
    for row, (survey, values) in enumerate(labels.items()):
        for side, (name, colour) in enumerate((("smaller", plots.BLUE), ("larger", plots.ORANGE))):
            height = row + 0.2 * (2 * side - 1)
            _box(axes, values[:, side], height, colour)
            if survey in paper.EIGENVALUES:
                quantiles = paper.EIGENVALUES[survey][name]
                axes.plot(quantiles, [height + 0.14] * len(quantiles), "x", color=colour, markersize=5)
    for value, text, side_ in ((prior_m2, "prior ", "right"), (floor_m2, " floor", "left")):
        axes.axvline(value, color=plots.GREY, linestyle=":", linewidth=1)
        axes.annotate(text, (value, -0.55), color=plots.GREY, va="top", ha=side_)
    for name, style in (("smaller", {"color": plots.BLUE}), ("larger", {"color": plots.ORANGE})):
        axes.plot([], [], linewidth=6, alpha=0.6, label=f"{name} eigenvalue", **style)  # type: ignore[arg-type]
    axes.plot([], [], "x", color=plots.GREY, label="the authors' network")
    axes.set(xscale="log", xlabel="eigenvalue of the label (m²)", ylim=(len(labels) - 0.4, -0.6))
    axes.set_yticks(range(len(labels)), [paper.title(survey) for survey in labels])
    plots.plain_log(axes, "x")
    axes.grid(axis="x", alpha=0.3)
    figure.legend(loc="outside upper center", ncols=3, frameon=False)
    return figure


def training(losses: Mapping[str, pd.DataFrame]) -> Figure:
    """Draw the KL divergence in training and validation by optimiser step, and mark the weights that were kept.

    A panel for each model. A loss has the columns step, training, validation (nats; validation may be missing between
    evaluations, training at step 0, before there was any).
    """
    figure = Figure((plots.WIDTH_IN, 0.5 + 2.9 * len(losses)), layout="constrained")
    grid = figure.subplots(len(losses), 1, squeeze=False, sharex=False).ravel()
    for axes, (model, loss) in zip(grid, losses.items(), strict=True):
        trained, judged = loss.dropna(subset=["training"]), loss.dropna(subset=["validation"])
        axes.plot(trained["step"], trained["training"], color=plots.SKY, lw=1, label="training, since the point before")
        axes.plot(judged["step"], judged["validation"], color=plots.BLUE, marker=".", label="validation")
        axes.set(xlabel="optimiser step", ylabel="KL divergence (nats)", yscale="log")
        axes.set_title(model + (_mark_kept(axes, judged) if len(judged) else ""), fontsize=10)
        plots.plain_log(axes, "y")
        axes.grid(alpha=0.3)
    figure.legend(*grid[0].get_legend_handles_labels(), loc="outside upper center", ncols=2, frameon=False)
    return figure


def dependence(variations: pd.DataFrame, prior_m2: float, runtime: Mapping[str, Any]) -> Iterator[tuple[str, Figure]]:
    """Yield the figures of what a label depends on (label_table.VARIATIONS), by name."""
    runs = runtime.get("machine", {}).get("params", {}).get("runs")
    seconds = runtime[GOLD]["mean_s"] / runs if runs and GOLD in runtime else None
    yield "cost_accuracy", cost_accuracy(label_numbers.accuracy(variations), seconds)
    yield "spacing", spacing(label_numbers.by_spacing(variations), prior_m2)
    yield "noise", noise(label_numbers.by_noise(variations))


def cost_accuracy(accuracy: pd.DataFrame, seconds: float | None) -> Figure:
    """Draw the error of a label against its number of runs, a line for each submap, beside that of Gaussian errors.

    `accuracy` is what label_numbers.accuracy returns; the `seconds` of one registration give a second axis.
    """
    figure = Figure((plots.WIDTH_IN, 4.4), layout="constrained")
    runs = np.geomspace(10, 4000, 100)
    curves = (
        ("relative_error", label_numbers.gaussian_error(runs), "relative error of a variance"),
        ("kl_mean", label_numbers.gaussian_kl(runs), "mean KL(label || label of L runs) (nats)"),
    )
    colours = {survey: _SURVEYS[i % len(_SURVEYS)] for i, survey in enumerate(dict.fromkeys(accuracy["survey"]))}
    for axes, (column, theory, label) in zip(figure.subplots(1, 2), curves, strict=True):
        for (survey, _), rows in accuracy.groupby(["survey", "submap"], sort=False):
            axes.plot(rows["runs"], rows[column], color=colours[survey], marker=".", lw=1.2, alpha=0.8)
        axes.plot(runs, theory, "--", color="black", lw=1.2, label="Gaussian errors", zorder=1)
        axes.set(xscale="log", yscale="log", xlabel="L, registrations per label", ylabel=label)
        axes.grid(alpha=0.3)
        _ticks(axes.xaxis, sorted({3000, *accuracy["runs"]}))
        plots.plain_log(axes, "y")
        if seconds:
            _seconds_axis(axes, seconds)
    for survey, colour in colours.items():
        axes.plot([], [], color=colour, marker=".", label=f"{paper.title(survey)}, a line for each submap")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    return figure


def spacing(labels: pd.DataFrame, prior_m2: float) -> Figure:
    """Draw both eigenvalues of labels against point spacing, a panel for each survey and kind of copy.

    `labels` is what label_numbers.by_spacing returns.
    """
    figure, panels = _panels(labels, "median distance of a point to its nearest (m)")
    spread = float(np.sqrt(prior_m2))
    for axes, rows in panels:
        _eigenvalues(axes, rows, "spacing_m", "cell_m")
        axes.axvline(spread, color=plots.GREY, linestyle=":", label=f"√a = {spread:g} m, the spread of the starts")
        axes.set_xscale("log")
        _ticks(axes.xaxis, [0.5, 1, 2, 3, 5, 10, 20, 50])
    _legend(figure)
    return figure


def noise(labels: pd.DataFrame) -> Figure:
    """Draw both eigenvalues of labels against the noise of the copy, a panel for each survey and kind of copy.

    `labels` is what label_numbers.by_noise returns.
    """
    figure, panels = _panels(labels, "standard deviation of the noise on each coordinate (m)")
    noises = sorted(set(labels["noise_sigma_m"]))
    smallest = min((sigma for sigma in noises if sigma > 0), default=1.0)
    for axes, rows in panels:
        _eigenvalues(axes, rows, "noise_sigma_m", "noise_sigma_m")
        axes.set_xscale("symlog", linthresh=smallest, linscale=0.5)
        _ticks(axes.xaxis, noises)
    _legend(figure)
    return figure


def _panels(labels: pd.DataFrame, label: str) -> tuple[Figure, list[tuple[Axes, pd.DataFrame]]]:
    """Return a figure with a row for each survey, a column for each kind of copy, and the labels of each panel."""
    surveys = list(dict.fromkeys(labels["survey"]))
    figure = Figure((plots.WIDTH_IN, 1.0 + 2.6 * max(1, len(surveys))), layout="constrained")
    grid = figure.subplots(max(1, len(surveys)), len(_COPIES), squeeze=False, sharex=True, sharey=True)
    panels = []
    for line, survey in zip(grid, surveys, strict=False):
        for axes, copy in zip(line, _COPIES, strict=True):
            rows = labels[(labels["survey"] == survey) & (labels["copy"] == copy)]
            axes.set(title=f"{paper.title(survey)}, copy: {copy}", yscale="log")
            axes.grid(alpha=0.3)
            panels.append((axes, rows))
        line[0].set_ylabel("eigenvalue of the label (m²)")
    values = labels[["smaller_m2", "larger_m2"]].to_numpy()
    if len(values):
        grid[0, 0].set_ylim(max(_LOWEST_M2, values.min() / 2), values.max() * 2)
    for side, colour in _COLOURS.items():
        grid[0, 0].plot([], [], color=colour, marker=".", label=f"{side} eigenvalue")
    figure.supxlabel(label, fontsize="medium")
    return figure, panels


def _eigenvalues(axes: Axes, rows: pd.DataFrame, x: str, varied: str) -> None:
    for side, colour in _COLOURS.items():
        for _, labels in rows.groupby("submap", sort=False):
            ordered = labels.sort_values(varied)
            axes.plot(ordered[x], ordered[f"{side}_m2"], color=colour, marker=".", lw=1, alpha=0.6)


def _legend(figure: Figure) -> None:
    handles, names = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=3, frameon=False)


def _ticks(axis: Axis, values: list[float]) -> None:
    axis.set_major_locator(FixedLocator(values))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: text_table.cell(float(value))))


def _seconds_axis(axes: Axes, seconds: float) -> None:
    above = axes.secondary_xaxis("top", functions=(_times(seconds), _times(1 / seconds)))
    above.set_xlabel("seconds per label")
    _ticks(above.xaxis, [10.0**power for power in range(-4, 4)])


def _times(factor: float) -> Callable[[ArrayLike], ArrayLike]:
    return lambda values: np.asarray(values) * factor


def _box(axes: Axes, values: np.ndarray, height: float, colour: str) -> None:
    q05, q25, q50, q75, q95 = np.quantile(values, paper.QUANTILES)
    axes.plot([q05, q95], [height, height], color=colour, linewidth=1.2)
    axes.barh(height, q75 - q25, left=q25, height=0.2, color=colour, alpha=0.6)
    axes.plot([q50, q50], [height - 0.13, height + 0.13], color="black", linewidth=1.5)


def _mark_kept(axes: Axes, judged: pd.DataFrame) -> str:
    """Ring the least validation divergence; return what the title says of it."""
    best = judged.loc[judged["validation"].idxmin()]
    axes.axvline(best["step"], color=plots.GREY, linestyle=":", linewidth=1)
    axes.plot(best["step"], best["validation"], "o", mfc="none", mec=plots.RED, markersize=10)
    return f", kept: step {best['step']:.0f}, {best['validation']:.3g} nats"
