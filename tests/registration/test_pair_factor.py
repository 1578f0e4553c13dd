"""What a graph gets of a pair: its rank by the ground, nothing of the start, and the gates."""

import dataclasses

import numpy as np
import pytest

import pairs
from pairs import BLOCK_M, GATES, NUMBERS, SETTINGS, SPACING_M, prior
from pointnetkl.registration import pair
from pointnetkl.registration.pair import covariance, factor
from pointnetkl.surveys.se2 import SE2

DOFS = ("xy", "xyyaw")
STARTS = np.random.default_rng(6).normal(0, 2, (8, 2))


def register(
    kind: str, number: int, start: np.ndarray, dof: str = "xy", sigma_m: float = 3.0
) -> tuple[pair.Estimate, pair.Factor]:
    """Return a pair's registration and its factor; both clouds lie where they truly do."""
    clouds = pairs.clouds(kind, number)
    end = pair.register(*clouds, prior(dof, sigma_m), SPACING_M, SETTINGS[dof], SE2(start, 0.0))
    return end, factor.of(end.forces, NUMBERS, GATES)


@pytest.mark.parametrize("dof", DOFS)
@pytest.mark.parametrize("noise_m", [0.0, 0.02, 0.3])
def test_flat_ground_has_rank_0_and_the_start_is_the_most_probable_place(noise_m: float, dof: str) -> None:
    clouds = pairs.clouds("flat", 0, noise_m)
    for start in STARTS:
        end = pair.register(*clouds, prior(dof), SPACING_M, SETTINGS[dof], SE2(start, 0.0))
        ground = factor.of(end.forces, NUMBERS, GATES)
        assert ground.A.shape == (0, end.forces.dimensions)
        back = SE2(start, 0.0).to_vector()[: end.forces.dimensions] - place(end)
        offset, Q = factor.place(ground, prior(dof), back)
        assert place(end) + offset == pytest.approx(place(SE2(start, 0.0)[: 0] if False else end) + back)
        assert Q == pytest.approx(prior(dof))


def place(end: pair.Estimate) -> np.ndarray:
    """Return the motion (M,) of the source's centroid, which lies within centimetres of the target's centre."""
    return np.asarray(end.T_target_source.to_vector()[: end.forces.dimensions])
