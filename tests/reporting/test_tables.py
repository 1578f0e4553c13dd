"""The paper's tables beside ours: what stands where, and how a number is written."""

import numpy as np
import pandas as pd
import pytest

from pointnetkl.reporting import paper, text_table
from pointnetkl.reporting.covariances import tables as covariance_tables
from pointnetkl.reporting.labels import tables as label_tables
from pointnetkl.reporting.slam import tables as slam_tables
from pointnetkl.reporting.surveys import tables as survey_tables

DATASETS = {
    "baltic": {"simulated": True, "vehicle": "surveyor", "area_km2": 252.4, "submaps": 7543, "sigma_z": 0.067827},
    "borno_8": {
        "simulated": True,
        "vehicle": "hugin",
        "area_km2": 1.0,
        "submaps": 9,
        "sigma_z": 0.2,
        "track_km": 4.78,
    },
    "mine": {
        "simulated": False,
        "vehicle": "unknown",
        "area_km2": 0.5,
        "submaps": 8,
        "sigma_z": 0.1,
        "track_km": 1.0,
    },
}
SLAM = {
    name: {
        "dead_reckoning_edges": 8,
        "loop_closures": closures,
        **{m: {"rmse_xyz_m": 7.0} for m in paper.SLAM_METHODS},
    }
    for name, closures in (("borno_8", 5), ("mine", 0))
}


def rows(block: text_table.Block, **where: object) -> list[dict[str, object]]:
    """Return the block's rows that have these values."""
    every = block.frame.to_dict("records")
    return [row for row in every if all(row[key] == value for key, value in where.items())]


def test_a_survey_stands_beside_the_paper_s_with_their_ratio():
    (row,) = rows(survey_tables.table_1(DATASETS)[0], survey="baltic")
    assert row["paper_area_km2"] == 504.8
    assert row["ratio_area_km2"] == pytest.approx(0.5)
    assert row["ratio_submaps"] == 1.0


def test_a_user_s_survey_has_the_same_columns_and_dashes_for_the_paper():
    (row,) = rows(survey_tables.table_1(DATASETS)[0], survey="mine")
    assert row["paper_submaps"] is None
    assert row["simulated"] is False
    line = next(line for line in text_table.markdown(survey_tables.table_1(DATASETS)).splitlines() if "| mine" in line)
    assert text_table.UNKNOWN in line
    assert "nan" not in line.lower()


def test_table_2_has_every_method_and_the_paper_s_row_below():
    kl = {"training": 0.02, "borno_8": {"constant": {"mean": 3.0}, "pointnetkl": {"mean": 1.5}}, "mine": {}}
    (block,) = covariance_tables.table_2(kl, DATASETS, {"pointnetkl": {"training": 0.02, "validation": 0.05}})
    assert list(block.frame) == ["method", "training", "validation", "borno_8 (simulated)", "mine"]
    assert text_table.csv(block.frame).splitlines()[1:] == [
        "constant,,,3.0,",
        "pointnetkl,0.02,0.05,1.5,",
        '"pointnetkl, the paper",0.0184,0.0394,1.0578,',
    ]


def test_table_3_gives_times_as_ratios_to_our_own_label():
    runtime = {"monte_carlo": {"mean_s": 2.0, "std_s": 0.1}, "pointnetkl": {"mean_s": 0.05, "std_s": 0.0}}
    (block,) = covariance_tables.table_3({**runtime, "machine": {"cpu": "toy"}})
    (row,) = rows(block, method="pointnetkl")
    assert row["times_faster"] == pytest.approx(40)
    assert row["paper_mean_s"] == 0.13
    assert "toy" in block.caption


def test_table_3_lists_a_method_that_was_not_timed():
    (block,) = covariance_tables.table_3({"monte_carlo": {"mean_s": 2.0, "std_s": 0.1}}, ["censi", "monte_carlo"])
    assert list(block.frame["method"]) == ["censi", "monte_carlo"]
    assert rows(block, method="censi")[0]["mean_s"] is None


def test_the_label_s_own_coverage_stands_beside_every_method_s():
    found = {"mine": {"monte_carlo": {"coverage_95": 0.89}, "constant": {"nees": 1.0, "coverage_95": 0.97}}}
    (row,) = rows(covariance_tables.calibrations(found, DATASETS), method="constant")
    assert (row["coverage_95"], row["mc_coverage_95"]) == (0.97, 0.89)


def test_table_4_has_the_paper_s_row_below_ours_and_says_which_is_simulated():
    ours, theirs = rows(slam_tables.table_4(SLAM, DATASETS)[0], survey="borno_8", error_m="RMSE_xyz, GT")
    assert (ours["of"], ours["simulated"], ours["corrupted"], ours["N_LC"]) == ("ours", True, 7.0, 5)
    assert (theirs["of"], theirs["simulated"], theirs["corrupted"], theirs["N_LC"]) == ("paper", False, 210.8, 301)


def test_a_survey_without_truth_has_a_row_of_dashes_against_it():
    (row,) = rows(slam_tables.table_4(SLAM, DATASETS)[0], survey="mine", error_m="RMSE_xyz, truth")
    assert row["pointnetkl"] is None


def test_every_method_is_listed_with_its_interval():
    slam = {"mine": {"loop_closures": 0, "odd": {"rmse_xyz_m": 3.0, "rmse_xyz_ci95_m": [2.0, 4.0]}}}
    (row,) = rows(slam_tables.slam_errors(slam, DATASETS), method="odd")
    assert (row["ci_low"], row["ci_high"], row["truth_rmse_xyz_m"]) == (2.0, 4.0, None)


def test_label_quantiles_of_the_authors_network_stand_below_ours():
    eigenvalues = {"borno_8": np.column_stack([np.linspace(0, 1, 21), np.linspace(5, 9, 21)])}
    block = label_tables.label_quantiles(eigenvalues, DATASETS)
    assert [row["of"] for row in rows(block, eigenvalue="smaller")] == ["labels", "authors' network"]
    assert rows(block, eigenvalue="larger", of="labels")[0]["q50_m2"] == pytest.approx(7.0)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "—"),
        (float("nan"), "—"),
        (float("inf"), "—"),
        (True, "yes"),
        (7543, "7543"),
        (0.067827, "0.06783"),
        (0.00013, "0.00013"),
        (123456.0, "123456"),
        (0.0, "0"),
        (2.5e-6, "2.5e-06"),
    ],
)
def test_a_number_is_written_for_a_reader(value: object, text: str):
    assert text_table.cell(value) == text


def test_the_paper_s_numbers_are_written_as_it_prints_them():
    frame = pd.DataFrame({"sigma_z": [0.0678271], "paper_sigma_z": [0.067827]})
    assert text_table.csv(frame) == "sigma_z,paper_sigma_z\n0.06783,0.067827\n"


def test_csv_leaves_unknown_fields_empty_and_whole_numbers_whole():
    block = text_table.block("", [{"a": 1}, {"a": None}, {"a": float("nan")}], ["a"])
    assert text_table.csv(block.frame) == 'a\n1\n""\n""\n'


def test_html_escapes_what_it_shows():
    block = text_table.block("<caption>", [{"survey": "<b>&"}], ["survey"])
    page = text_table.to_html([block])
    assert "<b>" not in page
    assert "&lt;b&gt;&amp;" in page
