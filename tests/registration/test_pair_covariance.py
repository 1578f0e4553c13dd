"""The covariance of a pair: K, Q and V, against Monte Carlo and at its limits."""

import dataclasses

import numpy as np
import pytest

import pairs
import terrains
from pairs import BLOCK_M, GICP, NUMBERS, SETTINGS, SPACING_M, prior
from pointnetkl.registration import gicp, pair
from pointnetkl.registration.pair import covariance
from pointnetkl.surveys.se2 import SE2

DOFS = ("xy", "xyyaw")
PLAIN = dataclasses.replace(NUMBERS, inflation=1.0, drift_share=0.0)  # what the blocks alone say
DRAWS = 300
FORCES = ("stiffness", "ground", "chance")


def forces(ground: np.ndarray, variance: np.ndarray, lever_m: float = 40.0, blocks: int = 30) -> pair.Forces:
    """Return forces with X and S, (M, M)."""
    m = len(ground)
    return pair.Forces(np.zeros(m), ground, ground, np.zeros((m, m)), variance, 1.0, 1000, blocks, lever_m, 1e6)


def random_forces(dimensions: int, seed: int) -> pair.Forces:
    roots = np.random.default_rng(seed).normal(size=(2, dimensions, dimensions))
    return forces(*(100 * root @ root.T + np.eye(dimensions) for root in roots))


class Draws:
    """Pairs with fixed matches: each source point lies on the normal of its own target point.

    So every match is the right one, and its residual is the ground's slope times an offset, and noise along the normal
    that neighbours share. Normals have noise of their own, in source and target alike.
    """

    OFFSET = np.array([0.05, -0.03, 2e-4])  # of the source from its place: metres, and radians about its centroid
    NOISE_M, PATCH_M = 0.05, 6.0

    def __init__(self, kind: str, dof: str, moved: bool, tilt: float) -> None:
        """Prepare the ground; the source lies at OFFSET or where it should; `tilt` is normals' rms error in x and y."""
        self._tilt = tilt
        self.settings = SETTINGS[dof]
        self._target = gicp.prepare(pairs.points(kind, 0, 0.0), GICP)
        points, h = self._target.points, 1e-3
        slopes = [
            (terrains.height(kind, points[:, :2] + step) - terrains.height(kind, points[:, :2] - step)) / (2 * h)
            for step in ([h, 0.0], [0.0, h])
        ]
        self._normals = unit(np.column_stack([-slopes[0], -slopes[1], np.ones(len(points))]))
        arms = points[:, :2] - points[:, :2].mean(axis=0)
        x, y, yaw = self.OFFSET * [1, 1, dof == "xyyaw"] * moved
        shift = np.column_stack([x - yaw * arms[:, 1], y + yaw * arms[:, 0], np.zeros(len(points))])
        self._along = (shift * self._normals).sum(axis=1)
        self._patch = np.unique(np.floor(arms / self.PATCH_M), axis=0, return_inverse=True)[1].ravel()

    def draws(self) -> list[pair.Forces]:
        """Return the forces of DRAWS draws of the noise."""
        rng = np.random.default_rng(8)
        return [self._draw(rng) for _ in range(DRAWS)]

    def _draw(self, rng: np.random.Generator) -> pair.Forces:
        noise = self.NOISE_M * rng.normal(size=self._patch.max() + 1)[self._patch]
        points = self._target.points + (self._along + noise)[:, None] * self._normals
        a, b = (unit(self._normals + self._tilt * rng.normal(size=points.shape) * [1, 1, 0]) for _ in range(2))
        target = dataclasses.replace(self._target, normals=b.astype(np.float32))
        return pair.at(gicp.Part(points, a.astype(np.float32)), target, SE2.identity(), BLOCK_M, self.settings)


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@pytest.mark.parametrize("dof", DOFS)
def test_the_covariance_is_that_of_monte_carlo_with_fixed_matches(dof: str) -> None:
    drawn = Draws("rugged", dof, moved=False, tilt=0.03).draws()
    total = np.array([each.total for each in drawn])
    m = total.shape[1]
    seen, told = total.T @ total / DRAWS, np.mean([each.variance for each in drawn], axis=0)
    assert between(seen, told, 0.6, 1.6)  # S is the variance of f
    places = np.array([np.linalg.solve(each.ground, each.total) for each in drawn])
    lever = covariance.levers(drawn[0].lever_m, m)
    seen = places.T @ places / DRAWS / np.outer(lever, lever)
    K = np.mean([covariance.information(each, PLAIN) for each in drawn], axis=0)
    assert between(seen, covariance.without_prior(K, drawn[0].lever_m, PLAIN), 0.6, 1.6)


