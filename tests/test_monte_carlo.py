"""Monte Carlo labels: what a covariance of registration must say of flat, ridged and rugged ground."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

import terrains
from pointnetkl import compute, gicp, label_summary, monte_carlo
from pointnetkl.covariance import gaussian
from pointnetkl.submap import Submap

REGISTRATION = gicp.Settings(
    neighbours=20, plane_epsilon=1e-3, max_distance_m=20.0, tolerance_m=1e-3, max_iterations=50
)
SETTINGS = monte_carlo.Settings(seed=2, copy="same", prior_variance_m2=9.0, noise_sigma_m=0.2, held_out_runs=10)
SPLIT = dataclasses.replace(SETTINGS, copy="split")


def submap(kind: str, points: int = 1000, number: int = 0) -> Submap:
    return Submap("baltic", number, *(terrains.cloud(kind, points, p) for p in range(3)))


def errors(of: Submap, runs: int = 200, settings: monte_carlo.Settings = SETTINGS) -> np.ndarray:
    rng = monte_carlo.generator(settings, of, monte_carlo.LABEL)
    return monte_carlo.errors(of, runs, rng, settings, REGISTRATION).errors


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


def test_a_copy_flatters_and_another_pass_does_not() -> None:
    of = submap("rugged")
    same, split = (monte_carlo.covariance(errors(of, settings=s)) for s in (SETTINGS, SPLIT))
    assert np.trace(split) > 2 * np.trace(same)


def test_labels_do_not_depend_on_the_number_of_workers_or_the_order(monkeypatch: pytest.MonkeyPatch) -> None:
    submaps = [submap("mild", 300, number) for number in range(4)]

    def label(one: Submap) -> monte_carlo.Label:
        return monte_carlo.label(one, 20, SETTINGS, REGISTRATION)

    results = []
    for workers, some in ((1, submaps), (3, submaps), (2, submaps[::-1])):
        monkeypatch.setenv("POINTNETKL_WORKERS", str(workers))
        results.append({r.row["submap"]: r for r in compute.over(label, some, "label")})
    for other in results[1:]:
        for number, first in results[0].items():
            assert first.row == other[number].row
            assert np.array_equal(first.held_out, other[number].held_out)
    assert not np.array_equal(results[0][0].errors, results[0][1].errors)


def test_the_first_runs_are_the_same_however_many_are_held_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    of = submap("mild", 300)
    together = errors(of, 30)
    monkeypatch.setattr(monte_carlo, "_NOISE_BYTES", 1)
    assert np.array_equal(together, errors(of, 30))


def test_held_out_errors_share_no_draw_with_the_label() -> None:
    label = monte_carlo.label(submap("flat", 300), 10, SETTINGS, REGISTRATION)
    assert label.held_out.shape == (10, 2)
    assert not np.isclose(label.errors[:, None], label.held_out).all(axis=2).any()


def test_the_mean_error_is_part_of_the_covariance() -> None:
    assert np.allclose(monte_carlo.covariance(np.array([[1.0, 0], [1, 0], [1, 0]])), [[1.5, 0], [0, 0]])


def test_a_covariance_of_one_error_is_refused() -> None:
    with pytest.raises(monte_carlo.MonteCarloError, match="at least 2"):
        monte_carlo.covariance(np.ones((1, 2)))


def test_standard_errors_are_those_of_repeated_labels() -> None:
    q = np.array([[2.0, 0.5], [0.5, 1.0]])
    samples = np.random.default_rng(0).multivariate_normal([0, 0], q, (400, 300))
    entries = np.stack([monte_carlo.covariance(s)[[0, 0, 1], [0, 1, 1]] for s in samples])
    claimed = np.mean([monte_carlo.standard_errors(s) for s in samples], axis=0)
    assert np.allclose(entries.std(axis=0), claimed, rtol=0.1)


@pytest.mark.parametrize(("outside", "apart"), [(0, 0.0), (100, 4.0), (400, 4.0)])
def test_the_main_basin_is_the_fuller_one(outside: int, apart: float) -> None:
    sample = 0.1 * np.random.default_rng(1).standard_normal((1000, 2)) @ [[1, 0.5], [0, 0.3]]
    sample[:outside] += apart
    assert monte_carlo.main_basin_share(sample) == pytest.approx(1 - outside / 1000, abs=0.03)


def test_a_spacing_wider_than_the_prior_is_marked_as_self_matching_and_warned_of() -> None:
    coarse = submap("gentle", 100)
    label = monte_carlo.label(coarse, 20, SETTINGS, REGISTRATION)
    assert label.row["spacing_m"] > 3
    assert label.row["self_matching"]
    # another pass cannot match itself
    assert not monte_carlo.label(coarse, 20, SPLIT, REGISTRATION).row["self_matching"]
    assert any("use label.copy: split" in line for line in label_summary.lines("x", pd.DataFrame([label.row]), 3.0))


def test_a_label_without_any_error_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    perfect = monte_carlo.Outcome(np.zeros((5, 2)), np.ones(5, np.bool_), np.ones(5, np.int32))
    monkeypatch.setattr(monte_carlo, "_errors", lambda *_: perfect)
    with pytest.raises(gaussian.CovarianceError, match="baltic, submap 0"):
        monte_carlo.label(submap("rugged", 300), 5, SETTINGS, REGISTRATION)


@pytest.mark.parametrize("change", [{"copy": "twin"}, {"prior_variance_m2": 0.0}, {"noise_sigma_m": -1.0}])
def test_settings_that_make_no_sense_are_refused(change: dict[str, object]) -> None:
    with pytest.raises(monte_carlo.MonteCarloError, match=next(iter(change))):
        dataclasses.replace(SETTINGS, **change)  # type: ignore[arg-type]
