"""How far methods' covariances are from the labels, and how well they describe errors: in all, by class, size, copy."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from pointnetkl.registration.covariance import gaussian, label_table, table
from pointnetkl.reporting import intervals, terrain
from pointnetkl.reporting.results import GOLD, OURS, Labels, Settings, Test

# m^2, of a label's larger eigenvalue: a position known to 0.1 m, to 1 m, or worse
_SIZES = {"below 0.01": (0.0, 0.01), "0.01 to 1": (0.01, 1.0), "above 1": (1.0, np.inf)}


@dataclass(frozen=True)
class Judged:
    """Estimates of some submaps, with the labels and errors that judge them."""

    labels: np.ndarray  # (k, M, M)
    covariances: Mapping[str, np.ndarray]  # by method, each (k, M, M)
    held_out: np.ndarray  # (k, H, M) errors that no label has seen

    def take(self, submaps: np.ndarray) -> "Judged":
        """Return the same for some of the submaps, by a mask or indices."""
        covariances = {method: q[submaps] for method, q in self.covariances.items()}
        return Judged(self.labels[submaps], covariances, self.held_out[submaps])


def judged(labels: Labels, test: Test) -> Judged:
    """Return a test survey's estimates with their labels and errors."""
    return Judged(labels.q, test.covariances, test.held_out)


def divergences(name: str, estimates: Judged, settings: Settings) -> dict[str, Any]:
    """Return how far each method's covariances are from the labels, nats; intervals are over submaps.

    `network_better` is the share of the bootstrap's draws in which `network` has the lower mean. Every method sees
    the same draws, which depend on `name`.
    """
    floor, labels = settings.kl_floor_m2, estimates.labels
    draws = intervals.resamples(len(labels), intervals.rng(settings.seed, name), settings.block_submaps)
    rivals = _without_gold(estimates)
    summaries = {method: intervals.kl_summary(labels, q, floor, draws) for method, q in rivals.items()}
    if OURS in summaries and len(labels) >= intervals.FEWEST:
        kl = {method: gaussian.divergence(labels, q, floor) for method, q in rivals.items()}
        for method in summaries.keys() - {OURS}:
            summaries[method]["network_better"] = intervals.share_better(kl[OURS], kl[method], draws)
    return summaries


def calibrations(estimates: Judged) -> dict[str, Any]:
    """Return how well each method's covariances describe the errors that no label has seen, if there are any."""
    if estimates.held_out.size == 0:
        return {}
    with_gold = {GOLD: estimates.labels, **estimates.covariances}
    return {method: gaussian.calibration(estimates.held_out, q) for method, q in with_gold.items()}


def by_class(
    name: str, estimates: Judged, classes: np.ndarray, trained: Collection[str], settings: Settings
) -> dict[str, Any]:
    """Return divergences and calibrations by terrain class, and whether a training submap is of that class.

    `classes` (k,) are those of the submaps, `trained` those of the training submaps.
    """
    present = [terrain_class for terrain_class in terrain.CLASSES if np.any(classes == terrain_class)]
    parts = {terrain_class: estimates.take(classes == terrain_class) for terrain_class in present}
    return {
        terrain_class: {
            "submaps": len(part.labels),
            "in_training": terrain_class in trained,
            "kl": divergences(f"{name}.{terrain_class}", part, settings),
            "calibration": calibrations(part),
        }
        for terrain_class, part in parts.items()
    }


def by_size(estimates: Judged, settings: Settings) -> dict[str, Any]:
    """Return each method's mean KL, with the floor and without, by the larger eigenvalue of the label in x, y."""
    larger = np.linalg.eigvalsh(estimates.labels[:, :2, :2])[:, -1]
    parts = {size: estimates.take((larger >= low) & (larger < high)) for size, (low, high) in _SIZES.items()}
    return {
        size: {"submaps": len(part.labels), "kl": _means(part.labels, _without_gold(part), settings.kl_floor_m2)}
        for size, part in parts.items()
        if len(part.labels)
    }


def by_copy(name: str, labels: Labels, test: Test, variations: pd.DataFrame, settings: Settings) -> dict[str, Any]:
    """Return each method's mean KL to labels of both copies, on the submaps that have both.

    `variations` has the schema label_table.VARIATIONS. Of it the labels under the survey's own spacing and noise count.
    """
    varied = variations[variations["survey"] == name]
    usual = varied[varied["study"] == label_table.RUNS]
    rows = varied[varied["study"] == label_table.CONDITIONS]
    for condition in ("noise_sigma_m", "cell_m"):
        rows = rows[rows[condition].isin(usual[condition])]
    copies = {}
    for copy, labelled in rows.groupby("copy"):
        submaps = np.searchsorted(labels.submap, labelled["submap"])
        covariances = {method: q[submaps] for method, q in test.covariances.items()}
        means = _means(table.to_matrices(labelled), covariances, settings.kl_floor_m2)
        copies[str(copy)] = {"submaps": len(labelled), "kl": means}
    return copies


def _without_gold(estimates: Judged) -> dict[str, np.ndarray]:
    return {method: q for method, q in estimates.covariances.items() if method != GOLD}


def _means(labels: np.ndarray, covariances: Mapping[str, np.ndarray], floor: float) -> dict[str, dict[str, float]]:
    return {
        method: {
            "mean": float(gaussian.divergence(labels, q, floor).mean()),
            "mean_floor0": float(gaussian.divergence(labels, q, 0.0).mean()),
        }
        for method, q in covariances.items()
    }
