"""A survey's labels in a few lines of text, beside what the paper's authors got on theirs."""

import numpy as np
import pandas as pd

from pointnetkl import paper
from pointnetkl.covariance import table

# The authors' network is known on one survey of each place: the guide to every survey there.
_PLACES = {"borno": "borno_8", "antarctica": "thwaites_11", "thwaites": "thwaites_11"}


def lines(survey: str, labels: pd.DataFrame, prior_sigma_m: float) -> list[str]:
    """Return what to print of a survey's labels (monte_carlo.LABELS): eigenvalue quantiles and warnings."""
    smaller, larger = np.linalg.eigvalsh(table.to_matrices(labels)).T
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
    return text + _warning(survey, labels, prior_sigma_m)


def _line(name: str, quantiles: np.ndarray | tuple[float, ...]) -> str:
    return f"{name:<31} " + " ".join(f"{value:9.3g}" for value in quantiles)


def _warning(survey: str, labels: pd.DataFrame, prior_sigma_m: float) -> list[str]:
    if not (count := int(labels["self_matching"].sum())):
        return []
    return [
        f"WARNING: {survey} is self-matching in {count} of {len(labels)} submaps: spacing"
        f" {labels['spacing_m'].median():.1f} m exceeds the prior's sigma {prior_sigma_m:g} m, so the copy can"
        " register to itself; use label.copy: split"
    ]
