"""The loops of a survey closed, on all cores, with drift as large as the closures say where nothing else is known."""

import dataclasses
import functools
import tempfile
import uuid
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np
from scipy import stats

from pointnetkl.correction.preparation.cut import Clouds
from pointnetkl.correction.solution.belief import Navigation
from pointnetkl.registration import pair
from pointnetkl.slam.closing import drift, search, solving, survey
from pointnetkl.slam.closing.estimate import Closure, Estimate, linearised
from pointnetkl.slam.closing.schemas import State
from pointnetkl.slam.closing.search import Ground
from pointnetkl.slam.closing.survey import Closed, Found
from pointnetkl.workflow import compute

_CHUNK = 16  # submaps of a task
_SEVERAL = 64  # submaps below which other processes are not worth their start
_ENOUGH = 4  # closures that drift can be measured by
_LARGE, _LARGE_ALONE = 2.0, 4.0  # variance factors that are more than one for all that can be told
_SCALES = (0.05, 20.0)  # of the sigmas of drift
_EXPECTED = 3.0  # by so much the rates of a preset may be off
_TRIALS = 3
# of closures whose matches fit, whether or not the poses agree
_FIT = (State.ACCEPTED, State.PREDICTION, State.OUTVOTED)

_LOADED: dict[Path, tuple[Ground, Estimate]] = {}  # what a worker has read of the round at hand


@dataclass(frozen=True)
class Problem:
    """A survey to close."""

    clouds: Clouds
    poses: np.ndarray  # (n, 4, 4) T_map_submap by navigation
    navigation: Navigation
    spacing_m: float
    settings: survey.Settings
    registration: pair.Settings
    anchors: Sequence[Closure] = ()
    reference: search.Reference | None = None


def close(problem: Problem, measure_drift: bool) -> tuple[Closed, drift.Settings]:
    """Return the survey with its loops closed, and the rates of drift that it is to be solved with.

    To measure drift is to multiply the rates' sigmas by one factor, if there are enough closures to tell. First until
    residuals at navigation's poses are no larger than they should be (excess, which a few wrong closures do not
    move), then by what is likely (likely_scale).

    Raises:
        ClosingError: the poses have no solution.
    """
    rates = problem.navigation.rates
    closed = _close(problem, rates)
    for _ in range(_TRIALS if measure_drift else 0):
        fit = [f.closure for f in closed.found if f.closure is not None and f.state in _FIT]
        factor = excess(_believed(problem, rates), [*problem.anchors, *fit])
        if len(fit) < _ENOUGH or factor <= 1:
            break
        rates = _times(rates, float(np.sqrt(factor)))
        print(f"drift is {np.sqrt(factor):.2g} times what was assumed, by {len(fit)} closures: once more with that")
        closed = _close(problem, rates)
    # of absolute positions closures see but what changes between passes: what is said of them is not measured away
    if measure_drift and problem.navigation.fix is not None and len(closed.accepted) >= _ENOUGH:
        scale = likely_scale(_believed(problem, rates), [*problem.anchors, *closed.accepted])
        print(f"drift is most likely {scale:.2g} times that, by {len(closed.accepted)} closures")
        rates = _times(rates, scale)
    return closed, rates


def excess(navigation: Estimate, closures: Sequence[Closure]) -> float:
    """Return by how much the variance of navigation's drift is too small, if closures contradict it; else 1.

    Whitened residuals (solving.variance_factor) see drift that changes faster than it should, and not one that is
    smooth and large: each closure alone, by the variance of its own offset, sees that. As closures share few causes,
    their median is less sure.
    """
    if not closures:
        return 1.0
    whitened = solving.variance_factor(navigation, closures)
    ratios = [_square(navigation, closure) / stats.chi2.median(closure.rank) for closure in closures if closure.rank]
    alone = float(np.median(ratios)) if ratios else 1.0
    return max(1.0, whitened if whitened > _LARGE else 0.0, alone if alone > _LARGE_ALONE else 0.0)


