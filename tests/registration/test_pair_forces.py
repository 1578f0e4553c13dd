"""Forces of a pair's matches: against the plain reference, and the variance of their sum by blocks."""

import dataclasses

import numpy as np
import pytest

import pairs
from pairs import BLOCK_M, SETTINGS, SPACING_M, prior
from pointnetkl.registration import gicp, pair
from pointnetkl.registration.pair import blocks, reference
from pointnetkl.surveys.se2 import SE2

DOFS = ("xy", "xyyaw")
PLACE = {"xy": SE2(np.array([0.4, -0.3]), 0.0), "xyyaw": SE2(np.array([0.4, -0.3]), 0.01)}


@pytest.mark.parametrize("in_plane", [False, True])
@pytest.mark.parametrize("dof", DOFS)
@pytest.mark.parametrize("kind", ["flat", "mild", "rugged", "ridge"])
def test_forces_and_stiffness_are_those_of_the_reference(kind: str, dof: str, in_plane: bool) -> None:
    source, target = pairs.clouds(kind)
    ours = pair.at(source, target, PLACE[dof], BLOCK_M, SETTINGS[dof], in_plane)
    matched = reference.matches(*pairs.plain(source, target), PLACE[dof], SETTINGS[dof])
    forces, total, stiffness, ground = reference.sums(matched, in_plane)
    size = np.sqrt(np.diag(stiffness))
    assert ours.matched == len(forces)
    assert np.allclose(ours.total / size, total / size, atol=1e-3 * np.abs(total / size).max())
    assert np.allclose(ours.stiffness / np.outer(size, size), stiffness / np.outer(size, size), atol=1e-4)
    assert np.allclose(ours.ground / np.outer(size, size), ground / np.outer(size, size), atol=1e-4)
    assert np.allclose(ours.chance, reference.chance(matched), rtol=1e-3, atol=1e-4 * np.diag(stiffness).max())
    variance = reference.force_variance(matched.arms, forces, BLOCK_M)
    assert np.allclose(ours.variance, variance, rtol=1e-3, atol=1e-3 * variance.max())
    assert ours.residual_variance == pytest.approx(reference.residual_variance(matched), rel=1e-4)
    assert ours.lever_m == pytest.approx(reference.lever_m(source.points))


def test_yaw_is_about_the_centroid_of_a_source_far_from_the_target_s_centre() -> None:
    source, target = pairs.clouds("rugged")
    east = gicp.part(source, source.points[:, 0] > 20, pairs.GICP)
    ours = pair.at(east, target, PLACE["xyyaw"], BLOCK_M, SETTINGS["xyyaw"])
    matched = reference.matches(*pairs.plain(east, target), PLACE["xyyaw"], SETTINGS["xyyaw"])
    _, total, stiffness, ground = reference.sums(matched)
    assert ours.total == pytest.approx(total, rel=1e-3, abs=1e-3 * np.abs(total).max())
    assert ours.stiffness == pytest.approx(stiffness, abs=1e-4 * stiffness.max())
    assert ours.ground == pytest.approx(ground, abs=1e-4 * ground.max())
    assert ours.lever_m < 0.8 * reference.lever_m(source.points)


@pytest.mark.parametrize("dof", DOFS)
@pytest.mark.parametrize("steps", [2, 15])
def test_the_forces_of_a_registration_are_those_at_its_last_place(steps: int, dof: str) -> None:
    source, target = pairs.clouds("mild")
    settings = dataclasses.replace(SETTINGS[dof], map_steps=steps)
    end = pair.register(source, target, prior(dof), SPACING_M, settings, SE2(np.array([1.5, -2.0]), 0.0))
    anew = pair.at(source, target, end.T_target_source, BLOCK_M, settings)
    assert end.forces.total == pytest.approx(anew.total, abs=0.02)  # float32 places points anew
    assert end.forces.stiffness == pytest.approx(anew.stiffness, rel=1e-3, abs=1e-3 * anew.stiffness.max())


