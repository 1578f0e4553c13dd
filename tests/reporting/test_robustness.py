"""The report's section on false loop closures: counts, tables, figures and advice."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import fake_artifacts
from pointnetkl.reporting import text_table
from pointnetkl.reporting.drawing import plots
from pointnetkl.reporting.robustness import figures as robustness_figures
from pointnetkl.reporting.robustness import numbers as robustness
from pointnetkl.reporting.robustness import tables as robustness_tables
from pointnetkl.reporting.robustness import words as robustness_words
from pointnetkl.reporting.robustness.numbers import StressTest

DATASETS = {"borno_8": {"simulated": True}, "mine": {"simulated": False}}


@pytest.fixture(scope="module")
def stress(tmp_path_factory: pytest.TempPathFactory) -> StressTest:
    root = tmp_path_factory.mktemp("study")
    fake_artifacts.write(root)
    return robustness.read(root / "reports", fake_artifacts.TEST)


def cells(rows: pd.DataFrame, **values: object) -> pd.Series:
    table = robustness.summarise(rows)
    for name, value in values.items():
        table = table[table[name] == value]
    return table.iloc[0]


def test_precision_is_of_the_accepted_and_recall_of_the_true(stress: StressTest):
    plain = cells(stress.rows, survey="borno_8", kernel="plain", method="constant", share=0.5)
    assert plain["precision"] == pytest.approx(0.9 / 1.9)
    assert plain["recall"] == pytest.approx(0.9)


def test_a_failed_run_is_counted_and_in_no_median(stress: StressTest):
    plain = cells(stress.rows, survey="borno_8", kernel="plain", method="constant", share=0.1)
    assert (plain["runs"], plain["failed"]) == (2, 1)
    assert np.isfinite(plain["truth_rmse_xyz_m"])


def test_the_share_itself_is_of_whole_closures(stress: StressTest):
    few = stress.rows.assign(true_closures=47, false_closures=2, share=0.05)
    table = robustness_tables.every(StressTest(few, stress.gate), DATASETS)
    assert set(table["robustness_shares"][0].frame["false_share"]) == {2 / 49}


def test_kernels_are_judged_from_where_the_first_ended(stress: StressTest):
    starts = robustness.from_standard_starts(stress.rows).groupby("kernel")["start"].unique()
    assert {kernel: list(names) for kernel, names in starts.items()} == {
        "cauchy": ["corrupted"],
        "gnc": ["cauchy"],
        "plain": ["corrupted"],
    }


def test_metrics_have_the_first_the_middle_and_the_last_share(stress: StressTest):
    numbers = robustness.numbers(stress)
    gnc = numbers["robustness"]["borno_8"]["gnc"]["constant"]
    assert list(gnc["truth_rmse_xyz_m"]) == ["0", "10", "50"]
    assert gnc["precision"] == 1
    assert numbers["loop_gate"]["borno_8"] == {"precision": 1.0, "recall": pytest.approx(12 / 14)}
    assert robustness.few_shares([0.5, 0.0, 0.05, 0.1, 0.25]) == [0.0, 0.1, 0.5]
    assert robustness.few_shares([0.0]) == [0.0]


def test_a_survey_without_closures_or_truth_has_dashes(stress: StressTest):
    numbers, tables = robustness.numbers(stress), robustness_tables.every(stress, DATASETS)
    assert numbers["loop_gate"]["mine"] == {"precision": None, "recall": None}
    assert numbers["robustness"]["mine"]["gnc"]["constant"]["recall"] is None
    mine = [line for line in text_table.markdown(tables["robustness"]).splitlines() if "| mine" in line]
    assert mine
    assert all(text_table.UNKNOWN in line for line in mine)
    assert "nan" not in text_table.markdown([*tables["robustness_shares"], *tables["loop_gate"]]).lower()


def test_the_page_says_which_kernels_withstand_false_closures(stress: StressTest):
    section = robustness_words.section(robustness_tables.every(stress, DATASETS))
    advice = next(text for text in section.paragraphs if text.startswith("Use "))
    assert "cauchy" in advice.split(":")[0]
    assert "gnc" in advice.split(":")[0]
    assert "plain" not in advice.split(":")[0]


def advice(rows: pd.DataFrame, stress: StressTest) -> str:
    """Return what the page advises of such runs."""
    section = robustness_words.section(robustness_tables.every(StressTest(rows, stress.gate), DATASETS))
    return section.paragraphs[1]


@pytest.mark.parametrize("share", [0.1, 0.5])
def test_a_kernel_that_failed_once_does_not_withstand_false_closures(stress: StressTest, share: float):
    rows = stress.rows.copy()
    once = (rows["kernel"] == "gnc") & (rows["start"] == "cauchy") & (rows["survey"] == "borno_8")
    once &= (rows["share"] == share) & (rows["repetition"] == 0) & (rows["method"] == "constant")
    rows.loc[once, "failed"] = True
    assert "Use cauchy:" in advice(rows, stress)
    assert "(1 failed)" in advice(rows, stress)


def test_a_kernel_that_failed_in_every_run_of_a_method_does_not_withstand_by_the_others(stress: StressTest):
    rows = stress.rows.copy()
    runs = (rows["kernel"] == "cauchy") & (rows["method"] == "constant") & (rows["survey"] == "borno_8")
    rows.loc[runs, "failed"] = True
    rows.loc[runs, "truth_rmse_xyz_m"] = np.nan
    text = advice(rows, stress)
    assert "Use gnc:" in text
    assert f"cauchy {text_table.UNKNOWN} (" in text


def test_a_kernel_without_a_number_does_not_withstand_though_no_run_failed(stress: StressTest):
    rows = stress.rows.copy()
    rows.loc[
        (rows["kernel"] == "gnc") & (rows["method"] == "constant") & (rows["share"] == 0.5), "truth_rmse_xyz_m"
    ] = np.nan
    assert "Use cauchy:" in advice(rows, stress)


def test_the_page_tells_what_a_start_costs_and_how_many_true_closures_stay(stress: StressTest):
    section = robustness_words.section(robustness_tables.every(stress, DATASETS))
    assert any("cauchy 0.9, gnc 0.9" in text for text in section.paragraphs)
    assert any("From the corrupted poses instead, with 50 %" in text for text in section.paragraphs)


def test_the_page_of_a_survey_of_ones_own_alone_gives_no_advice(stress: StressTest):
    mine = StressTest(*(table[table["survey"] == "mine"] for table in (stress.rows, stress.gate)))
    section = robustness_words.section(robustness_tables.every(mine, DATASETS))
    assert any("nothing can be said" in text for text in section.paragraphs)


def test_figures_are_drawn_of_what_there_is_and_the_same_each_time(stress: StressTest):
    drawn = dict(robustness_figures.every(stress))
    assert set(drawn) == {"robustness", "robustness_gate"}
    panels = drawn["robustness"].axes
    assert len(panels) == 3  # kernels, of the one survey that has loop closures
    assert len(panels[0].get_lines()) == 3  # methods
    again = dict(robustness_figures.every(stress))
    for name, figure in drawn.items():
        assert plots.png(figure) == plots.png(again[name])


def test_a_survey_without_loop_closures_has_no_panels(stress: StressTest):
    mine = replace(stress, rows=stress.rows[stress.rows["survey"] == "mine"])
    for figure in dict(robustness_figures.every(mine)).values():
        assert not figure.axes
        assert [text.get_text() for text in figure.texts] == ["no test survey has loop closures"]


def test_a_study_without_test_surveys_has_empty_tables(tmp_path: Path):
    nothing = robustness.read(tmp_path, [])
    assert robustness.numbers(nothing) == {"robustness": {}, "loop_gate": {}}
