"""Charts of the results: a figure is a function of a table, and only the report stage saves it."""

import io
from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from PIL import Image

from pointnetkl.reporting import paper, text_table

# Okabe and Ito's colours, which colour-blind readers tell apart
BLUE, ORANGE, GREEN, RED, PURPLE, SKY, GREY = (
    "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#777777"
)  # fmt: skip
WIDTH_IN, DPI = 8.5, 130
RADIUS_95 = float(np.sqrt(-2 * np.log(0.05)))  # in sigmas, of the ellipse that holds 95 % of a Gaussian in the plane
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
    image.save(buffer, "PNG")  # optimize=True takes eight times as long and saves 4 %
    return buffer.getvalue()


def without_held_out() -> Figure:
    """Return a figure that says why there is nothing to draw of held-out errors."""
    figure = Figure((WIDTH_IN, 0.6))
    figure.text(0.5, 0.5, "no held-out errors: label.held_out_runs is 0", ha="center", va="center", fontsize=10)
    return figure


def training(losses: Mapping[str, pd.DataFrame]) -> Figure:
    """Draw the KL divergence in training and validation by optimiser step, and mark the weights that were kept.

    A panel for each model. A loss has the columns step, training, validation (nats; validation may be missing between
    evaluations, training at step 0, before there was any).
    """
    figure = Figure((WIDTH_IN, 0.5 + 2.9 * len(losses)), layout="constrained")
    grid = figure.subplots(len(losses), 1, squeeze=False, sharex=False).ravel()
    for axes, (model, loss) in zip(grid, losses.items(), strict=True):
        trained, judged = loss.dropna(subset=["training"]), loss.dropna(subset=["validation"])
        axes.plot(trained["step"], trained["training"], color=SKY, lw=1, label="training, since the point before")
        axes.plot(judged["step"], judged["validation"], color=BLUE, marker=".", label="validation")
        axes.set(xlabel="optimiser step", ylabel="KL divergence (nats)", yscale="log")
        axes.set_title(model + (_mark_kept(axes, judged) if len(judged) else ""), fontsize=10)
        plain_log(axes, "y")
        axes.grid(alpha=0.3)
    figure.legend(*grid[0].get_legend_handles_labels(), loc="outside upper center", ncols=2, frameon=False)
    return figure


def _mark_kept(axes: Axes, judged: pd.DataFrame) -> str:
    """Ring the least validation divergence; return what the title says of it."""
    best = judged.loc[judged["validation"].idxmin()]
    axes.axvline(best["step"], color=GREY, linestyle=":", linewidth=1)
    axes.plot(best["step"], best["validation"], "o", mfc="none", mec=RED, markersize=10)
    return f", kept: step {best['step']:.0f}, {best['validation']:.3g} nats"


def eigenvalues(labels: Mapping[str, np.ndarray], prior_m2: float, floor_m2: float) -> Figure:
    """Draw the spread of the labels' eigenvalues: {survey: (k, 2) m^2, smaller first}.

    Boxes span the quartiles, whiskers 5 to 95 %. Crosses are the same quantiles of the authors' network's Q.
    """
    figure = Figure((WIDTH_IN, 1.1 + 0.75 * len(labels)), layout="constrained")
    axes = figure.subplots()
    axes.use_sticky_edges = False  # of boxes: on a logarithmic axis they would cut whiskers off
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


def _box(axes: Axes, values: np.ndarray, height: float, colour: str) -> None:
    q05, q25, q50, q75, q95 = np.quantile(values, paper.QUANTILES)
    axes.plot([q05, q95], [height, height], color=colour, linewidth=1.2)
    axes.barh(height, q75 - q25, left=q25, height=0.2, color=colour, alpha=0.6)
    axes.plot([q50, q50], [height - 0.13, height + 0.13], color="black", linewidth=1.5)


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
