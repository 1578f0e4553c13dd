"""The covariance of a registration turns with the submap: no axis, grid or rounding is preferred."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import terrains
from pointnetkl.registration import gicp, monte_carlo

FINE = gicp.Settings(neighbours=20, plane_epsilon=1e-3, max_distance_m=20.0, tolerance_m=1e-6, max_iterations=200)
RUNS = 40
# Rounding to float32 moves a point 70 m away by 4e-6 m, and a translation, a mean over hundreds of them, by less. The
# rest is for a run that ends in another solution because a point as near to two others chooses the other one.
TURNED_M = 1e-4  # root mean square, of the difference between errors


def errors(submap: np.ndarray, angle: float) -> np.ndarray:
    """Return errors (RUNS, 2) of the same copies of a submap, all of it turned by an angle."""
    rng = np.random.default_rng(3)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    moves = np.pad(3 * rng.standard_normal((RUNS, 2)), ((0, 0), (0, 1)))
    copies = submap + moves[:, None] + 0.1 * rng.standard_normal((RUNS, *submap.shape))
    target = gicp.prepare(submap @ turn.T, FINE)
    translations = [
        gicp.register(gicp.prepare(copy @ turn.T, FINE), target, FINE).T_target_source.translation for copy in copies
    ]
    return np.asarray((moves @ turn.T)[:, :2] + translations)


@pytest.mark.parametrize("kind", ["flat", "mild", "rugged", "ridge"])
@settings(max_examples=6, derandomize=True, deadline=None)
@given(angle=st.floats(-np.pi, np.pi))
@example(angle=np.pi / 2)
def test_the_covariance_of_the_same_draws_turns_with_the_submap(kind: str, angle: float) -> None:
    submap = terrains.cloud(kind, 500)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    straight, turned = (monte_carlo.covariance(errors(submap, by)) for by in (0.0, angle))
    # of E' = E R^T + D with |D| the root mean square, Q' - R Q R^T has the terms 2 |E| |D| and |D|^2
    tolerance = 2 * TURNED_M * np.sqrt(np.trace(straight)) + TURNED_M**2
    assert np.linalg.norm(turned - turn @ straight @ turn.T) < tolerance
