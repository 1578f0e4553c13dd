"""Truths of the ways to get Q that need no network: constant, labels, naive GICP, a few draws, and the fits."""

import dataclasses
import json
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest

import toy_submaps
from pointnetkl.methods import estimated, labelled, sampled
from pointnetkl.methods.closed_forms import naive_gicp
from pointnetkl.methods.closed_forms.self_registration import SelfRegistration
from pointnetkl.methods.fitted import constant, fitting, learned
from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.registration.covariance import gaussian, method, table
from pointnetkl.registration.streams import Stream
from pointnetkl.surveys.submap import Submap, SubmapError
from pointnetkl.workflow import artifacts, parameters

REGISTRATION = gicp.Settings(
    neighbours=20, plane_epsilon=1e-3, max_distance_m=20.0, tolerance_m=1e-3, max_iterations=50
)
LABEL = monte_carlo.Settings(seed=2, copy="same", prior_variance_m2=9.0, noise_sigma_m=0.2, held_out_runs=0)
WITH_YAW = dataclasses.replace(REGISTRATION, dof="xyyaw")
SETUP = SelfRegistration(6, LABEL, REGISTRATION)
FIT = fitting.Settings(seed=4, floor_m2=0.01, starts=6, blocks=2)
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


def mc(runs: int, seed: int = 5, registration: gicp.Settings = REGISTRATION) -> sampled.Sampled:
    """Return Monte Carlo with this many registrations."""
    return sampled.Sampled(f"mc_{runs}", runs, seed, LABEL, registration)


@pytest.fixture(scope="module")
def labels() -> pd.DataFrame:
    """Return label columns of SUBMAPS."""
    q = np.stack([mc(150, seed=2).covariance(s) for s in SUBMAPS])
    return table.from_matrices("toy", "label", [s.number for s in SUBMAPS], q)


@pytest.fixture(scope="module")
def fits(labels) -> learned.Fits:
    """Return what is learned from SUBMAPS and their labels."""
    return learned.fit(fitting.training([SUBMAPS], [labels], SETUP), FIT)


def test_naive_gicp_is_twice_the_identity_on_flat_ground():
    q = naive_gicp.NaiveGicp(REGISTRATION).covariance(SUBMAPS[0])
    np.testing.assert_allclose(q, 2 * np.eye(2), rtol=1e-3, atol=1e-3)


def test_naive_gicp_is_the_inverse_of_the_mean_information_of_its_points():
    normals = gicp.prepare(SUBMAPS[2].points, REGISTRATION).normals.astype(np.float64)
    c = np.eye(3) - (1 - REGISTRATION.plane_epsilon) * normals[:, :, None] * normals[:, None, :]
    information = np.linalg.inv(2 * c).mean(axis=0)[:2, :2]
    q = naive_gicp.NaiveGicp(REGISTRATION).covariance(SUBMAPS[2])
    np.testing.assert_allclose(q, np.linalg.inv(information), rtol=1e-3)


