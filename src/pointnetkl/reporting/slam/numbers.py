"""Numbers of the SLAM benchmark: the paper's table of one graph, and statistics over draws of its loop closures."""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from pointnetkl.registration.covariance.catalogue import CORRUPTED, GT, NAVIGATION, REFERENCES, TRUTH
from pointnetkl.reporting import intervals
from pointnetkl.reporting.results import OURS, Settings, Test
from pointnetkl.reporting.text_table import Numbers
from pointnetkl.slam.benchmark.schemas import AUTHORS, RMSES, TABLE
from pointnetkl.slam.graph import trajectory_error

ERRORS = (  # of one solution; the other measures are over draws
    *(f"{against}{name}" for against in ("", "truth_") for name in RMSES),
    *("map_to_map_m", "map_to_map_auvlib_m", "pose_nees"),
)


class _Names(NamedTuple):
    """How metrics.json names a measure over draws: its mean, network's error less the method's, and their test."""

    mean: str
    minus: str
    test: str


_OVER_DRAWS = {
    "truth_rmse_xyz_m": _Names("draws_truth_rmse_xyz", "network_minus", "network"),
    "truth_rmse_se2_m": _Names("draws_truth_rmse_se2", "network_minus_se2", "network_se2"),
    "truth_relative_m": _Names("truth_relative", "network_minus_relative", "network_relative"),
}
MEASURES = tuple(_OVER_DRAWS)
DIFFERENCES = ["survey", "method", "measure", "network_m", "difference_m", "ci_low", "ci_high"]


def summarise(survey: str, test: Test, settings: Settings) -> dict[str, Any]:
    """Return the graph's size and each method's errors, NaN or None where not known.

    Plain names are means over the noises on the first draw, as in the paper, with a bootstrap interval over noises.
    draws_*, truth_relative_* and network_* are over all draws and the noises that every draw has; their intervals and
    tests are clustered by draw.
    """
    solutions = test.slam[test.slam["variant"] == TABLE]
    methods = {
        str(method): {
            **_errors(rows[rows["draw"] == 0], survey, str(method), settings),
            **_over_draws(solutions, str(method)),
        }
        for method, rows in solutions.groupby("method", sort=False)
    }
    return {**_sizes(test), **methods, GT: {"truth_rmse_xyz_m": _gt_error(test.trajectories)}}


def authors(survey: str, test: Test, settings: Settings) -> dict[str, Any]:
    """Return the same numbers on the paper's graph as the authors' program, with its two slips, would compute them."""
    variant = (test.slam["variant"] == AUTHORS) | test.slam["method"].isin([NAVIGATION, CORRUPTED])
    methods = test.slam[variant & (test.slam["draw"] == 0)].groupby("method", sort=False)
    sizes = _sizes(test)
    sizes["loop_closures"] = max(0, sizes["loop_closures"] - 1)
    errors = {str(m): _errors(rows, f"{survey}, {AUTHORS}", str(m), settings) for m, rows in methods}
    return {**sizes, **errors}


def variants(test: Test) -> dict[str, dict[str, Any]]:
    """Return, by variant and method, mean errors over draws and their paired difference from the variant `table`."""
    methods = test.slam[test.slam["variant"] != TABLE]["method"].unique()
    rows = shared_noises(test.slam[test.slam["method"].isin(methods)])
    numbers: dict[str, dict[str, Any]] = {}
    for (variant, method), own in rows.groupby(["variant", "method"], sort=False):
        table = rows[(rows["variant"] == TABLE) & (rows["method"] == method)]
        more = difference(own, table, "truth_rmse_xyz_m")
        numbers.setdefault(str(variant), {})[str(method)] = {
            **{column: float(own[column].mean()) for column in ("rmse_xyz_m", *MEASURES)},
            "minus_table_m": float(more.mean()),
            "minus_table_ci95_m": intervals.interval(more.to_numpy(), _draw(more)),
        }
    return numbers


def differences(slam: Mapping[str, Numbers]) -> pd.DataFrame:
    """Return network's mean error less each method's with its 95 % interval, metres; the columns are DIFFERENCES.

    `slam` has the results of `summarise` by survey. A survey without a truth, or without network, gives no rows.
    """
    rows = [row for survey, numbers in slam.items() for row in _differences(survey, numbers)]
    return pd.DataFrame(rows, columns=DIFFERENCES)


