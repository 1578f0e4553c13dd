"""Monte Carlo labels: perturb a submap, register it back, many times; the covariance of the outcome (Eq. 10, 11)."""

import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from pointnetkl.registration import error_statistics, gicp
from pointnetkl.registration.covariance import gaussian, table
from pointnetkl.registration.streams import Stream
from pointnetkl.surveys.se2 import SE2
from pointnetkl.surveys.submap import Submap
from pointnetkl.workflow.errors import PointNetKLError
from pointnetkl.workflow.parameters import require_positive, require_seed
from pointnetkl.workflow.study import MOST_RUNS

# Runs between two checks of the relative error. Fewer may look Gaussian before a second basin shows; 100 reach a basin
# of 5 % of the runs in 99.4 of 100 labels.
_BATCH = 100


class MonteCarloError(PointNetKLError):
    """A submap cannot be labelled."""


@dataclass(frozen=True)
class Settings:
    """Section `label` of the parameters.

    Raises:
        ValueError: a setting is out of its range.
    """

    seed: int
    copy: str  # same: the submap itself (the paper); split: source and target are its halves, from alternate pings
    prior_variance_m2: float  # a of Sigma_sample = a I
    noise_sigma_m: float  # of each coordinate of the copy
    held_out_runs: int
    engine: str = "cpu"  # cpu, or cuda (experimental)
    target_relative_error: float | None = None  # at which a label's runs end early; None: never
    prior_yaw_sigma_rad: float = 0.03  # of the yaw of the perturbation, where yaw is registered

    def __post_init__(self) -> None:
        """Refuse settings out of range."""
        require_seed(self.seed)
        require_positive(self, "prior_variance_m2", "prior_yaw_sigma_rad")
        for name, choices in (("copy", ("same", "split")), ("engine", ("cpu", "cuda"))):
            if getattr(self, name) not in choices:
                raise ValueError(f"{name} is {getattr(self, name)!r}, must be {choices[0]} or {choices[1]}")
        for name in ("noise_sigma_m", "held_out_runs"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} is {getattr(self, name)!r}, must be 0 or above")
        if self.held_out_runs > MOST_RUNS:
            raise ValueError(f"held_out_runs is {self.held_out_runs}, must be at most {MOST_RUNS}")
        if self.target_relative_error is not None:
            require_positive(self, "target_relative_error")


@dataclass(frozen=True)
class Outcome:
    """Outcome of L registrations of one submap."""

    errors: np.ndarray  # (L, M) metres and radians: e_l = log(exp(T_hat)^-1 T) of Eq. 10, see `errors`
    converged: np.ndarray  # (L,) bool
    iterations: np.ndarray  # (L,) int32


def generator(settings: Settings, submap: Submap, stream: Stream) -> np.random.Generator:
    """Return the generator of a submap's draws, which does not depend on workers, order or other submaps."""
    return np.random.default_rng([settings.seed, zlib.crc32(submap.survey.encode()), submap.number, stream])


def errors(
    submap: Submap, runs: int, rng: np.random.Generator, settings: Settings, registration: gicp.Settings
) -> Outcome:
    """Return the errors of `runs` registrations of a perturbed, noisy copy of a submap onto the submap.

    T is the motion of the copy and T_hat its estimate by registration, so exp(T_hat)^-1 T is the residual motion,
    p -> R p + t. With x and y alone (M = 2) the error is e = t. With yaw (M = 3) e = (x, y, yaw) is the residual's
    logarithm in SE(2), in the axes of the submap's frame with the origin at the mean of submap.points: there yaw
    depends least on x and y, and there a canonical cloud has its origin.

    The draws, in this order, are a key (63 bits) and the perturbations (runs, M) float64. The noise of run l is a
    function of (key, l), so the first runs are the same however many follow.

    Raises:
        GicpError: a cloud of the submap cannot be registered.
    """
    return _errors(submap, clouds(submap, settings, registration), runs, rng, settings, registration)


def prior_sigmas(settings: Settings, dimensions: int) -> np.ndarray:
    """Return the standard deviations (M,) of a perturbation, metres and radians: Sigma_sample's."""
    sigma = np.sqrt(settings.prior_variance_m2)
    return np.array([sigma, sigma, settings.prior_yaw_sigma_rad])[:dimensions]


def covariance(errors: np.ndarray) -> np.ndarray:
    """Return Q = 1/(L-1) sum e e^T (Eq. 11), (M, M), of errors (L, M); the mean is not subtracted.

    Raises:
        MonteCarloError: fewer than two errors.
    """
    if len(errors) < 2:
        raise MonteCarloError(f"a covariance needs at least 2 registrations, not {len(errors)}; raise label_runs")
    return np.asarray(errors.T @ errors / (len(errors) - 1))


