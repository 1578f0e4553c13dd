"""Charts of the results: a figure is a function of a table, and only the report stage saves it."""

import io
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from PIL import Image

from pointnetkl import paper, text_table

# Okabe and Ito's colours, which colour-blind readers tell apart
BLUE, ORANGE, GREEN, RED, PURPLE, SKY, GREY = (
    "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#777777"
)  # fmt: skip
WIDTH_IN, DPI = 8.5, 130
_LARGEST = 250_000  # bytes of a saved figure: a larger one is saved in 256 colours


def png(figure: Figure) -> bytes:
    """Return the figure as PNG, without dates or version names: the same figure, the same bytes."""
    figure.set_dpi(DPI)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # type: ignore[no-untyped-call]
    pixels = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
    image = Image.fromarray(pixels[..., :3])
    whole = _encoded(image)
    return whole if len(whole) < _LARGEST else _encoded(image.quantize(256, dither=Image.Dither.NONE))


def _encoded(image: Image.Image) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


def training(loss: pd.DataFrame) -> Figure:
    """Draw the KL divergence in training and validation by optimiser step, and mark the weights that were kept.

    `loss` has the columns step, training, validation (nats; validation may be missing between evaluations).
    """
    figure = Figure((WIDTH_IN, 3.6), layout="constrained")
    axes = figure.subplots()
    judged = loss.dropna(subset=["validation"])
    axes.plot(loss["step"], loss["training"], color=SKY, linewidth=1, label="training, since the point before")
    axes.plot(judged["step"], judged["validation"], color=BLUE, marker=".", label="validation")
    if len(judged):
        best = judged.loc[judged["validation"].idxmin()]
        axes.axvline(best["step"], color=GREY, linestyle=":", linewidth=1)
        axes.plot(best["step"], best["validation"], "o", mfc="none", mec=RED, markersize=10)
        axes.annotate(
            f"kept: step {best['step']:.0f}, {best['validation']:.3g} nats",
            (best["step"], best["validation"]), xytext=(0, 14), textcoords="offset points", color=RED, ha="right",
        )  # fmt: skip
    axes.set(xlabel="optimiser step", ylabel="KL divergence (nats)", yscale="log")
    plain_log(axes, "y")
    axes.grid(alpha=0.3)
    axes.legend(frameon=False)
    return figure


def divergence(kl: pd.DataFrame) -> Figure:
    """Draw each method's mean KL divergence to the labels with its interval, a panel per survey.

    `kl` has a row per survey and method: mean, ci_low, ci_high (nats).
    """
    figure, panels = _panels(kl, "KL(label || Q), mean and 95 % interval (nats)")
    for axes, rows in panels:
        _dots(axes, rows["mean"], _colours(rows["method"]))
        _whiskers(axes, rows, _colours(rows["method"]))
        _paper_marks(axes, rows, "paper")
        axes.set_xscale("log")
        plain_log(axes, "x")
    _legend_once(figure)
    return figure


def calibration(nees: pd.DataFrame) -> Figure:
    """Draw each method's normalised NEES on held-out errors, a panel per survey; above 1 is too sure.

    `nees` has a row per survey and method: nees.
    """
    figure, panels = _panels(nees, "eᵀ Q⁻¹ e / 2, mean over held-out errors (1 is right; above it, too sure)")
    for axes, rows in panels:
        _dots(axes, rows["nees"], _colours(rows["method"]))
        axes.axvline(1.0, color=GREY, linestyle=":", linewidth=1)
        axes.set_xscale("log")
        plain_log(axes, "x")
    return figure


