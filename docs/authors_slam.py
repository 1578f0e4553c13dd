"""What the slip in the authors' whitening does to a covariance, as docs/authors_slam.md shows it."""

import numpy as np
from matplotlib.figure import Figure

from pointnetkl.reporting.drawing import plots
from pointnetkl.slam.benchmark import authors_slips

# m^2, of x and y: the block that the authors' program has for their Antarctic survey
ANTARCTIC = np.array([[3.35, -3.13], [-3.13, 5.45]])
_TURN = np.linspace(0, 2 * np.pi, 181)


def whitening(q: np.ndarray) -> Figure:
    """Draw a covariance q (2, 2) in m^2 as given and as it acts: 95 % ellipses, and the cost of a residual of 1 m."""
    kinds = {
        "as given: r' = Lᵀ r": (q, plots.GREEN, "-"),
        "as it acts: r' = L r": (authors_slips.acting(q), plots.RED, "--"),
    }
    figure = Figure((plots.WIDTH_IN, 4.2), layout="constrained")
    plan, cost = figure.subplots(1, 2)
    u = np.stack([np.cos(_TURN), np.sin(_TURN)])
    for name, (each, colour, style) in kinds.items():
        plan.plot(*(plots.RADIUS_95 * np.linalg.cholesky(each) @ u), style, color=colour, linewidth=2, label=name)
        cost.plot(np.rad2deg(_TURN), np.sum(u * np.linalg.solve(each, u), axis=0), style, color=colour, linewidth=2)
        _, vectors = np.linalg.eigh(each)
        plan.axline((0, 0), vectors[:, -1], color=colour, linewidth=0.8, linestyle=":")
    plan.set(xlabel="x (m)", ylabel="y (m)", aspect="equal", title="95 % ellipse of Q")
    cost.set(xlabel="direction of the residual from x to y (°)", ylabel="|r'|², for a residual of 1 m", xlim=(0, 180))
    cost.set(title="what the optimiser pays", ylim=(0, None), xticks=range(0, 181, 45))
    for axes in (plan, cost):
        axes.grid(alpha=0.3)
    figure.legend(*plan.get_legend_handles_labels(), loc="outside upper center", ncols=2, frameon=False)
    return figure
