"""Loop closures searched from an estimate of a survey's poses: which submaps lie on which, and where they register."""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from pointnetkl.registration import gicp, pair
from pointnetkl.registration.pair import covariance, factor
from pointnetkl.slam.closing.estimate import ClosingError, Closure, Estimate, Tie, to_matrices
from pointnetkl.slam.graph import footprint
from pointnetkl.surveys import pose
from pointnetkl.surveys.se2 import rotate
from pointnetkl.workflow.parameters import require_positive, require_within

# The points (m, 3) of a known seabed over a rectangle of the map, from its lower to its upper corner (2,), metres
Reference = Callable[[np.ndarray, np.ndarray], np.ndarray]

_SIGMAS = 3.0  # of the relative place, that two submaps may lie apart and still meet


@dataclass(frozen=True)
class Settings:
    """How loop closures are searched.

    Raises:
        ValueError: a setting is out of its range.
    """

    coverage: float = 0.6  # expected share of a submap's footprint that earlier ones must cover, together
    target_coverage: float = 0.2  # and that each of them must cover
    cell_factor: float = 5.0  # size of a footprint's cells, in point spacings
    overlap_factor: float = 2.0  # only points over a target's are registered: within so many spacings
    search_variance_m2: float = 9.0  # of the search's start, beside that of the estimate: it may be too sure
    numbers: covariance.Settings = field(default_factory=covariance.Settings)
    gates: factor.Settings = field(default_factory=factor.Settings)

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        require_within(self, 1e-3, 1.0, "coverage", "target_coverage")
        require_within(self, 0.1, 1e3, "cell_factor")
        require_positive(self, "overlap_factor", "search_variance_m2")


@dataclass(frozen=True)
class Ground:
    """The submaps of a survey: their points, and how they are registered."""

    clouds: Sequence[np.ndarray]  # n of (n_i, 3), metres, in the submaps' frames
    navigation: np.ndarray  # (n, 4, 4) T_map_submap: z, roll and pitch are taken from here
    spacing_m: float
    registration: pair.Settings
    settings: Settings
    reference: Reference | None = None

    def __post_init__(self) -> None:
        """Refuse what cannot be registered.

        Raises:
            ClosingError: clouds and poses are not one each, or registrations find yaw.
        """
        if len(self.clouds) != len(self.navigation):
            raise ClosingError(
                f"there are {len(self.clouds)} clouds and {len(self.navigation)} poses, must be one each"
            )
        if self.registration.dimensions != 2:
            raise ClosingError("loop closures are registered in x and y: set registration.dof to xy")

    @functools.cached_property
    def numbers(self) -> covariance.Settings:
        """Return the numbers of closures' covariances, for submaps as long as these."""
        return self.settings.numbers.of_submaps(self.navigation[:, :3, 3])

    @functools.cached_property
    def levers(self) -> np.ndarray:
        """Return the middles (n, 2) of the clouds in their own frames, metres."""
        return np.array([cloud[:, :2].mean(axis=0) for cloud in self.clouds])

    @functools.cached_property
    def radii(self) -> np.ndarray:
        """Return how far (n,) their points reach from there, metres."""
        return np.array(
            [np.hypot(*(cloud[:, :2] - lever).T).max() for cloud, lever in zip(self.clouds, self.levers, strict=True)]
        )


def targets(ground: Ground, estimate: Estimate, source: int, posed: "Posed | None" = None) -> list[int]:
    """Return the earlier submaps that a source lies on; none where they cover too little of it together.

    What they cover is expected over where the source may lie on each of them, by the estimate's relative variance; so
    is how far off a submap may be. The one just before the source never counts.
    """
    cell = ground.settings.cell_factor * ground.spacing_m
    posed, covered = posed or Posed(ground, estimate), {}
    middles = posed.middles
    apart = np.hypot(*(middles[source] - middles[: max(source - 1, 0)]).T)
    reach = ground.radii[source] + ground.radii[: len(apart)]
    cloud = posed.cloud(source)[:, :2] if len(apart) else np.empty((0, 2))
    for k in np.flatnonzero(apart <= reach + _farthest(estimate, source, len(apart))).tolist():
        around = _sigma_points(Tie.at(estimate.poses, source, [k], None, ground.levers[source]).variance(estimate))
        covering = posed.footprint(k, cell)
        share = np.mean([footprint.within(footprint.keys(cloud + offset, cell), covering) for offset in around], axis=0)
        if share.mean() >= ground.settings.target_coverage:
            covered[k] = share
    if not covered or np.max(list(covered.values()), axis=0).mean() < ground.settings.coverage:
        return []
    return list(covered)


