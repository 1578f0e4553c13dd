"""Loop closures of a survey by registration: the front end of Algorithm 1 of the paper."""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from pointnetkl import compute, footprint, gicp, pose
from pointnetkl.errors import PointNetKLError
from pointnetkl.pose_graph import ClosureNoise, DeadReckoningNoise, Edges
from pointnetkl.submap import Submap
from pointnetkl.survey_graph import Closures


class LoopClosureError(PointNetKLError):
    """Submaps and poses do not belong together, or a setting makes no sense."""


@dataclass(frozen=True)
class Settings:
    """Section `graph` of the parameters."""

    seed: int
    coverage: float
    prior_variance_m2: float
    cell_factor: float
    overlap_factor: float | None
    dead_reckoning: DeadReckoningNoise
    loop_closure: ClosureNoise

    def __post_init__(self) -> None:
        """Refuse what makes no sense.

        Raises:
            LoopClosureError: a setting is out of its range.
        """
        if not (0 < self.coverage <= 1 and self.prior_variance_m2 >= 0):
            raise LoopClosureError(
                f"graph.coverage is {self.coverage} and prior_variance_m2 {self.prior_variance_m2};"
                " they must be in (0, 1] and not negative"
            )
        if self.cell_factor <= 0 or (self.overlap_factor is not None and self.overlap_factor <= 0):
            raise LoopClosureError(
                f"graph.cell_factor is {self.cell_factor} and overlap_factor {self.overlap_factor};"
                " they must be positive"
            )


def starts(survey: str, submaps: Sequence[Submap], settings: Settings) -> np.ndarray:
    """Return each submap's perturbation (n, 2) before it is registered, a draw from N(0, a I) in metres."""
    sigma = np.sqrt(settings.prior_variance_m2)
    key = zlib.crc32(survey.encode())
    draws = [np.random.default_rng([settings.seed, key, s.number]).normal(0.0, sigma, 2) for s in submaps]
    return np.array(draws)


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
        perturbations: (n, 2) metres; None starts each registration where dead reckoning from the submap before,
            as corrected, would have it: what a vehicle does when its poses drift.
        spacing: of neighbouring points in metres, the unit of `cell_factor` and `overlap_factor`.
        settings: coverage asked for, and those factors.
        registration: of GICP.

    Raises:
        LoopClosureError: there is not one pose a submap.
    """
    if len(poses) != len(submaps):
        raise LoopClosureError(
            f"there are {len(submaps)} submaps and {len(poses)} poses, must be one each; run segment again"
        )
    front = _FrontEnd(spacing, settings, registration)
    for i in compute.progress(range(len(submaps)), "loop closures", len(submaps)):
        drift = front.correction if perturbations is None else np.zeros(2)
        perturbation = np.zeros(2) if perturbations is None else perturbations[i]
        front.add(submaps[i].points, poses[i], drift, perturbation)
    return front.closures()


class _FrontEnd:
    """The map as it grows: S_graph of Algorithm 1."""

    def __init__(self, spacing: float, settings: Settings, registration: gicp.Settings) -> None:
        self._footprints = footprint.Footprints(settings.cell_factor * spacing)
        self._share, self._registration = settings.coverage, registration
        self._reach = None if settings.overlap_factor is None else settings.overlap_factor * spacing
        self._clouds: list[np.ndarray] = []
        self._T_map: list[np.ndarray] = []
        self._edges: list[tuple[int, int, int, np.ndarray]] = []
        self._registered: list[tuple[int, np.ndarray, np.ndarray, bool]] = []
        self._rejected: list[int] = []
        self.correction = np.zeros(2)  # of the submap added last, metres in the map frame

    def add(self, points: np.ndarray, T: np.ndarray, drift: np.ndarray, perturbation: np.ndarray) -> None:
        """Add the next submap, with pose T, shifted by `drift`; register it if it closes a loop."""
        i = len(self._clouds)
        cloud = pose.transform(_shifted(T, drift), points)
        targets = self._footprints.covering(cloud, self._share, among=i - 1)  # never S_{i-1}
        found = self._register(cloud, targets, perturbation) if len(targets) else None
        self.correction = drift if found is None else drift + found.translation
        self._place(cloud + np.append(self.correction - drift, 0.0), _shifted(T, self.correction))
        if found is not None:
            self._connect(i, targets, drift + perturbation, found.converged)
        elif len(targets):
            self._rejected.append(i)

    def _register(self, cloud: np.ndarray, targets: np.ndarray, start: np.ndarray) -> gicp.Registration | None:
        origin = cloud.mean(axis=0)  # keeps the numbers of the registration small
        fused, moving = np.concatenate([self._clouds[k] for k in targets]) - origin, cloud - origin
        if self._reach is not None:
            moving = _over(moving, fused, start, self._reach)
        if len(moving) < self._registration.neighbours:
            return None
        target = gicp.prepare(fused, self._registration)
        source = gicp.prepare(moving, self._registration)
        outcome = gicp.register(source, target, self._registration, (float(start[0]), float(start[1])))
        return outcome if outcome.matched_share > 0 else None

    def _place(self, cloud: np.ndarray, T: np.ndarray) -> None:
        self._footprints.add(cloud)
        self._clouds.append(cloud)
        self._T_map.append(T)

    def _connect(self, i: int, targets: np.ndarray, start: np.ndarray, converged: bool) -> None:
        # x, y from the registration; z and rotation are those handed in, because only x, y were corrected
        for k in targets:
            measured = np.linalg.inv(self._T_map[k]) @ self._T_map[i]
            self._edges.append((int(k), i, len(self._registered), measured))
        self._registered.append((i, start, self.correction, converged))

    def closures(self) -> Closures:
        """Return what was found."""
        edges, registered = self._edges, self._registered
        return Closures(
            edges=Edges(
                target=np.array([e[0] for e in edges], np.int64),
                source=np.array([e[1] for e in edges], np.int64),
                measured=np.array([e[3] for e in edges]).reshape(-1, 4, 4),
            ),
            registration=np.array([e[2] for e in edges], np.int64),
            node=np.array([r[0] for r in registered], np.int64),
            start=np.array([r[1] for r in registered]).reshape(-1, 2),
            correction=np.array([r[2] for r in registered]).reshape(-1, 2),
            converged=np.array([r[3] for r in registered], bool),
            rejected=np.array(self._rejected, np.int64),
        )


def _over(moving: np.ndarray, fixed: np.ndarray, start: np.ndarray, reach: float) -> np.ndarray:
    # Points beyond the target's edge would match its border: on flat ground nothing holds against them, and they
    # drag a half-covered submap right across the target.
    distance, _ = cKDTree(fixed[:, :2]).query(moving[:, :2] + start, distance_upper_bound=reach)
    return moving[np.isfinite(distance)]


def _shifted(T: np.ndarray, shift: np.ndarray) -> np.ndarray:
    moved = T.copy()
    moved[:2, 3] += shift
    return moved
