"""The benchmark's numbers: the paper's from one graph, and comparisons over draws of its loop closures."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
import pytest

from pointnetkl.reporting import results, terrain
from pointnetkl.reporting.slam import numbers as slam_numbers
from pointnetkl.reporting.slam import tables as slam_tables
from pointnetkl.reporting.slam import words as slam_words
from pointnetkl.reporting.text_table import Block
from pointnetkl.slam.benchmark.schemas import TRAJECTORIES

RUN = ["variant", "method", "draw", "repetition"]
ERRORS = [*slam_numbers.ERRORS, "truth_relative_m"]
SETTINGS = results.Settings(9, 0.01, 2.0, 5, terrain.Settings(0.004, 0.02))
DRAWS, MANY, FEW = 8, 40, 5
DATASETS = {"toy": {"simulated": True, "track_km": 1.0}}


def rows(seed: int = 0, better_m: float = 0.1) -> pd.DataFrame:
    """Return a benchmark in which draws differ by metres and network is better than constant by a little in each."""
    rng, table = np.random.default_rng(seed), []
    of_draw = rng.normal(20, 4, DRAWS)
    for draw in range(DRAWS):
        for repetition in range(MANY if draw == 0 else FEW):
            error = of_draw[draw] + rng.normal(0, 2)
            for method, more in (("network", 0.0), ("constant", better_m + rng.normal(0, 0.03)), ("twin", 0.0)):
                run = {"variant": "table", "method": method, "draw": draw, "repetition": repetition}
                table.append({**run, **dict.fromkeys(ERRORS, error + more)})
                if method == "constant":
                    table.append({**table[-1], "variant": "authors", **dict.fromkeys(ERRORS, error + 5)})
    return pd.DataFrame(table)[RUN + ERRORS]


def benchmark(table: pd.DataFrame) -> results.Test:
    """Return a test survey with these rows, and 7 loop closures."""
    trajectories = pd.DataFrame(columns=TRAJECTORIES.names)
    poses, edges, none = np.tile(np.eye(4), (9, 1, 1)), np.zeros((7, 2)), np.empty(0)
    return results.Test({}, none, table, trajectories, poses, edges, none, none)


def table_rows(method: str) -> pd.DataFrame:
    """Return a method's rows of the table itself."""
    return TEST.slam[(TEST.slam["method"] == method) & (TEST.slam["variant"] == "table")]


TEST = benchmark(rows())
NUMBERS = slam_numbers.summarise("toy", TEST, SETTINGS)


def test_the_paper_s_numbers_are_of_all_noises_on_the_first_draw():
    first = table_rows("constant").query("draw == 0")
    assert len(first) == MANY
    assert NUMBERS["constant"]["rmse_xyz_m"] == pytest.approx(first["rmse_xyz_m"].mean())
    low, high = NUMBERS["constant"]["rmse_xyz_ci95_m"]
    assert low < NUMBERS["constant"]["rmse_xyz_m"] < high


def test_every_draw_counts_the_same_over_draws():
    means = table_rows("constant").query("repetition < @FEW").groupby("draw")["truth_rmse_xyz_m"].mean()
    assert NUMBERS["constant"]["draws_truth_rmse_xyz_m"] == pytest.approx(means.mean())


def test_pairing_tells_apart_what_draws_would_hide():
    constant = NUMBERS["constant"]
    low, high = constant["draws_truth_rmse_xyz_ci95_m"]
    assert high - low > 20 * 0.1  # the intervals of both methods overlap nearly whole
    assert constant["network_minus_m"] == pytest.approx(-0.1, abs=0.02)
    assert constant["network_p"] < 1e-4
    low, high = constant["network_minus_ci95_m"]
    assert low < constant["network_minus_m"] < high < 0


def test_where_network_is_worse_the_interval_says_so():
    worse = slam_numbers.summarise("toy", benchmark(rows(better_m=-0.1)), SETTINGS)["constant"]
    assert worse["network_p"] > 0.99
    for measure in ("", "_se2", "_relative"):
        assert 0 < worse[f"network_minus{measure}_ci95_m"][0] < worse[f"network_minus{measure}_m"]


def test_a_twin_of_network_is_no_better_and_no_test_says_so():
    assert NUMBERS["twin"]["network_minus_m"] == 0.0
    assert NUMBERS["twin"]["network_p"] is None
    assert "network_p" not in NUMBERS["network"]


