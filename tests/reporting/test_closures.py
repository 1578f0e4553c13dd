"""The report's section on loop closures: errors drawn from Q are described rightly, surveys may close no loop."""

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from scipy import stats

from pointnetkl.registration.covariance import table
from pointnetkl.reporting.closures import figures as closure_figures
from pointnetkl.reporting.closures import numbers as closure_numbers
from pointnetkl.reporting.closures import tables as closure_tables
from pointnetkl.reporting.closures import words as closure_words
from pointnetkl.reporting.closures.numbers import Closures
from pointnetkl.reporting.results import GOLD, Folders, Labels, ResultsError
from pointnetkl.slam.closures import schemas as calibrate_schemas
from pointnetkl.workflow import artifacts, study

SUBMAPS, DRAWS = 60, 60
DATASETS = {name: {"simulated": True} for name in ("a", "b", "mine")}


def drawn_closures(seed: int, sigma: float = 1.0, count: int = SUBMAPS, m: int = 2, truth: bool = True) -> Closures:
    """Return loop closures whose errors are drawn from the labels' Q, times a standard deviation."""
    rng = np.random.default_rng(seed)
    roots = rng.normal(size=(count, m, m)) * 10 ** rng.uniform(-2, 0, (count, 1, 1)) + 0.01 * np.eye(m)
    q = roots @ np.swapaxes(roots, 1, 2)
    number = np.tile(np.arange(count), DRAWS if count else 0)
    placed = np.einsum("rij,rj->ri", roots[number], rng.normal(size=(len(number), m)))
    rows = pd.DataFrame({"draw": np.repeat(np.arange(len(number) // max(count, 1)), count), "submap": number})
    rows = rows.assign(
        targets=1, converged=True, **{name: rng.random(len(rows)) for name in calibrate_schemas.DESCRIPTION}
    )
    errors = {"error": sigma * placed if truth else np.nan * placed, "gt_error": sigma * placed, "placed_error": placed}
    for kind, e in errors.items():
        rows = rows.assign(**{f"{kind}_{unit}": e[:, i] for i, unit in enumerate(("x_m", "y_m", "w_rad")[:m])})
    known = {"monte_carlo": 1.0, "split": 4.0, "measured_pair": sigma**2}
    return Closures(rows, {name: dict(enumerate(factor * q)) for name, factor in known.items()})


def numbers(surveys: dict[str, Closures]) -> dict[str, dict]:
    """Return what the report hands to the tables."""
    return {
        "calibration_lc": closure_numbers.calibrations(surveys),
        "calibration": {name: {} for name in surveys},
        "closures": {name: closure_numbers.sizes(closures) for name, closures in surveys.items()},
        "closures_by_hold": {name: closure_numbers.by_hold(closures) for name, closures in surveys.items()},
        "closure_ratios": {name: closure_numbers.dependence(closures) for name, closures in surveys.items()},
    }


def paragraphs(numbers: dict[str, dict], copies: dict[str, str]) -> Sequence[str]:
    """Return what the page says of these numbers."""
    return closure_words.section(closure_tables.every(numbers, DATASETS), numbers, copies).paragraphs


@pytest.mark.parametrize("m", [2, 3])
def test_errors_drawn_from_q_have_a_nees_of_one_and_nominal_coverage(m: int):
    result = closure_numbers.calibrations({"a": drawn_closures(1, m=m)})["a"][GOLD]
    assert result["nees"] == pytest.approx(1, abs=0.05)
    assert result["nees_median"] == pytest.approx(1, abs=0.05)
    for percent in (50, 90, 95, 99):
        assert result[f"coverage_{percent}"] == pytest.approx(percent / 100, abs=0.02)
    assert result["inflation"] == pytest.approx(1, abs=0.1)


def test_errors_of_the_map_do_not_count_in_placed_registrations():
    result = closure_numbers.calibrations({"a": drawn_closures(1, sigma=3.0)})["a"]
    assert result[GOLD]["nees"] == pytest.approx(9, rel=0.05)
    assert result[GOLD]["placed_nees"] == pytest.approx(1, abs=0.05)
    assert result["measured_pair"]["nees"] == pytest.approx(1, abs=0.05)


def test_a_factor_found_on_one_survey_makes_the_other_one_right_if_both_are_wrong_alike():
    surveys = {"a": drawn_closures(1, sigma=3.0), "b": drawn_closures(2, sigma=3.0)}
    result = closure_numbers.calibrations(surveys)["b"][GOLD]
    assert result["inflation"] == pytest.approx(9, rel=0.1)
    assert result["coverage_95"] < 0.6
    assert result["coverage_95_inflated"] == pytest.approx(0.95, abs=0.02)


def test_the_variance_to_add_is_that_which_was_left_out():
    closures = drawn_closures(1)
    shaken = np.random.default_rng(3).normal(0, 0.5, (len(closures.rows), 2))
    exact = dict.fromkeys(closures.covariances[GOLD], 1e-4 * np.eye(2))
    rows = closures.rows.assign(error_x_m=shaken[:, 0], error_y_m=shaken[:, 1])
    result = closure_numbers.calibrations({"a": Closures(rows, {GOLD: exact})})["a"][GOLD]
    assert result["added_m2"] == pytest.approx(0.25, rel=0.1)
    wide = Closures(closures.rows, {"split": closures.covariances["split"]})
    assert closure_numbers.calibrations({"a": wide})["a"]["split"]["added_m2"] == 0


def test_where_the_truth_is_not_known_errors_are_against_gt():
    closures = drawn_closures(1, sigma=2.0, truth=False)
    assert closures.reference == "gt"
    assert closure_numbers.calibrations({"a": closures})["a"][GOLD]["nees"] == pytest.approx(4, rel=0.05)


def test_ratios_are_of_standard_deviations():
    closures = drawn_closures(1, sigma=3.0)
    assert closure_numbers.ratios(closures, GOLD)["ratio"].to_numpy() == pytest.approx(3.0)
    assert closure_numbers.ratios(closures, "split")["ratio"].to_numpy() == pytest.approx(1.5)
    assert len(closure_numbers.ratios(closures, GOLD)) == SUBMAPS
    assert closure_numbers.ratios(closures, GOLD)["worst_ratio"].to_numpy() == pytest.approx(3.0)
    longer = {number: q @ np.diag([4.0, 1.0]) for number, q in dict.fromkeys(range(SUBMAPS), np.eye(2)).items()}
    squeezed = Closures(closures.rows, {GOLD: dict.fromkeys(range(SUBMAPS), np.eye(2)), "measured_pair": longer})
    result = closure_numbers.ratios(squeezed, GOLD)
    assert result["ratio"].to_numpy() == pytest.approx(np.sqrt(5 / 2))
    assert result["worst_ratio"].to_numpy() == pytest.approx(2)


def one_bias(against: str = "truth") -> Closures:
    """Return registrations of each submap that all end at an error drawn from its label: Q_ij is of rank one, nearly.

    Its short axis is a millimetre, of what the starts leave.
    """
    closures, rng = drawn_closures(1, truth=against == "truth"), np.random.default_rng(4)
    labels = np.array(list(closures.covariances[GOLD].values()))
    bias = np.einsum("kij,kj->ki", np.linalg.cholesky(labels), rng.normal(size=(SUBMAPS, 2)))
    ends = bias[closures.rows["submap"]] + rng.normal(0, 1e-3, (len(closures.rows), 2))
    rows = closures.rows.assign(placed_error_x_m=ends[:, 0], placed_error_y_m=ends[:, 1])
    pair = dict(enumerate(bias[:, :, None] * bias[:, None, :] + 1e-6 * np.eye(2)))
    return Closures(rows, {**closures.covariances, "measured_pair": pair})


def test_a_q_of_rank_one_is_as_wide_as_its_error_and_not_as_its_short_axis():
    closures = one_bias()
    result = closure_numbers.ratios(closures, GOLD)
    shares = [
        np.sqrt(np.linalg.det(closures.covariances["measured_pair"][n]) / np.linalg.det(closures.covariances[GOLD][n]))
        for n in range(SUBMAPS)
    ]
    assert np.median(np.sqrt(shares)) < 0.5  # by determinants, though the labels describe these errors rightly
    assert 0.6 < np.sqrt((result["ratio"] ** 2).mean()) < 1.4
    assert (result["worst_ratio"] >= result["ratio"]).all()


def test_with_yaw_ratios_are_of_positions():
    closures = drawn_closures(1, m=3)
    turned = {number: q * np.diag([1.0, 1.0, 1e4]) for number, q in closures.covariances[GOLD].items()}
    closures = Closures(
        closures.rows,
        {GOLD: dict.fromkeys(turned, np.eye(3)), "measured_pair": dict.fromkeys(turned, np.diag([4, 4, 1e6]))},
    )
    result = closure_numbers.ratios(closures, GOLD)
    assert result[["ratio", "worst_ratio"]].to_numpy() == pytest.approx(2.0)


def test_the_page_calls_q_ij_an_oracle_and_quotes_no_circular_coverage():
    surveys = {"a": one_bias(), "mine": one_bias("gt")}
    texts = paragraphs(numbers(surveys), {"a": "same"})
    assert any("an oracle" in text and "circular" in text for text in texts)
    (inside,) = (text for text in texts if text.startswith("Inside the ellipse"))
    known, unknown = inside.split("; ")
    assert known.count("(placed") == 2  # labels and split
    assert "Q_ij" in known.rsplit(",", 1)[1]
    assert "placed" not in unknown


def test_classes_by_hold_hold_every_registration_once():
    closures = drawn_closures(1)
    result = closure_numbers.by_hold(closures)
    assert sum(medians["registrations"] for medians in result.values()) == len(closures.rows)
    assert result["below 0.1 m"]["placed_error_m"] < 0.1 < result["above 1 m"]["placed_error_m"]


def test_a_survey_that_closes_no_loop_has_dashes_and_no_figure_fails():
    surveys = {"mine": drawn_closures(1, count=0)}
    result = numbers(surveys)
    assert result["calibration_lc"] == {"mine": {}}
    blocks = closure_tables.every(result, DATASETS)["calibration_lc"]
    assert blocks[0].frame.empty
    assert blocks[1].frame.loc[0, "registrations"] == 0
    assert blocks[1].frame.loc[0, "error_m"] is None
    assert paragraphs(result, {"mine": "same"})[-1] == "No survey here closes a loop."
    assert len(dict(closure_figures.every(blocks[0].frame, surveys))) == 3


def test_the_page_advises_the_copy_whose_labels_hold_as_many_errors_as_they_say():
    surveys = {"a": drawn_closures(1), "b": drawn_closures(2)}
    copies = {"a": "same", "b": "same"}
    assert "those of copy same: the paper's labels stand" in paragraphs(numbers(surveys), copies)[-2]
    swapped = {
        name: Closures(
            closures.rows,
            {**closures.covariances, GOLD: closures.covariances["split"], "split": closures.covariances[GOLD]},
        )
        for name, closures in surveys.items()
    }
    assert "take label.copy: split" in paragraphs(numbers(swapped), copies)[-2]
    assert not any("What follows" in text for text in paragraphs(numbers(swapped), {"a": "split"}))


def test_where_the_truth_is_not_known_no_copy_is_advised():
    texts = paragraphs(numbers({"a": drawn_closures(1, truth=False)}), {"a": "same"})
    assert not any("What follows" in text for text in texts)
    texts = paragraphs(
        numbers({"a": drawn_closures(1, truth=False), "b": drawn_closures(2)}), {"a": "same", "b": "same"}
    )
    assert sum("What follows" in text for text in texts) == 1  # of b
    of_a, of_b = next(text for text in texts if "other test surveys ask" in text).split("; b, ", 1)
    assert "without GT's errors" in of_b
    assert "without GT's errors" not in of_a


def test_bins_of_errors_drawn_from_q_lie_on_the_line():
    closures = drawn_closures(1)
    points = closure_figures.binned(*closures.described(GOLD))
    assert len(points) == 8
    assert points[:, 1] == pytest.approx(points[:, 0], rel=0.1)
    assert closure_figures.binned(np.empty((0, 2)), np.empty((0, 2, 2))).shape == (0, 2)


def with_ends(closures: Closures, factor: float = 1.0) -> Closures:
    """Return closures whose placed registrations have each the label's Q, times a factor, as methods pair and map."""
    q = factor * np.array([closures.covariances[GOLD][number] for number in closures.rows["submap"]])
    ends = closures.rows.assign(**table.to_columns(q))
    return Closures(closures.rows, closures.covariances, {"pair": ends, "map": ends})


@pytest.mark.parametrize("m", [2, 3])
def test_the_log_likelihood_is_that_of_the_errors_under_their_own_covariances(m: int):
    closures = with_ends(drawn_closures(1, m=m))
    result = closure_numbers.calibrations({"a": closures})["a"]
    errors = closures.errors("placed_error")
    densities = [
        stats.multivariate_normal.logpdf(error, np.zeros(m), closures.covariances[GOLD][number])
        for error, number in zip(errors, closures.rows["submap"], strict=True)
    ]
    for method in (GOLD, "pair", "map"):
        assert result[method]["placed_log_likelihood"] == pytest.approx(np.mean(densities))
        low, high = result[method]["placed_log_likelihood_ci95"]
        assert low < np.mean(densities) < high
        assert result[method]["placed_median_m"] == pytest.approx(np.median(np.hypot(*errors[:, :2].T)))
    assert result["split"]["placed_log_likelihood"] < result[GOLD]["placed_log_likelihood"]
    assert "nees" not in result["pair"]  # of the graph's own registrations it has no covariance


def test_birge_s_ratio_is_what_sigmas_are_too_small_by():
    result = closure_numbers.calibrations({"a": with_ends(drawn_closures(1, sigma=3.0), 0.25)})["a"]
    assert result[GOLD]["birge"] == pytest.approx(3, rel=0.03)
    assert result[GOLD]["placed_birge"] == pytest.approx(1, rel=0.03)
    assert result["pair"]["placed_birge"] == pytest.approx(2, rel=0.03)


def test_split_is_recalibrated_by_what_the_other_surveys_ask_for():
    surveys = {"a": drawn_closures(1), "b": drawn_closures(2)}
    result = closure_numbers.calibrations(surveys)["b"]
    assert result["split"]["placed_nees"] == pytest.approx(0.25, rel=0.05)  # split is four times the labels
    assert result["split_recalibrated"]["placed_nees"] == pytest.approx(1, rel=0.05)
    assert result["split_recalibrated"]["placed_log_likelihood"] == pytest.approx(
        result[GOLD]["placed_log_likelihood"], abs=0.01
    )
    for others in ({}, {"a": drawn_closures(1, truth=False)}, {"a": drawn_closures(1, count=0)}):
        assert "split_recalibrated" not in closure_numbers.calibrations({"b": surveys["b"], **others})["b"]


def test_the_table_begins_with_the_log_likelihood_and_the_page_says_it():
    surveys = {name: with_ends(drawn_closures(seed)) for seed, name in enumerate(("a", "b"))}
    result = numbers(surveys)
    frame = closure_tables.every(result, DATASETS)["calibration_lc"][0].frame
    assert list(frame.columns[:7]) == [
        *("survey", "simulated", "against", "method"),
        *("placed_log_likelihood", "ci_low", "ci_high"),
    ]
    assert set(frame["method"]) == {GOLD, "split", "measured_pair", "split_recalibrated", "pair", "map"}
    assert frame[frame["method"] == "pair"]["nees"].isna().all()
    assert frame["placed_birge"].notna().all()
    (likelihoods,) = (text for text in paragraphs(result, {}) if text.startswith("Mean log likelihood"))
    assert "measured_pair" not in likelihoods
    assert likelihoods.count("by MAP") == 2
    assert len(dict(closure_figures.every(frame, surveys))) == 3


def read(folder: Path, ends: pd.DataFrame, schema: pa.Schema = calibrate_schemas.ENDS) -> Closures:
    """Return what the report reads of two registrations of a test survey, and these ends."""
    own = folder / "test/borno_8"
    rows = pd.DataFrame(1.0, [0, 1], calibrate_schemas.CLOSURES.names)
    rows = rows.assign(survey="borno_8", draw=0, submap=[3, 4], targets=1, converged=True)
    artifacts.write_table(own / "closures.parquet", rows, calibrate_schemas.CLOSURES, {})
    artifacts.write_table(own / "closure_covariances.parquet", table.SCHEMA.empty_table().to_pandas(), table.SCHEMA, {})
    artifacts.write_table(own / "closure_ends.parquet", ends, schema, {})
    folders = Folders(folder, folder, folder, study.read(Path(__file__).parents[2] / "params.yaml"))
    labels = Labels(np.array([3, 4]), np.array(2 * [np.eye(2)]), np.ones(2), np.zeros(2, bool), pd.DataFrame(), {})
    return closure_numbers.read(folders, "borno_8", labels, SimpleNamespace(covariances={}))


def two_ends(submaps: tuple[int, int]) -> pd.DataFrame:
    """Return two ends of method pair with errors of a metre."""
    ends = pd.DataFrame(1.0, [0, 1], calibrate_schemas.ENDS.names)
    return ends.assign(survey="borno_8", draw=0, submap=submaps, method="pair", q_xy_m2=0.0)


def test_ends_are_read_by_method(tmp_path: Path):
    closures = read(tmp_path, two_ends((3, 4)))
    errors, q = closures.described("pair", "placed_error")
    assert (errors == 1).all()
    assert (q == np.eye(2)).all()
    assert closures.nodes("pair").tolist() == [3, 4]
    assert len(closures.described("pair")[0]) == 0


def test_ends_of_other_registrations_and_of_another_form_are_refused_in_a_sentence(tmp_path: Path):
    with pytest.raises(ResultsError, match=r"closure_ends.parquet: has registrations that closures.parquet lacks"):
        read(tmp_path, two_ends((3, 5)))
    short = pa.schema([calibrate_schemas.ENDS.field(name) for name in calibrate_schemas.ENDS.names[:-1]])
    with pytest.raises(artifacts.ArtifactError, match=r"closure_ends.parquet.*q_yy_m2"):
        read(tmp_path, two_ends((3, 4)).drop(columns="q_yy_m2"), short)
