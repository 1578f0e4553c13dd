"""What the label stage prints of a survey's labels: quantiles, how the registrations went, and warnings."""

import numpy as np
import pandas as pd

from pointnetkl.registration.covariance import table

_QUANTILES = (0.05, 0.25, 0.50, 0.75, 0.95)


def lines(survey: str, labels: pd.DataFrame, prior_sigma_m: float, target: float | None = None) -> list[str]:
    """Return what to print of a survey's labels (label_table.LABELS)."""
    q = table.to_matrices(labels)
    smaller, larger = np.linalg.eigvalsh(q[:, :2, :2]).T
    percent = " ".join(f"{100 * share:8.0f}%" for share in _QUANTILES)
    text = [f"eigenvalues of the labels, m^2  {percent}"]
    text += [_quantiles(f"{name}, {survey}", values) for name, values in (("smaller", smaller), ("larger", larger))]
    if q.shape[1] == 3:
        text.append(_quantiles(f"sigma of yaw in rad, {survey}", np.sqrt(q[:, 2, 2])))
    return text + _registrations(labels) + _target(labels, target) + _warnings(survey, labels, prior_sigma_m)


def _quantiles(name: str, values: np.ndarray) -> str:
    return f"{f'  {name}':<31} " + " ".join(f"{value:9.3g}" for value in np.quantile(values, _QUANTILES))


def _registrations(labels: pd.DataFrame) -> list[str]:
    runs, relative = labels["runs"], labels["relative_error"]
    return [
        f"registrations a label {runs.median():g} ({runs.min()} to {runs.max()}),"
        f" converged {labels['converged_share'].mean():.3g}, in the main basin {labels['main_basin_share'].mean():.3g}",
        f"relative standard error {relative.median():.3g} (in 95 % of the submaps below {relative.quantile(0.95):.3g})",
    ]


def _target(labels: pd.DataFrame, target: float | None) -> list[str]:
    if target is None:
        return []
    met = int((labels["relative_error"] <= target).sum())
    return [f"target of a relative standard error of {target:g} met in {met} of {len(labels)} submaps"]


def _warnings(survey: str, labels: pd.DataFrame, prior_sigma_m: float) -> list[str]:
    self_matching, unsettled = labels[labels["self_matching"]], labels[labels["converged_share"] < 0.5]
    text = []
    if len(self_matching):
        text.append(
            f"WARNING: {survey} is self-matching in {len(self_matching)} of {len(labels)} submaps: spacing"
            f" {self_matching['spacing_m'].median():.1f} m exceeds the prior's sigma {prior_sigma_m:g} m, so"
            " the copy can register to itself; use label.copy: split"
        )
    if len(unsettled):
        text.append(
            f"WARNING: {survey} has {len(unsettled)} of {len(labels)} submaps on which under half of the registrations"
            " converged: such a label says more about where they started or stopped than about the ground; see"
            " registration.max_iterations, max_distance_m and plane_epsilon"
        )
    return text