def test_a_repetition_without_solution_leaves_its_pair_out():
    table = rows()
    lost = (table["method"] == "constant") & (table["draw"] == 2) & (table["repetition"] == 0)
    table.loc[lost, ERRORS] = np.nan
    numbers = slam_numbers.summarise("toy", benchmark(table), SETTINGS)["constant"]
    assert numbers["network_minus_m"] == pytest.approx(NUMBERS["constant"]["network_minus_m"], abs=0.01)
    assert numbers["network_p"] < 1e-4


def test_navigation_which_no_noise_touches_is_compared_with_nothing():
    alone = table_rows("twin").head(1).assign(method="navigation")
    numbers = slam_numbers.summarise("toy", benchmark(pd.concat([TEST.slam, alone])), SETTINGS)
    assert set(numbers["navigation"]) == set(slam_numbers.ERRORS)


def test_one_draw_has_means_and_no_test():
    numbers = slam_numbers.summarise("toy", benchmark(TEST.slam[TEST.slam["draw"] == 0]), SETTINGS)["constant"]
    assert numbers["network_minus_m"] == pytest.approx(-0.1, abs=0.02)
    assert numbers["network_p"] is None
    assert numbers["draws_truth_rmse_xyz_ci95_m"] is None


def test_the_authors_table_has_their_rows_and_one_loop_closure_less():
    numbers = slam_numbers.authors("toy", TEST, SETTINGS)
    assert set(numbers) == {"dead_reckoning_edges", "loop_closures", "constant"}
    assert (numbers["loop_closures"], NUMBERS["loop_closures"]) == (6, 7)
    assert numbers["constant"]["rmse_xyz_m"] == pytest.approx(NUMBERS["constant"]["rmse_xyz_m"] + 4.9, abs=0.05)


def test_a_variant_stands_beside_the_table_with_their_paired_difference():
    numbers = slam_numbers.variants(TEST)
    methods = {variant: set(errors) for variant, errors in numbers.items()}
    assert methods == {"table": {"constant"}, "authors": {"constant"}}
    assert numbers["table"]["constant"]["minus_table_m"] == 0.0
    low, high = numbers["authors"]["constant"]["minus_table_ci95_m"]
    assert low < numbers["authors"]["constant"]["minus_table_m"] < high
    assert (low, high) == pytest.approx((4.9, 4.9), abs=0.1)


def test_the_tables_have_a_row_a_method_and_a_row_a_variant():
    over = slam_tables.draws({"toy": NUMBERS}, DATASETS).frame
    assert over["method"].tolist() == ["network", "constant", "twin"]
    assert over["network_p"].tolist()[0] is None
    constant = over[over["method"] == "constant"].iloc[0]
    for measure in ("", "_se2", "_relative"):
        limits = constant[f"ci_low_minus{measure}"], constant[f"ci_high_minus{measure}"]
        assert limits == NUMBERS["constant"][f"network_minus{measure}_ci95_m"]
    assert list(over.columns).index("ci_high_minus") == list(over.columns).index("network_p") - 1
    both = slam_tables.variants({"toy": slam_numbers.variants(TEST)}, DATASETS).frame
    assert both["variant"].tolist() == ["table", "authors"]


@pytest.mark.parametrize(("better_m", "verdict"), [(0.1, "better"), (-0.1, "worse")])
def test_the_page_says_whether_network_is_better_by_the_interval(better_m: float, verdict: str):
    numbers = slam_numbers.summarise("toy", benchmark(rows(better_m=better_m)), SETTINGS)
    assert sum(text.startswith("By truth_") and f"), {verdict}." in text for text in paragraphs(numbers)) == 2
    single = slam_numbers.summarise("toy", benchmark(TEST.slam[TEST.slam["draw"] == 0]), SETTINGS)
    assert not any(text.startswith("By truth_") for text in paragraphs(single))


def paragraphs(numbers: dict) -> Sequence[str]:
    """Return what the page says of the benchmark of a survey with these numbers."""
    thinning = pd.DataFrame({"survey": ["toy"], "thinning": [1], "map_to_map_m": [0.5]})
    shown = {"table_4": [], "table_4_authors": [], "slam_variants": [], "map_thinning": [Block("", thinning)]}
    return slam_words.sections(shown, {"toy": numbers})[0].paragraphs


def test_thinning_has_the_ratio_to_the_error_without_thinning():
    errors = {"map_to_map_m": [2.0, 2.1, 2.5], "both_thinned_m": [2.0, 3.0, 4.0]}
    rows = pd.DataFrame({"survey": "mine", "thinning": [1, 2, 4], "cells": 9, **errors})
    frame = slam_tables.thinning(rows, {"mine": {"simulated": True}}).frame
    assert frame["ratio"].tolist() == [1.0, 2.1 / 2.0, 2.5 / 2.0]
