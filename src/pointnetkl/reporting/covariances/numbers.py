"""How far methods' covariances are from the labels, and how well they describe errors: whole, by class, size, copy."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from pointnetkl.registration.covariance import gaussian, table
from pointnetkl.reporting import intervals, terrain
from pointnetkl.reporting.labels import numbers as label_study
from pointnetkl.reporting.results import GOLD, OURS, Labels, Settings, Test

# m^2, of a label's larger eigenvalue: a position known to 0.1 m, to 1 m, or worse
_SIZES = {"below 0.01": (0.0, 0.01), "0.01 to 1": (0.01, 1.0), "above 1": (1.0, np.inf)}


@dataclass(frozen=True)
class Judged:
    """Estimates of some submaps, and what they are judged by."""

    labels: np.ndarray  # (k, M, M)
    covariances: Mapping[str, np.ndarray]  # by method, each (k, M, M)
    held_out: np.ndarray  # (k, H, M) errors that no label has seen

    def of(self, which: np.ndarray) -> "Judged":
        """Return the same for some of the submaps, by a mask or indices."""
        return Judged(
            self.labels[which], {name: q[which] for name, q in self.covariances.items()}, self.held_out[which]
        )


def judged(labels: Labels, test: Test) -> Judged:
    """Return a test survey's estimates with their labels and errors."""
    return Judged(labels.q, test.covariances, test.held_out)


def divergences(name: str, of: Judged, settings: Settings) -> dict[str, Any]:
    """Return how far each method's covariances are from the labels, nats; intervals over submaps.

    `network_better`: the share of the bootstrap's draws in which `network` has the lower mean; every method sees the
    same draws.
    """
    floor = settings.kl_floor_m2
    draws = intervals.resamples(len(of.labels), intervals.rng(settings.seed, name), settings.block_submaps)
    found = {method: intervals.kl_summary(of.labels, q, floor, draws) for method, q in _rivals(of).items()}
    if OURS in found and len(of.labels) >= intervals.FEWEST:
        each = {method: gaussian.divergence(of.labels, of.covariances[method], floor) for method in found}
        for method in found.keys() - {OURS}:
            found[method]["network_better"] = intervals.share_better(each[OURS], each[method], draws)
    return found


def calibrations(of: Judged) -> dict[str, Any]:
    """Return how well each method's covariances describe the errors that no label has seen, if there are any."""
    if of.held_out.size == 0:
        return {}
    every = {GOLD: of.labels, **of.covariances}
    return {method: gaussian.calibration(of.held_out, q) for method, q in every.items()}


def by_class(
    name: str, of: Judged, classes: np.ndarray, trained: Collection[str], settings: Settings
) -> dict[str, Any]:
    """Return both for the submaps of each terrain class (k,), and whether a training submap is of that class."""
    present = [each for each in terrain.CLASSES if np.any(classes == each)]
    parts = {each: of.of(classes == each) for each in present}
    return {
        each: {
            "submaps": len(part.labels),
            "in_training": each in trained,
            "kl": divergences(f"{name}.{each}", part, settings),
            "calibration": calibrations(part),
        }
        for each, part in parts.items()
    }


def by_size(of: Judged, settings: Settings) -> dict[str, Any]:
    """Return each method's mean KL, with the floor and without, by the larger eigenvalue of the label in x, y."""
    larger = np.linalg.eigvalsh(of.labels[:, :2, :2])[:, -1]
    parts = {size: of.of((larger >= low) & (larger < high)) for size, (low, high) in _SIZES.items()}
    return {
        size: {"submaps": len(part.labels), "kl": _means(part.labels, _rivals(part), settings.kl_floor_m2)}
        for size, part in parts.items()
        if len(part.labels)
    }


def by_copy(name: str, labels: Labels, test: Test, variations: pd.DataFrame, settings: Settings) -> dict[str, Any]:
    """Return each method's mean KL to labels of both copies, on the submaps that have both.

    `variations` has the schema results.VARIATIONS; its labels under the survey's own spacing and noise count.
    """
    varied = variations[variations["survey"] == name]
    usual = varied[varied["study"] == label_study.RUNS]
    rows = varied[varied["study"] == label_study.CONDITIONS]
    for condition in ("noise_sigma_m", "cell_m"):
        rows = rows[rows[condition].isin(usual[condition])]
    found = {}
    for copy, of in rows.groupby("copy"):
        which = np.searchsorted(labels.submap, of["submap"])
        q = {method: each[which] for method, each in test.covariances.items()}
        means = _means(table.to_matrices(of), q, settings.kl_floor_m2)
        found[str(copy)] = {"submaps": len(of), "kl": means}
    return found


def _rivals(of: Judged) -> dict[str, np.ndarray]:
    return {method: q for method, q in of.covariances.items() if method != GOLD}


def _means(labels: np.ndarray, covariances: Mapping[str, np.ndarray], floor: float) -> dict[str, dict[str, float]]:
    return {
        method: {
            "mean": float(gaussian.divergence(labels, q, floor).mean()),
            "mean_floor0": float(gaussian.divergence(labels, q, 0.0).mean()),
        }
        for method, q in covariances.items()
    }
