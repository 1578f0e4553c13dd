"""The numbers of the SLAM benchmark: the paper's table of one graph, and statistics over draws of its loop closures."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd

from pointnetkl.reporting import intervals
from pointnetkl.reporting.results import OURS, Settings, Test
from pointnetkl.slam.benchmark.tables import AUTHORS, RMSES, TABLE
from pointnetkl.slam.graph import trajectory_error

ERRORS = (  # of one solution; the other measures are over draws
    *(f"{against}{name}" for against in ("", "truth_") for name in RMSES),
    *("map_to_map_m", "map_to_map_auvlib_m", "pose_nees"),
)
NOT_SOLVED = ("navigation", "corrupted", "gt")  # trajectories that no method's covariances made
# Measured over draws, and how their numbers are called: {} stands in a name of the measure's mean, or of a comparison
_OVER_DRAWS = {
    "truth_rmse_xyz_m": ("draws_truth_rmse_xyz", "network_minus", "network"),
    "truth_rmse_se2_m": ("draws_truth_rmse_se2", "network_minus_se2", "network_se2"),
    "truth_relative_m": ("truth_relative", "network_minus_relative", "network_relative"),
}
MEASURES = tuple(_OVER_DRAWS)
DIFFERENCES = ["survey", "method", "measure", "network_m", "difference_m", "ci_low", "ci_high"]


def summarise(name: str, test: Test, settings: Settings) -> dict[str, Any]:
    """Return the graph's size and each method's errors, NaN or None where nothing is known.

    Plain names are means over the noises on the first draw, as in the paper, with a bootstrap interval over noises;
    draws_*, truth_relative_* and network_* are over draws and the noises that all have, with draws as clusters.
    """
    every = test.slam[test.slam["variant"] == TABLE]
    methods = {
        str(method): {
            **_errors(rows[rows["draw"] == 0], name, str(method), settings),
            **_over_draws(every, str(method)),
        }
        for method, rows in every.groupby("method", sort=False)
    }
    return {**_sizes(test), **methods, "gt": {"truth_rmse_xyz_m": _gt_error(test.trajectories)}}


def authors(name: str, test: Test, settings: Settings) -> dict[str, Any]:
    """Return the same of the paper's graph as the authors' program, with its two slips, would have it."""
    own = (test.slam["variant"] == AUTHORS) | test.slam["method"].isin(["navigation", "corrupted"])
    rows = test.slam[own & (test.slam["draw"] == 0)]
    sizes = _sizes(test)
    sizes["loop_closures"] = max(0, sizes["loop_closures"] - 1)
    methods = rows.groupby("method", sort=False)
    return {**sizes, **{str(m): _errors(of, f"{name}, {AUTHORS}", str(m), settings) for m, of in methods}}


def variants(test: Test) -> dict[str, dict[str, Any]]:
    """Return, by variant and method, mean errors over draws, and how far they are from the table's (paired)."""
    few = test.slam[test.slam["variant"] != TABLE]["method"].unique()
    rows = shared_noises(test.slam[test.slam["method"].isin(few)])
    found: dict[str, dict[str, Any]] = {}
    for (variant, method), of in rows.groupby(["variant", "method"], sort=False):
        means = {column: float(of[column].mean()) for column in ("rmse_xyz_m", *_OVER_DRAWS)}
        rival = rows[(rows["variant"] == TABLE) & (rows["method"] == method)]
        more = difference(of, rival, "truth_rmse_xyz_m")
        found.setdefault(str(variant), {})[str(method)] = {
            **means,
            "minus_table_m": float(more.mean()),
            "minus_table_ci95_m": intervals.interval(more.to_numpy(), _draw(more)),
        }
    return found


