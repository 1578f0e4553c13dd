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

# Runs between two looks at the relative error. Few look Gaussian before a second basin shows; 100 meet one of 5 % of
# the runs in 99.4 of 100 labels.
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
    copy: str  # same: the very points of the submap (the paper); split: its two halves, from alternate pings
    prior_variance_m2: float  # a of Sigma_sample = a I
    noise_sigma_m: float  # of each coordinate of the copy
    held_out_runs: int
    engine: str = "cpu"  # what registers: cpu or cuda
    target_relative_error: float | None = None  # of a label whose runs may end early; None: all are made
    prior_yaw_sigma_rad: float = 0.03  # of the yaw that a registration starts with, where it finds yaw

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        require_seed(self.seed)
        require_positive(self, "prior_variance_m2", "prior_yaw_sigma_rad")
        for name, known in (("copy", ("same", "split")), ("engine", ("cpu", "cuda"))):
            if getattr(self, name) not in known:
                raise ValueError(f"{name} is {getattr(self, name)!r}, must be {known[0]} or {known[1]}")
        for name in ("noise_sigma_m", "held_out_runs"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} is {getattr(self, name)!r}, must be 0 or above")
        if self.held_out_runs > MOST_RUNS:
            raise ValueError(f"held_out_runs is {self.held_out_runs}, must be at most {MOST_RUNS}")
        if self.target_relative_error is not None:
            require_positive(self, "target_relative_error")


@dataclass(frozen=True)
class Outcome:
    """What became of L registrations of one submap."""

    errors: np.ndarray  # (L, M) metres and radians: e_l = log(exp(T_hat)^-1 T) of Eq. 10, see `errors`
    converged: np.ndarray  # (L,) bool
    iterations: np.ndarray  # (L,) int32


def generator(settings: Settings, submap: Submap, stream: Stream) -> np.random.Generator:
    """Return the source of a submap's draws: the same whatever the workers, order or other submaps."""
    return np.random.default_rng([settings.seed, zlib.crc32(submap.survey.encode()), submap.number, stream])


def errors(
    submap: Submap, runs: int, rng: np.random.Generator, settings: Settings, registration: gicp.Settings
) -> Outcome:
    """Return the errors of `runs` registrations of a perturbed, noisy copy of a submap onto the submap.

    T is the motion of the copy and T_hat what the registration says that it was, so exp(T_hat)^-1 T is what is left of
    it, p -> R p + t. With x and y alone (M = 2) e = t. With yaw (M = 3) e = (x, y, yaw) is its logarithm in SE(2), in
    the axes of the submap's frame with the origin at the mean of submap.points: there yaw has least to do with x and
    y, and there is the origin of a canonical cloud.

    Draws, in this order: a key (63 bits), then what each copy is moved by, (runs, M) float64. The noise of run l is a
    function of (key, l), so the first runs are the same however many follow.

    Raises:
        GicpError: a cloud of the submap cannot be registered.
    """
    return _errors(submap, clouds(submap, settings, registration), runs, rng, settings, registration)


def prior_sigmas(settings: Settings, dimensions: int) -> np.ndarray:
    """Return the standard deviations (M,) of what a copy is moved by, metres and radians: Sigma_sample's."""
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
    """Return what a table of labels says of registrations alone: their covariance, how sure it is, how they went.

    Raises:
        MonteCarloError: fewer than two runs.
    """
    q, sure = covariance(outcome.errors), error_statistics.standard_errors(outcome.errors)
    return {
        **table.to_columns(q),
        **{name.replace("q_", "se_", 1): value for name, value in table.to_columns(sure).items()},
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
    """Return a submap's Monte Carlo label from `runs` registrations, or fewer, and the samples.

    With settings.target_relative_error the runs end at the first look, one every 100 runs, that finds the label's
    relative error at the target or below (a sequential stop, Chow and Robbins 1965). They are the first of the runs
    that are made without a target. A target that is met says nothing of a second basin that no run has met: at 0.2, a
    third of the labels with a basin of 1 % of the runs stop before they meet it.

    Raises:
        MonteCarloError: fewer than two runs.
        GicpError: a cloud of the submap cannot be registered.
        CovarianceError: the label is not positive definite.
    """
    pair = clouds(submap, settings, registration)
    outcome, held_out = (
        _errors(submap, pair, count, generator(settings, submap, stream), settings, registration, enough)
        for count, stream, enough in (
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
            # only a copy of the very points can register to itself
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


def of_starts(
    submap: Submap,
    pair: tuple[gicp.Cloud, gicp.Cloud],
    moved: np.ndarray,
    noise: gicp.Noise,
    settings: Settings,
    registration: gicp.Settings,
) -> Outcome:
    """Return the errors of registrations of a submap's `clouds` whose copies are moved by (b, M) metres, radians."""
    centroid = submap.points[:, :2].mean(axis=0, dtype=np.float64) - pair[1].centre[:2]
    registered = gicp.register_noisy(*pair, moved, noise, registration, engine=settings.engine)
    # the copy was moved, and then turned (from the start's yaw on) and moved again: all of that is left of its motion
    T_target_source = registered.T_target_copy @ SE2(moved[:, :2], 0.0)
    residual = T_target_source.about(-centroid).log()
    return Outcome(residual[:, : moved.shape[1]], registered.converged, registered.iterations)


def _errors(
    submap: Submap,
    pair: tuple[gicp.Cloud, gicp.Cloud],
    runs: int,
    rng: np.random.Generator,
    settings: Settings,
    registration: gicp.Settings,
    enough: float | None = None,
) -> Outcome:
    sigmas = prior_sigmas(settings, registration.dimensions)
    key = int(rng.integers(1 << 63))
    made = Outcome(np.zeros((0, registration.dimensions)), np.zeros(0, np.bool_), np.zeros(0, np.int32))
    together = max(1, runs if enough is None else _BATCH)
    for first in range(0, runs, together):
        moved = rng.standard_normal((min(together, runs - first), len(sigmas))) * sigmas
        noise = gicp.Noise(settings.noise_sigma_m, key, first)
        found = of_starts(submap, pair, moved, noise, settings, registration)
        made = Outcome(**{name: np.concatenate([old, vars(found)[name]]) for name, old in vars(made).items()})
        if enough is not None and error_statistics.relative_error(made.errors) <= enough:
            break
    return made