def between(seen: np.ndarray, told: np.ndarray, low: float, high: float) -> bool:
    """Whether one covariance is between so many times another in every direction."""
    root = np.linalg.inv(np.linalg.cholesky(told))
    values = np.linalg.eigvalsh(root @ seen @ root.T)
    return bool(low < values[0] and values[-1] < high)


@pytest.mark.parametrize("dof", DOFS)
@pytest.mark.parametrize(("kind", "tilt", "names"), [("rugged", 0.02, "X"), ("gentle", 0.06, "X - chance")])
def test_x_is_the_mean_slope_of_the_force(kind: str, tilt: float, names: str, dof: str) -> None:
    here, moved = (Draws(kind, dof, offset, tilt).draws() for offset in (False, True))
    offset = Draws.OFFSET[: len(here[0].total)] * covariance.levers(here[0].lever_m, len(here[0].total))
    pull = -np.mean([there.total - each.total for there, each in zip(moved, here, strict=True)], axis=0)
    H, X, chance = (np.mean([getattr(each, name) for each in here], axis=0) for name in FORCES)
    size = np.sqrt(np.diag(H))
    told = (X if names == "X" else X - chance) @ offset / size
    assert pull / size == pytest.approx(told, abs=0.1 * np.linalg.norm(told))
    if kind == "gentle":  # where noise tilts the normals more than the ground does
        assert np.linalg.norm(H @ offset / size) > 3 * np.linalg.norm(pull / size)
        assert np.linalg.norm(X @ offset / size) > 2 * np.linalg.norm(pull / size)


def test_a_direction_that_nothing_holds_costs_the_other_none_of_its_digits() -> None:
    R = pairs.rotation(0.3)[:2, :2]
    X, S = R @ np.diag([1e4, 1e-9]) @ R.T, R @ np.diag([1e3, 1e1]) @ R.T
    K = covariance.information(forces(X, S), NUMBERS)
    V = R.T @ covariance.without_prior(K, 40.0, NUMBERS) @ R
    assert V[0, 0] == pytest.approx(NUMBERS.inflation * 1e3 / 1e8 + NUMBERS.drift_m2, rel=1e-9)
    assert V[1, 1] == pytest.approx(NUMBERS.largest_m2 + NUMBERS.drift_m2, rel=1e-6)


def test_a_negative_eigenvalue_of_x_is_noise_and_tells_nothing() -> None:
    K = covariance.information(forces(np.diag([100.0, -5.0]), np.eye(2)), NUMBERS)
    assert pytest.approx(np.diag([100.0**2 / NUMBERS.inflation, 0.0])) == K


def test_forces_in_too_few_blocks_tell_nothing() -> None:
    assert not covariance.information(forces(np.eye(2), np.eye(2), blocks=2), NUMBERS).any()


@pytest.mark.parametrize("dof", DOFS)
def test_without_information_q_is_the_prior_and_v_the_largest(dof: str) -> None:
    m, lever_m = SETTINGS[dof].dimensions, 40.0
    scale = np.diag(covariance.levers(lever_m, m) ** -2)
    K, b = np.zeros((m, m)), NUMBERS.drift_m2
    assert covariance.with_prior(K, prior(dof), lever_m, NUMBERS) == pytest.approx(prior(dof) + b * scale)
    expected = (NUMBERS.largest_m2 + b) * scale
    assert covariance.without_prior(K, lever_m, NUMBERS) == pytest.approx(expected)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_q_nears_v_as_the_prior_widens_and_is_never_more_than_either(dimensions: int) -> None:
    wide = np.diag([1e6, 1e6, 1e4][:dimensions])
    for seed in range(5):
        each = random_forces(dimensions, seed)
        K = covariance.information(each, PLAIN)
        V = covariance.without_prior(K, each.lever_m, PLAIN)
        assert covariance.with_prior(K, wide, each.lever_m, PLAIN) == pytest.approx(V, rel=1e-3)
        tight = 0.01 * wide
        Q = covariance.with_prior(K, tight, each.lever_m, PLAIN)
        assert np.linalg.eigvalsh(tight - Q)[0] > -1e-9
        assert np.linalg.eigvalsh(V - Q)[0] > -1e-9


def test_information_is_unchanged_by_the_unit_in_which_yaw_is_told() -> None:
    each = random_forces(3, 4)
    D = np.diag([1.0, 1.0, 2.5])  # a lever 2.5 times as short: yaw's forces are so many times as large
    other = dataclasses.replace(
        each, ground=D @ each.ground @ D, variance=D @ each.variance @ D, lever_m=each.lever_m / 2.5
    )
    assert covariance.information(other, NUMBERS) == pytest.approx(covariance.information(each, NUMBERS))


