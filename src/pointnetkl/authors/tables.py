"""Tables I and II from the authors' arrays, beside the paper's own numbers."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pointnetkl.authors.consolidated import SURVEYS, Consolidated
from pointnetkl.registration.covariance import gaussian
from pointnetkl.reporting import intervals, paper
from pointnetkl.reporting.text_table import Block, block
from pointnetkl.surveys import voxel

_QUANTILES = (0.05, 0.5, 0.95)


@dataclass(frozen=True)
class Predictions:
    """Labels and predicted covariances of one set of submaps, m^2."""

    label: np.ndarray  # (k, 2, 2)
    network: np.ndarray  # (k, 2, 2)
    constant_train: np.ndarray  # (2, 2), mean of the training labels


def table_1(files: Mapping[str, Consolidated]) -> list[Block]:
    """Return Table I of files by their stems, sigma_z pooled over all points, and a table of priors and labels."""
    columns = ("file", "survey", "submaps", "paper_submaps", "points_mean", "rho_mean_m")
    sigmas = ("sigma_z", "paper_sigma_z", "ratio_sigma_z")
    return [
        block(
            "Table I. The authors' arrays: submaps, and spread of the normalised points.",
            [_sizes(name, file) for name, file in files.items()],
            [*columns, *sigmas],
        ),
        block(
            "Variance of the prior, and quantiles of the eigenvalues of the labels, m².",
            [{"file": name, **_prior_and_quantiles(file)} for name, file in files.items()],
            ["file", "prior_mean", *_quantile_columns()],
        ),
    ]


def table_2(sets: Mapping[str, Predictions], kl_floor_m2: float, block_submaps: int, seed: int) -> list[Block]:
    """Return Table II: KL(label || Q) in nats of PointNetKL on each set, the paper's value, and two constant Q.

    The floor is added to label and Q, except for `mean_floor0`, because the paper's loss has none. The intervals are by
    bootstrap over blocks of `block_submaps` consecutive submaps.
    """
    rng = np.random.default_rng(seed)
    rows = [
        _divergences(name, predictions, kl_floor_m2, intervals.resamples(len(predictions.label), rng, block_submaps))
        for name, predictions in sets.items()
    ]
    columns = ("set", "survey", "submaps", "mean", "ci_low", "ci_high", "median", "mean_floor0", "paper")
    caption = f"Table II. KL divergence of PointNetKL on the authors' arrays, nats, {kl_floor_m2:g} m² added to both."
    return [block(caption, rows, [*columns, "constant_train", "constant"])]


def _sizes(name: str, file: Consolidated) -> dict[str, object]:
    survey, sigma = SURVEYS.get(name), voxel.sigma_z(file.clouds)
    printed = paper.DATASETS.get(survey) if survey else None
    return {
        "file": name,
        "survey": survey and paper.title(survey),
        "submaps": len(file),
        "points_mean": len(file.clouds.points) / len(file),
        "rho_mean_m": float(file.clouds.radius.mean()),
        "sigma_z": sigma,
        "paper_submaps": printed and printed.submaps,
        "paper_sigma_z": printed and printed.sigma_z,
        "ratio_sigma_z": printed and sigma / printed.sigma_z,
    }


def _prior_and_quantiles(file: Consolidated) -> dict[str, float]:
    eigenvalues = np.quantile(np.linalg.eigvalsh(file.label), _QUANTILES, axis=0)
    cells = dict(zip(_quantile_columns(), eigenvalues.T.ravel().tolist(), strict=True))
    return {"prior_mean": float(np.trace(file.prior, axis1=1, axis2=2).mean() / 2), **cells}


def _quantile_columns() -> list[str]:
    return [f"{size}_{100 * quantile:.0f}" for size in ("smaller", "larger") for quantile in _QUANTILES]


def _divergences(name: str, predictions: Predictions, floor: float, draws: np.ndarray) -> dict[str, object]:
    survey, label = SURVEYS.get(name), predictions.label
    kl = gaussian.divergence(label, predictions.network, floor)
    low, high = intervals.mean_ci95(kl, draws)
    constants = {"constant_train": predictions.constant_train, "constant": label.mean(axis=0)}
    return {
        "set": name,
        "survey": survey and paper.title(survey),
        "submaps": len(label),
        "mean": float(kl.mean()),
        "ci_low": low,
        "ci_high": high,
        "median": float(np.median(kl)),
        "mean_floor0": float(gaussian.divergence(label, predictions.network, 0.0).mean()),
        "paper": paper.KL.get(survey or name),
        **{key: float(gaussian.divergence(label, q, floor).mean()) for key, q in constants.items()},
    }
