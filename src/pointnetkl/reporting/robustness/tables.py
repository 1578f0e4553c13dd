"""Tables of SLAM with false loop closures: errors by share, where a search starts, and the loop gate."""

from collections.abc import Iterable

import pandas as pd

from pointnetkl.reporting.robustness import numbers as robustness
from pointnetkl.reporting.text_table import Block, Numbers, block

_SHORT = {"truth_m": "truth_rmse_xyz_m", "pairs_m": "truth_relative_m", "precision": "precision", "recall": "recall"}


def tables(found: robustness.Found, datasets: Numbers) -> dict[str, list[Block]]:
    """Return the tables by the stems of their files."""
    return {
        "robustness": [_wide(found.rows, datasets), _starts(found.rows, datasets)],
        "robustness_shares": [_long(found.rows, datasets)],
        "loop_gate": [_gates(found.gate, datasets)],
    }


def _wide(rows: pd.DataFrame, datasets: Numbers) -> Block:
    cells = robustness.summarised(robustness.judged(rows))
    shares = robustness.shown(rows["share"])
    made = []
    for (survey, kernel, method), of in robustness.groups(cells, ["survey", "kernel", "method"]):
        who = {"survey": survey, "simulated": datasets[survey]["simulated"], "kernel": kernel, "method": method}
        made.append({**who, **_by_share(of, shares), "runs": int(of["runs"].sum()), "failed": int(of["failed"].sum())})
    names = [f"{name}_{robustness.percent(share)}" for name in _SHORT for share in shares]
    caption = (
        "Wrong loop closures: error against truth (unaligned, and of joined pairs; median, metres), and true closures"
        " among the accepted (precision) and accepted among the true (recall), by per cent of closures that are to be"
        " false; that is rounded to a whole number of them (false_share in robustness_shares.csv)."
    )
    return block(caption, made, ["survey", "simulated", "kernel", "method", *names, "runs", "failed"])


def _by_share(cells: pd.DataFrame, shares: Iterable[float]) -> dict[str, float | None]:
    at = cells.set_index("share")
    return {
        f"{short}_{robustness.percent(share)}": float(at.at[share, name]) if share in at.index else None
        for short, name in _SHORT.items()
        for share in shares
    }


def _starts(rows: pd.DataFrame, datasets: Numbers) -> Block:
    """Return what a kernel finds from either start, over all methods, in the repetitions that tried both."""
    shares, by = robustness.shown(rows["share"]), ["survey", "kernel", "start", "share"]
    tried = rows.groupby([*by[:2], "method", "share", "repetition"])["start"].transform("nunique") > 1
    made = []
    for (survey, kernel, start), of in robustness.groups(robustness.summarised(rows[tried.astype(bool)], by), by[:3]):
        who = {"survey": survey, "simulated": datasets[survey]["simulated"], "kernel": kernel, "start": start}
        made.append({**who, **_by_share(of, shares)})
    names = [f"{name}_{robustness.percent(share)}" for name in ("truth_m", "recall") for share in shares]
    caption = "Where the search starts: from the corrupted poses, or from where the kernel named as start ended."
    return block(caption, made, ["survey", "simulated", "kernel", "start", *names])


def _long(rows: pd.DataFrame, datasets: Numbers) -> Block:
    columns = [*robustness.CELLS, *robustness.MEASURES]
    made = [
        {**row, "simulated": datasets[row["survey"]]["simulated"]}
        for row in robustness.summarised(rows).to_dict("records")
    ]
    return block("Wrong loop closures, every share and start.", made, ["survey", "simulated", *columns[1:]])


def _gates(gate: pd.DataFrame, datasets: Numbers) -> Block:
    made = [
        {
            "survey": survey,
            "simulated": datasets[survey]["simulated"],
            "at": at,
            "tried": len(of),
            **{name: float(of[name].mean()) for name in robustness.PAIRS},
            **robustness.gate(of),
        }
        for (survey, at), of in robustness.groups(gate, ["survey", "at"])
    ]
    columns = ["survey", "simulated", "at", "tried", *robustness.PAIRS, "precision", "recall"]
    caption = "The loop gate: pairs joined, pairs that cover enough at the true poses, and both; means."
    return block(caption, made, columns)
