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


def register(kind: str, number: int, start: np.ndarray, dof: str = "xy", sigma_m: float = 3.0) -> pair.Estimate:
    """Return the registration of a pair, both of which lie where they truly do."""
    return pair.register(*pairs.clouds(kind, number), prior(dof, sigma_m), SPACING_M, SETTINGS[dof], SE2(start, 0.0))


def of(end: pair.Estimate) -> pair.Factor:
    return factor.of(end.forces, NUMBERS, GATES)


def most_probable(end: pair.Estimate, start: np.ndarray) -> np.ndarray:
    """Return the translation of the most probable place, of the factor and the prior about the start."""
    here = end.T_target_source.translation
    return np.asarray(here + factor.place(of(end), prior("xy"), start - here)[0])


@pytest.mark.parametrize("dof", DOFS)
@pytest.mark.parametrize("noise_m", [0.0, 0.02, 0.3])
def test_flat_ground_has_rank_0(noise_m: float, dof: str) -> None:
    for number in range(4):
        clouds = pairs.clouds("flat", number, noise_m)
        end = pair.register(*clouds, prior(dof), SPACING_M, SETTINGS[dof], SE2(STARTS[number], 0.0))
        assert of(end).A.shape == (0, end.forces.dimensions)
        assert not of(end).pull.any()


@pytest.mark.parametrize("dof", DOFS)
def test_a_ridge_has_no_component_along_it(dof: str) -> None:
    for number, rank in enumerate([2, 2, 2] if dof == "xyyaw" else [1, 1, 1]):
        ground = of(register("ridge", number, STARTS[number], dof))
        across = ground.A[:, 1:]  # the ridge is along x
        assert len(ground.c) == rank
        assert np.abs(ground.A[:, 0]).max() < 0.1 * np.abs(ground.A[:, 1]).max()
        assert np.linalg.matrix_rank(across) == rank


@pytest.mark.parametrize(("dof", "rank"), [("xy", 2), ("xyyaw", 3)])
def test_rugged_ground_has_full_rank_and_the_factor_is_v(dof: str, rank: int) -> None:
    end = register("rugged", 0, STARTS[0], dof)
    ground, lever_m = of(end), end.forces.lever_m
    V = covariance.without_prior(covariance.information(end.forces, NUMBERS), lever_m, NUMBERS)
    scale = np.outer(*2 * [covariance.levers(lever_m, rank)])
    assert len(ground.c) == rank
    assert np.linalg.inv(ground.information) * scale == pytest.approx(V * scale, rel=0.02, abs=1e-5)


def test_on_flat_ground_the_most_probable_place_is_the_start_and_on_a_ridge_it_is_across_from_it() -> None:
    for number, start in enumerate(STARTS[:4]):
        assert most_probable(register("flat", number, start), start) == pytest.approx(start)
        x, y = most_probable(register("ridge", number, start), start)
        assert x == pytest.approx(start[0], abs=0.2)
        assert y == pytest.approx(0.0, abs=0.2)


@pytest.mark.parametrize("kind", ["gentle", "mild", "rugged"])
def test_of_a_wrong_start_a_fifth_at_most_is_kept(kind: str) -> None:
    ends = [register(kind, 0, start) for start in STARTS]
    places = np.array([end.T_target_source.translation + of(end).pull for end in ends])
    assert abs(slope(STARTS, places)) < 0.2


def test_what_a_tight_prior_holds_back_is_given_back() -> None:
    starts = 0.2 * STARTS
    ends = [register("hills", 0, start, sigma_m=0.05) for start in starts]
    places = np.array([end.T_target_source.translation for end in ends])
    assert slope(starts, places) > 0.3  # the search's end leans on the start
    assert abs(slope(starts, places + [of(end).pull for end in ends])) < 0.2


def slope(starts: np.ndarray, places: np.ndarray) -> float:
    """Return how much of a wrong start is kept."""
    starts, places = starts - starts.mean(axis=0), places - places.mean(axis=0)
    return float((starts * places).sum() / (starts**2).sum())


def test_the_factor_has_no_prior_in_it() -> None:
    source, target = pairs.clouds("mild")
    ends = [
        pair.register(source, target, prior("xy", sigma), SPACING_M, SETTINGS["xy"], SE2(np.array([0.2, 0.1]), 0.0))
        for sigma in (3.0, 30.0)
    ]
    first, second = (of(end).information for end in ends)
    assert first == pytest.approx(second, rel=0.1, abs=0.1 * first.max())


