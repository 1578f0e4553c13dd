"""Loop closures of a survey by registration: the front end of Algorithm 1 of the paper."""

import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from pointnetkl.registration import gicp, pair
from pointnetkl.slam.graph import footprint
from pointnetkl.slam.graph.pose_graph import ClosureNoise, DeadReckoningNoise, Edges
from pointnetkl.slam.graph.survey_graph import Closures
from pointnetkl.surveys import pose
from pointnetkl.surveys.se2 import SE2
from pointnetkl.surveys.submap import Submap
from pointnetkl.workflow.errors import PointNetKLError
from pointnetkl.workflow.parameters import require_positive, require_seed, require_within

LEAST_SIGMA = 1e-4  # metres and radians, of a start that is not perturbed: its variance must have an inverse


class LoopClosureError(PointNetKLError):
    """Submaps and poses do not belong together."""


@dataclass(frozen=True)
class Settings:
    """Section `graph` of the parameters.

    Raises:
        ValueError: a setting is out of its range.
    """

    seed: int  # of the perturbations
    draws: int  # of the loop closures
    coverage: float  # share of a submap's footprint that an earlier one must cover to close a loop
    prior_variance_m2: float  # a of the perturbations' N(0, a I)
    cell_factor: float  # size of a footprint's cells, in point spacings
    overlap_factor: float | None  # reach of the ground around a target's points, in point spacings; None: no limit
    dead_reckoning: DeadReckoningNoise
    loop_closure: ClosureNoise
    prior_yaw_sigma_rad: float = 0.03  # of the perturbations' yaw, where registrations find yaw
    method: str = "gicp"  # of registering loop closures: gicp (the paper), or map, with the perturbations' prior

    def __post_init__(self) -> None:
        """Refuse numbers out of their range."""
        require_seed(self.seed)
        require_positive(self, "draws", "coverage")
        if self.coverage > 1:
            raise ValueError(f"coverage is {self.coverage}, a share: must be at most 1")
        require_within(self, 0.1, 1e3, "cell_factor")  # finer cells fill the memory, coarser ones all overlap
        require_within(self, 0.0, 1e6, "prior_variance_m2")
        require_within(self, 0.0, np.pi, "prior_yaw_sigma_rad")
        if self.overlap_factor is not None:
            require_positive(self, "overlap_factor")
        if self.method not in pair.METHODS:
            raise ValueError(f"method is {self.method!r}, must be {' or '.join(pair.METHODS)}")
        if self.method == "map" and not self.prior_variance_m2:
            raise ValueError(f"prior_variance_m2 is {self.prior_variance_m2}, must be above zero with the method map")


def starts(
    survey: str, submaps: Sequence[Submap], settings: Settings, dimensions: int = 2, draw: int = 0
) -> np.ndarray:
    """Return each submap's perturbation (n, M) before registration: x and y of N(0, a I) in metres, and yaw.

    Each `draw` has its own.
    """
    sigmas = start_sigmas(settings, dimensions)
    key = zlib.crc32(survey.encode())
    seeds = ([settings.seed, key, draw, s.number] for s in submaps)
    return np.array([np.random.default_rng(seed).normal(0.0, sigmas) for seed in seeds])


def start_sigmas(settings: Settings, dimensions: int) -> np.ndarray:
    """Return the standard deviations (M,) of a perturbation, metres and radians."""
    sigma = np.sqrt(settings.prior_variance_m2)
    return np.array([sigma, sigma, settings.prior_yaw_sigma_rad])[:dimensions]