def both_ways(slam: Mapping[str, Numbers], authors: Mapping[str, Numbers]) -> pd.DataFrame:
    """Return the mean truth_rmse_xyz_m on the paper's graph as it should be and with the authors' slips, metres.

    `slam` and `authors` have the results of the functions `summarise` and `authors` by survey. There is a row for each
    survey and method that was solved both ways and has a truth: survey, method, table_m, authors_m.
    """
    error = "truth_rmse_xyz_m"
    rows = [
        {"survey": survey, "method": method, "table_m": slam[survey][method][error], "authors_m": values[error]}
        for survey, numbers in authors.items()
        for method, values in _solved(numbers)
        if pd.notna(values[error])
    ]
    return pd.DataFrame(rows, columns=["survey", "method", "table_m", "authors_m"])


def shared_noises(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of the noises that every draw has: the first draw has more of them."""
    return rows[rows["repetition"] <= rows.groupby("draw")["repetition"].max().min()]


def difference(rows: pd.DataFrame, rivals: pd.DataFrame, column: str) -> "pd.Series[float]":
    """Return a column's values less those of rivals under the same draw and noise, where both are known.

    `rows` and `rivals` have one row for each draw and noise, which are the index of the result.
    """
    key = ["draw", "repetition"]
    return (rows.set_index(key)[column] - rivals.set_index(key)[column]).dropna()


def _differences(survey: str, numbers: Numbers) -> Iterator[dict[str, Any]]:
    for measure, names in _OVER_DRAWS.items():
        for method, values in sorted(_solved(numbers)):
            if pd.notna(values.get(f"{names.minus}_m")):
                low, high = values[f"{names.minus}_ci95_m"] or (None, None)
                yield {
                    "survey": survey,
                    "method": method,
                    "measure": measure,
                    "network_m": numbers[OURS][f"{names.mean}_m"],
                    "difference_m": values[f"{names.minus}_m"],
                    "ci_low": low,
                    "ci_high": high,
                }


def _solved(numbers: Numbers) -> list[tuple[str, Numbers]]:
    return [(name, own) for name, own in numbers.items() if isinstance(own, Mapping) and name not in REFERENCES]


def _sizes(test: Test) -> dict[str, Any]:
    return {
        "dead_reckoning_edges": len(test.gt) - 1 if test.track else 0,
        "loop_closures": len(test.loop_closures),
    }


def _errors(rows: pd.DataFrame, survey: str, method: str, settings: Settings) -> dict[str, Any]:
    means = {column: float(rows[column].mean()) for column in ERRORS}  # NaN if all repetitions are
    errors = rows["rmse_xyz_m"].dropna().to_numpy()
    if len(errors) < 2:
        return means
    draws = intervals.resamples(len(errors), intervals.rng(settings.seed, survey, method))
    return {**means, "rmse_xyz_ci95_m": intervals.mean_ci95(errors, draws)}


def _over_draws(solutions: pd.DataFrame, method: str) -> dict[str, Any]:
    rows = shared_noises(solutions)
    own, ours = (rows[rows["method"] == name] for name in (method, OURS))
    if len(own) < 2:  # navigation has one row, because no noise changes it
        return {}
    numbers: dict[str, Any] = {}
    for column, names in _OVER_DRAWS.items():
        solved = own.dropna(subset=[column])
        numbers[f"{names.mean}_m"] = float(solved[column].mean())
        numbers[f"{names.mean}_ci95_m"] = intervals.interval(solved[column].to_numpy(), solved["draw"].to_numpy())
        if method != OURS and len(ours):
            numbers |= _comparison(difference(ours, own, column), names)
    return numbers


def _comparison(less: "pd.Series[float]", names: _Names) -> dict[str, Any]:
    """Return the mean of network's errors less a method's, with its interval and the p-value that it is below zero."""
    values, draw = less.to_numpy(), _draw(less)
    return {
        f"{names.minus}_m": float(less.mean()),
        f"{names.minus}_ci95_m": intervals.interval(values, draw),
        f"{names.test}_p": intervals.p_below(values, draw),
    }


def _draw(values: "pd.Series[float]") -> np.ndarray:
    return values.index.get_level_values("draw").to_numpy()


def _gt_error(trajectories: pd.DataFrame) -> float | None:
    positions: Mapping[Any, np.ndarray] = {
        name: rows.sort_values("submap")[["x_m", "y_m", "z_m"]].to_numpy()
        for name, rows in trajectories.groupby("which")
    }
    return trajectory_error.rmse(positions[GT], positions[TRUTH]) if {GT, TRUTH} <= set(positions) else None
