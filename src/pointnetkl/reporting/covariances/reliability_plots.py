"""Nominal against observed coverage of ellipses, at every level."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy import stats

from pointnetkl.registration.covariance import catalogue, gaussian
from pointnetkl.reporting import paper
from pointnetkl.reporting.drawing import families, plots, sheet

LEVELS = np.array([0.005, *np.arange(0.01, 1.0, 0.01), 0.995])
EMPTY = pd.DataFrame({"survey": [], "method": [], "nominal": [], "observed": []})
_TICKS = (0, 20, 40, 60, 80, 95)
_DASHES = ("-", "--", ":", "-.")  # of a family's methods, which share a colour


def coverage(
    survey: str, held_out: np.ndarray, covariances: Mapping[str, np.ndarray], methods: Sequence[str]
) -> pd.DataFrame:
    """Return the share of errors (k, H, M) inside each method's ellipses: survey, method, nominal, observed.

    `covariances` are (k, M, M) in m^2 by method; a method that is not among them is left out.
    """
    bounds = stats.chi2.ppf(LEVELS, held_out.shape[-1])
    tables = [
        pd.DataFrame({"survey": survey, "method": method, "nominal": LEVELS, "observed": _inside(held_out, q, bounds)})
        for method, q in ((name, covariances[name]) for name in methods if name in covariances)
    ]
    return pd.concat([EMPTY, *tables], ignore_index=True)


def reliability(table: pd.DataFrame) -> Figure:
    """Draw observed against nominal coverage of each method's ellipses, a panel for each survey.

    `table` has the columns of `coverage`. Below the diagonal a method is overconfident.
    """
    if table.empty:
        return sheet.no_held_out()
    surveys = list(dict.fromkeys(table["survey"]))
    across = min(3, len(surveys))
    down = -(-len(surveys) // across)
    figure = Figure((plots.WIDTH_IN, 0.7 + down * (8.0 / max(2, across) + 0.3)), layout="constrained")
    grid = figure.subplots(down, across, squeeze=False, sharex=True, sharey=True).ravel()
    for axes, survey in zip(grid, surveys, strict=False):
        axes.plot([0, 100], [0, 100], color="black", linewidth=0.8)
        for method, rows in table[table["survey"] == survey].groupby("method", sort=False):
            family, dashes = families.style(str(method)), _dashes(str(method), table)
            wide = 2.4 if family is families.GOLD else 1.6
            percent = 100 * rows[["nominal", "observed"]].to_numpy(float)
            axes.plot(*percent.T, dashes, color=family.colour, linewidth=wide, label=method)
        axes.set(xlim=(0, 100), ylim=(0, 100), aspect="equal", xticks=_TICKS, yticks=_TICKS)
        axes.set_title(paper.title(survey), fontsize=10)
        axes.grid(alpha=0.3)
    for axes in grid[len(surveys) :]:
        axes.remove()
    figure.supxlabel("nominal coverage (%)", fontsize=10)
    figure.supylabel("errors inside the ellipse (%)", fontsize=10)
    handles, names = grid[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=4, frameon=False, fontsize=9, handlelength=3)
    return figure


def _inside(errors: np.ndarray, q: np.ndarray, bounds: np.ndarray) -> np.ndarray:
    ordered = np.sort(gaussian.squared_mahalanobis(errors, q), axis=None)
    return np.searchsorted(ordered, bounds, side="right") / len(ordered)


def _dashes(method: str, table: pd.DataFrame) -> str:
    kin = [name for name in dict.fromkeys(table["method"]) if catalogue.family(name) is catalogue.family(method)]
    return _DASHES[kin.index(method) % len(_DASHES)]
