"""Numbers on SLAM with false loop closures: what robust estimators make of them, and how precise the loop gate is."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pointnetkl.slam.robust.schemas import CORRUPTED, GATE, GRAPH, ROWS
from pointnetkl.workflow import artifacts

ERRORS = ("truth_rmse_xyz_m", "truth_relative_m", "rmse_xyz_m")
MEASURES = ("false_share", *ERRORS, "precision", "recall", "runs", "failed")
CASE = ["survey", "kernel", "start", "method", "share"]  # columns that tell one case from another
PAIRS = ("joined", "covering", "both")  # counts of pairs of submaps in GATE
_CLOSURES = ["true_closures", "false_closures"]
_ACCEPTED = ("accepted_true", "accepted_false")


@dataclass(frozen=True)
class StressTest:
    """Results of stage stress on all test surveys."""

    rows: pd.DataFrame  # schema ROWS
    gate: pd.DataFrame  # schema GATE, a row for each gate that was tried


def read(reports: Path, surveys: Iterable[str]) -> StressTest:
    """Read the tables of the test surveys, below the folder of reports.

    Raises:
        ArtifactError: a table is missing or damaged.
    """
    rows, gates = [ROWS.empty_table().to_pandas()], [GATE.empty_table().to_pandas()]
    for survey in surveys:
        rows.append(artifacts.read_table(reports / f"robustness/{survey}.parquet", ROWS))
        gates.append(artifacts.read_table(reports / f"robustness/{survey}_gate.parquet", GATE))
    return StressTest(pd.concat(rows[len(rows) > 1 :]), pd.concat(gates[len(gates) > 1 :]))


def summarise(rows: pd.DataFrame, by: Iterable[str] = CASE) -> pd.DataFrame:
    """Return a row for each case, by default per survey, kernel, start, method and share.

    Errors are medians over the runs that did not fail. `false_share` is the share of false closures after rounding to
    whole closures; `share` is what was asked for. precision and recall take all closures of these runs together, and
    a closure is accepted if its weight is above a half. Without accepted closures precision is NaN.
    """
    cases = [dict(zip(by, key, strict=True)) | _summary(runs) for key, runs in groups(rows, list(by))]
    return pd.DataFrame(cases, columns=[*by, *MEASURES])


def from_standard_starts(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the runs from each kernel's standard start: where the first kernel ended, if the kernel has such runs."""
    settled = set(rows.loc[rows["start"] != CORRUPTED, "kernel"])
    return rows[(rows["start"] != CORRUPTED) | ~rows["kernel"].isin(settled)]


def few_shares(shares: Iterable[float]) -> list[float]:
    """Return the smallest, the middle and the largest share, which stand for all in tables."""
    ordered = sorted(set(shares))
    return [ordered[i] for i in sorted({0, len(ordered) // 2, len(ordered) - 1})] if ordered else []


def numbers(stress: StressTest) -> dict[str, Any]:
    """Return what metrics.json holds: `robustness` by survey, kernel and method, and `loop_gate` by survey."""
    robustness: dict[str, Any] = {}
    cases = summarise(from_standard_starts(stress.rows))
    for (survey, kernel, method), rows in groups(cases, ["survey", "kernel", "method"]):
        few = rows[rows["share"].isin(few_shares(cases["share"]))]
        errors = {ERRORS[0]: dict(zip(map(percent, few["share"]), few[ERRORS[0]].tolist(), strict=True))}
        last = rows.iloc[-1]
        accepted = {name: None if pd.isna(last[name]) else float(last[name]) for name in ("precision", "recall")}
        robustness.setdefault(survey, {}).setdefault(kernel, {})[method] = {**errors, **accepted}
    graph = stress.gate[stress.gate["at"] == GRAPH]
    gates = {survey: precision_recall(gate) for (survey,), gate in groups(graph, ["survey"])}
    return {"robustness": robustness, "loop_gate": gates}


def percent(share: float) -> str:
    """Return a share in per cent, for names of columns."""
    return f"{100 * share:g}"


def precision_recall(gate: pd.DataFrame) -> dict[str, float | None]:
    """Return precision and recall of the loop gate over these rows of GATE; None where the truth is not known."""
    joined, covering, both = (float(gate[name].sum(min_count=len(gate))) for name in PAIRS)
    return {
        "precision": both / joined if joined and np.isfinite(both) else None,
        "recall": both / covering if covering and np.isfinite(both) else None,
    }


def groups(rows: pd.DataFrame, by: list[str]) -> Iterator[tuple[tuple[Any, ...], pd.DataFrame]]:
    """Yield the key, always a tuple, and the rows of each group, in the order of the rows."""
    for key, group in rows.groupby(by, sort=False):
        yield key if isinstance(key, tuple) else (key,), group


def _summary(runs: pd.DataFrame) -> dict[str, Any]:
    done = runs[~runs["failed"].astype(bool)]
    accepted_true, accepted_false = (float(done[name].sum()) for name in _ACCEPTED)
    closures = float(done["true_closures"].sum())
    total, false = float(runs[_CLOSURES].to_numpy().sum()), float(runs["false_closures"].sum())
    return {
        "false_share": false / total if total else np.nan,
        **{name: float(done[name].median()) if done[name].notna().any() else np.nan for name in ERRORS},
        "precision": accepted_true / (accepted_true + accepted_false) if accepted_true + accepted_false else np.nan,
        "recall": accepted_true / closures if closures else np.nan,
        "runs": len(runs),
        "failed": len(runs) - len(done),
    }
