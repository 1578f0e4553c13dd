"""What robust estimators make of wrong loop closures: numbers of a report."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from pointnetkl.reporting.results import Folders
from pointnetkl.slam.robust.tables import CORRUPTED, GATE, GRAPH, ROWS
from pointnetkl.workflow import artifacts

ERRORS = ("truth_rmse_xyz_m", "truth_relative_m", "rmse_xyz_m")
_COUNTS = ("true_closures", "false_closures")
_ACCEPTED = ("accepted_true", "accepted_false")
PAIRS = ("joined", "covering", "both")
MEASURES = ("false_share", *ERRORS, "precision", "recall", "runs", "failed")
CELLS = ["survey", "kernel", "start", "method", "share"]


@dataclass(frozen=True)
class Found:
    """What stage stress made of the test surveys."""

    rows: pd.DataFrame  # schema ROWS
    gate: pd.DataFrame  # GATE, a row per gate that was tried


def read(folders: Folders, surveys: Iterable[str]) -> Found:
    """Read every test survey's tables."""
    rows, gates = [ROWS.empty_table().to_pandas()], [GATE.empty_table().to_pandas()]
    for name in surveys:
        rows.append(artifacts.read_table(folders.reports / f"robustness/{name}.parquet", ROWS))
        gates.append(artifacts.read_table(folders.reports / f"robustness/{name}_gate.parquet", GATE))
    return Found(pd.concat(rows[len(rows) > 1 :]), pd.concat(gates[len(gates) > 1 :]))


def summarised(rows: pd.DataFrame, by: Iterable[str] = CELLS) -> pd.DataFrame:
    """Return one row per survey, kernel, start, method and share: medians of the errors, and the estimator as a gate.

    `false_share` is the share itself, of whole closures, where `share` is what was asked for. Medians are over the runs
    that did not fail; precision and recall are of all their closures together, those with a weight above a half being
    accepted. What nobody accepted has no precision.
    """
    found = [dict(zip(by, key, strict=True)) | _summary(of) for key, of in groups(rows, list(by))]
    return pd.DataFrame(found, columns=[*by, *MEASURES])


def judged(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the runs that started as the rule has it: each kernel where the first ended, if it has such runs."""
    settled = set(rows.loc[rows["start"] != CORRUPTED, "kernel"])
    return rows[(rows["start"] != CORRUPTED) | ~rows["kernel"].isin(settled)]


def shown(shares: Iterable[float]) -> list[float]:
    """Return the smallest share, the middle one and the largest, which stand for the others."""
    every = sorted(set(shares))
    return [every[i] for i in sorted({0, len(every) // 2, len(every) - 1})] if every else []


def numbers(found: Found) -> dict[str, Any]:
    """Return what metrics.json has: `robustness`, by survey, kernel and method, and `loop_gate`."""
    made: dict[str, Any] = {}
    cells = summarised(judged(found.rows))
    for (survey, kernel, method), of in groups(cells, ["survey", "kernel", "method"]):
        few = of[of["share"].isin(shown(cells["share"]))]
        errors = {ERRORS[0]: dict(zip(map(percent, few["share"]), few[ERRORS[0]].tolist(), strict=True))}
        last = of.iloc[-1]
        precision = {name: None if pd.isna(last[name]) else float(last[name]) for name in ("precision", "recall")}
        made.setdefault(survey, {}).setdefault(kernel, {})[method] = {**errors, **precision}
    own = found.gate[found.gate["at"] == GRAPH]
    return {"robustness": made, "loop_gate": {name: gate(of) for (name,), of in groups(own, ["survey"])}}


def percent(share: float) -> str:
    """Return a share as per cent, for names."""
    return f"{100 * share:g}"


def _summary(of: pd.DataFrame) -> dict[str, Any]:
    done = of[~of["failed"].astype(bool)]
    true, wrong = (float(done[name].sum()) for name in _ACCEPTED)
    closures = float(done["true_closures"].sum())
    every, false = float(of[list(_COUNTS)].to_numpy().sum()), float(of["false_closures"].sum())
    return {
        "false_share": false / every if every else np.nan,
        **{name: float(done[name].median()) if done[name].notna().any() else np.nan for name in ERRORS},
        "precision": true / (true + wrong) if true + wrong else np.nan,
        "recall": true / closures if closures else np.nan,
        "runs": len(of),
        "failed": len(of) - len(done),
    }


def gate(of: pd.DataFrame) -> dict[str, float | None]:
    joined, covering, both = (float(of[name].sum(min_count=len(of))) for name in PAIRS)
    return {
        "precision": both / joined if joined and np.isfinite(both) else None,
        "recall": both / covering if covering and np.isfinite(both) else None,
    }


def groups(rows: pd.DataFrame, by: list[str]) -> Iterator[tuple[tuple[Any, ...], pd.DataFrame]]:
    for key, of in rows.groupby(by, sort=False):
        yield key if isinstance(key, tuple) else (key,), of