def test_the_factor_is_the_likelihood_at_any_place_without_a_search() -> None:
    source, target = pairs.clouds("rugged")
    place = np.array([0.15, -0.1])
    ground = factor.of(pair.at(source, target, SE2(place, 0.0), BLOCK_M, SETTINGS["xy"]), NUMBERS, GATES)
    assert place + ground.pull == pytest.approx([0.0, 0.0], abs=0.15)


def test_residuals_have_unit_variance_where_the_source_truly_lies() -> None:
    squares = []
    for number in range(10):
        end = register("mild", number, STARTS[number % len(STARTS)])
        squares.append(of(end).residual(-end.T_target_source.translation) ** 2)
    assert 0.1 < np.mean(squares) < 1.5


def test_a_right_prediction_passes_and_one_that_is_10_m_off_does_not() -> None:
    for number in range(4):
        end = register("rugged", number, np.zeros(2))
        here, drift = -end.T_target_source.translation, 0.5**2 * np.eye(2)
        assert factor.passes_prediction(of(end), here, drift, GATES)
        assert not factor.passes_prediction(of(end), here + np.array([10.0, 0.0]), drift, GATES)


def test_drift_that_is_understated_threefold_is_forgiven() -> None:
    ground = pair.Factor(10 * np.eye(2), np.zeros(2), np.ones(2))
    off, believed = np.array([2.0, 2.0]), 0.3**2 * np.eye(2)  # 2.8 m at a sigma of 0.3 m
    assert factor.passes_prediction(ground, off, believed, GATES)
    assert not factor.passes_prediction(ground, off, believed, dataclasses.replace(GATES, drift_factor=1.0))


def test_chi2_is_that_of_the_prediction_s_error_and_the_factor_s() -> None:
    root = np.array([[2.0, 0.3], [0.0, 1.5]])
    ground = pair.Factor(root, np.array([0.4, -0.2]), np.ones(2))
    M, offset = np.array([[0.5, 0.1], [0.1, 0.8]]), np.array([1.0, 0.7])
    error = offset - ground.pull
    expected = error @ np.linalg.solve(M + np.linalg.inv(ground.information), error)
    assert factor.chi2(ground, offset, M) == pytest.approx(expected)


def test_ground_that_says_nothing_refuses_nothing() -> None:
    ground = of(register("flat", 0, np.zeros(2)))
    assert factor.chi2(ground, np.array([50.0, 0.0]), np.eye(2)) == 0
    assert factor.passes_prediction(ground, np.array([50.0, 0.0]), np.eye(2), GATES)


def test_an_end_in_a_wrong_place_has_more_residual_variance_than_the_gate_lets_in() -> None:
    right = [register("rugged", number, np.zeros(2)).forces for number in range(5)]
    median = float(np.median([each.residual_variance for each in right]))
    assert all(factor.passes_residuals(each, median, GATES) for each in right)
    wrong = register("rugged", 0, np.array([10.0, 8.0]), sigma_m=0.5)
    assert np.linalg.norm(wrong.T_target_source.translation) > 3
    assert not factor.passes_residuals(wrong.forces, median, GATES)


def test_matches_in_too_few_blocks_have_rank_0() -> None:
    end = register("rugged", 0, np.zeros(2))
    assert len(factor.of(dataclasses.replace(end.forces, blocks=2), NUMBERS, GATES).c) == 0


def test_a_place_with_a_prior_is_between_the_two_and_surer_than_either() -> None:
    ground = pair.Factor(np.diag([2.0, 0.1]), np.array([2.0, 0.0]), np.ones(2))
    offset, Q = factor.place(ground, np.eye(2), np.zeros(2))
    assert offset == pytest.approx([0.8, 0.0])
    assert np.diag(Q) == pytest.approx([0.2, 1 / 1.01])


@pytest.mark.parametrize(
    ("name", "value"),
    [("least_share", 1.5), ("largest_variance_ratio", 0.0), ("drift_factor", -1.0), ("gate_probability", 1.0)],
)
def test_numbers_out_of_range_are_refused(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        dataclasses.replace(GATES, **{name: value})