def slam_error(slam: pd.DataFrame) -> Figure:
    """Draw each method's trajectory error against GT and against truth, a panel per survey.

    `slam` has a row per survey and method, metres: rmse_xyz_m with ci_low and ci_high, truth_rmse_xyz_m,
    paper_rmse_xyz_m.
    """
    figure, panels = _panels(slam, "RMSE of submap positions, no alignment (m)")
    for axes, rows in panels:
        _dots(axes, rows["rmse_xyz_m"], [BLUE] * len(rows), "against GT")
        _whiskers(axes, rows, [BLUE] * len(rows))
        _dots(axes, rows["truth_rmse_xyz_m"], [ORANGE] * len(rows), "against truth", 0.25, "s")
        _paper_marks(axes, rows, "paper_rmse_xyz_m")
        axes.set_xscale("log")
        plain_log(axes, "x")
    _legend_once(figure)
    return figure


def eigenvalues(labels: Mapping[str, np.ndarray], prior_m2: float, floor_m2: float) -> Figure:
    """Draw the spread of the labels' eigenvalues: {survey: (k, 2) m^2, smaller first}.

    Boxes span the quartiles, whiskers 5 to 95 %. Crosses are the same quantiles of the authors' network's Q.
    """
    figure = Figure((WIDTH_IN, 1.1 + 0.75 * len(labels)), layout="constrained")
    axes = figure.subplots()
    for row, (survey, values) in enumerate(labels.items()):
        for side, (name, colour) in enumerate((("smaller", BLUE), ("larger", ORANGE))):
            height = row + 0.2 * (2 * side - 1)
            _box(axes, values[:, side], height, colour)
            if survey in paper.EIGENVALUES:
                quantiles = paper.EIGENVALUES[survey][name]
                axes.plot(quantiles, [height + 0.14] * len(quantiles), "x", color=colour, markersize=5)
    for value, text, side_ in ((prior_m2, "prior ", "right"), (floor_m2, " floor", "left")):
        axes.axvline(value, color=GREY, linestyle=":", linewidth=1)
        axes.annotate(text, (value, -0.55), color=GREY, va="top", ha=side_)
    for name, style in (("smaller", {"color": BLUE}), ("larger", {"color": ORANGE})):
        axes.plot([], [], linewidth=6, alpha=0.6, label=f"{name} eigenvalue", **style)  # type: ignore[arg-type]
    axes.plot([], [], "x", color=GREY, label="the authors' network")
    axes.set(xscale="log", xlabel="eigenvalue of the label (m²)", ylim=(len(labels) - 0.4, -0.6))
    axes.set_yticks(range(len(labels)), [paper.title(survey) for survey in labels])
    plain_log(axes, "x")
    axes.grid(axis="x", alpha=0.3)
    figure.legend(loc="outside upper center", ncols=3, frameon=False)
    return figure


def accuracy_time(kl: pd.DataFrame, seconds: Mapping[str, float]) -> Figure:
    """Draw mean KL divergence (nats) against seconds per submap, a panel per survey; lower left is better.

    `kl` as for `divergence`; a method without a time is left out.
    """
    timed = kl[kl["method"].isin(list(seconds))]
    figure, panels = _grid(timed, 3.6)
    for axes, rows in panels:
        times = rows["method"].map(seconds).to_numpy(float)
        _front(axes, times, rows["mean"].to_numpy(float))
        axes.scatter(times, rows["mean"].astype(float), c=_colours(rows["method"]), zorder=3)
        for i, place in enumerate(np.argsort(times)):
            # above and below by turns, so that neighbours' names do not meet
            shift, side = (5, "bottom") if i % 2 else (-5, "top")
            at = (times[place], rows["mean"][place])
            name = axes.annotate(rows["method"][place], at, (0, shift), textcoords="offset points", fontsize=7.5)
            name.set(ha="center", va=side)
        axes.set(xscale="log", yscale="log", xlabel="seconds per submap, one thread", ylabel="mean KL (nats)")
        axes.margins(0.2)
        plain_log(axes, "x")
        plain_log(axes, "y")
    return figure


