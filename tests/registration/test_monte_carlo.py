"""Monte Carlo labels: what a covariance of registration must say of flat, ridged and rugged ground."""

import dataclasses
import functools

import numpy as np
import pandas as pd
import pytest

import terrains
from pointnetkl.labels import warnings
from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.registration.covariance import gaussian, label_table, table
from pointnetkl.registration.streams import Stream
from pointnetkl.surveys.se2 import SE2
from pointnetkl.surveys.submap import Submap
from pointnetkl.workflow import compute

REGISTRATION = gicp.Settings(
    neighbours=20, plane_epsilon=1e-3, max_distance_m=20.0, tolerance_m=1e-3, max_iterations=50
)
SETTINGS = monte_carlo.Settings(seed=2, copy="same", prior_variance_m2=9.0, noise_sigma_m=0.2, held_out_runs=10)
SPLIT = dataclasses.replace(SETTINGS, copy="split")


def submap(kind: str, points: int = 1000, number: int = 0) -> Submap:
    return Submap("baltic", number, *(terrains.cloud(kind, points, p) for p in range(3)))


def errors(cloud: Submap, runs: int = 200, settings: monte_carlo.Settings = SETTINGS) -> np.ndarray:
    rng = monte_carlo.generator(settings, cloud, Stream.LABEL)
    return monte_carlo.errors(cloud, runs, rng, settings, REGISTRATION).errors


def test_the_covariance_is_largest_along_a_ridge() -> None:
    q = monte_carlo.covariance(errors(submap("ridge")))
    values, vectors = np.linalg.eigh(q)
    assert abs(vectors[0, 1]) > 0.99
    assert values[1] > 20 * values[0]


def test_the_covariance_turns_with_the_submap() -> None:
    straight = submap("ridge")
    c, s = np.cos(1.0), np.sin(1.0)
    turned = dataclasses.replace(straight, points=straight.points @ [[c, s, 0], [-s, c, 0], [0, 0, 1]])
    long = np.linalg.eigh(monte_carlo.covariance(errors(turned)))[1][:, 1]
    assert abs(long @ [c, s]) > 0.99


def test_a_flat_seabed_leaves_errors_of_metres_and_a_rugged_one_of_centimetres() -> None:
    flat, rugged = (np.linalg.eigvalsh(monte_carlo.covariance(errors(submap(k)))) for k in ("flat", "rugged"))
    assert flat[0] > 1
    assert rugged[1] < 0.01


def test_registration_is_better_than_none() -> None:
    for kind in (*terrains.AMPLITUDES_M, "ridge"):
        assert np.linalg.eigvalsh(monte_carlo.covariance(errors(submap(kind))))[1] < SETTINGS.prior_variance_m2


def errors_with_yaw(cloud: Submap, runs: int, **changes: float) -> np.ndarray:
    registration = dataclasses.replace(REGISTRATION, dof="xyyaw", **changes)
    return monte_carlo.errors(cloud, runs, np.random.default_rng(3), SETTINGS, registration).errors


def test_a_registration_that_finds_no_match_leaves_the_whole_perturbation() -> None:
    sample = errors_with_yaw(submap("flat", 100), 2000, max_distance_m=1e-6)
    assert sample.std(axis=0) == pytest.approx([3, 3, SETTINGS.prior_yaw_sigma_rad], rel=0.05)
    assert np.abs(np.corrcoef(sample.T) - np.eye(3)).max() < 0.1


def test_registration_finds_yaw_and_finds_it_best_on_rugged_ground() -> None:
    flat, rugged = (errors_with_yaw(submap(kind), 100)[:, 2].std() for kind in ("flat", "rugged"))
    assert 3 * rugged < flat < SETTINGS.prior_yaw_sigma_rad


def test_errors_with_yaw_are_about_the_middle_of_the_submap_wherever_its_frame_has_its_origin() -> None:
    cloud = submap("mild", 300)
    away = dataclasses.replace(cloud, points=cloud.points + np.array([60.0, -40.0, 5.0]))
    assert errors_with_yaw(away, 20) == pytest.approx(errors_with_yaw(cloud, 20), abs=1e-3)


def test_errors_with_yaw_turn_with_the_submap_and_yaw_does_not() -> None:
    straight, (c, s) = submap("rugged", 500), (np.cos(1.0), np.sin(1.0))
    turned = dataclasses.replace(straight, points=straight.points @ [[c, s, 0], [-s, c, 0], [0, 0, 1]])
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    q, other = (monte_carlo.covariance(errors_with_yaw(cloud, 1000)) for cloud in (straight, turned))
    sigma = np.sqrt(np.diag(other))
    assert (R @ q @ R.T) / np.outer(sigma, sigma) == pytest.approx(other / np.outer(sigma, sigma), abs=0.15)