def differences(slam: Mapping[str, Mapping[str, Any]]) -> pd.DataFrame:
    """Return network's mean error less each method's, with its 95 % interval, metres: columns DIFFERENCES.

    `slam` has the results of `summarise` by survey. A survey without a truth, or without network, gives no rows.
    """
    rows = [row for survey, numbers in slam.items() for row in _differences(survey, numbers)]
    return pd.DataFrame(rows, columns=DIFFERENCES)


def both_ways(slam: Mapping[str, Any], authors: Mapping[str, Any]) -> pd.DataFrame:
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


def _differences(survey: str, numbers: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    for measure, (mean, minus, _) in _OVER_DRAWS.items():
        for method, values in sorted(_solved(numbers)):
            if pd.notna(values.get(f"{minus}_m")):
                low, high = values[f"{minus}_ci95_m"] or (None, None)
                yield {
                    "survey": survey,
                    "method": method,
                    "measure": measure,
                    "network_m": numbers[OURS][f"{mean}_m"],
                    "difference_m": values[f"{minus}_m"],
                    "ci_low": low,
                    "ci_high": high,
                }


def _solved(numbers: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any]]]:
    return [(name, each) for name, each in numbers.items() if isinstance(each, Mapping) and name not in NOT_SOLVED]


def _sizes(test: Test) -> dict[str, Any]:
    return {
        "dead_reckoning_edges": len(test.gt) - 1 if test.track else 0,
        "loop_closures": len(test.loop_closures),
    }


def _errors(rows: pd.DataFrame, name: str, method: str, settings: Settings) -> dict[str, Any]:
    means = {column: float(rows[column].mean()) for column in ERRORS}  # NaN where every repetition is
    solved = rows["rmse_xyz_m"].dropna().to_numpy()
    if len(solved) < 2:
        return means
    draws = intervals.resamples(len(solved), intervals.rng(settings.seed, name, method))
    return {**means, "rmse_xyz_ci95_m": intervals.mean_ci95(solved, draws)}


def _over_draws(every: pd.DataFrame, method: str) -> dict[str, Any]:
    rows = shared_noises(every)
    of, ours = (rows[rows["method"] == each] for each in (method, OURS))
    if len(of) < 2:  # navigation, which no noise touches
        return {}
    found: dict[str, Any] = {}
    for column, (mean, minus, test) in _OVER_DRAWS.items():
        known = of.dropna(subset=[column])
        found[f"{mean}_m"] = float(known[column].mean())
        found[f"{mean}_ci95_m"] = intervals.interval(known[column].to_numpy(), known["draw"].to_numpy())
        if method != OURS and len(ours):
            found |= _against(difference(ours, of, column), minus, test)
    return found


def _against(less: "pd.Series[float]", minus: str, test: str) -> dict[str, Any]:
    values, draw = less.to_numpy(), _draw(less)
    return {
        f"{minus}_m": float(less.mean()),
        f"{minus}_ci95_m": intervals.interval(values, draw),
        f"{test}_p": intervals.p_below(values, draw),
    }


def shared_noises(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of the noises that every draw has: the first has more of them."""
    return rows[rows["repetition"] <= rows.groupby("draw")["repetition"].max().min()]


def difference(rows: pd.DataFrame, rivals: pd.DataFrame, column: str) -> "pd.Series[float]":
    """Return a column's values less those of rivals under the same draw and noise, where both are known.

    Both have one row for a draw and noise, which index what is returned.
    """
    key = ["draw", "repetition"]
    return (rows.set_index(key)[column] - rivals.set_index(key)[column]).dropna()


def _draw(values: "pd.Series[float]") -> np.ndarray:
    return values.index.get_level_values("draw").to_numpy()


def _gt_error(trajectories: pd.DataFrame) -> float | None:
    found: Mapping[Any, np.ndarray] = {
        which: rows.sort_values("submap")[["x_m", "y_m", "z_m"]].to_numpy()
        for which, rows in trajectories.groupby("which")
    }
    return trajectory_error.rmse(found["gt"], found["truth"]) if {"gt", "truth"} <= set(found) else None
