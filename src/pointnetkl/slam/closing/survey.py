"""A survey closed from its own navigation: closures searched, judged and solved, until nothing changes."""

import dataclasses
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import stats

from pointnetkl.registration import pair
from pointnetkl.slam.closing import gates, search, solving
from pointnetkl.slam.closing.estimate import Closure, Estimate, from_matrices, to_matrices
from pointnetkl.slam.closing.schemas import State
from pointnetkl.slam.closing.search import Ground
from pointnetkl.slam.closing.search import Settings as SearchSettings
from pointnetkl.surveys.se2 import rotate
from pointnetkl.workflow.parameters import require_positive

Over = Callable[[Ground, Estimate], "list[Found]"]
Watched = Callable[[Sequence[int]], Iterable[int]]

_FEWEST = 5  # closures whose residuals have a median worth the name


@dataclass(frozen=True)
class Settings:
    """How a survey is closed.

    Raises:
        ValueError: a setting is out of its range.
    """

    search: SearchSettings = field(default_factory=SearchSettings)
    rounds: int = 3  # of registering from the poses of the round before; the first goes along the track
    steady_m: float = 0.02  # no more rounds once no pose moves farther
    gnc_probability: float = 0.999  # of the squared residual of a true closure
    gnc_step: float = 2.0  # factor of the control parameter from one problem to the next

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        require_positive(self, "rounds", "steady_m")
        if not 0 < self.gnc_probability < 1:
            raise ValueError(f"gnc_probability is {self.gnc_probability:g}, must be between 0 and 1")
        if self.gnc_step <= 1:
            raise ValueError(f"gnc_step is {self.gnc_step:g}, must be above 1")


@dataclass(frozen=True)
class Found:
    """What became of a submap that returns to mapped ground."""

    source: int
    targets: Sequence[int]
    closure: Closure | None  # None: no match
    state: State


@dataclass(frozen=True)
class Closed:
    """A survey with its loops closed."""

    poses: np.ndarray  # (n, 4, 4) T_map_submap
    navigation: Estimate
    estimate: Estimate  # of the same poses, with their covariance
    found: Sequence[Found]  # in the order of their sources
    rounds: int

    @property
    def accepted(self) -> list[Closure]:
        """Return the closures that hold the poses."""
        return _accepted(self.found)

    @property
    def variance_factor(self) -> float:
        """Return solving.variance_factor of the closures whose matches fit, those that the poses refuse among them."""
        fit = (State.ACCEPTED, State.PREDICTION, State.OUTVOTED)
        closures = [f.closure for f in self.found if f.closure is not None and f.state in fit]
        return solving.variance_factor(self.navigation, closures)


def close(
    clouds: Sequence[np.ndarray],
    navigation: np.ndarray,
    covariance: np.ndarray,
    spacing_m: float,
    settings: Settings,
    registration: pair.Settings,
    anchors: Sequence[Closure] = (),
    reference: search.Reference | None = None,
    over: "Over | None" = None,
    watched: "Watched" = iter,
) -> Closed:
    """Return a survey whose loops are closed, from its navigation as it is.

    Args:
        clouds: n submaps' points (n_i, 3), metres, in their own frames.
        navigation: T_map_submap (n, 4, 4).
        covariance: (3 n, 3 n) of navigation's x, y and yaw, in axes of the map: see `drift`.
        spacing_m: of the survey's points.
        settings: of the search, the gates and the solution.
        registration: of the pairs, whose method should be map.
        anchors: ties to the map that are known beforehand, such as fixes of position; they correct navigation first.
        reference: a known seabed, on which submaps are registered too.
        over: how the submaps of a round, which do not wait for each other, are registered; None: one after the other.
        watched: yields the submaps of the first round, which do wait; for a progress bar.

    Raises:
        ClosingError: poses, clouds and covariance are not of one survey, or the poses have no solution.
    """
    ground = Ground(clouds, navigation, spacing_m, registration, settings.search, reference)
    start = solving.solve(Estimate(from_matrices(navigation), covariance), anchors)
    found, estimate = judge(start, _along_the_track(ground, start, watched), settings)
    rounds = 1
    while rounds < settings.rounds:
        last = estimate
        found, estimate = judge(start, (over or registered_at)(ground, last), settings)
        rounds += 1
        if np.abs(estimate.poses - last.poses)[:, :2].max() < settings.steady_m:
            break
    return Closed(to_matrices(estimate.poses, navigation), start, estimate, found, rounds)


