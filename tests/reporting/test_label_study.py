"""How sure a label of few runs is, and what noise does to it: numbers against theory."""

import numpy as np
import pandas as pd
import pytest

from pointnetkl.registration.covariance import gaussian
from pointnetkl.reporting.labels import numbers as label_study
from pointnetkl.reporting.labels import tables as label_tables

Q = np.array([[4.0, 1.0], [1.0, 0.5]])
DATASETS = {"borno_8": {"simulated": True}}


def variations(errors: np.ndarray, counts: tuple[int, ...], submap: int = 0) -> pd.DataFrame:
    """Return rows of study `runs` of errors (n, 2), taken apart into parts of each count."""
    rows = []
    for count in (*counts, len(errors)):
        for i in range(len(errors) // count):
            part = errors[i * count : (i + 1) * count]
            q = part.T @ part / (count - 1)
            rows.append((submap, count, i, q[0, 0], q[0, 1], q[1, 1]))
    columns = ["submap", "runs", "repeat", "q_xx_m2", "q_xy_m2", "q_yy_m2"]
    where = {"survey": "borno_8", "study": "runs", "copy": "same", "noise_sigma_m": 0.2, "cell_m": 4.0}
    return pd.DataFrame(rows, columns=columns).assign(**where)


@pytest.fixture(scope="module")
def errors() -> np.ndarray:
    """Gaussian errors."""
    return np.random.default_rng(0).multivariate_normal([0, 0], Q, 9000)


def test_labels_of_gaussian_errors_are_as_far_off_as_theory_says(errors: np.ndarray):
    found = label_study.accuracy(variations(errors, (13, 30, 90, 300, 1000, 3000)))
    assert found["runs"].tolist() == [13, 30, 90, 300, 1000, 3000]
    many = found[found["parts"] >= 30]
    assert np.allclose(many["relative_error"], label_study.gaussian_error(many["runs"]), rtol=0.15)
    assert np.allclose(many["kl_mean"], label_study.gaussian_kl(many["runs"]), rtol=0.25)
    assert (found["kl_low"] <= found["kl_mean"]).all()


def test_parts_that_are_much_of_the_whole_are_judged_as_against_the_truth():
    rng, found = np.random.default_rng(1), []
    for number in range(200):
        drawn = rng.multivariate_normal([0, 0], Q, 300)
        found.append(variations(drawn, (100,), number))
    many = label_study.accuracy(pd.concat(found))
    assert np.sqrt(np.mean(many["relative_error"] ** 2)) == pytest.approx(np.sqrt(2 / 100), rel=0.1)
    assert many["kl_mean"].mean() == pytest.approx(float(label_study.gaussian_kl(np.array(100))), rel=0.15)


def test_the_expected_divergence_of_gaussian_labels_is_that_of_simulated_ones():
    rng = np.random.default_rng(2)
    drawn = rng.multivariate_normal([0, 0], Q, (20_000, 13))
    labels = np.einsum("nli,nlj->nij", drawn, drawn) / 12
    expected = float(label_study.gaussian_kl(np.array(13)))
    assert gaussian.kl_divergence(Q, labels).mean() == pytest.approx(expected, rel=0.03)
    assert label_study.gaussian_kl(np.array(3000)) == pytest.approx(3 / (2 * 3000), rel=0.01)


def test_a_size_that_fits_less_than_three_times_is_left_out(errors: np.ndarray):
    assert label_study.accuracy(variations(errors[:100], (13, 30, 50)))["runs"].tolist() == [13, 30]


def test_a_second_basin_makes_few_runs_worth_less():
    rng = np.random.default_rng(3)
    sample = 0.05 * rng.standard_normal((3000, 2))
    far = rng.random(3000) < 0.03
    sample[far] += 3 * rng.standard_normal((far.sum(), 2))
    found = label_study.accuracy(variations(sample, (13, 300))).set_index("runs")
    assert found.loc[13, "kl_mean"] > 100 * label_study.gaussian_kl(np.array(13))
    assert found.loc[300, "relative_error"] > 3 * label_study.gaussian_error(np.array(300))


def conditions() -> pd.DataFrame:
    """Return the study of runs and four conditions: the usual one, two noises, another spacing."""
    every = [(0.2, 4.0, 1.0), (0.1, 4.0, 0.25), (0.0, 4.0, 1e-9), (0.2, 8.0, 3.0)]
    columns = {"study": "conditions", "copy": "same", "submap": 0, "survey": "borno_8", "runs": 20, "q_xy_m2": 0.0}
    varied = pd.DataFrame(every, columns=["noise_sigma_m", "cell_m", "q_yy_m2"]).assign(**columns)
    usual = variations(np.random.default_rng(4).standard_normal((60, 2)), (20,))
    return pd.concat([usual, varied.assign(q_xx_m2=2 * varied["q_yy_m2"])], ignore_index=True)


def test_what_is_varied_alone_is_told_from_the_rest():
    by_noise, by_spacing = label_study.by_noise(conditions()), label_study.by_spacing(conditions())
    assert by_noise["noise_sigma_m"].tolist() == [0.2, 0.1, 0.0]
    assert by_noise["larger_m2"].tolist() == pytest.approx([2.0, 0.5, 2e-9])
    assert by_spacing["cell_m"].tolist() == [4.0, 8.0]
    assert len(label_study.conditions(conditions())) == 4


def test_the_noise_table_has_a_column_for_each_noise_and_the_power_it_grows_with():
    frame = label_tables.noise(label_study.by_noise(conditions()), DATASETS).frame
    assert frame["at_0.1_m"].tolist() == pytest.approx([0.25, 0.5])
    assert frame["power"].tolist() == pytest.approx([2.0, 2.0])
    assert label_study.growth(np.array([0.0, 0.1]), np.array([1.0, 2.0])) is None


def test_accuracy_is_told_over_submaps_beside_theory(errors: np.ndarray):
    both = pd.concat([variations(errors[:3000], (300,)), variations(errors[3000:6000], (300,), 1)])
    (row,) = label_tables.accuracy(label_study.accuracy(both), DATASETS).frame.to_dict("records")
    assert (row["runs"], row["parts"]) == (300, 20)
    assert row["gaussian_error"] == pytest.approx(np.sqrt(2 / 300))
    assert row["relative_error"] <= row["relative_error_max"]


def test_the_quality_of_labels_is_told_over_their_submaps():
    k = 101
    rows = pd.DataFrame({"runs": range(100, 100 + k), "relative_error": np.linspace(0, 1, k)})
    rows = rows.assign(mean_x_m=0.3, mean_y_m=0.4, q_xx_m2=0.75, q_yy_m2=0.25, q_xy_m2=0.0, self_matching=False)
    rows = rows.assign(converged_share=0.9, main_basin_share=np.linspace(0.5, 1, k), iterations_mean=7.0, spacing_m=2.0)
    (row,) = label_tables.quality({"borno_8": rows}, DATASETS).frame.to_dict("records")
    assert (row["runs"], row["runs_min"], row["runs_max"]) == (150, 100, 200)
    assert (row["relative_error"], row["relative_error_q95"]) == pytest.approx((0.5, 0.95))
    assert (row["bias_m"], row["bias_share"]) == pytest.approx((0.5, 0.25))
    assert (row["main_basin_share"], row["main_basin_share_q05"]) == pytest.approx((0.75, 0.525))