def register(
    ground: Ground, estimate: Estimate, source: int, on: Sequence[int], posed: "Posed | None" = None
) -> Closure | None:
    """Return the closure of a source registered on targets, from where the estimate has it; None without matches.

    Without targets it is registered on the ground's reference, and its tie is to the map.

    It is the likelihood alone, about the place where the search ends: nothing of the start is in it. The search's prior
    is wide on purpose, for an estimate may be too sure.
    """
    posed = posed or Posed(ground, estimate)
    whole = posed.cloud(source)
    origin = whole.mean(axis=0)  # small coordinates round less
    mapped, owner = _mapped(posed, on, whole, ground)
    prepared = gicp.prepare(whole - origin, ground.registration)
    reach = ground.settings.overlap_factor * ground.spacing_m
    if len(mapped) < ground.registration.neighbours:
        return None
    distance, nearest = cKDTree((mapped - origin)[:, :2]).query(prepared.points[:, :2], distance_upper_bound=reach)
    over = np.isfinite(distance)
    if over.sum() < ground.registration.neighbours:
        return None
    part = gicp.part(prepared, over, ground.registration)
    shares = np.bincount(owner[nearest[over]], minlength=len(on))[: len(on)] / over.sum()
    x, y, yaw = estimate.poses[source]
    lever = rotate((part.points.mean(axis=0) + origin)[:2] - [x, y], -yaw)
    tie = Tie.at(estimate.poses, source, list(on), shares, lever)
    return _closure(ground, tie, estimate, part, gicp.prepare(mapped - origin, ground.registration))


def _mapped(posed: "Posed", on: Sequence[int], cloud: np.ndarray, ground: Ground) -> tuple[np.ndarray, np.ndarray]:
    """Return the points (m, 3) of targets over the rectangle of a cloud and a margin, and each one's place in `on`."""
    margin = ground.registration.max_distance_m
    low, high = cloud[:, :2].min(axis=0) - margin, cloud[:, :2].max(axis=0) + margin
    if not len(on):
        known = ground.reference(low, high) if ground.reference else np.empty((0, 3))
        return known, np.zeros(len(known), np.int64)
    clouds = [posed.cloud(k) for k in on]
    around = [c[((c[:, :2] >= low) & (c[:, :2] <= high)).all(axis=1)] for c in clouds]
    return np.concatenate(around), np.repeat(np.arange(len(on)), [len(c) for c in around])


def _closure(ground: Ground, tie: Tie, estimate: Estimate, part: gicp.Part, target: gicp.Cloud) -> Closure | None:
    settings = ground.settings
    prior = settings.search_variance_m2 * np.eye(2) + tie.variance(estimate)
    blocks = ground.numbers.block_spacings
    end = pair.register(part, target, prior, ground.spacing_m, ground.registration, block_spacings=blocks)
    if end.forces.matched < ground.registration.neighbours:
        return None
    held = factor.of(end.forces, ground.numbers, settings.gates)
    moved = (
        end.T_target_source.translation
    )  # the factor's offset is from the end of the search, and the tie's from its start
    variance = end.forces.residual_variance
    return Closure(tie, held.A, held.c + held.A @ moved, variance, moved, len(part.points))


class Posed:
    """Clouds of a survey where an estimate has them, and their footprints, each made once."""

    def __init__(self, ground: Ground, estimate: Estimate) -> None:
        """Pose no cloud yet."""
        self._ground = ground
        self._footprints: dict[int, np.ndarray] = {}
        self._poses = to_matrices(estimate.poses, ground.navigation)

    @functools.cached_property
    def middles(self) -> np.ndarray:
        """Return the middles (n, 2) of the clouds in the map."""
        return np.asarray((self._poses[:, :2, :2] @ self._ground.levers[:, :, None])[:, :, 0] + self._poses[:, :2, 3])

    def cloud(self, k: int) -> np.ndarray:
        """Return the points (n, 3) of a submap in the map."""
        return pose.transform(self._poses[k], self._ground.clouds[k])

    def footprint(self, k: int, cell: float) -> np.ndarray:
        """Return the sorted keys of the cells that hold points of a submap."""
        if k not in self._footprints:
            self._footprints[k] = footprint.cells(self.cloud(k), cell)
        return self._footprints[k]


def _farthest(estimate: Estimate, source: int, others: int) -> np.ndarray:
    """Return how far (others,) the first submaps may lie off their places on a source, metres: a bound."""
    variances = np.trace(estimate.marginals[:, :2, :2], axis1=1, axis2=2)
    return np.asarray(_SIGMAS * np.sqrt(2 * (variances[source] + variances[:others])))


def _sigma_points(variance: np.ndarray) -> np.ndarray:
    """Return five offsets (5, 2) with about this covariance: none, and to both sides along its axes."""
    w, v = np.linalg.eigh(variance)
    axes = np.sqrt(2.5 * np.maximum(w, 0.0))[:, None] * v.T  # four of five points carry all of the variance
    return np.concatenate([np.zeros((1, 2)), axes, -axes])
