"""Monte Carlo labels: perturb a submap, register it back, many times; the covariance of the outcome (Eq. 5, 6)."""

import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from pointnetkl import gicp
from pointnetkl.covariance import gaussian
from pointnetkl.errors import PointNetKLError
from pointnetkl.submap import Submap

# Streams of random numbers: held-out errors share no draw with the label. Not 0, which NumPy's seeding ignores.
LABEL, HELD_OUT = 1, 2

LABELS = pa.schema(
    [
        ("submap", pa.int32()),
        ("q_xx_m2", pa.float64()),
        ("q_xy_m2", pa.float64()),
        ("q_yy_m2", pa.float64()),
        ("mean_x_m", pa.float64()),  # of the errors: the registration's bias, part of Q
        ("mean_y_m", pa.float64()),
        ("runs", pa.int32()),
        ("converged_share", pa.float64()),
        ("main_basin_share", pa.float64()),
        ("iterations_mean", pa.float64()),
        ("se_xx_m2", pa.float64()),  # standard errors of q_xx, q_xy, q_yy, from the errors' fourth moments
        ("se_xy_m2", pa.float64()),
        ("se_yy_m2", pa.float64()),
        ("spacing_m", pa.float64()),  # median distance to the nearest neighbour, in the cloud registered to
        ("self_matching", pa.bool_()),
    ]
)

_NOISE_BYTES = 1 << 20  # of noise held at once: what a core's cache holds, and never much memory
_SMALLEST_BASIN_M = 0.05  # registrations closer than this are in one basin, however tight the rest


class MonteCarloError(PointNetKLError):
    """A submap cannot be labelled, or a setting of the labels makes no sense."""


@dataclass(frozen=True)
class Settings:
    """Section `label` of the parameters."""

    seed: int
    copy: str  # same: the very points of the submap (the paper); split: its two halves, from alternate pings
    prior_variance_m2: float  # a of Sigma_sample = a I
    noise_sigma_m: float  # of each coordinate of the copy
    held_out_runs: int

    def __post_init__(self) -> None:
        """Refuse what makes no sense.

        Raises:
            MonteCarloError: a setting is out of its range.
        """
        if self.copy not in ("same", "split"):
            raise MonteCarloError(f"label.copy is {self.copy!r}, must be same or split")
        if not (self.prior_variance_m2 > 0 and self.noise_sigma_m >= 0 and self.held_out_runs >= 0):
            raise MonteCarloError(
                f"label has prior_variance_m2 {self.prior_variance_m2}, noise_sigma_m {self.noise_sigma_m} and"
                f" held_out_runs {self.held_out_runs}; the first must be positive, the others not negative"
            )


@dataclass(frozen=True)
class Outcome:
    """What became of L registrations of one submap."""

    errors: np.ndarray  # (L, 2) metres, in the submap's frame: e_l = log(exp(T_hat)^-1 T) of Eq. 5
    converged: np.ndarray  # (L,) bool
    iterations: np.ndarray  # (L,) int32


def generator(settings: Settings, submap: Submap, stream: int) -> np.random.Generator:
    """Return the source of a submap's draws: the same whatever the workers, order or other submaps."""
    return np.random.default_rng([settings.seed, zlib.crc32(submap.survey.encode()), submap.number, stream])


def errors(
    submap: Submap, runs: int, rng: np.random.Generator, settings: Settings, registration: gicp.Settings
) -> Outcome:
    """Return the errors of `runs` registrations of a perturbed, noisy copy of a submap onto the submap.

    Draws, in this order: the translations (runs, 2) float64, then each run's noise (n, 3) float32, points in the
    order of the prepared cloud.

    Raises:
        GicpError: a cloud of the submap cannot be registered.
    """
    source, target = _clouds(submap, settings, registration)
    return _errors(source, target, runs, rng, settings, registration)


def covariance(errors: np.ndarray) -> np.ndarray:
    """Return Q = 1/(L-1) sum e e^T (Eq. 6), (2, 2) in m^2, of errors (L, 2); the mean is not subtracted.

    Raises:
        MonteCarloError: fewer than two errors.
    """
    if len(errors) < 2:
        raise MonteCarloError(f"a covariance needs at least 2 registrations, not {len(errors)}; raise label_runs")
    return np.asarray(errors.T @ errors / (len(errors) - 1))


def standard_errors(errors: np.ndarray) -> np.ndarray:
    """Return the standard errors (3,) of the covariance's xx, xy and yy, in m^2, by the errors' fourth moments."""
    x, y = errors.T
    products = np.stack([x * x, x * y, y * y])
    return np.asarray(products.std(axis=1) / np.sqrt(len(errors)))