def test_the_mean_covariance_is_the_mean_of_its_points():
    normals = gicp.prepare(SUBMAPS[2].points, REGISTRATION).normals.astype(np.float64)
    c = np.eye(3) - (1 - REGISTRATION.plane_epsilon) * normals[:, :, None] * normals[:, None, :]
    q = naive_gicp.NaiveMeanCovariance(REGISTRATION).covariance(SUBMAPS[2])
    np.testing.assert_allclose(q, 2 * c.mean(axis=0)[:2, :2], rtol=1e-3)
    flat = naive_gicp.NaiveMeanCovariance(REGISTRATION).covariance(SUBMAPS[0])
    np.testing.assert_allclose(flat, 2 * np.eye(2), rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("registration", [REGISTRATION, WITH_YAW])
@pytest.mark.parametrize("kind", [naive_gicp.NaiveGicp, naive_gicp.NaiveMeanCovariance])
def test_naive_gicp_rotates_with_the_submap(kind, registration):
    R, m = toy_submaps.rotation(0.7, 3), registration.dimensions
    naive = kind(registration)
    q = naive.covariance(SUBMAPS[2])
    rotated = naive.covariance(dataclasses.replace(SUBMAPS[2], points=SUBMAPS[2].points @ R.T))
    np.testing.assert_allclose(rotated, R[:m, :m] @ q @ R[:m, :m].T, rtol=1e-2, atol=1e-4)


@pytest.mark.parametrize("kind", [naive_gicp.NaiveGicp, naive_gicp.NaiveMeanCovariance])
def test_naive_gicp_knows_the_yaw_of_flat_ground_by_its_points_arms(kind):
    q = kind(WITH_YAW).covariance(SUBMAPS[0])
    arms = SUBMAPS[0].points[:, :2] - SUBMAPS[0].points[:, :2].mean(axis=0)
    expected = np.diag([2, 2, 2 / (arms**2).sum(axis=1).mean()])
    root = np.sqrt(np.linalg.inv(expected))
    np.testing.assert_allclose(root @ q @ root, np.eye(3), atol=2e-3)


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
    rivals = ["naive_gicp", "naive_meancov", "hessian", "censi", "unscented", "mean_field", "mc_13"]
    names = ["monte_carlo", "constant", *rivals]
    assert list(rows["method"].unique()) == names
    assert not rows.duplicated(["survey", "submap", "method"]).any()
    assert len(rows) == len(names) * len(SUBMAPS)
    assert list(rows.columns) == table.SCHEMA.names


def test_every_method_gives_x_y_and_yaw_where_all_are_found(labels):
    setup = SelfRegistration(6, LABEL, WITH_YAW)
    q = np.stack([mc(60, 2, WITH_YAW).covariance(s) for s in SUBMAPS])
    rows = table.from_matrices("toy", "label", [s.number for s in SUBMAPS], q)
    fits = learned.fit(fitting.training([SUBMAPS], [rows], setup), FIT)
    methods = [*estimated.methods(rows, ESTIMATE, LABEL, WITH_YAW), *learned.methods(fits, setup.seed)]
    tabulated = method.tabulate(methods, SUBMAPS)
    assert list(tabulated.columns) == table.schema(3).names
    assert table.to_matrices(tabulated).shape == (len(methods) * len(SUBMAPS), 3, 3)


def test_mc_s_draws_and_closed_forms_noise_are_not_the_labels_even_with_their_seed(labels):
    rugged = SUBMAPS[2]
    q = [method_.covariance(rugged) for method_ in (mc(150, seed=LABEL.seed), mc(151, seed=LABEL.seed))]
    assert abs(q[0][0, 0] / q[1][0, 0] - 1) > 1e-3
    label = monte_carlo.label(rugged, 150, LABEL, REGISTRATION)
    assert abs(q[0][0, 0] / label.row["q_xx_m2"] - 1) > 1e-3
    own = SelfRegistration(LABEL.seed, LABEL, REGISTRATION).noise(rugged)
    streams = (Stream.LABEL, Stream.HELD_OUT)
    labels_keys = [int(monte_carlo.generator(LABEL, rugged, each).integers(1 << 63)) for each in streams]
    assert own.key not in labels_keys


def test_a_method_whose_answer_is_not_a_covariance_is_refused():
    wrong = constant.Constant("wrong", np.diag([1.0, -1.0]))
    with pytest.raises(gaussian.CovarianceError, match="toy, submap 0, wrong"):
        method.tabulate([wrong], SUBMAPS)


def test_no_submaps_is_an_error():
    with pytest.raises(SubmapError, match="no submaps"):
        method.tabulate([naive_gicp.NaiveGicp(REGISTRATION)], [])


@pytest.mark.parametrize("runs", [[13, 13], [2], [0], [10**12]])
def test_senseless_numbers_of_draws_are_refused(runs):
    with pytest.raises(ValueError, match="sampled_runs"):
        estimated.Settings(seed=0, sampled_runs=runs)


@pytest.mark.slow
def test_the_structure_tensor_fits_labels_better_than_their_mean(fits):
    assert fits.fits["structure_tensor"].mean_kl < 0.5 * fits.fits["constant_train"].mean_kl


def test_learned_methods_give_a_covariance_for_every_submap(fits):
    rows = method.tabulate(learned.methods(fits, SETUP.seed), SUBMAPS)
    assert list(rows["method"].unique()) == list(learned.LEARNERS)
    assert len(rows) == len(learned.LEARNERS) * len(SUBMAPS)


def test_the_mean_kl_of_a_fit_is_that_of_its_method(fits, labels):
    # what is remembered is judged without the submap's own block: tests/methods/test_cello.py
    for each in (m for m in learned.methods(fits, SETUP.seed) if not fits.fits[m.name].rows):
        q = np.stack([each.covariance(s) for s in SUBMAPS])
        assert fitting.mean_kl(table.to_matrices(labels), q, 0.01) == pytest.approx(fits.fits[each.name].mean_kl)


def test_fits_come_back_as_they_were_written(tmp_path, fits):
    path = tmp_path / "fits.json"
    learned.write(path, fits, {"fit": {"seed": 4}})
    assert learned.read(path) == fits
    assert artifacts.read_json(path)["params"]["fit"] == {"seed": 4}


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
    learned.write(path, fits, {})
    content = json.loads(path.read_text())
    for damage, said in (("1 nan", "a gap"), ("1 x", "without numbers"), ("1", "a gap")):
        path.write_text(json.dumps(content | {"cello": {**content["cello"], "rows": [damage, "1 2"]}}))
        with pytest.raises(fitting.FittingError, match=rf"cello\.rows has a line.*{said}"):
            learned.read(path)
    path.write_text(json.dumps(content | {"cello": {**content["cello"], "rows": []}}))
    with pytest.raises(fitting.FittingError, match="cello: remembers no rows of 10 numbers"):
        learned.methods(learned.read(path), SETUP.seed)
    path.write_text(json.dumps(content)[:40])
    with pytest.raises(artifacts.ArtifactError, match="damaged"):
        learned.read(path)


@pytest.mark.parametrize("section", ["label", "registration"])
def test_fits_that_do_not_say_which_labels_they_are_of_are_refused(tmp_path, fits, section):
    path = tmp_path / "fits.json"
    learned.write(path, fits, {})
    content = json.loads(path.read_text())
    del content["params"][section]
    path.write_text(json.dumps(content))
    with pytest.raises(parameters.SettingsError, match=rf"fits\.json: does not say with which {section} it was made"):
        learned.read(path)


def test_a_training_submap_without_a_label_is_an_error(labels):
    with pytest.raises(labelled.LabelledError, match="submap 3"):
        fitting.training([SUBMAPS], [labels.iloc[:3]], SETUP)


def test_no_training_submap_is_an_error():
    with pytest.raises(fitting.FittingError, match="no training submap"):
        fitting.training([], [], SETUP)


@pytest.mark.parametrize("change", [{"blocks": 1}, {"judged": 0}, {"starts": 0}, {"floor_m2": -1.0}, {"seed": -1}])
def test_senseless_settings_of_a_fit_are_refused(change):
    with pytest.raises(ValueError, match=next(iter(change))):
        dataclasses.replace(FIT, **change)


@pytest.mark.parametrize("module", ["estimated", "fitted.learned"])
def test_neither_estimate_nor_fit_waits_for_torch(module):
    code = f"import sys, pointnetkl.methods.{module}; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
