"""Truths of the ways to get Q that need no network: constant, labels, naive GICP, a few draws, and the fits."""

import dataclasses
import json
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest

from pointnetkl import artifacts, gicp, monte_carlo
from pointnetkl.covariance import (
    constant,
    estimated,
    fitting,
    gaussian,
    labelled,
    learned,
    method,
    naive_gicp,
    sampled,
    table,
)
from pointnetkl.submap import Submap, SubmapError

REGISTRATION = gicp.Settings(
    neighbours=20, plane_epsilon=1e-3, max_distance_m=20.0, tolerance_m=1e-3, max_iterations=50
)
LABEL = monte_carlo.Settings(seed=2, copy="same", prior_variance_m2=9.0, noise_sigma_m=0.2, held_out_runs=0)
FIT = fitting.Settings(seed=4, floor_m2=0.01, starts=6)
ESTIMATE = estimated.Settings(seed=5, sampled_runs=[13])


def seabed(number: int, amplitude: float, *, n: int = 18, spacing: float = 3.2) -> Submap:
    """Return a submap of n x n points over ridges along y, with slighter ones across, `amplitude` metres high."""
    rng = np.random.default_rng(number)
    axis = spacing * (np.arange(n) - n / 2)
    xy = np.stack(np.meshgrid(axis, axis), -1).reshape(-1, 2) + rng.uniform(-1, 1, (n * n, 2))
    z = amplitude * (np.sin(xy[:, 0] / 5) + 0.3 * np.sin(xy[:, 1] / 7))
    points = np.column_stack([xy, z])
    return Submap("toy", number, points, points[::2], points[1::2])


SUBMAPS = [seabed(number, amplitude) for number, amplitude in enumerate([0.0, 0.5, 2.0, 4.0])]


def mc(runs: int, seed: int = 5) -> sampled.Sampled:
    """Return Monte Carlo with this many registrations."""
    return sampled.Sampled(f"mc_{runs}", runs, seed, LABEL, REGISTRATION)


@pytest.fixture(scope="module")
def labels() -> pd.DataFrame:
    """Return label columns of SUBMAPS."""
    q = np.stack([mc(150, seed=2).covariance(s) for s in SUBMAPS])
    return table.from_matrices("toy", "label", [s.number for s in SUBMAPS], q)


@pytest.fixture(scope="module")
def fits(labels) -> learned.Fits:
    """Return what is learned from SUBMAPS and their labels."""
    return learned.fit(fitting.training([SUBMAPS], [labels], REGISTRATION), FIT)


def test_naive_gicp_is_twice_the_identity_on_flat_ground():
    q = naive_gicp.NaiveGicp(REGISTRATION).covariance(SUBMAPS[0])
    np.testing.assert_allclose(q, 2 * np.eye(2), rtol=1e-3, atol=1e-3)


def test_naive_gicp_is_the_inverse_of_the_mean_information_of_its_points():
    normals = gicp.prepare(SUBMAPS[2].points, REGISTRATION).normals.astype(np.float64)
    c = np.eye(3) - (1 - REGISTRATION.plane_epsilon) * normals[:, :, None] * normals[:, None, :]
    information = np.linalg.inv(2 * c).mean(axis=0)[:2, :2]
    q = naive_gicp.NaiveGicp(REGISTRATION).covariance(SUBMAPS[2])
    np.testing.assert_allclose(q, np.linalg.inv(information), rtol=1e-3)


def test_naive_gicp_rotates_with_the_submap():
    c, s = np.cos(0.7), np.sin(0.7)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    naive = naive_gicp.NaiveGicp(REGISTRATION)
    q = naive.covariance(SUBMAPS[2])
    rotated = naive.covariance(dataclasses.replace(SUBMAPS[2], points=SUBMAPS[2].points @ R.T))
    np.testing.assert_allclose(rotated, R[:2, :2] @ q @ R[:2, :2].T, rtol=1e-2, atol=1e-4)


def test_a_label_is_returned_as_it_stands_in_the_table(labels):
    gold = labelled.from_table("monte_carlo", labels)
    np.testing.assert_array_equal(gold.covariance(SUBMAPS[1]), table.to_matrices(labels)[1])


def test_a_submap_without_a_label_is_an_error_that_names_it(labels):
    gold = labelled.from_table("monte_carlo", labels)
    with pytest.raises(labelled.LabelledError, match="toy, submap 7: has no label"):
        gold.covariance(seabed(7, 1.0))


def test_the_mean_of_labels_is_the_constant_with_the_least_mean_kl(labels):
    matrices = table.to_matrices(labels)
    mean = constant.mean("constant", matrices).q
    best = fitting.mean_kl(matrices, mean, 0.01)
    for other in (1.1 * mean, 0.9 * mean, mean + np.diag([0.2, 0.0]), np.diag(np.diag(mean) * [0.8, 1.1])):
        assert fitting.mean_kl(matrices, other, 0.01) > best


