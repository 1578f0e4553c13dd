"""headline.json: few numbers, in the order of reading them, the same as those of metrics.json."""

import numpy as np
import pytest

from pointnetkl.reporting import headline

METHODS = ("network", "pointnetkl", "structure_tensor", "constant", "naive_gicp", "cello")
LARGER_M2 = np.linspace(0.0, 1.0, 101)


def metrics(surveys: int, truth: bool = True) -> dict[str, dict]:
    """Return made-up numbers as metrics.json has them, every one another."""
    counter = iter(range(10_000))
    names = [f"survey_{i}" for i in range(surveys)]
    column = "truth_rmse_xyz_m" if truth else "rmse_xyz_m"
    return {
        "kl": {name: {method: {"mean": next(counter)} for method in METHODS} for name in names},
        "closing": {name: {"map": {"as_it_is_m": next(counter)}} for name in names},
        "calibration": {
            name: {method: {"coverage_95": next(counter)} for method in ("monte_carlo", *METHODS)} for name in names
        },
        "slam": {
            name: {
                "loop_closures": 7,
                **{method: {column: next(counter)} for method in ("corrupted", "monte_carlo", *METHODS)},
            }
            for name in names
        },
    }


def select(surveys: int, truth: bool = True) -> dict[str, dict]:
    return headline.select(metrics(surveys, truth), {f"survey_{i}": LARGER_M2 for i in range(surveys)})


def count(selected: dict[str, dict]) -> int:
    return sum(len(values) for quantities in selected.values() for values in quantities.values())


def test_up_to_three_surveys_have_every_number():
    for surveys in (1, 2, 3):
        assert count(select(surveys)) == 20 * surveys


@pytest.mark.parametrize("surveys", [4, 5, 15, 20, 59, 60, 61, 200])
def test_of_many_surveys_there_are_still_at_most_sixty_numbers_and_every_survey_has_as_many(surveys: int):
    selected = select(surveys)
    assert 30 < count(selected) <= 60
    assert len({count({name: each}) for name, each in selected.items()}) == 1
    assert list(selected) == [f"survey_{i}" for i in range(min(surveys, 60))]


def test_numbers_that_do_not_fit_are_the_least_important_of_their_quantity():
    (first, *_) = select(8).values()
    assert {key: list(values) for key, values in first.items()} == {
        "KL_nats": ["network", "constant"],
        "closed_m": ["map"],
        "coverage_95": ["network", "constant"],
        "label_larger_m2": ["q50"],
        "slam_truth_m": ["network"],
    }


def test_the_order_is_that_of_reading_and_dvc_which_sorts_keys_keeps_it():
    (first,) = select(1).values()
    assert list(first) == ["KL_nats", "closed_m", "coverage_95", "label_larger_m2", "slam_truth_m"] == sorted(first)
    assert list(first["KL_nats"]) == ["network", "pointnetkl", "structure_tensor", "constant", "naive_gicp"]
    assert list(first["coverage_95"]) == [*first["KL_nats"], "monte_carlo"]
    assert list(first["slam_truth_m"]) == ["corrupted", "monte_carlo", "network", "constant", "naive_gicp"]


def test_numbers_are_those_of_metrics():
    numbers = metrics(2)
    for name, each in select(2).items():
        assert each["KL_nats"] == {m: numbers["kl"][name][m]["mean"] for m in each["KL_nats"]}
        assert each["closed_m"] == {"map": numbers["closing"][name]["map"]["as_it_is_m"]}
        assert each["coverage_95"] == {m: numbers["calibration"][name][m]["coverage_95"] for m in each["coverage_95"]}
        assert each["slam_truth_m"] == {m: numbers["slam"][name][m]["truth_rmse_xyz_m"] for m in each["slam_truth_m"]}
        assert each["label_larger_m2"] == pytest.approx({"q05": 0.05, "q50": 0.5, "q95": 0.95})


def test_without_the_truth_slam_errors_are_against_gt():
    (first,) = select(1, truth=False).values()
    assert "slam_truth_m" not in first
    assert len(first["slam_gt_m"]) == 5


def test_what_is_not_known_is_left_out():
    selected = headline.select({"kl": {}, "slam": {"mine": {"loop_closures": 0}}}, {"mine": LARGER_M2})
    assert list(selected["mine"]) == ["label_larger_m2"]
