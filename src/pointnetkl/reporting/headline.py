"""headline.json: at most 60 numbers that a user compares after changing a parameter, in the order of reading them.

`dvc metrics diff` shows them. It sorts keys, so the keys of a survey's quantities are in alphabetical order as well.
"""

from collections.abc import Iterator, Mapping
from itertools import islice, zip_longest

import numpy as np

from pointnetkl.registration.covariance.catalogue import (
    CONSTANT,
    MAP,
    MONTE_CARLO,
    NAIVE_GICP,
    NETWORK,
    POINTNETKL,
    STRUCTURE_TENSOR,
)
from pointnetkl.reporting.text_table import Numbers, rounded

MOST = 60
KL, CLOSED, COVERAGE, LABEL = "KL_nats", "closed_m", "coverage_95", "label_larger_m2"
SLAM_TRUTH, SLAM_GT = "slam_truth_m", "slam_gt_m"
_METHODS = (NETWORK, POINTNETKL, STRUCTURE_TENSOR, CONSTANT, NAIVE_GICP)
_SOLUTIONS = ("corrupted", MONTE_CARLO, NETWORK, CONSTANT, NAIVE_GICP)
_QUANTILES = {"q05": 0.05, "q50": 0.50, "q95": 0.95}
# What is kept first where not all numbers fit, for each quantity
_IMPORTANCE = (
    NETWORK,
    MAP,
    "q50",
    CONSTANT,
    MONTE_CARLO,
    POINTNETKL,
    NAIVE_GICP,
    "corrupted",
    STRUCTURE_TENSOR,
    "q95",
    "q05",
)


def select(numbers: Numbers, larger_m2: Mapping[str, np.ndarray]) -> dict[str, dict[str, dict[str, float]]]:
    """Return {survey: {quantity: {method: number}}} of the test surveys, at most MOST numbers.

    `numbers` are those of metrics.json; `larger_m2` is, by survey, the larger eigenvalue (k,) of each label in x, y.
    What is not known is left out. Where there are too many surveys for all numbers, each survey keeps as many as
    any other: the most important of each quantity in turn (_IMPORTANCE). Beyond MOST surveys the last have none.
    """
    surveys = list(larger_m2)[:MOST]
    whole = {name: _quantities(name, numbers, larger_m2[name]) for name in surveys}
    share = MOST // max(1, len(surveys))
    return {name: _cut(quantities, share) for name, quantities in whole.items()}


def _quantities(name: str, numbers: Numbers, larger_m2: np.ndarray) -> dict[str, dict[str, float]]:
    sections = ("kl", "closing", "calibration", "slam")
    kl, closing, coverage, slam = (numbers.get(key, {}).get(name, {}) for key in sections)
    against_truth = any("truth_rmse_xyz_m" in slam.get(method, {}) for method in _SOLUTIONS)
    slam_key, column = (SLAM_TRUTH, "truth_rmse_xyz_m") if against_truth else (SLAM_GT, "rmse_xyz_m")
    quantiles = {key: rounded(float(np.quantile(larger_m2, share))) for key, share in _QUANTILES.items()}
    return {
        KL: {method: kl[method]["mean"] for method in _METHODS if method in kl},
        CLOSED: {MAP: closing[MAP]["as_it_is_m"]} if "as_it_is_m" in closing.get(MAP, {}) else {},
        COVERAGE: {m: coverage[m]["coverage_95"] for m in (*_METHODS, MONTE_CARLO) if m in coverage},
        LABEL: quantiles,
        slam_key: {method: slam[method][column] for method in _SOLUTIONS if column in slam.get(method, {})},
    }


def _cut(quantities: Mapping[str, Mapping[str, float]], share: int) -> dict[str, dict[str, float]]:
    """Return at most `share` of a survey's numbers, in the order that they had."""
    kept = set(islice(_by_importance(quantities), share))
    cut = {key: {n: value for n, value in numbers.items() if (key, n) in kept} for key, numbers in quantities.items()}
    return {key: values for key, values in cut.items() if values}


def _by_importance(quantities: Mapping[str, Mapping[str, float]]) -> Iterator[tuple[str, str]]:
    """Yield quantity and method of each number: the most important one of every quantity, then the next of each."""
    columns = [[(key, name) for name in sorted(values, key=_IMPORTANCE.index)] for key, values in quantities.items()]
    yield from (number for row in zip_longest(*columns) for number in row if number is not None)