def test_thirteen_draws_agree_on_average_with_a_label_of_many_runs():
    rugged = SUBMAPS[2]
    label = mc(1500, seed=2).covariance(rugged)
    draws = np.mean([mc(13, seed).covariance(rugged) for seed in range(40)], axis=0)
    # 40 x 13 draws: 6 % on a variance for Gaussian errors, more for the heavy tails that errors have
    np.testing.assert_allclose(np.diag(draws), np.diag(label), rtol=0.5)


def test_draws_do_not_depend_on_order_or_workers(monkeypatch):
    tables = []
    for workers, submaps in (("1", SUBMAPS), ("3", SUBMAPS[::-1])):
        monkeypatch.setenv("POINTNETKL_WORKERS", workers)
        tables.append(method.tabulate([mc(13)], submaps).sort_values("submap", ignore_index=True))
    pd.testing.assert_frame_equal(*tables, check_exact=True)


def test_draws_differ_between_submaps_surveys_seeds_and_numbers_of_runs():
    others = [dataclasses.replace(SUBMAPS[2], number=9), dataclasses.replace(SUBMAPS[2], survey="other")]
    q = [mc(13).covariance(s) for s in (SUBMAPS[2], *others)]
    q += [mc(13, seed=6).covariance(SUBMAPS[2]), mc(14).covariance(SUBMAPS[2])]
    assert len({float(m[0, 0]) for m in q}) == 5


def test_the_estimate_table_has_one_row_for_every_method_and_submap(labels):
    rows = method.tabulate(estimated.methods(labels, ESTIMATE, LABEL, REGISTRATION), SUBMAPS)
    assert list(rows["method"].unique()) == ["monte_carlo", "constant", "naive_gicp", "mc_13"]
    assert not rows.duplicated(["survey", "submap", "method"]).any()
    assert len(rows) == 4 * len(SUBMAPS)
    assert list(rows.columns) == table.SCHEMA.names


def test_a_method_whose_answer_is_not_a_covariance_is_refused():
    wrong = constant.Constant("wrong", np.diag([1.0, -1.0]))
    with pytest.raises(gaussian.CovarianceError, match="toy, submap 0, wrong"):
        method.tabulate([wrong], SUBMAPS)


def test_no_submaps_is_an_error():
    with pytest.raises(SubmapError, match="no submaps"):
        method.tabulate([naive_gicp.NaiveGicp(REGISTRATION)], [])


@pytest.mark.parametrize("runs", [[13, 13], [2], [0]])
def test_senseless_numbers_of_draws_are_refused(runs):
    with pytest.raises(ValueError, match="sampled_runs"):
        estimated.Settings(seed=0, sampled_runs=runs)


def test_the_structure_tensor_fits_labels_better_than_their_mean(fits):
    assert fits.fits["structure_tensor"].mean_kl < 0.5 * fits.fits["constant_train"].mean_kl


def test_learned_methods_give_a_covariance_for_every_submap(fits):
    rows = method.tabulate(learned.methods(fits, REGISTRATION), SUBMAPS)
    assert list(rows["method"].unique()) == list(learned.LEARNERS)
    assert len(rows) == len(learned.LEARNERS) * len(SUBMAPS)


def test_the_mean_kl_of_a_fit_is_that_of_its_method(fits, labels):
    for each in learned.methods(fits, REGISTRATION):
        q = np.stack([each.covariance(s) for s in SUBMAPS])
        assert fitting.mean_kl(table.to_matrices(labels), q, 0.01) == pytest.approx(fits.fits[each.name].mean_kl)


def test_fits_come_back_as_they_were_written(tmp_path, fits):
    path = tmp_path / "fits.json"
    learned.write(path, fits, {"fit": {"seed": 4}})
    assert learned.read(path) == fits
    assert artifacts.read_json(path)["params"] == {"fit": {"seed": 4}}


def test_a_damaged_file_of_fits_is_named_with_what_it_lacks(tmp_path, fits):
    path = tmp_path / "fits.json"
    learned.write(path, fits, {})
    content = json.loads(path.read_text())
    del content["structure_tensor"]["gamma"]
    path.write_text(json.dumps(content))
    with pytest.raises(fitting.FittingError, match=r"fits.json: structure_tensor\.gamma is None"):
        learned.read(path)
    del content["structure_tensor"]
    path.write_text(json.dumps(content))
    with pytest.raises(fitting.FittingError, match="has no fit of structure_tensor"):
        learned.read(path)
    path.write_text(json.dumps(content)[:40])
    with pytest.raises(artifacts.ArtifactError, match="damaged"):
        learned.read(path)


def test_a_training_submap_without_a_label_is_an_error(labels):
    with pytest.raises(labelled.LabelledError, match="submap 3"):
        fitting.training([SUBMAPS], [labels.iloc[:3]], REGISTRATION)


def test_no_training_submap_is_an_error():
    with pytest.raises(fitting.FittingError, match="no training submap"):
        fitting.training([], [], REGISTRATION)


@pytest.mark.parametrize("module", ["estimated", "learned"])
def test_neither_estimate_nor_fit_waits_for_torch(module):
    code = f"import sys, pointnetkl.covariance.{module}; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