def test_a_label_with_yaw_describes_errors_that_it_has_not_seen() -> None:
    registration = dataclasses.replace(REGISTRATION, dof="xyyaw")
    label = monte_carlo.label(submap("rugged"), 400, dataclasses.replace(SETTINGS, held_out_runs=400), registration)
    q = table.to_matrices(pd.DataFrame([label.row]))
    assert set(label.row) == set(label_table.schema(3).names)
    assert gaussian.calibration(label.held_out[None], q)["nees"] == pytest.approx(1, abs=0.15)


def test_a_copy_flatters_and_another_pass_does_not() -> None:
    cloud = submap("rugged")
    same, split = (monte_carlo.covariance(errors(cloud, settings=s)) for s in (SETTINGS, SPLIT))
    assert np.trace(split) > 2 * np.trace(same)


def test_labels_do_not_depend_on_the_number_of_workers_or_the_order(monkeypatch: pytest.MonkeyPatch) -> None:
    submaps = [submap("mild", 300, number) for number in range(4)]

    label = functools.partial(monte_carlo.label, runs=20, settings=SETTINGS, registration=REGISTRATION)
    results = []
    for workers, ordered in ((1, submaps), (3, submaps), (2, submaps[::-1])):
        monkeypatch.setenv("POINTNETKL_WORKERS", str(workers))
        results.append({r.row["submap"]: r for r in compute.in_threads(label, ordered, "label")})
    for other in results[1:]:
        for number, first in results[0].items():
            assert first.row == other[number].row
            assert np.array_equal(first.held_out, other[number].held_out)
    assert not np.array_equal(results[0][0].errors, results[0][1].errors)


def test_the_first_runs_are_the_same_however_many_follow_or_are_made_at_once() -> None:
    cloud = submap("mild", 300)
    all_errors = errors(cloud, 230)
    assert np.array_equal(all_errors[:30], errors(cloud, 30))
    # a target looks at the errors every 100 runs
    looked_at = monte_carlo.label(cloud, 230, dataclasses.replace(SETTINGS, target_relative_error=1e-9), REGISTRATION)
    assert np.array_equal(all_errors, looked_at.errors)


def test_held_out_errors_share_no_draw_with_the_label() -> None:
    label = monte_carlo.label(submap("flat", 300), 10, SETTINGS, REGISTRATION)
    assert label.held_out.shape == (10, 2)
    assert not np.isclose(label.errors[:, None], label.held_out).all(axis=2).any()


def test_the_mean_error_is_part_of_the_covariance() -> None:
    assert np.allclose(monte_carlo.covariance(np.array([[1.0, 0], [1, 0], [1, 0]])), [[1.5, 0], [0, 0]])


def test_a_covariance_of_one_error_is_refused() -> None:
    with pytest.raises(monte_carlo.MonteCarloError, match="at least 2"):
        monte_carlo.covariance(np.ones((1, 2)))


def test_a_spacing_wider_than_the_prior_is_marked_as_self_matching_and_warned_of() -> None:
    coarse = submap("gentle", 100)
    label = monte_carlo.label(coarse, 20, SETTINGS, REGISTRATION)
    assert label.row["spacing_m"] > 3
    assert label.row["self_matching"]
    # another pass cannot match itself
    assert not monte_carlo.label(coarse, 20, SPLIT, REGISTRATION).row["self_matching"]
    assert any("use label.copy: split" in line for line in warnings.lines("x", pd.DataFrame([label.row]), 3.0))


def test_a_label_without_any_error_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    perfect = monte_carlo.Outcome(np.zeros((5, 2)), np.ones(5, np.bool_), np.ones(5, np.int32))
    monkeypatch.setattr(monte_carlo, "_errors", lambda *_: perfect)
    with pytest.raises(gaussian.CovarianceError, match="baltic, submap 0"):
        monte_carlo.label(submap("rugged", 300), 5, SETTINGS, REGISTRATION)


def pretend(monkeypatch: pytest.MonkeyPatch, sample: np.ndarray, shared: np.ndarray | None = None) -> None:
    """Let registrations end with these errors (n, 2), one after the other, those of `shared` converged."""
    remaining = iter(range(len(sample)))

    def register(
        source: gicp.Cloud, target: gicp.Cloud, moved: np.ndarray, *_: object, **__: object
    ) -> gicp.Registrations:
        indices = np.array([next(remaining) for _ in moved])
        converged = np.ones(len(indices), np.bool_) if shared is None else shared[indices]
        T_target_copy = SE2(sample[indices] - moved, np.zeros(len(indices)))
        return gicp.Registrations(T_target_copy, converged, iterations=indices % 4)

    monkeypatch.setattr(gicp, "register_noisy", register)