def summarise(outcome: Outcome) -> dict[str, Any]:
    """Return a label's columns that follow from its registrations: covariance, standard errors, counts and shares.

    Raises:
        MonteCarloError: fewer than two runs.
    """
    q, standard_errors = covariance(outcome.errors), error_statistics.standard_errors(outcome.errors)
    return {
        **table.to_columns(q),
        **{name.replace("q_", "se_", 1): value for name, value in table.to_columns(standard_errors).items()},
        **dict(zip(("mean_x_m", "mean_y_m", "mean_w_rad"), outcome.errors.mean(axis=0), strict=False)),
        "runs": len(outcome.errors),
        "converged_share": outcome.converged.mean(),
        "main_basin_share": error_statistics.main_basin_share(outcome.errors),
        "iterations_mean": outcome.iterations.mean(),
        "relative_error": error_statistics.relative_error(outcome.errors),
    }


@dataclass(frozen=True)
class Label:
    """A submap's label and the error samples behind it."""

    row: dict[str, Any]  # of a table of labels
    errors: np.ndarray  # (L, M) metres and radians; L is row["runs"]
    held_out: np.ndarray  # (settings.held_out_runs, M), not used for the label


def label(submap: Submap, runs: int, settings: Settings, registration: gicp.Settings) -> Label:
    """Return a submap's Monte Carlo label from `runs` registrations, or fewer, and the error samples.

    With settings.target_relative_error the label's relative error is checked every 100 runs, and the runs end when it
    is at the target or below (a sequential stop, Chow and Robbins 1965). The runs until then are those of a label
    without a target. A target that is met does not exclude a second basin that no run has reached: at 0.2, a third of
    the labels with a basin of 1 % of the runs stop before a run reaches it.

    Raises:
        MonteCarloError: fewer than two runs.
        GicpError: a cloud of the submap cannot be registered.
        CovarianceError: the label is not positive definite.
    """
    pair = clouds(submap, settings, registration)
    outcome, held_out = (
        _errors(submap, pair, count, generator(settings, submap, stream), settings, registration, target_error)
        for count, stream, target_error in (
            (runs, Stream.LABEL, settings.target_relative_error),
            (settings.held_out_runs, Stream.HELD_OUT, None),
        )
    )
    gaussian.check(covariance(outcome.errors), f"{submap.survey}, submap {submap.number}, label")
    return Label(
        row={
            **summarise(outcome),
            "submap": submap.number,
            "spacing_m": pair[1].spacing_m,
            # only a copy of the same points can register to itself
            "self_matching": settings.copy == "same" and pair[1].spacing_m > np.sqrt(settings.prior_variance_m2),
        },
        errors=outcome.errors,
        held_out=held_out.errors,
    )


def clouds(submap: Submap, settings: Settings, registration: gicp.Settings) -> tuple[gicp.Cloud, gicp.Cloud]:
    """Return source and target, ready to be registered: one cloud with copy `same`, the two halves with `split`.

    Raises:
        GicpError: a cloud of the submap cannot be registered.
    """
    if settings.copy == "split":
        return gicp.prepare(submap.second, registration), gicp.prepare(submap.first, registration)
    cloud = gicp.prepare(submap.points, registration)
    return cloud, cloud


def register_perturbed(
    submap: Submap,
    pair: tuple[gicp.Cloud, gicp.Cloud],
    perturbations: np.ndarray,
    noise: gicp.Noise,
    settings: Settings,
    registration: gicp.Settings,
) -> Outcome:
    """Return the errors of registering copies of a submap's `clouds`, moved by (b, M) metres and radians."""
    centroid = submap.points[:, :2].mean(axis=0, dtype=np.float64) - pair[1].centre[:2]
    registered = gicp.register_noisy(*pair, perturbations, noise, registration, engine=settings.engine)
    # the perturbation moves the copy, then registration turns it (from the start's yaw on) and moves it
    T_target_source = registered.T_target_copy @ SE2(perturbations[:, :2], 0.0)
    residual = T_target_source.from_centre(-centroid).log()
    return Outcome(residual[:, : perturbations.shape[1]], registered.converged, registered.iterations)


def _errors(
    submap: Submap,
    pair: tuple[gicp.Cloud, gicp.Cloud],
    runs: int,
    rng: np.random.Generator,
    settings: Settings,
    registration: gicp.Settings,
    target_error: float | None = None,
) -> Outcome:
    sigmas = prior_sigmas(settings, registration.dimensions)
    key = int(rng.integers(1 << 63))
    outcome = Outcome(np.zeros((0, registration.dimensions)), np.zeros(0, np.bool_), np.zeros(0, np.int32))
    batch = max(1, runs if target_error is None else _BATCH)
    for first in range(0, runs, batch):
        perturbations = rng.standard_normal((min(batch, runs - first), len(sigmas))) * sigmas
        noise = gicp.Noise(settings.noise_sigma_m, key, first)
        latest = register_perturbed(submap, pair, perturbations, noise, settings, registration)
        outcome = Outcome(**{name: np.concatenate([old, vars(latest)[name]]) for name, old in vars(outcome).items()})
        if target_error is not None and error_statistics.relative_error(outcome.errors) <= target_error:
            break
    return outcome
