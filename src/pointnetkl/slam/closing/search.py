"""Loop closures searched from an estimate of a survey's poses: which submaps lie on which, and where they register."""

from collections.abc import Sequence
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


def targets(ground: Ground, estimate: Estimate, source: int) -> list[int]:
    """Return the earlier submaps that a source lies on; none where they cover too little of it together.

    What they cover is expected over where the source may lie on each of them, by the estimate's relative variance; so
    is how far off a submap may be. The one just before the source never counts.
    """
    cell = ground.settings.cell_factor * ground.spacing_m
    posed = _Posed(ground, estimate)
    union, kept = [], []
    for k in range(source - 1):
        tie = Tie.at(estimate.poses, source, [k], None, posed.lever(source))
        sigma_points = _sigma_points(tie.variance(estimate))
        if not posed.near(source, k, float(_SIGMAS * np.abs(sigma_points).max() / np.sqrt(2))):
            continue
        covering = footprint.cells(posed.cloud(k), cell)
        covered = [np.isin(footprint.keys(posed.cloud(source)[:, :2] + s, cell), covering) for s in sigma_points]
        if np.mean(covered) >= ground.settings.target_coverage:
            kept.append(k)
            union.append(np.mean(covered, axis=0))
    if not kept or np.mean(np.max(union, axis=0)) < ground.settings.coverage:
        return []
    return kept


def register(ground: Ground, estimate: Estimate, source: int, on: Sequence[int]) -> Closure | None:
    """Return the closure of a source registered on targets, from where the estimate has it; None without matches.

    It is the likelihood alone, about the place where the search ends: nothing of the start is in it. The search's prior
    is wide on purpose, for an estimate may be too sure.
    """
    posed = _Posed(ground, estimate)
    whole, owner = posed.cloud(source), np.repeat(np.arange(len(on)), [len(ground.clouds[k]) for k in on])
    fused, origin = np.concatenate([posed.cloud(k) for k in on]), whole.mean(axis=0)
    around = _box_around(fused, whole, ground.registration.max_distance_m)
    fused, owner = fused[around] - origin, owner[around]
    reach = ground.settings.overlap_factor * ground.spacing_m
    if len(fused) < ground.registration.neighbours:
        return None
    prepared = gicp.prepare(whole - origin, ground.registration)
    distance, nearest = cKDTree(fused[:, :2]).query(prepared.points[:, :2], distance_upper_bound=reach)
    over = np.isfinite(distance)
    if over.sum() < ground.registration.neighbours:
        return None
    part = gicp.part(prepared, over, ground.registration)
    shares = np.bincount(owner[nearest[over]], minlength=len(on)) / over.sum()
    x, y, yaw = estimate.poses[source]
    lever = rotate(part.points.mean(axis=0)[:2] + origin[:2] - [x, y], -yaw)
    tie = Tie.at(estimate.poses, source, list(on), shares, lever)
    return _closure(ground, tie, estimate, part, gicp.prepare(fused, ground.registration))


def _closure(ground: Ground, tie: Tie, estimate: Estimate, part: gicp.Part, target: gicp.Cloud) -> Closure | None:
    settings = ground.settings
    prior = settings.search_variance_m2 * np.eye(2) + tie.variance(estimate)
    blocks = settings.numbers.block_spacings
    end = pair.register(part, target, prior, ground.spacing_m, ground.registration, block_spacings=blocks)
    if end.forces.matched < ground.registration.neighbours:
        return None
    held = factor.of(end.forces, settings.numbers, settings.gates)
    # its offset is from the end of the search, and the tie's from the start
    c = held.c + held.A @ end.T_target_source.translation
    return Closure(tie, held.A, c, end.forces.residual_variance)


class _Posed:
    """Clouds of a survey where an estimate has them."""

    def __init__(self, ground: Ground, estimate: Estimate) -> None:
        self._clouds = ground.clouds
        self._poses = to_matrices(estimate.poses, ground.navigation)

    def cloud(self, k: int) -> np.ndarray:
        return pose.transform(self._poses[k], self._clouds[k])

    def lever(self, k: int) -> np.ndarray:
        """Return the middle (2,) of a cloud in its own frame."""
        return np.asarray(self._clouds[k][:, :2].mean(axis=0))

    def near(self, i: int, k: int, apart_m: float) -> bool:
        """Whether two clouds may touch, if they may lie so far off their places."""
        middle = [T[:2, :2] @ self.lever(j) + T[:2, 3] for j, T in ((i, self._poses[i]), (k, self._poses[k]))]
        radii = sum(float(np.hypot(*(self._clouds[j][:, :2] - self.lever(j)).T).max()) for j in (i, k))
        return bool(np.hypot(*(middle[0] - middle[1])) <= radii + apart_m)


def _sigma_points(variance: np.ndarray) -> np.ndarray:
    """Return five offsets (5, 2) with about this covariance: none, and to both sides along its axes."""
    w, v = np.linalg.eigh(variance)
    axes = np.sqrt(2.5 * np.maximum(w, 0.0))[:, None] * v.T  # four of five points carry all of the variance
    return np.concatenate([np.zeros((1, 2)), axes, -axes])


def _box_around(points: np.ndarray, cloud: np.ndarray, margin: float) -> np.ndarray:
    """Return which points (n, 3) lie over the rectangle of a cloud, or within a margin of it."""
    low, high = cloud[:, :2].min(axis=0) - margin, cloud[:, :2].max(axis=0) + margin
    return np.asarray(((points[:, :2] >= low) & (points[:, :2] <= high)).all(axis=1))
