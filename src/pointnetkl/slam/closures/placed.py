"""Registrations with every submap at its true pose: their errors, and the covariances that their own matches tell.

GICP registers each start once. From where it ends come Q of the pair (docs/closures.md), and two rivals of it: the
region of small misfit, and point-to-plane with noisy normals. MAP registers the starts of the graph's draws as well,
and has errors of its own.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from pointnetkl.registration import gicp, pair
from pointnetkl.registration.covariance.catalogue import DRPM, MAP, MISFIT_REGION, PAIR
from pointnetkl.slam.closures import drpm, misfit_region
from pointnetkl.slam.closures.loop_closure import LEAST_SIGMA, Ground, covariance_about
from pointnetkl.slam.graph import survey_graph
from pointnetkl.surveys import pose
from pointnetkl.surveys.se2 import SE2, rotate
from pointnetkl.surveys.submap import Submap

_MARGIN_SIGMAS = 8.0  # of the start: where an end may lie, and the misfit be looked up about it


class End(NamedTuple):
    """A start, the points over the targets there, and the motion of the map frame that GICP has found."""

    start: SE2  # about the centroid of the whole cloud
    part: gicp.Part
    motion: SE2


class Judged(NamedTuple):
    """The error of an end in the submap's frame, and the covariance that a method gives it."""

    method: str
    error: np.ndarray  # (M,) metres, and radians about the centroid of the submap's points
    covariance: np.ndarray  # (M, M) m^2, m rad, rad^2


class Placed:
    """A submap to be registered onto its targets, all of them where they truly are."""

    def __init__(
        self,
        source: Submap,
        T_map_source: np.ndarray,
        targets: Sequence[np.ndarray],
        spacing_m: float,
        reach_m: float | None,
        registration: gicp.Settings,
        numbers: pair.covariance.Settings,
    ) -> None:
        """Prepare a submap at its pose (4, 4), and its targets' points (n, 3) in the map frame."""
        cloud = pose.transform(T_map_source, source.points)
        self.T_map_source = T_map_source
        self._spacing_m, self._numbers = spacing_m, numbers
        self._registration = pair.Settings.of(registration, "map")
        self._centroid = source.points[:, :2].mean(axis=0) if registration.dimensions == 3 else None
        self._ground = Ground(np.concatenate(targets), cloud.mean(axis=0), reach_m, registration)
        self._whole = self._ground.prepare(cloud)

    def register(self, starts: np.ndarray) -> list[End | None]:
        """Return GICP's end of each start (b, M) about the submap's pose; None without a match."""
        motions = [SE2.from_vector(start) for start in np.pad(starts, ((0, 0), (0, 3 - starts.shape[1])))]
        return [self._register(start) for start in motions]

    def errors(self, ends: Sequence[End | None]) -> np.ndarray:
        """Return the errors (b, M) of ends in the submap's frame; NaN of None."""
        return self._errors([None if end is None else end.motion for end in ends])

    def judge(self, ends: Sequence[End | None], sigmas: np.ndarray, noise_m: float) -> list[list[Judged]]:
        """Return what each method says of each end, by catalogue.OF_REGISTRATIONS; nothing of None.

        `sigmas` (M,) are the standard deviations of a start about the submap's centroid, and `noise_m` is that of
        points, which drpm asks for. misfit_region has no yaw, and is left out where registrations find it.
        """
        known = [end for end in ends if end is not None]
        if not known:
            return [[] for _ in ends]
        box = self._whole.points[:, :2].min(axis=0), self._whole.points[:, :2].max(axis=0)
        rivals = _Rivals(self._ground.target, noise_m, self._registration)
        if self._registration.dimensions == 2:
            rivals.look_up(box, self._spacing_m, max(float(sigmas[0]), LEAST_SIGMA))
        return [[] if end is None else list(self._judge(end, sigmas, rivals)) for end in ends]

    def _register(self, start: SE2) -> End | None:
        part = self._ground.part(self._whole, start)
        outcome = None if part is None else self._ground.register_part(part, start)
        return None if part is None or outcome is None else End(start, part, outcome[0])

    def _judge(self, end: End, sigmas: np.ndarray, rivals: "_Rivals") -> Iterator[Judged]:
        target, block_m = self._ground.target, self._numbers.block_spacings * self._spacing_m
        offset = (end.part.points.mean(axis=0) - self._whole.points.mean(axis=0))[:2]
        prior = covariance_about(np.diag(np.maximum(sigmas, LEAST_SIGMA) ** 2), offset)
        T_target_source = self._ground.from_map(end.motion)
        (error,) = self._errors([end.motion])
        forces = pair.at(end.part, target, T_target_source, block_m, self._registration, in_plane=True)
        yield Judged(PAIR, error, self._in_submap(self._q(forces, prior), offset))
        for method, q in rivals.covariances(end.part, T_target_source, prior):
            yield Judged(method, error, self._in_submap(q, offset))
        start = self._ground.to_target(end.start)
        found = pair.register(end.part, target, prior, self._spacing_m, self._registration, start)
        (error,) = self._errors([self._ground.to_map(found.T_target_source)])
        yield Judged(MAP, error, self._in_submap(self._q(found.forces, prior), offset))

    def _q(self, forces: pair.Forces, prior: np.ndarray) -> np.ndarray:
        K = pair.covariance.information(forces, self._numbers)
        return pair.covariance.with_prior(K, prior, forces.lever_m, self._numbers)

    def _errors(self, motions: Sequence[SE2 | None]) -> np.ndarray:
        residual = np.full((len(motions), 4, 4), np.nan)
        for i, motion in enumerate(motions):
            if motion is not None:
                residual[i] = np.linalg.inv(motion.act_on_pose(self.T_map_source)) @ self.T_map_source
        centroids = None if self._centroid is None else np.tile(self._centroid, (len(residual), 1))
        return survey_graph.residual_errors(residual, centroids)

    def _in_submap(self, q: np.ndarray, offset: np.ndarray) -> np.ndarray:
        """Return a covariance in the map's axes about a part's centroid in those of the submap, about its own."""
        turn = np.eye(len(q))
        turn[:2, :2] = rotate(np.eye(2), -SE2.from_matrix(self.T_map_source).yaw).T
        q = turn @ covariance_about(q, -offset) @ turn.T
        return np.asarray((q + q.T) / 2)


class _Rivals:
    """The other covariances of GICP's end, with what they need of a target once."""

    def __init__(self, target: gicp.Cloud, noise_m: float, registration: gicp.Settings) -> None:
        self._target, self._registration = target, registration
        self._planes = drpm.target(target, noise_m)
        self._relief: misfit_region.Relief | None = None

    def look_up(self, box: tuple[np.ndarray, np.ndarray], spacing_m: float, sigma_m: float) -> None:
        """Look up the relief about a source that lies in a box, for misfit_region to be one of the covariances."""
        margin = _MARGIN_SIGMAS * sigma_m
        wide = box[0] - margin, box[1] + margin
        self._relief = misfit_region.relief(self._target.points, self._target.normals, wide, spacing_m, sigma_m)

    def covariances(self, part: gicp.Part, T_target_source: SE2, prior: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
        """Yield each one by its method's name, in the target's axes about the part's centroid."""
        if self._relief is not None:
            moved = part.points + np.append(T_target_source.translation, 0.0)
            yield MISFIT_REGION, misfit_region.covariance(moved, self._relief)
        yield DRPM, drpm.covariance(part, self._planes, T_target_source, prior, self._registration)