def covariance_about(covariance: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """Return a covariance (M, M) about a point as one about the point that is `offset` (2,) metres from it."""
    if len(covariance) == 2:
        return covariance
    adjoint = SE2(-offset, 0.0).adjoint()
    return np.asarray(adjoint @ covariance @ adjoint.T)


def close(
    submaps: Sequence[Submap],
    poses: np.ndarray,
    perturbations: np.ndarray | None,
    spacing: float,
    settings: Settings,
    registration: gicp.Settings,
) -> Closures:
    """Register every submap that returns to mapped ground; return its edges (Algorithm 1, lines 4 to 16).

    Args:
        submaps: the n nodes in the order of the track.
        poses: T_map_submap (n, 4, 4).
        perturbations: (n, M) metres, and radians about the submap's mean. None starts each registration at dead
            reckoning from the corrected pose of the submap before, as a vehicle does whose poses drift.
        spacing: of neighbouring points in metres, the unit of `cell_factor` and `overlap_factor`.
        settings: the required coverage, and those factors.
        registration: settings of GICP, whose neighbours, plane_epsilon and so on MAP has too.

    Raises:
        LoopClosureError: the numbers of submaps and poses differ.
        GicpError: a cloud cannot be registered.
    """
    if len(poses) != len(submaps):
        raise LoopClosureError(
            f"there are {len(submaps)} submaps and {len(poses)} poses, must be one each; run segment again"
        )
    front = _FrontEnd(spacing, settings, registration)
    for i in range(len(submaps)):
        drift = front.correction if perturbations is None else SE2.identity()
        perturbation = np.zeros(3)
        if perturbations is not None:
            perturbation[: registration.dimensions] = perturbations[i]
        front.add(submaps[i].points, poses[i], drift, SE2.from_vector(perturbation))
    return front.closures()


class MapSearch(NamedTuple):
    """How a cloud is registered to its most probable place (pair.register)."""

    prior: np.ndarray  # (M, M) variance of starts about the middle of the whole cloud, m^2 and rad^2
    spacing_m: float  # of neighbouring points
    settings: pair.Settings


class Ground:
    """Mapped ground, the target of registrations: points (n, 3) in the map frame."""

    def __init__(
        self,
        points: np.ndarray,
        origin: np.ndarray,
        reach: float | None,
        registration: gicp.Settings,
        search: MapSearch | None = None,
    ) -> None:
        """Prepare the points about an origin (3,) near them; only a cloud's points within `reach` metres will count.

        Without a search clouds are registered by GICP; with one the origin must be the middle of the cloud.
        """
        self._origin, self._reach, self._registration = origin, reach, registration  # small coordinates round less
        self._search = search
        local = points - origin
        self._tree = None if reach is None else cKDTree(local[:, :2])
        self._target = gicp.prepare(local, registration)

    def register(self, cloud: np.ndarray, start: SE2) -> tuple[SE2, bool] | None:
        """Return the motion that aligns a cloud with the ground, and whether it converged; None without a match.

        The cloud (n, 3) is in the map frame, and `start` a motion about the origin.
        """
        points = cloud - self._origin
        points = points[self._over_target(points, start)]
        if len(points) < self._registration.neighbours:
            return None
        return self.register_part(gicp.prepare(points, self._registration), start)

    def register_many(self, cloud: np.ndarray, starts: Iterable[SE2]) -> list[tuple[SE2, bool] | None]:
        """Return the result of `register` for each start, up to rounding, in less time."""
        whole = self.prepare(cloud)
        parts = ((self.part(whole, start), start) for start in starts)
        return [None if part is None else self.register_part(part, start) for part, start in parts]

    @property
    def target(self) -> gicp.Cloud:
        """Return the ground as registrations take it, about the origin."""
        return self._target

    def prepare(self, cloud: np.ndarray) -> gicp.Cloud:
        """Return a cloud (n, 3) of the map frame in the axes of the target."""
        return gicp.prepare(cloud - self._origin, self._registration)

    def part(self, whole: gicp.Cloud, start: SE2) -> gicp.Part | None:
        """Return the points of a prepared cloud that lie over the ground at a start; None of fewer than neighbours."""
        near = self._over_target(whole.points, start)
        if near.sum() < self._registration.neighbours:
            return None
        return gicp.part(whole, near, self._registration)

    def register_part(self, part: gicp.Cloud | gicp.Part, start: SE2) -> tuple[SE2, bool] | None:
        """Return the result of `register` for a part of the cloud that was taken at this start."""
        outcome = self._estimate(part, self.to_target(start))
        if outcome.matched_share == 0:
            return None
        return self.to_map(outcome.T_target_source), outcome.converged

    def _estimate(self, part: gicp.Cloud | gicp.Part, start: SE2) -> gicp.Registration | pair.Estimate:
        if self._search is None:
            return gicp.register(part, self._target, self._registration, start)
        prior, spacing_m, settings = self._search
        about_part = covariance_about(prior, part.points.mean(axis=0)[:2])
        return pair.register(part, self._target, about_part, spacing_m, settings, start)

    def to_target(self, motion: SE2) -> SE2:
        """Return a motion about the origin as `registration` takes it: about the target's centre."""
        return motion.from_centre(-self._target.centre[:2])

    def to_map(self, T_target_source: SE2) -> SE2:
        """Return a motion about the target's centre as one of the map frame."""
        return T_target_source.from_centre((self._origin + self._target.centre)[:2])

    def from_map(self, motion: SE2) -> SE2:
        """Return a motion of the map frame as one about the target's centre."""
        return motion.from_centre(-(self._origin + self._target.centre)[:2])

    def _over_target(self, points: np.ndarray, start: SE2) -> np.ndarray:
        # Points beyond the target's edge would match its border. On flat ground nothing counters them, and they drag a
        # half-covered submap right across the target.
        if self._tree is None or self._reach is None:
            return np.ones(len(points), bool)
        distance, _ = self._tree.query(start.act(points[:, :2]), distance_upper_bound=self._reach)
        return np.isfinite(distance)


class _Edge(NamedTuple):
    target: int
    source: int
    registration: int
    T_target_source: np.ndarray


class _Registration(NamedTuple):
    node: int
    start: np.ndarray  # (3,) change of the pose's x, y and yaw before the registration
    correction: np.ndarray  # (3,) and after it
    converged: bool


class _FrontEnd:
    """The map as it grows: S_graph of Algorithm 1.

    Motions are in the map frame, about its origin; without yaw their rotation is exactly the identity.
    """

    def __init__(self, spacing: float, settings: Settings, registration: gicp.Settings) -> None:
        self._footprints = footprint.Footprints(settings.cell_factor * spacing)
        self._share, self._registration = settings.coverage, registration
        self._search = None
        if settings.method == "map":
            prior = np.diag(np.maximum(start_sigmas(settings, registration.dimensions), LEAST_SIGMA) ** 2)
            self._search = MapSearch(prior, spacing, pair.Settings.of(registration, "map"))
        self._reach = None if settings.overlap_factor is None else settings.overlap_factor * spacing
        self._clouds: list[np.ndarray] = []
        self._T_map_submap: list[np.ndarray] = []
        self._centroids: list[np.ndarray] = []
        self._edges: list[_Edge] = []
        self._registrations: list[_Registration] = []
        self._rejected: list[int] = []
        self.correction = SE2.identity()  # the motion of the submap added last

    def add(self, points: np.ndarray, T_map_submap: np.ndarray, drift: SE2, perturbation: SE2) -> None:
        """Add the next submap, with its pose moved by `drift`; register it if it closes a loop."""
        i = len(self._clouds)
        cloud = pose.transform(drift.act_on_pose(T_map_submap), points)
        targets = self._footprints.covering(cloud, self._share, among=i - 1)  # never S_{i-1}
        outcome = self._register(cloud, targets, perturbation) if len(targets) else None
        self.correction = drift if outcome is None else outcome[0] @ drift
        self._centroids.append(points[:, :2].mean(axis=0))
        self._place((self.correction / drift).act(cloud), self.correction.act_on_pose(T_map_submap))
        if outcome is not None:
            start = perturbation.from_centre(cloud.mean(axis=0)[:2]) @ drift
            before, after = (
                motion.from_centre(-T_map_submap[:2, 3]).to_vector() for motion in (start, self.correction)
            )
            self._connect(targets, _Registration(i, before, after, outcome[1]))
        elif len(targets):
            self._rejected.append(i)

    def _register(self, cloud: np.ndarray, targets: np.ndarray, start: SE2) -> tuple[SE2, bool] | None:
        """Return the motion that aligns a cloud with its targets, and whether it converged; None without a match."""
        fused = np.concatenate([self._clouds[k] for k in targets])
        ground = Ground(fused, cloud.mean(axis=0), self._reach, self._registration, self._search)
        return ground.register(cloud, start)

    def _place(self, cloud: np.ndarray, T_map_submap: np.ndarray) -> None:
        self._footprints.add(cloud)
        self._clouds.append(cloud)
        self._T_map_submap.append(T_map_submap)

    def _connect(self, targets: np.ndarray, registration: _Registration) -> None:
        # the registration corrects x, y and with xyyaw yaw; the rest of the pose is the one handed in
        i = registration.node
        for k in targets:
            T_target_source = np.linalg.inv(self._T_map_submap[k]) @ self._T_map_submap[i]
            self._edges.append(_Edge(int(k), i, len(self._registrations), T_target_source))
        self._registrations.append(registration)

    def closures(self) -> Closures:
        """Return the edges and registrations so far."""
        edges, registrations, m = self._edges, self._registrations, self._registration.dimensions
        return Closures(
            edges=Edges(
                target=np.array([e.target for e in edges], np.int64),
                source=np.array([e.source for e in edges], np.int64),
                T_target_source=np.array([e.T_target_source for e in edges]).reshape(-1, 4, 4),
            ),
            registration=np.array([e.registration for e in edges], np.int64),
            node=np.array([r.node for r in registrations], np.int64),
            start=np.array([r.start for r in registrations]).reshape(-1, 3)[:, :m],
            correction=np.array([r.correction for r in registrations]).reshape(-1, 3)[:, :m],
            converged=np.array([r.converged for r in registrations], bool),
            rejected=np.array(self._rejected, np.int64),
            centroid=np.array(self._centroids).reshape(-1, 2) if m == 3 else None,
        )
