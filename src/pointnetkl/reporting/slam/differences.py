"""How far `network`'s solutions of the SLAM benchmark are from each method's, paired by draw and noise."""

from collections.abc import Iterator, Mapping
from typing import Any

import pandas as pd

from pointnetkl.reporting import intervals
from pointnetkl.reporting.results import OURS
from pointnetkl.reporting.slam.numbers import AUTHORS, TABLE, difference, shared_noises

MEASURES = ("truth_rmse_xyz_m", "truth_rmse_se2_m", "truth_relative_m")  # against the truth; see slam.ROWS
COLUMNS = ["survey", "method", "measure", "network_m", "difference_m", "ci_low", "ci_high"]
_NOT_SOLVED = ("navigation", "corrupted")


def differences(rows: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Return network's mean error less each method's by survey and measure, metres, with its 95 % interval (COLUMNS).

    `rows` are slam.ROWS by survey; every draw of the loop closures counts with as many noises, and the interval is
    clustered by draw. A survey without truth, or without network, has no rows.
    """
    found = [row for survey, each in rows.items() for row in _of_survey(survey, each)]
    return pd.DataFrame(found, columns=COLUMNS)


def both_ways(rows: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Return the mean truth_rmse_xyz_m of the paper's graph as it should be and with the authors' slips, metres.

    A row per survey and method that was run both ways and has a truth: survey, method, table_m, authors_m.
    """
    found = []
    for survey, each in rows.items():
        means = each[each["draw"] == 0].groupby(["variant", "method"], sort=False)["truth_rmse_xyz_m"].mean()
        for method in means.get(AUTHORS, pd.Series(dtype=float)).dropna().index:
            both = {f"{variant}_m": float(means[variant, method]) for variant in (TABLE, AUTHORS)}
            found += [] if method in _NOT_SOLVED else [{"survey": survey, "method": str(method), **both}]
    return pd.DataFrame(found, columns=["survey", "method", "table_m", "authors_m"])


def _of_survey(survey: str, rows: pd.DataFrame) -> Iterator[dict[str, Any]]:
    solved = shared_noises(rows[(rows["variant"] == TABLE) & ~rows["method"].isin(_NOT_SOLVED)])
    ours = solved[solved["method"] == OURS]
    for measure in MEASURES:
        for method, of in solved[solved["method"] != OURS].groupby("method"):
            less = difference(ours, of, measure)
            if len(less):
                draw = less.index.get_level_values("draw").to_numpy()
                low, high = intervals.interval(less.to_numpy(), draw) or (None, None)
                yield {
                    "survey": survey,
                    "method": str(method),
                    "measure": measure,
                    "network_m": float(ours[measure].mean()),
                    "difference_m": float(less.mean()),
                    "ci_low": low,
                    "ci_high": high,
                }