def _grid(table: pd.DataFrame, height_in: float) -> tuple[Figure, list[tuple[Axes, pd.DataFrame]]]:
    """Return a figure with a panel for each survey of the table, two in a row, and the survey's rows."""
    surveys = list(dict.fromkeys(table["survey"]))
    across = min(2, max(1, len(surveys)))
    down = -(-len(surveys) // across)
    figure = Figure((WIDTH_IN, height_in * max(1, down)), layout="constrained")
    grid = figure.subplots(max(1, down), across, squeeze=False).ravel()
    for axes, survey in zip(grid, surveys, strict=False):
        axes.set_title(paper.title(survey))
        axes.grid(alpha=0.3)
    for axes in grid[len(surveys) :]:
        axes.remove()
    rows = [table[table["survey"] == survey].reset_index(drop=True) for survey in surveys]
    return figure, list(zip(grid, rows, strict=False))


def _panels(table: pd.DataFrame, label: str) -> tuple[Figure, list[tuple[Axes, pd.DataFrame]]]:
    """Return the same with a line for each method, its name at the side."""
    methods = int(table.groupby("survey").size().max()) if len(table) else 1
    figure, panels = _grid(table, 0.9 + 0.24 * methods)
    for axes, rows in panels:
        axes.set_ylim(len(rows) - 0.4, -0.6)
        axes.set_yticks(range(len(rows)), rows["method"])
    figure.supxlabel(label, fontsize="medium")
    return figure, panels


def _dots(
    axes: Axes,
    values: pd.Series,
    colours: Sequence[str],
    label: str | None = None,
    shift: float = 0.0,
    marker: str = "o",
) -> None:
    heights = np.arange(len(values)) + shift
    axes.scatter(values.astype(float), heights, c=list(colours), marker=marker, s=24, label=label, zorder=3)


def _whiskers(axes: Axes, rows: pd.DataFrame, colours: Sequence[str]) -> None:
    low, high = rows["ci_low"].astype(float), rows["ci_high"].astype(float)
    axes.hlines(np.arange(len(rows)), low, high, colors=list(colours), linewidth=1.5)


def _paper_marks(axes: Axes, rows: pd.DataFrame, column: str) -> None:
    known = rows[column].notna()
    axes.plot(rows[column][known], rows.index[known], "D", mfc="none", mec=GREY, label="the paper (its own data)")


def _legend_once(figure: Figure) -> None:
    handles, names = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=3, frameon=False)


def _box(axes: Axes, values: np.ndarray, height: float, colour: str) -> None:
    q05, q25, q50, q75, q95 = np.quantile(values, paper.QUANTILES)
    axes.plot([q05, q95], [height, height], color=colour, linewidth=1.2)
    axes.barh(height, q75 - q25, left=q25, height=0.2, color=colour, alpha=0.6)
    axes.plot([q50, q50], [height - 0.13, height + 0.13], color="black", linewidth=1.5)


def _front(axes: Axes, times: np.ndarray, means: np.ndarray) -> None:
    order = np.lexsort((means, times))
    best = np.minimum.accumulate(means[order])
    axes.step(times[order], best, where="post", color=GREY, linestyle=":", linewidth=1)


def _colours(methods: pd.Series) -> list[str]:
    special = {"pointnetkl": RED, "network": RED, "monte_carlo": GREEN}
    return [special.get(method, BLUE) for method in methods]


def plain_log(axes: Axes, which: str) -> None:
    """Write plain numbers at a logarithmic axis, x or y, as many as its decades leave room for."""
    axis, decades = axes.xaxis if which == "x" else axes.yaxis, _decades(axes, which)
    subs = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0) if decades < 0.8 else (1.0, 2.0, 5.0) if decades < 2.5 else (1.0,)
    axis.set_major_locator(LogLocator(subs=subs, numticks=30))
    axis.set_major_formatter(FuncFormatter(lambda value, _: text_table.cell(float(value))))
    axis.set_minor_formatter(NullFormatter())


def _decades(axes: Axes, which: str) -> float:
    low, high = axes.get_xlim() if which == "x" else axes.get_ylim()
    return float(np.log10(high / low)) if low > 0 else np.inf