def test_a_label_holds_what_its_registrations_ended_with(monkeypatch: pytest.MonkeyPatch) -> None:
    sample = np.random.default_rng(0).standard_normal((400, 2)) @ [[2.0, 0.3], [0.0, 0.5]] + [0.7, -0.2]
    sample[:40] += [30.0, 0.0]  # the second basin
    converged = np.arange(400) % 5 != 0
    pretend(monkeypatch, np.concatenate([sample, sample[:10]]), np.concatenate([converged, converged[:10]]))
    label = monte_carlo.label(submap("flat", 100), 400, SETTINGS, REGISTRATION)
    row, q = label.row, np.einsum("li,lj->ij", sample, sample) / 399
    assert [row[name] for name in ("q_xx_m2", "q_xy_m2", "q_yy_m2")] == pytest.approx([q[0, 0], q[0, 1], q[1, 1]])
    assert [row["mean_x_m"], row["mean_y_m"]] == pytest.approx(sample.mean(axis=0).tolist())
    assert (row["runs"], row["converged_share"], row["iterations_mean"]) == (400, 0.8, 1.5)
    assert row["main_basin_share"] == pytest.approx(0.9 * 0.99, abs=0.02)
    assert np.allclose(label.errors, sample)
    assert np.allclose(label.held_out, sample[:10])


TARGET = dataclasses.replace(SETTINGS, held_out_runs=0, target_relative_error=0.2)


@pytest.mark.parametrize("kind", ["flat", "rugged"])
def test_a_label_that_stops_early_is_the_label_of_so_many_runs(kind: str) -> None:
    cloud, stopping = submap(kind, 300), dataclasses.replace(TARGET, held_out_runs=7)
    stopped = monte_carlo.label(cloud, 1000, stopping, REGISTRATION)
    same_runs = monte_carlo.label(
        cloud, stopped.row["runs"], dataclasses.replace(SETTINGS, held_out_runs=7), REGISTRATION
    )
    assert stopped.row["runs"] < 1000
    assert stopped.row["relative_error"] <= 0.2
    assert stopped.row == same_runs.row
    assert np.array_equal(stopped.errors, same_runs.errors)
    assert np.array_equal(stopped.held_out, same_runs.held_out)


def test_a_label_never_stops_before_100_runs_nor_makes_more_than_it_may() -> None:
    for target, runs, expected in ((5.0, 500, 100), (5.0, 60, 60), (1e-6, 230, 230)):
        settings = dataclasses.replace(TARGET, target_relative_error=target)
        label = monte_carlo.label(submap("mild", 100), runs, settings, REGISTRATION)
        assert label.row["runs"] == len(label.errors) == expected


def stops(monkeypatch: pytest.MonkeyPatch, share: float, tails: float, most: int) -> tuple[float, float]:
    """Return how often Q +- 2 standard errors hold the true variance, and how often a label stopped, of 150 labels.

    Errors are of Student's t of so many degrees of freedom, but for a share of them some hundred times wider.
    """
    rng, cloud, covered, stopped = np.random.default_rng(3), submap("flat", 100), [], []
    wide = 2.0
    true = (1 - share) * 0.02**2 * tails / (tails - 2) + share * wide**2
    for _ in range(150):
        inside = 0.02 * rng.standard_t(tails, (most, 2))
        outside = wide * rng.standard_normal((most, 2))
        pretend(monkeypatch, np.where(rng.random((most, 1)) < share, outside, inside))
        row = monte_carlo.label(cloud, most, TARGET, REGISTRATION).row
        covered.append(abs(row["q_xx_m2"] - true) <= 2 * row["se_xx_m2"])
        stopped.append(row["runs"] < most)
    return float(np.mean(covered)), float(np.mean(stopped))


def test_a_stop_keeps_its_word_on_gaussian_errors_heavy_tails_and_a_second_basin(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for share, tails, least in ((0.0, 100.0, 0.9), (0.0, 6.0, 0.85), (0.3, 100.0, 0.85), (0.1, 100.0, 0.85)):
        covered, stopped = stops(monkeypatch, share, tails, 2000)
        assert covered >= least
        assert stopped > 0.9


def test_a_stop_cannot_know_of_a_basin_that_no_run_has_met(monkeypatch: pytest.MonkeyPatch) -> None:
    # one run in a hundred: 0.99^100, a third of the labels, have met none at the first look
    covered, stopped = stops(monkeypatch, 0.01, 100.0, 500)
    assert 0.25 < stopped < 0.45
    assert covered < 0.7


@pytest.mark.parametrize(
    "change",
    [
        {"copy": "twin"},
        {"prior_variance_m2": 0.0},
        {"noise_sigma_m": -1.0},
        {"held_out_runs": -1},
        {"engine": "gpu"},
        {"target_relative_error": 0.0},
        {"seed": -1},
    ],
)
def test_settings_that_make_no_sense_are_refused(change: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=f"^{next(iter(change))} is "):
        dataclasses.replace(SETTINGS, **change)  # type: ignore[arg-type]
