"""Registering a pair by GICP or to its most probable place, and what its matches say at the end."""

from dataclasses import dataclass, replace

import numpy as np

from pointnetkl.registration import gicp
from pointnetkl.registration.gicp.registration import limits
from pointnetkl.registration.pair import compilation, forces, kernel
from pointnetkl.registration.pair.forces import Forces, Source
from pointnetkl.registration.pair.settings import PairError, Settings
from pointnetkl.surveys.se2 import SE2, rotate


@dataclass(frozen=True)
class Estimate:
    """Outcome of registering a pair."""

    T_target_source: SE2  # from the source's coordinates to the target's, both with the origin at the target's centre
    forces: Forces  # at the end; those of GICP's end hold its pull in the plane
    converged: bool
    iterations: int
    matched_share: float  # of the source's points, at the end


def register(
    source: Source,
    target: gicp.Cloud,
    prior: np.ndarray,
    spacing_m: float,
    settings: Settings,
    start: SE2 | None = None,
    block_spacings: float = 8.0,
) -> Estimate:
    """Register the source with the target by settings.method, from the motion `start` on.

    Args:
        source: the cloud that moves, in the target's axes.
        target: the cloud that it is registered to.
        prior: variance of the start (M, M), m^2 and rad^2, of the source's centroid and of its yaw about it; method map
            alone uses it.
        spacing_m: of the survey's points, the unit of the longest step and of blocks.
        settings: of the registration.
        start: its origin is the target's centre, as the result's.
        block_spacings: edge of the blocks that the variance of forces is taken by.

    Returns:
        The end. With fewer matches than settings.neighbours method map stops, and has not converged.

    Raises:
        GicpError, PairError: the start has a yaw, and the dof is xy.
        PairError: the prior is no covariance (M, M), or blocks are so small that most hold no point.
    """
    start, block_m = start or SE2.identity(), block_spacings * spacing_m
    if settings.method == "gicp":
        return _by_gicp(source, target, block_m, settings, start)
    if start.yaw and settings.dimensions == 2:
        raise PairError(f"a start with a yaw of {start.yaw:g} rad needs the dof xyyaw; set registration.dof to xyyaw")
    limit = replace(settings, max_iterations=settings.map_steps)
    (x, y, yaw), sums, iterations, converged = _register(
        forces.as_source(source, target, start),
        target.as_target,
        float(start.yaw),
        block_m,
        limits(limit),
        _search(prior, spacing_m, settings),
    )
    end = forces.from_kernel(sums, settings.dimensions, block_m)
    T_target_source = SE2(np.array([x, y]) + rotate(start.translation, yaw - start.yaw), yaw)
    return Estimate(T_target_source, end, converged, iterations, end.matched / len(source.points))


def _by_gicp(source: Source, target: gicp.Cloud, block_m: float, settings: Settings, start: SE2) -> Estimate:
    found = gicp.register(gicp.Part(source.points, source.normals), target, settings, start)
    end = forces.at(source, target, found.T_target_source, block_m, settings, in_plane=True)
    return Estimate(found.T_target_source, end, found.converged, found.iterations, end.matched / len(source.points))


def _search(prior: np.ndarray, spacing_m: float, settings: Settings) -> kernel.Search:
    return kernel.Search(
        precision=_precision(prior, settings.dimensions),
        residuals_as_one=settings.residuals_as_one,
        longest_step=settings.longest_step_spacings * spacing_m,
        tolerance_sigmas=settings.tolerance_sigmas,
        least_matches=settings.neighbours,
    )


def _precision(prior: np.ndarray, dimensions: int) -> np.ndarray:
    # the precision (3, 3) of a prior (M, M); without yaw the step of yaw is that of a prior of 1 and no force: none
    try:
        if prior.shape != (dimensions, dimensions) or np.linalg.eigvalsh(prior)[0] <= 0:
            raise np.linalg.LinAlgError
        precision = np.eye(3)
        precision[:dimensions, :dimensions] = np.linalg.inv(prior)
    except np.linalg.LinAlgError as error:
        raise PairError(
            f"the prior must be a covariance of {dimensions} dimensions, and is {prior.tolist()}"
        ) from error
    return precision


@compilation.kernel
def _register(source, target, start_yaw, block, limits, search):  # type: ignore[no-untyped-def]
    cloud = kernel.load(source)
    motion, iterations, converged = kernel.find(cloud, target, start_yaw, limits, search)
    kernel.match(cloud, target, motion, limits)  # the forces are those at the end: the search's are a step older
    sums = forces.total(cloud, target, motion, block, limits.epsilon, False)
    return (motion.x, motion.y, motion.yaw), sums, iterations, converged
