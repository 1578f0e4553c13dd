"""How sure labels are: over a survey, by number of runs, and by point spacing and noise (label_table.VARIATIONS)."""

from collections.abc import Iterator

import numpy as np
import pandas as pd
from scipy.special import digamma

from pointnetkl.registration.covariance import gaussian, table
from pointnetkl.registration.covariance.label_table import CONDITIONS, RUNS

SIDES = ("smaller", "larger")
QUALITY = (  # what `quality` returns
    *("runs", "runs_min", "runs_max", "relative_error", "relative_error_q95", "bias_m", "bias_q95_m", "bias_share"),
    *("converged_share", "main_basin_share", "main_basin_share_q05", "iterations"),
)
_FEWEST = 3  # parts of one size: the spread of fewer says nothing


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


def accuracy(rows: pd.DataFrame) -> pd.DataFrame:
    """Return how far labels of few runs are from those of all, by survey, submap and runs, as far as parts repeat.

    `relative_error` is the root mean square, over parts and over the two axes of the label of all runs, of the error
    of the variance along an axis, as a share of it; `kl_mean`, `kl_low`, `kl_high` are the mean and the 5 and 95 %
    quantiles over parts of KL(label of all || label of the part), nats. All are raised to what they would be against
    the truth: a part of L of the N runs shares those with the label of all, which takes L / N off its squared error.
    """
    columns = ["survey", "submap", "runs", "parts", "relative_error", "kl_mean", "kl_low", "kl_high"]
    by_submap = rows[rows["study"] == RUNS].groupby(["survey", "submap"], sort=False)
    errors = [
        {"survey": survey, "submap": number, **error}
        for (survey, number), parts in by_submap
        for error in _by_runs(parts)
    ]
    return pd.DataFrame(errors, columns=columns)


def gaussian_error(runs: np.ndarray) -> np.ndarray:
    """Return the relative standard error of a variance of so many Gaussian errors of known mean."""
    return np.asarray(np.sqrt(2 / np.asarray(runs)))


def gaussian_kl(runs: np.ndarray, M: int = 2) -> np.ndarray:
    """Return the expected KL(Q || Q_L), nats, of labels of L > M + 1 Gaussian errors, as Q_L has a Wishart's law."""
    freedom = np.asarray(runs, float)
    logarithm = sum(digamma((freedom - i) / 2) for i in range(M)) + M * np.log(2 / (freedom - 1))
    return np.asarray(0.5 * (M * (freedom - 1) / (freedom - M - 1) - M + logarithm))


def by_spacing(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the labels under the usual noise, whatever their spacing, with their eigenvalues."""
    return _labels(rows, "noise_sigma_m")


def by_noise(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the labels of the survey's own spacing, whatever their noise, with their eigenvalues."""
    return _labels(rows, "cell_m")


def conditions(rows: pd.DataFrame) -> pd.DataFrame:
    """Return all labels under varied conditions with their eigenvalues, m^2."""
    return _with_eigenvalues(rows[rows["study"] == CONDITIONS])


def growth(noises: np.ndarray, values: np.ndarray) -> float | None:
    """Return the power of the noise with which values grow, from the smallest noise above 0 to the largest.

    2 means that the noise alone makes the values, 0 that it does not matter. None with fewer than two such noises.
    """
    positive = np.flatnonzero(noises > 0)
    if len(positive) < 2:
        return None
    low, high = positive[np.argmin(noises[positive])], positive[np.argmax(noises[positive])]
    return float(np.log(values[high] / values[low]) / np.log(noises[high] / noises[low]))


def _by_runs(labels: pd.DataFrame) -> Iterator[dict[str, float]]:
    """Yield the error of the labels of one submap by their number of runs."""
    q, runs = table.to_matrices(labels)[:, :2, :2], labels["runs"].to_numpy()
    everything, whole = int(runs.max()), q[runs.argmax()]
    axes = np.linalg.eigh(whole)[1]
    true = np.einsum("ia,ij,ja->a", axes, whole, axes)
    for count in np.unique(runs[runs * _FEWEST <= everything]):
        parts = q[runs == count]
        share = 1 - count / everything
        wrong = np.einsum("ia,nij,ja->na", axes, parts, axes) / true - 1
        kl = gaussian.kl_divergence(whole, parts) / share
        yield {
            "runs": int(count),
            "parts": len(parts),
            "relative_error": float(np.sqrt(np.mean(wrong**2) / share)),
            "kl_mean": float(kl.mean()),
            "kl_low": float(np.quantile(kl, 0.05)),
            "kl_high": float(np.quantile(kl, 0.95)),
        }


def _labels(rows: pd.DataFrame, usual: str) -> pd.DataFrame:
    # the labels that the number of runs was studied on were made under the usual conditions
    wanted = rows[rows["study"] == RUNS].groupby("survey")[usual].first()
    varied = rows[rows["study"] == CONDITIONS]
    return _with_eigenvalues(varied[varied[usual] == varied["survey"].map(wanted)])


def _with_eigenvalues(rows: pd.DataFrame) -> pd.DataFrame:
    values = np.linalg.eigvalsh(table.to_matrices(rows)[:, :2, :2])
    return rows.assign(**{f"{side}_m2": values[:, i] for i, side in enumerate(SIDES)}).reset_index(drop=True)
