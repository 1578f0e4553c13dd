"""A survey's labels in a few lines of text, beside what the paper's authors got on theirs."""

import numpy as np
import pandas as pd

from pointnetkl.registration.covariance import table
from pointnetkl.reporting import paper, text_table

# The authors' network is known on one survey of each place: the guide to every survey there.
_PLACES = {"borno": "borno_8", "antarctica": "thwaites_11", "thwaites": "thwaites_11"}

QUALITY = (  # what `quality` returns
    *("runs", "runs_min", "runs_max", "relative_error", "relative_error_q95", "bias_m", "bias_q95_m", "bias_share"),
    *("converged_share", "main_basin_share", "main_basin_share_q05", "iterations"),
)


def quality(labels: pd.DataFrame) -> dict[str, float]:
    """Return how sure a survey's labels are and how their registrations went, over its submaps.

    A quantile is over submaps: `_q95` of relative_error is what 95 % of them are at or below. `bias` is the mean
    error; `bias_share` the median of its square's share of the label's trace.
    """
    bias = np.hypot(labels["mean_x_m"], labels["mean_y_m"])
    return {
        "runs": float(labels["runs"].median()),
        "runs_min": int(labels["runs"].min()),
        "runs_max": int(labels["runs"].max()),
        "relative_error": float(labels["relative_error"].median()),
        "relative_error_q95": float(labels["relative_error"].quantile(0.95)),
        "bias_m": float(bias.median()),
        "bias_q95_m": float(bias.quantile(0.95)),
        "bias_share": float((bias**2 / (labels["q_xx_m2"] + labels["q_yy_m2"])).median()),
        "converged_share": float(labels["converged_share"].mean()),
        "main_basin_share": float(labels["main_basin_share"].mean()),
        "main_basin_share_q05": float(labels["main_basin_share"].quantile(0.05)),
        "iterations": float(labels["iterations_mean"].mean()),
    }


def lines(survey: str, labels: pd.DataFrame, prior_sigma_m: float, target: float | None = None) -> list[str]:
    """Return what to print of a survey's labels (label_table.LABELS): eigenvalue quantiles and warnings."""
    q = table.to_matrices(labels)
    smaller, larger = np.linalg.eigvalsh(q[:, :2, :2]).T
    percent = " ".join(f"{100 * share:8.0f}%" for share in paper.QUANTILES)
    text = [f"eigenvalues of the labels, m^2  {percent}"]
    text += [
        _line(f"  {name}, {survey}", np.quantile(values, paper.QUANTILES))
        for name, values in (("smaller", smaller), ("larger", larger))
    ]
    known = next((of for place, of in _PLACES.items() if survey.startswith(place)), None)
    if known is not None:
        # a loose guide, never a goal: those predictions were 1.06 and 1.99 nats off
        text += [_line(f"  {name}, authors' network", v) for name, v in paper.EIGENVALUES[known].items()]
    if q.shape[1] == 3:
        text.append(_line(f"  sigma of yaw in rad, {survey}", np.sqrt(np.quantile(q[:, 2, 2], paper.QUANTILES))))
    return text + _quality(labels) + _target(labels, target) + _warnings(survey, labels, prior_sigma_m)


def _line(name: str, quantiles: np.ndarray | tuple[float, ...]) -> str:
    return f"{name:<31} " + " ".join(f"{value:9.3g}" for value in quantiles)


def _quality(labels: pd.DataFrame) -> list[str]:
    of = {name: text_table.cell(value, 3) for name, value in quality(labels).items()}
    return [
        f"registrations a label {of['runs']} ({of['runs_min']} to {of['runs_max']}), converged"
        f" {of['converged_share']}, in the main basin {of['main_basin_share']}, {of['iterations']} iterations",
        f"relative standard error {of['relative_error']} (in 95 % of the submaps below {of['relative_error_q95']}),"
        f" mean error {of['bias_m']} m (below {of['bias_q95_m']} m)",
    ]


def _target(labels: pd.DataFrame, target: float | None) -> list[str]:
    if target is None:
        return []
    met = int((labels["relative_error"] <= target).sum())
    return [f"target of a relative standard error of {target:g} met in {met} of {len(labels)} submaps"]


def _warnings(survey: str, labels: pd.DataFrame, prior_sigma_m: float) -> list[str]:
    alike, lost = labels[labels["self_matching"]], labels[labels["converged_share"] < 0.5]
    text = []
    if len(alike):
        text.append(
            f"WARNING: {survey} is self-matching in {len(alike)} of {len(labels)} submaps: spacing"
            f" {alike['spacing_m'].median():.1f} m exceeds the prior's sigma {prior_sigma_m:g} m, so"
            " the copy can register to itself; use label.copy: split"
        )
    if len(lost):
        text.append(
            f"WARNING: {survey} has {len(lost)} of {len(labels)} submaps on which under half of the registrations"
            " converged: such a label tells more of where they started or stopped than of the ground; see"
            " registration.max_iterations, max_distance_m and plane_epsilon"
        )
    return text
