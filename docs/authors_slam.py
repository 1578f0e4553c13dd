"""Draw docs/authors_slam.png: what the slip in the authors' whitening does to a covariance.

Run `python docs/authors_slam.py`; docs/authors_slam.md explains the figure.
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from pointnetkl.reporting.drawing import plots
from pointnetkl.slam.benchmark import authors_slips

# Covariance of x and y, m^2, that the authors' program has for their Antarctic survey
ANTARCTIC = np.array([[3.35, -3.13], [-3.13, 5.45]])
_ANGLES = np.linspace(0, 2 * np.pi, 181)


def whitening(q: np.ndarray) -> Figure:
    """Draw a covariance q (2, 2) in m^2 as it is and as the slip makes it act.

    On the left are the 95 % ellipses, on the right the cost of a residual of 1 m by its direction.
    """
    covariances = {
        "as given: r' = Lᵀ r": (q, plots.GREEN, "-"),
        "as it acts: r' = L r": (authors_slips.acting(q), plots.RED, "--"),
    }
    figure = Figure((plots.WIDTH_IN, 4.2), layout="constrained")
    plan, cost = figure.subplots(1, 2)
    directions = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)])
    for name, (covariance, colour, style) in covariances.items():
        ellipse = plots.RADIUS_95 * np.linalg.cholesky(covariance) @ directions
        costs = np.sum(directions * np.linalg.solve(covariance, directions), axis=0)
        plan.plot(*ellipse, style, color=colour, linewidth=2, label=name)
        cost.plot(np.rad2deg(_ANGLES), costs, style, color=colour, linewidth=2)
        _, vectors = np.linalg.eigh(covariance)
        plan.axline((0, 0), vectors[:, -1], color=colour, linewidth=0.8, linestyle=":")
    plan.set(xlabel="x (m)", ylabel="y (m)", aspect="equal", title="95 % ellipse of Q")
    cost.set(xlabel="direction of the residual from x to y (°)", ylabel="|r'|², for a residual of 1 m", xlim=(0, 180))
    cost.set(title="what the optimiser pays", ylim=(0, None), xticks=range(0, 181, 45))
    for axes in (plan, cost):
        axes.grid(alpha=0.3)
    figure.legend(*plan.get_legend_handles_labels(), loc="outside upper center", ncols=2, frameon=False)
    return figure


if __name__ == "__main__":
    Path(__file__).with_suffix(".png").write_bytes(plots.png(whitening(ANTARCTIC)))