def test_information_turns_with_the_axes() -> None:
    R = pairs.rotation(0.8)
    each = random_forces(3, 2)
    turned = dataclasses.replace(each, ground=R @ each.ground @ R.T, variance=R @ each.variance @ R.T)
    expected = R @ covariance.information(each, NUMBERS) @ R.T
    assert covariance.information(turned, NUMBERS) == pytest.approx(expected)


def test_what_blocks_miss_divides_the_information() -> None:
    each = random_forces(2, 1)
    double = dataclasses.replace(NUMBERS, inflation=2 * NUMBERS.inflation)
    assert 2 * covariance.information(each, double) == pytest.approx(covariance.information(each, NUMBERS))


@pytest.mark.parametrize("dof", DOFS)
def test_pairs_where_they_lie_have_the_errors_that_q_says(dof: str) -> None:
    nees, m = [], SETTINGS[dof].dimensions
    for number in range(12):
        draw = np.pad(np.random.default_rng(number).normal(0, np.sqrt(np.diag(prior(dof)))), (0, 3 - m))
        end = pair.register(*pairs.clouds("hills", number), prior(dof), SPACING_M, SETTINGS[dof], SE2.from_vector(draw))
        K = covariance.information(end.forces, NUMBERS)
        Q = covariance.with_prior(K, prior(dof), end.forces.lever_m, NUMBERS)
        error = end.T_target_source.to_vector()[:m]  # the clouds' centroids lie together
        nees.append(error @ np.linalg.solve(Q, error) / m)
    assert 0.1 < np.mean(nees) < 1.5


def test_the_pull_of_nearest_points_is_noise_of_an_end_that_gicp_has_found() -> None:
    source, target = pairs.clouds("flat")
    alone, whole = (pair.at(source, target, SE2.identity(), BLOCK_M, GICP, in_plane) for in_plane in (False, True))
    assert np.linalg.eigvalsh(whole.variance)[0] > np.linalg.eigvalsh(alone.variance)[-1]


def test_the_forces_of_an_end_that_gicp_has_found_cancel_with_the_pull_of_nearest_points() -> None:
    source, target = pairs.clouds("mild")
    settings = dataclasses.replace(GICP, tolerance_m=1e-6, max_iterations=200)
    end = pair.register(source, target, prior("xy"), SPACING_M, settings)
    alone = pair.at(source, target, end.T_target_source, BLOCK_M, GICP)
    assert np.linalg.norm(end.forces.total) < 0.1 * np.linalg.norm(alone.total)


@pytest.mark.parametrize(("noise_m", "without_chance"), [(0.1, False), (2.0, True)])
def test_on_flat_ground_normals_tell_nothing_however_noisy(noise_m: float, without_chance: bool) -> None:
    numbers = dataclasses.replace(NUMBERS, without_chance=without_chance)
    for number in range(6):
        end = pair.register(*pairs.clouds("flat", number, noise_m), prior("xy"), SPACING_M, SETTINGS["xy"])
        Q = covariance.with_prior(covariance.information(end.forces, numbers), prior("xy"), 1.0, NUMBERS)
        assert np.linalg.eigvalsh(Q)[0] > 0.5 * prior("xy")[0, 0]


@pytest.mark.parametrize("bad", [np.eye(3), np.diag([1.0, 0.0])])
def test_a_prior_that_is_no_covariance_is_refused(bad: np.ndarray) -> None:
    with pytest.raises(pair.PairError, match="prior must be a covariance of 2 dimensions"):
        covariance.with_prior(np.eye(2), bad, 40.0, NUMBERS)


def test_drift_is_a_share_of_the_submaps_length_along_their_track() -> None:
    line = np.array([[0.0, 200 * k, 5.0] for k in range(5)])
    track = np.concatenate(
        [line, np.add(line[::-1], [1000.0, 0.0, 0.0])]
    )  # the way from one line to the next is longer
    assert NUMBERS.of_submaps(track).drift_m2 == pytest.approx((NUMBERS.drift_share * 200.0) ** 2)
    assert NUMBERS.of_submaps(track[:1]) == NUMBERS


@pytest.mark.parametrize("name", ["inflation", "drift_share", "block_spacings", "largest_m2"])
def test_numbers_out_of_range_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match=name):
        dataclasses.replace(NUMBERS, **{name: -1.0})