def test_a_search_that_has_not_converged_has_another_force_than_its_prior_says() -> None:
    source, target = pairs.clouds("mild")
    settings, start = dataclasses.replace(SETTINGS["xy"], map_steps=2), np.array([1.5, -2.0])
    end = pair.register(source, target, prior("xy"), SPACING_M, settings, SE2(start, 0.0))
    offset = end.T_target_source.translation - start
    balance = settings.residuals_as_one * end.forces.residual_variance * np.linalg.solve(prior("xy"), offset)
    assert np.linalg.norm(balance - end.forces.total) > np.linalg.norm(balance)


@pytest.mark.parametrize("dof", DOFS)
def test_a_normal_may_have_either_sign(dof: str) -> None:
    source, target = pairs.clouds("rugged")
    signs = np.where(np.random.default_rng(1).random(len(source.points)) < 0.5, -1, 1).astype(np.float32)
    flipped = gicp.Part(source.points, source.normals * signs[:, None])
    ours, same = (pair.at(each, target, PLACE[dof], BLOCK_M, SETTINGS[dof]) for each in (source, flipped))
    assert same.ground == pytest.approx(ours.ground)
    assert same.stiffness == pytest.approx(ours.stiffness)


@pytest.mark.parametrize("dof", DOFS)
def test_forces_and_stiffness_turn_with_the_clouds(dof: str) -> None:
    R, m = pairs.rotation(0.7), SETTINGS[dof].dimensions
    clouds = [gicp.prepare(pairs.points("mild", k) @ R.T, pairs.GICP) for k in (0, 1)]
    place = SE2(R[:2, :2] @ PLACE[dof].translation, PLACE[dof].yaw)
    straight = pair.at(*pairs.clouds("mild"), PLACE[dof], BLOCK_M, SETTINGS[dof])
    turned = pair.at(*clouds, place, BLOCK_M, SETTINGS[dof])
    R = R[:m, :m]
    assert turned.total == pytest.approx(R @ straight.total, rel=1e-2)
    for name in ("stiffness", "ground", "chance"):
        was, now = getattr(straight, name), getattr(turned, name)
        assert now == pytest.approx(R @ was @ R.T, abs=2e-3 * np.abs(was).max())
    # blocks lie along the axes, and are others
    assert np.trace(turned.variance) == pytest.approx(np.trace(straight.variance), rel=0.3)


def variance(xy: np.ndarray, forces: np.ndarray, block_m: float) -> np.ndarray:
    columns = np.ascontiguousarray(xy.T)
    return np.asarray(
        blocks.variance(columns[0], columns[1], np.pad(forces, ((0, 0), (0, 1))).T.copy(), block_m)[0][:2, :2]
    )


def test_independent_forces_have_the_variance_of_their_sum_of_squares() -> None:
    rng = np.random.default_rng(2)
    xy, forces = rng.uniform(-300, 300, (20_000, 2)), rng.normal(size=(20_000, 2))
    assert variance(xy, forces, 25.0) == pytest.approx(20_000 * np.eye(2), abs=2_500)


def test_forces_that_are_alike_within_a_block_have_more() -> None:
    rng = np.random.default_rng(2)
    xy = rng.uniform(-300, 300, (20_000, 2))
    patch = np.floor(xy / 10).astype(int) + 30
    forces = rng.normal(size=(60, 60, 2))[patch[:, 0], patch[:, 1]]
    truth = sum(count**2 for count in np.unique(patch, axis=0, return_counts=True)[1])
    assert variance(xy, forces, 40.0) == pytest.approx(truth * np.eye(2), rel=0.2, abs=0.2 * truth)


def test_the_variance_by_blocks_is_that_of_the_reference_wherever_the_arms_lie() -> None:
    rng = np.random.default_rng(3)
    xy, forces = rng.uniform(-70, 41, (500, 2)), rng.normal(size=(500, 2)) + 0.5
    for shift in ([0.0, 0.0], [1e3, -3e3]):
        expected = reference.force_variance(xy + shift, forces, 13.0)
        assert variance(xy + shift, forces, 13.0) == pytest.approx(expected)


def test_blocks_without_points_are_refused() -> None:
    with pytest.raises(pair.PairError, match="too small"):
        pair.at(*pairs.clouds("flat"), SE2.identity(), 0.1, SETTINGS["xy"])