def main_basin_share(errors: np.ndarray) -> float:
    """Return the share of errors (L, 2) within three robust sigmas of the main mode: 0.99 for a Gaussian.

    Along each principal axis the mode and sigma are those of the shortest interval that holds half of the errors
    (Rousseeuw's shortest half), so a second basin moves neither as long as it holds under half of them.
    """
    axes = np.linalg.eigh(errors.T @ errors)[1]
    along = errors @ axes
    ordered, half = np.sort(along, axis=0), len(along) // 2
    starts = np.argmin(ordered[half:] - ordered[: len(along) - half], axis=0)
    low, high = ordered[starts, (0, 1)], ordered[starts + half, (0, 1)]
    sigma = np.maximum((high - low) / (2 * 0.6745), _SMALLEST_BASIN_M)  # 0.6745: a Gaussian's upper quartile
    return float(np.mean(np.linalg.norm((along - (low + high) / 2) / sigma, axis=1) <= 3))


@dataclass(frozen=True)
class Label:
    """A submap's label and the error samples behind it."""

    row: dict[str, Any]  # of the table LABELS
    errors: np.ndarray  # (L, 2) metres
    held_out: np.ndarray  # (settings.held_out_runs, 2) metres, not used for the label


def label(submap: Submap, runs: int, settings: Settings, registration: gicp.Settings) -> Label:
    """Return a submap's Monte Carlo label from `runs` registrations, and the samples.

    Raises:
        MonteCarloError: fewer than two runs.
        GicpError: a cloud of the submap cannot be registered.
        CovarianceError: the label is not positive definite.
    """
    source, target = _clouds(submap, settings, registration)
    outcome, held_out = (
        _errors(source, target, count, generator(settings, submap, stream), settings, registration)
        for count, stream in ((runs, LABEL), (settings.held_out_runs, HELD_OUT))
    )
    q = gaussian.check(covariance(outcome.errors), f"{submap.survey}, submap {submap.number}, label")
    return Label(
        row={
            **_row(q, outcome),
            "submap": submap.number,
            "spacing_m": target.spacing_m,
            # only a copy of the very points can register to itself
            "self_matching": settings.copy == "same" and target.spacing_m > np.sqrt(settings.prior_variance_m2),
        },
        errors=outcome.errors,
        held_out=held_out.errors,
    )


def _row(q: np.ndarray, outcome: Outcome) -> dict[str, Any]:
    xx, xy, yy = standard_errors(outcome.errors)
    x, y = outcome.errors.mean(axis=0)
    return {
        "q_xx_m2": q[0, 0],
        "q_xy_m2": q[0, 1],
        "q_yy_m2": q[1, 1],
        "mean_x_m": x,
        "mean_y_m": y,
        "runs": len(outcome.errors),
        "converged_share": outcome.converged.mean(),
        "main_basin_share": main_basin_share(outcome.errors),
        "iterations_mean": outcome.iterations.mean(),
        "se_xx_m2": xx,
        "se_xy_m2": xy,
        "se_yy_m2": yy,
    }


def _clouds(submap: Submap, settings: Settings, registration: gicp.Settings) -> tuple[gicp.Cloud, gicp.Cloud]:
    if settings.copy == "split":
        return gicp.prepare(submap.second, registration), gicp.prepare(submap.first, registration)
    cloud = gicp.prepare(submap.points, registration)
    return cloud, cloud


def _errors(
    source: gicp.Cloud,
    target: gicp.Cloud,
    runs: int,
    rng: np.random.Generator,
    settings: Settings,
    registration: gicp.Settings,
) -> Outcome:
    n = len(source.points)
    moved = rng.standard_normal((runs, 2)) * np.sqrt(settings.prior_variance_m2)
    together = max(1, _NOISE_BYTES // (12 * n))
    found = []
    for start in range(0, runs, together):
        some = moved[start : start + together]
        noise = rng.standard_normal((len(some), n, 3), dtype=np.float32) * np.float32(settings.noise_sigma_m)
        found.append(gicp.register_noisy(source, target, some, noise, registration))
    if not found:
        return Outcome(np.zeros((0, 2)), np.zeros(0, np.bool_), np.zeros(0, np.int32))
    return Outcome(
        # the copy was moved by t_l, so the perturbation that the registration found is minus its translation
        errors=moved + np.concatenate([f.translation for f in found]),
        converged=np.concatenate([f.converged for f in found]),
        iterations=np.concatenate([f.iterations for f in found]),
    )
