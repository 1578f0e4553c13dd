"""What robust estimators make of wrong loop closures: numbers and tables of a report."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from pointnetkl.reporting.results import Folders
from pointnetkl.reporting.text_table import Block, block
from pointnetkl.workflow import artifacts

Numbers = Mapping[str, Any]
ERRORS = ("truth_rmse_xyz_m", "truth_relative_m", "rmse_xyz_m")
_COUNTS = ("true_closures", "false_closures")
_ACCEPTED = ("accepted_true", "accepted_false")
ROWS = pa.schema(
    [
        *((name, pa.string()) for name in ("survey", "kernel", "start", "method")),
        ("share", pa.float64()),
        ("repetition", pa.int32()),
        *((name, pa.int32()) for name in _COUNTS),
        *((name, pa.float64()) for name in (*ERRORS, *_ACCEPTED)),
        ("failed", pa.bool_()),
    ]
)
_PAIRS = ("joined", "covering", "both")
GATE = pa.schema([("survey", pa.string()), ("at", pa.string()), *((name, pa.float64()) for name in _PAIRS)])
PLAIN = "plain"  # the kernel that is none
CORRUPTED = "corrupted"  # a start; only kernels that have no other are judged by it
_MEASURES = ("false_share", *ERRORS, "precision", "recall", "runs", "failed")
_CELLS = ["survey", "kernel", "start", "method", "share"]


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


def summarised(rows: pd.DataFrame, by: Iterable[str] = _CELLS) -> pd.DataFrame:
    """Return one row per survey, kernel, start, method and share: medians of the errors, and the estimator as a gate.

    `false_share` is the share itself, of whole closures, where `share` is what was asked for. Medians are over the runs
    that did not fail; precision and recall are of all their closures together, those with a weight above a half being
    accepted. What nobody accepted has no precision.
    """
    found = [dict(zip(by, key, strict=True)) | _summary(of) for key, of in _groups(rows, list(by))]
    return pd.DataFrame(found, columns=[*by, *_MEASURES])


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
    for (survey, kernel, method), of in _groups(cells, ["survey", "kernel", "method"]):
        few = of[of["share"].isin(shown(cells["share"]))]
        errors = {ERRORS[0]: dict(zip(map(percent, few["share"]), few[ERRORS[0]].tolist(), strict=True))}
        last = of.iloc[-1]
        gate = {name: None if pd.isna(last[name]) else float(last[name]) for name in ("precision", "recall")}
        made.setdefault(survey, {}).setdefault(kernel, {})[method] = {**errors, **gate}
    own = found.gate[found.gate["at"] == "graph"]
    return {"robustness": made, "loop_gate": {name: _gate(of) for (name,), of in _groups(own, ["survey"])}}


def tables(found: Found, datasets: Numbers) -> dict[str, list[Block]]:
    """Return the tables by the stems of their files."""
    return {
        "robustness": [_wide(found.rows, datasets), _starts(found.rows, datasets)],
        "robustness_shares": [_long(found.rows, datasets)],
        "loop_gate": [_gates(found.gate, datasets)],
    }


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


def _gate(of: pd.DataFrame) -> dict[str, float | None]:
    joined, covering, both = (float(of[name].sum(min_count=len(of))) for name in _PAIRS)
    return {
        "precision": both / joined if joined and np.isfinite(both) else None,
        "recall": both / covering if covering and np.isfinite(both) else None,
    }


def _wide(rows: pd.DataFrame, datasets: Numbers) -> Block:
    cells = summarised(judged(rows))
    shares = shown(rows["share"])
    made = []
    for (survey, kernel, method), of in _groups(cells, ["survey", "kernel", "method"]):
        who = {"survey": survey, "simulated": datasets[survey]["simulated"], "kernel": kernel, "method": method}
        made.append({**who, **_by_share(of, shares), "runs": int(of["runs"].sum()), "failed": int(of["failed"].sum())})
    names = [f"{name}_{percent(share)}" for name in _SHORT for share in shares]
    caption = (
        "Wrong loop closures: error against truth (unaligned, and of joined pairs; median, metres), and true closures"
        " among the accepted (precision) and accepted among the true (recall), by per cent of closures that are to be"
        " false; that is rounded to a whole number of them (false_share in robustness_shares.csv)."
    )
    return block(caption, made, ["survey", "simulated", "kernel", "method", *names, "runs", "failed"])


_SHORT = {"truth_m": "truth_rmse_xyz_m", "pairs_m": "truth_relative_m", "precision": "precision", "recall": "recall"}


def _by_share(cells: pd.DataFrame, shares: Iterable[float]) -> dict[str, float | None]:
    at = cells.set_index("share")
    return {
        f"{short}_{percent(share)}": float(at.at[share, name]) if share in at.index else None
        for short, name in _SHORT.items()
        for share in shares
    }


def _starts(rows: pd.DataFrame, datasets: Numbers) -> Block:
    """Return what a kernel finds from either start, over all methods, in the repetitions that tried both."""
    shares, by = shown(rows["share"]), ["survey", "kernel", "start", "share"]
    tried = rows.groupby([*by[:2], "method", "share", "repetition"])["start"].transform("nunique") > 1
    made = []
    for (survey, kernel, start), of in _groups(summarised(rows[tried.astype(bool)], by), by[:3]):
        who = {"survey": survey, "simulated": datasets[survey]["simulated"], "kernel": kernel, "start": start}
        made.append({**who, **_by_share(of, shares)})
    names = [f"{name}_{percent(share)}" for name in ("truth_m", "recall") for share in shares]
    caption = "Where the search starts: from the corrupted poses, or from where the kernel named as start ended."
    return block(caption, made, ["survey", "simulated", "kernel", "start", *names])


def _long(rows: pd.DataFrame, datasets: Numbers) -> Block:
    columns = [*_CELLS, *_MEASURES]
    made = [{**row, "simulated": datasets[row["survey"]]["simulated"]} for row in summarised(rows).to_dict("records")]
    return block("Wrong loop closures, every share and start.", made, ["survey", "simulated", *columns[1:]])


def _gates(gate: pd.DataFrame, datasets: Numbers) -> Block:
    made = [
        {
            "survey": survey,
            "simulated": datasets[survey]["simulated"],
            "at": at,
            "tried": len(of),
            **{name: float(of[name].mean()) for name in _PAIRS},
            **_gate(of),
        }
        for (survey, at), of in _groups(gate, ["survey", "at"])
    ]
    columns = ["survey", "simulated", "at", "tried", *_PAIRS, "precision", "recall"]
    caption = "The loop gate: pairs joined, pairs that cover enough at the true poses, and both; means."
    return block(caption, made, columns)


def _groups(rows: pd.DataFrame, by: list[str]) -> Iterator[tuple[tuple[Any, ...], pd.DataFrame]]:
    for key, of in rows.groupby(by, sort=False):
        yield key if isinstance(key, tuple) else (key,), of