def with_covariances(closed: Closed, covariances: np.ndarray, settings: Settings) -> Closed:
    """Return a survey solved again from the same ends of its registrations, weighted by covariances (n, 2, 2).

    They are m^2 in each source's own frame, as those of labels and networks are. Of NaN, where there is none: that
    source counts as unmatched. Gates judge by them.

    Raises:
        ClosingError: one of them is not positive definite, or the poses have no solution.
    """
    found = [dataclasses.replace(f, closure=_weighted(f.closure, covariances[f.source])) for f in closed.found]
    judged, estimate = judge(closed.navigation, found, settings)
    poses = to_matrices(estimate.poses, closed.poses)
    return dataclasses.replace(closed, poses=poses, estimate=estimate, found=judged)


def _weighted(closure: Closure | None, Q: np.ndarray) -> Closure | None:
    if closure is None or np.isnan(Q).any():
        return None
    R = rotate(np.eye(2), float(closure.tie.tied_source[2])).T
    return closure.with_covariance(R @ Q @ R.T)


def judge(navigation: Estimate, found: Sequence[Found], settings: Settings) -> tuple[list[Found], Estimate]:
    """Return closures with their states, and the poses that the accepted ones give.

    Residuals are judged first, then the place at a larger drift, then graduated non-convexity among what is left.

    Raises:
        ClosingError: the poses have no solution.
    """
    numbers = settings.search.gates
    judged = [dataclasses.replace(f, state=_of_ground(f.closure)) for f in found]
    judged = _refuse(judged, gates.by_residuals(_accepted(judged), numbers), State.RESIDUALS)
    judged = _refuse(judged, gates.by_prediction(navigation, _accepted(judged), numbers), State.PREDICTION)
    left = _accepted(judged)
    estimate, weights = solving.graduated(navigation, left, settings.gnc_probability, settings.gnc_step)
    return _refuse(judged, weights > 0, State.OUTVOTED), estimate


def _of_ground(closure: Closure | None) -> State:
    if closure is None:
        return State.UNMATCHED
    return State.ACCEPTED if closure.rank else State.FLAT


def _accepted(found: Sequence[Found]) -> list[Closure]:
    return [f.closure for f in found if f.closure is not None and f.state == State.ACCEPTED]


def _refuse(found: Sequence[Found], passed: np.ndarray, state: State) -> list[Found]:
    """Return closures of which those accepted so far that have not passed (k,) get a state."""
    verdicts = iter(passed.tolist())
    return [f if f.state != State.ACCEPTED or next(verdicts) else dataclasses.replace(f, state=state) for f in found]


def _along_the_track(ground: Ground, navigation: Estimate, watched: "Watched") -> list[Found]:
    """Return the closures of each submap in turn, registered from the poses that those before it have corrected."""
    found: list[Found] = []
    estimate = Estimate(navigation.poses, navigation.covariance.copy())  # for `updated`
    for source in watched(range(len(navigation.poses))):
        closures = _found(ground, estimate, source, search.Posed(ground, estimate))
        found += closures
        for f in closures:
            if f.closure is not None and _is_plausible(f.closure, estimate, _accepted(found), ground):
                estimate = solving.updated(estimate, f.closure)
    return found


def registered_at(ground: Ground, estimate: Estimate, sources: Sequence[int] | None = None) -> list[Found]:
    """Return the closures of some submaps, by default of all, registered from where an estimate has them."""
    posed = search.Posed(ground, estimate)
    asked = range(len(estimate.poses)) if sources is None else sources
    return [f for source in asked for f in _found(ground, estimate, source, posed)]


def _found(ground: Ground, estimate: Estimate, source: int, posed: search.Posed) -> list[Found]:
    """Return the closures of a submap: on earlier ones, where it lies on mapped ground, and on the reference."""
    on = [targets] if (targets := search.targets(ground, estimate, source, posed)) else []
    found = []
    for targets in [*on, *([[]] if ground.reference else [])]:
        closure = search.register(ground, estimate, source, targets, posed)
        if closure is not None or targets:
            found.append(Found(source, targets, closure, _of_ground(closure)))
    return found


def _is_plausible(closure: Closure, estimate: Estimate, others: Sequence[Closure], ground: Ground) -> bool:
    """Whether a closure may correct the poses that the next ones start from; the gates proper see the whole survey."""
    numbers = ground.settings.gates
    if not closure.rank:
        return False
    if len(others) >= _FEWEST:
        median = np.median([other.residual_variance for other in others])
        if closure.residual_variance > numbers.largest_variance_ratio * median:
            return False
    variance = numbers.drift_factor**2 * closure.tie.variance(estimate)
    r = closure.residual(estimate.poses)
    chi2 = r @ np.linalg.solve(np.eye(len(r)) + closure.A @ variance @ closure.A.T, r)
    return bool(chi2 <= stats.chi2.ppf(numbers.gate_probability, closure.A.shape[1]))
