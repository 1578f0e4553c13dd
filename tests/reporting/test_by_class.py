"""Measures split by terrain class, label size and copy: whose rows they are, and that the parts make the whole."""

import numpy as np
import pandas as pd
import pytest

from pointnetkl.registration.covariance import gaussian, table
from pointnetkl.reporting import results, terrain
from pointnetkl.reporting.covariances import numbers as covariances
from pointnetkl.reporting.covariances import tables as covariance_tables

SETTINGS = results.Settings(9, 0.01, 2.0, 5, terrain.Settings(0.004, 0.02))
DATASETS = {"a": {"simulated": True}}
K = 30
RNG = np.random.default_rng(0)
Q = RNG.gamma(1.0, 1.0, K)[:, None, None] * np.eye(2)
CLASSES = np.array(["flat"] * 12 + ["wall"] * 15 + ["rugged"] * 3, dtype=object)
HELD_OUT = RNG.normal(size=(K, 50, 2)) * np.sqrt(Q[:, :1, 0])[:, None]
JUDGED = covariances.Judged(
    Q, {"monte_carlo": Q, "network": 1.2 * Q, "constant": np.tile(Q.mean(0), (K, 1, 1))}, HELD_OUT
)


@pytest.fixture(scope="module")
def found() -> dict:
    """Measures by class; training has no wall."""
    return {"a": covariances.by_class("a", JUDGED, CLASSES, {"flat", "rugged"}, SETTINGS)}


def test_the_classes_of_a_survey_make_up_its_mean(found: dict):
    whole = covariances.divergences("a", JUDGED, SETTINGS)["constant"]["mean"]
    parts = [(each["submaps"], each["kl"]["constant"]["mean"]) for each in found["a"].values()]
    assert sum(n for n, _ in parts) == K
    assert sum(n * mean for n, mean in parts) / K == pytest.approx(whole)


def test_a_class_that_training_has_not_is_marked(found: dict):
    frame = covariance_tables.by_class(found, DATASETS)[0].frame
    marked = frame.groupby("class")["training"].unique().map(list).to_dict()
    assert marked == {"flat": ["seen"], "rugged": ["seen"], "wall": [covariance_tables.UNSEEN]}


def test_monte_carlo_s_own_coverage_stands_beside_every_method_s(found: dict):
    frame = covariance_tables.by_class(found, DATASETS)[0].frame
    wall = frame[frame["class"] == "wall"].set_index("method")
    assert set(wall["mc_coverage_95"]) == {wall["coverage_95"]["monte_carlo"]}
    assert wall["coverage_95"]["network"] > wall["coverage_95"]["monte_carlo"]


def test_the_network_is_compared_with_each_rival_pair_by_pair_where_there_are_enough(found: dict):
    kl = found["a"]["flat"]["kl"]
    assert kl["constant"]["network_better"] == 1.0
    assert "network_better" not in kl["network"]
    assert "network_better" not in found["a"]["rugged"]["kl"]["constant"]
    assert found["a"]["rugged"]["kl"]["constant"]["ci95"] is None


def test_the_short_table_has_a_column_a_method_and_a_row_a_class(found: dict):
    mean = covariance_tables.by_class(found, DATASETS)[1].frame
    assert list(mean["class"]) == ["flat", "rugged", "wall"]
    assert mean["constant"][2] == found["a"]["wall"]["kl"]["constant"]["mean"]
    assert "monte_carlo" not in mean


def test_sizes_of_labels_make_up_the_whole_and_never_overlap():
    parts = covariances.by_size(JUDGED, SETTINGS)
    assert sum(each["submaps"] for each in parts.values()) == K
    above = gaussian.divergence(Q, JUDGED.covariances["constant"], 0.01)[Q[:, 0, 0] >= 1]
    assert parts["above 1"]["kl"]["constant"]["mean"] == pytest.approx(above.mean())


def variations() -> pd.DataFrame:
    """Return labels of submaps 4 and 9 (numbers 104 and 109) under both copies, by two noises and two spacings."""
    rows = []
    for copy, factor in (("same", 1.0), ("split", 3.0)):
        for sigma, cell in ((0.2, 4.0), (0.5, 4.0), (0.2, 8.0)):
            off = factor if (sigma, cell) == (0.2, 4.0) else 100.0
            q = off * Q[[4, 9]]
            which = {"survey": "a", "study": "conditions", "copy": copy, "noise_sigma_m": sigma, "cell_m": cell}
            rows.append(pd.DataFrame({**which, "submap": [104, 109], **table.to_columns(q)}))
    runs = rows[0].assign(study="runs")
    return pd.concat([runs, *rows, rows[0].assign(survey="b")])


def test_both_copies_judge_the_same_submaps_under_the_survey_s_own_conditions():
    labels = type("Labels", (), {"submap": np.arange(100, 100 + K)})
    found = covariances.by_copy("a", labels, JUDGED, variations(), SETTINGS)
    assert [found[copy]["submaps"] for copy in ("same", "split")] == [2, 2]
    assert found["same"]["kl"]["monte_carlo"]["mean"] == pytest.approx(0.0, abs=1e-9)
    expected = gaussian.divergence(3 * Q[[4, 9]], 1.2 * Q[[4, 9]], 0.01).mean()
    assert found["split"]["kl"]["network"]["mean"] == pytest.approx(expected)
