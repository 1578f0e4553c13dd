"""Differences of network from other methods are paired by draw and noise, and a draw counts once."""

import numpy as np
import pandas as pd
import pytest

from pointnetkl.reporting import results, terrain
from pointnetkl.reporting.covariances import method_plots
from pointnetkl.reporting.drawing import plots
from pointnetkl.reporting.slam import numbers as slam_numbers
from pointnetkl.slam.benchmark.schemas import TRAJECTORIES

SETTINGS = results.Settings(9, 0.01, 2.0, 5, terrain.Settings(0.004, 0.02))
ERRORS = [*slam_numbers.ERRORS, "truth_relative_m"]
OFF = {"network": 0.0, "constant": 0.5, "censi": 40.0, "hessian": 0.1, "cello": 0.2, "mean_field": 0.3}


def rows(first: int = 5, noise: float = 0.0) -> pd.DataFrame:
    """Made-up errors of four draws, of `first` noises in the first and three in the others; the noise is common."""
    rng, result = np.random.default_rng(0), []
    for draw in range(4):
        for repetition in range(first if draw == 0 else 3):
            common = rng.uniform(10, 100)
            for method, off in OFF.items():
                error = (
                    common + off + noise * rng.normal() + (1000.0 if repetition > 2 and method == "constant" else 0.0)
                )
                run = {"variant": "table", "method": method, "draw": draw, "repetition": repetition}
                result.append({**run, **dict.fromkeys(ERRORS, error)})
    return pd.DataFrame(result)


def benchmark(rows: pd.DataFrame) -> results.Test:
    """Return a test survey with these rows of the benchmark."""
    none, trajectories = np.empty(0), pd.DataFrame(columns=TRAJECTORIES.names)
    return results.Test({}, none, rows, trajectories, np.tile(np.eye(4), (9, 1, 1)), np.zeros((7, 2)), none, none)


def differences(rows: dict[str, pd.DataFrame]) -> pd.DataFrame:
    """Return network's errors less the methods', of the benchmark's rows by survey."""
    return slam_numbers.differences(
        {name: slam_numbers.summarise(name, benchmark(own), SETTINGS) for name, own in rows.items()}
    )


def test_what_all_methods_share_drops_out():
    result = differences({"borno_8": rows()}).set_index(["measure", "method"])["difference_m"]
    for measure in slam_numbers.MEASURES:
        assert result[measure].to_dict() == pytest.approx(
            {name: -off for name, off in OFF.items() if name != "network"}
        )


def test_seeing_every_noise_twice_makes_no_interval_narrower():
    once = rows(first=3, noise=0.3)
    twice = pd.concat([once, once.assign(repetition=once["repetition"] + 3)])
    ends = [differences({"borno_8": repeated})[["ci_low", "ci_high"]].astype(float) for repeated in (once, twice)]
    assert (ends[0]["ci_high"] > ends[0]["ci_low"]).all()
    pd.testing.assert_frame_equal(*ends)


def test_every_draw_counts_with_as_many_noises():
    result = differences({"borno_8": rows(first=5)})  # constant is far off in the first draw's last two
    assert result[result["method"] == "constant"]["difference_m"].to_numpy() == pytest.approx(-0.5)


def test_what_has_no_solution_is_left_out_of_its_method_only():
    table = rows()
    table.loc[(table["method"] == "censi") & (table["draw"] == 1), list(slam_numbers.MEASURES)] = np.nan
    result = differences({"borno_8": table})
    assert result[result["method"] == "censi"]["difference_m"].to_numpy() == pytest.approx(-40.0)
    assert set(result["method"]) == set(OFF) - {"network"}


def test_a_survey_without_truth_or_without_network_has_no_rows_and_the_figure_says_so():
    blind = rows().assign(**dict.fromkeys(slam_numbers.MEASURES, np.nan))
    alone = rows()[lambda table: table["method"] != "network"]
    empty = differences({"mine": blind, "other": alone})
    assert empty.empty
    assert "no test survey" in method_plots.slam_differences(empty).texts[0].get_text()


def test_a_method_far_behind_stands_at_the_border_with_its_number():
    figure = method_plots.slam_differences(differences({"borno_8": rows(noise=0.01)}))
    assert len(figure.axes) == len(slam_numbers.MEASURES)
    for axes in figure.axes:
        assert axes.get_xlim()[0] > -10
        assert [text.get_text() for text in axes.texts] == ["-40"]


def test_a_survey_without_pairs_leaves_its_panel_empty_and_moves_no_other():
    alone = rows().assign(truth_relative_m=np.nan)
    result = differences({"mine": alone, "borno_8": rows()})
    titles = [axes.get_title() for axes in method_plots.slam_differences(result).axes]
    assert [title.split(":")[0] for title in titles] == ["mine", "Bornö 8"] * 2 + ["", "Bornö 8"]


def test_both_ways_are_those_of_the_paper_s_graph():
    table = rows()
    authors = table[table["method"].isin(["network", "constant"])].assign(variant="authors")
    authors["truth_rmse_xyz_m"] += np.where(authors["draw"] == 0, 1.0, 500.0)
    tests = {"borno_8": benchmark(pd.concat([table, authors])), "mine": benchmark(table)}
    both = slam_numbers.both_ways(
        {name: slam_numbers.summarise(name, test, SETTINGS) for name, test in tests.items()},
        {name: slam_numbers.authors(name, test, SETTINGS) for name, test in tests.items()},
    )
    assert list(both["method"]) == ["network", "constant"]
    assert (both["authors_m"] - both["table_m"]).to_numpy() == pytest.approx(1.0)
    assert len(method_plots.slam_both_ways(both).axes) == 1
    assert plots.png(method_plots.slam_both_ways(both.iloc[:0]))
