"""Numbers on surveys closed from their own navigation: errors by method over all drifts, and shares of worse runs."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pointnetkl.registration.covariance import catalogue
from pointnetkl.reporting.robustness.numbers import groups
from pointnetkl.slam.closing.schemas import CLOSURES, ERRORS, POSES, ROWS
from pointnetkl.workflow import artifacts

WORSE = 1.02  # times navigation's error: more is worse
_MEANS, _COUNTS = ("pose_nees", "joined_95", "variance_factor"), ("closures", "accepted", "flat")


@dataclass(frozen=True)
class Closings:
    """Results of stage close on all test surveys."""

    rows: pd.DataFrame  # schema ROWS
    poses: pd.DataFrame  # schema POSES
    closures: pd.DataFrame  # schema CLOSURES


def read(reports: Path, surveys: Iterable[str]) -> Closings:
    """Read the tables of the test surveys, below the folder of reports.

    Raises:
        ArtifactError: a table is missing or damaged.
    """
    names = list(surveys)

    def tables(suffix: str, schema: Any) -> pd.DataFrame:
        paths = [reports / f"closing/{name}{suffix}.parquet" for name in names]
        return pd.concat([artifacts.read_table(path, schema) for path in paths], ignore_index=True)

    return Closings(tables("", ROWS), tables("_closed", POSES), tables("_closures", CLOSURES))


def summarise(rows: pd.DataFrame) -> dict[str, Any]:
    """Return what metrics.json holds under `closing`: by survey and method, with the believed drift after the name.

    Errors are root mean squares over the runs; pose_nees, joined_95, variance_factor and counts are means; `worse`
    counts runs whose error as it is is more than WORSE times that of navigation in the same run. Errors are NaN where
    the truth is not known.
    """
    numbers: dict[str, Any] = {}
    for (survey,), of_survey in groups(rows, ["survey"]):
        navigation = of_survey[of_survey["method"] == catalogue.NAVIGATION].set_index("run")["as_it_is_m"]
        first = of_survey["believed"].iloc[0]
        for (method, believed), runs in groups(of_survey, ["method", "believed"]):
            name = method if believed == first else f"{method}_believed_{believed:g}"
            worse = runs["as_it_is_m"].to_numpy() > WORSE * navigation.loc[runs["run"]].to_numpy()
            numbers.setdefault(survey, {})[name] = {
                **{error: float(np.sqrt(np.mean(runs[error] ** 2))) for error in ERRORS},
                **{name: float(runs[name].mean()) for name in _MEANS},
                "worse": int(worse.sum()) if navigation.notna().all() else None,
                "runs": len(runs),
                **{count: float(runs[count].mean()) for count in _COUNTS},
            }
    return numbers