def _square(navigation: Estimate, closure: Closure) -> float:
    r = closure.residual(navigation.poses)
    return float(r @ np.linalg.solve(closure.A @ closure.tie.variance(navigation) @ closure.A.T + np.eye(len(r)), r))


def likely_scale(navigation: Estimate, closures: Sequence[Closure]) -> float:
    """Return the rms of the factor on drift's sigmas, over what is likely by the closures' residuals at navigation.

    The likelihood is N(r; 0, s^2 J C J^T + I), which knows that residuals of one survey share few causes; s is expected
    to be 1, and to be off by a factor of three. The rms, not the likeliest, because a survey says little of what is
    constant in it, such as the bias of a heading, and its sigmas must hold that too.
    """
    J, r = linearised(closures, navigation.poses)
    w, v = np.linalg.eigh(J @ np.asarray((J @ navigation.covariance).T))
    w, squares = np.maximum(w, 0.0), (v.T @ r) ** 2
    s = np.geomspace(*_SCALES, 200)
    variances = s[:, None] ** 2 * w + 1
    logs = -0.5 * (np.log(variances) + squares / variances).sum(axis=1) - 0.5 * (np.log(s) / np.log(_EXPECTED)) ** 2
    weights = np.exp(logs - logs.max())
    return float(np.sqrt((weights * s**2).sum() / weights.sum()))


def _believed(problem: Problem, rates: drift.Settings) -> Estimate:
    return Estimate(problem.navigation.poses, problem.navigation.covariance(rates))


def _times(rates: drift.Settings, scale: float) -> drift.Settings:
    """Return rates times a scale, or as they are where that leaves what rates can be.

    A smaller scale is not for what is constant over a survey: closures hardly see it, and cannot make it surer.
    """
    try:
        scaled = rates.times(scale)
    except ValueError:
        return rates
    if scale >= 1:
        return scaled
    return dataclasses.replace(scaled, scale_error=rates.scale_error, heading_bias_rad=rates.heading_bias_rad)


def _close(problem: Problem, rates: drift.Settings) -> Closed:
    with tempfile.TemporaryDirectory(prefix=".ground-", dir=problem.clouds.path.parent) as folder:
        return survey.close(
            problem.clouds,
            problem.poses,
            problem.navigation.covariance(rates),
            problem.spacing_m,
            problem.settings,
            problem.registration,
            problem.anchors,
            problem.reference,
            functools.partial(_over, Path(folder)) if len(problem.clouds) >= _SEVERAL else None,
            _watched,
        )


def _watched(sources: Sequence[int]) -> Iterable[int]:
    several = len(sources) >= _SEVERAL
    return compute.progress(sources, "closing loops along the track", len(sources)) if several else sources


def _over(folder: Path, ground: Ground, estimate: Estimate) -> list[Found]:
    """Return the closures of all submaps, registered by workers, who find clouds and estimate in files."""
    stored = folder / f"{uuid.uuid4().hex}.npz"
    np.savez(stored, poses=estimate.poses, covariance=estimate.covariance, navigation=ground.navigation)
    without_arrays = dataclasses.replace(ground, clouds=[], navigation=np.empty((0, 4, 4)))
    work = functools.partial(_registered, stored, cast(Clouds, ground.clouds), without_arrays)
    chunks = [range(k, min(k + _CHUNK, len(ground.clouds))) for k in range(0, len(ground.clouds), _CHUNK)]
    return [f for part in compute.over(work, chunks, "closing loops", unit="part") for f in part]


def _registered(stored: Path, clouds: Clouds, known: Ground, sources: Sequence[int]) -> list[Found]:
    if stored not in _LOADED:
        with np.load(stored, allow_pickle=False) as arrays:
            ground = dataclasses.replace(known, clouds=clouds, navigation=arrays["navigation"])
            _LOADED.clear()
            _LOADED[stored] = ground, Estimate(arrays["poses"], arrays["covariance"])
    return survey.registered_at(*_LOADED[stored], sources)
