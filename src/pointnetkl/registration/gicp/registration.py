"""Registering clouds: one source, or many noisy copies of it."""

from dataclasses import dataclass

import numpy as np

from pointnetkl.registration.gicp import kernel
from pointnetkl.registration.gicp.cloud import Cloud, GicpError, Settings, Source
from pointnetkl.registration.gicp.noise import Noise
from pointnetkl.surveys.se2 import SE2, rotate


@dataclass(frozen=True)
class Registration:
    """Outcome of aligning one cloud with another."""

    T_target_source: SE2  # from the source's coordinates to the target's, both with the origin at the target's centre
    # (M, M) 1/m^2 and 1/rad^2, yaw about the target's centre: the sum of J^T W J over the matches at the solution, J
    # the Jacobian of (x, y) or (x, y, yaw); zero without any match
    information: np.ndarray
    converged: bool
    iterations: int
    matched_share: float  # of the source's points


@dataclass(frozen=True)
class Registrations:
    """Outcomes of aligning b noisy copies of one cloud with another."""

    T_target_copy: SE2  # (b) motions from the coordinates of the moved, noisy copies, also about the target's centre
    converged: np.ndarray  # (b,) bool
    iterations: np.ndarray  # (b,) int32


def register(source: Source, target: Cloud, settings: Settings, start: SE2 | None = None) -> Registration:
    """Register the source with the target, from the motion `start` on.

    Both clouds are in the same axes. `start` and the result have their origin at the target's centre; only the dof
    xyyaw has a yaw. Without any match within settings.max_distance_m the result is the start itself, not converged,
    with zero information.

    Raises:
        GicpError: the start has a yaw, and the dof is xy.
    """
    start = start or SE2.identity()
    if start.yaw and settings.dimensions == 2:
        raise GicpError(
            f"a start with a yaw of {start.yaw:g} rad needs the dof xyyaw, and it is xy; set registration.dof to xyyaw"
        )
    # the kernel takes a source that is moved first, and then turns it
    move = rotate(start.translation, -start.yaw)
    (x, y, yaw), sums, iterations, converged, matched = kernel.register(
        source.as_source(target, np.array([*move, 0.0])), target.as_target, float(start.yaw), limits(settings)
    )
    return Registration(
        T_target_source=SE2(np.array([x, y]), yaw) @ SE2(move, 0.0),
        information=_information(sums, settings.dimensions),
        converged=converged,
        iterations=iterations,
        matched_share=matched / len(source.points),
    )


def register_noisy(
    source: Cloud, target: Cloud, moves: np.ndarray, noise: Noise, settings: Settings, engine: str = "cpu"
) -> Registrations:
    """Register copies of the source, each moved by x, y of moves (b, 2) in metres and noise, onto the target.

    With the dof xyyaw moves may be (b, 3): a search begins with the moved copy turned by so many radians. Copy i has
    the noise of run `noise.first` + i, in the order of source.points. A copy's normals come from its own noisy points
    and the source's neighbour lists. The engine is cpu; or cuda for an NVIDIA GPU, which is experimental: the same
    answer, up to float32's rounding.

    Raises:
        GicpError: moves have a yaw, and the dof is xy; or the engine cuda cannot do it, as cuda.engine.register_noisy
            says.
    """
    if moves.shape[1] > settings.dimensions:
        raise GicpError(f"moves of shape {moves.shape} have a yaw, which the dof {settings.dof} does not find")
    if engine == "cuda":
        from pointnetkl.registration.gicp.cuda import engine as cuda  # only here: a machine without a GPU has none

        translations, iterations, converged = cuda.register_noisy(source, target, moves, noise, limits(settings))
        return Registrations(SE2(translations, np.zeros(len(translations))), converged, iterations)
    start_yaws = np.ascontiguousarray(moves[:, 2], np.float64) if moves.shape[1] == 3 else np.zeros(len(moves))
    motions, iterations, converged = kernel.register_noisy(
        source.as_source(target, np.zeros(3)),
        target.as_target,
        np.ascontiguousarray(moves[:, :2], np.float64),
        start_yaws,
        noise.as_arguments(),
        limits(settings),
    )
    return Registrations(SE2.from_vector(motions), converged, iterations)


def limits(settings: Settings) -> kernel.Limits:
    """Return the settings as the kernels take them."""
    return kernel.Limits(
        epsilon=np.float32(settings.plane_epsilon),
        max_distance=np.float32(settings.max_distance_m),
        tolerance=settings.tolerance_m,
        max_iterations=settings.max_iterations,
        with_yaw=settings.dimensions == 3,
    )


def _information(sums: np.ndarray, dimensions: int) -> np.ndarray:
    xx, xy, yy, _, _, x_yaw, y_yaw, yaw_yaw, _ = sums
    return np.array([[xx, xy, x_yaw], [xy, yy, y_yaw], [x_yaw, y_yaw, yaw_yaw]])[:dimensions, :dimensions]
