"""The method in plain NumPy says the same as the kernels."""

import dataclasses

import numpy as np
import pytest

import terrains
from pointnetkl.registration import gicp, monte_carlo, reference
from pointnetkl.registration.streams import Stream
from pointnetkl.surveys.se2 import SE2, rotate
from pointnetkl.surveys.submap import Submap

REGISTRATION = gicp.Settings(
    neighbours=20, plane_epsilon=1e-3, max_distance_m=20.0, tolerance_m=1e-6, max_iterations=200
)
SETTINGS = monte_carlo.Settings(seed=2, copy="same", prior_variance_m2=9.0, noise_sigma_m=0.1, held_out_runs=0)
RUNS = 40


@pytest.mark.parametrize("dof", ["xy", "xyyaw"])
@pytest.mark.parametrize("kind", ["ridge", "rugged"])
def test_a_label_is_that_of_the_reference_from_the_same_draws(kind: str, dof: str) -> None:
    submap = Submap("baltic", 0, *(terrains.cloud(kind, 400, seed) for seed in range(3)))
    registration = dataclasses.replace(REGISTRATION, dof=dof)
    errors = monte_carlo.errors(
        submap, RUNS, monte_carlo.generator(SETTINGS, submap, Stream.LABEL), SETTINGS, registration
    ).errors
    expected = reference.errors(*draws(submap, registration), registration)
    sigmas = np.sqrt(np.diag(reference.label(expected)))
    assert np.abs(errors - expected).max(axis=1) == pytest.approx(0, abs=1e-3)
    assert monte_carlo.covariance(errors) / np.outer(sigmas, sigmas) == pytest.approx(
        reference.label(expected) / np.outer(sigmas, sigmas), abs=0.02
    )


def draws(submap: Submap, registration: gicp.Settings) -> tuple[np.ndarray, list[SE2], np.ndarray]:
    """Return the points, perturbations and noise that `monte_carlo.errors` registers: the copy moves, then turns."""
    rng = monte_carlo.generator(SETTINGS, submap, Stream.LABEL)
    cloud = gicp.prepare(submap.points, registration)
    noise = gicp.Noise(SETTINGS.noise_sigma_m, int(rng.integers(1 << 63))).draw(RUNS, len(cloud.points))
    sigmas = monte_carlo.prior_sigmas(SETTINGS, registration.dimensions)
    moved = np.pad(rng.standard_normal((RUNS, len(sigmas))) * sigmas, ((0, 0), (0, 3 - len(sigmas))))
    perturbations = [SE2(np.zeros(2), yaw) @ SE2(np.array([x, y]), 0.0) for x, y, yaw in moved]
    turned = rotate(noise[..., :2], moved[:, 2:])
    return cloud.points, perturbations, np.concatenate([turned, noise[..., 2:]], axis=-1)
