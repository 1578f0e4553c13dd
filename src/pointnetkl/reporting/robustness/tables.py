"""Tables of SLAM with false loop closures: errors by share, where a search starts, and the loop gate."""

from collections.abc import Iterable
from typing import Any

import pandas as pd

from pointnetkl.reporting.robustness import numbers
from pointnetkl.reporting.robustness.numbers import StressTest
from pointnetkl.reporting.text_table import Block, Numbers, block

_SHORT = {"truth_m": "truth_rmse_xyz_m", "pairs_m": "truth_relative_m", "precision": "precision", "recall": "recall"}


def every(stress: StressTest, datasets: Numbers) -> dict[str, list[Block]]:
    """Return the tables by the stem of their files."""
    return {
        "robustness": [_by_kernel(stress.rows, datasets), _by_start(stress.rows, datasets)],
        "robustness_shares": [_all_cases(stress.rows, datasets)],
        "loop_gate": [_gates(stress.gate, datasets)],
    }


def _by_kernel(rows: pd.DataFrame, datasets: Numbers) -> Block:
    cases = numbers.summarise(numbers.from_standard_starts(rows))
    shares, by = numbers.few_shares(rows["share"]), ["survey", "kernel", "method"]
    cells = []
    for key, group in numbers.groups(cases, by):
        counts = {"runs": int(group["runs"].sum()), "failed": int(group["failed"].sum())}
        cells.append({**_named(by, key, datasets), **_by_share(group, shares), **counts})
    names = [f"{name}_{numbers.percent(share)}" for name in _SHORT for share in shares]
    caption = (
        "Wrong loop closures: error against truth (unaligned, and of joined pairs; median, metres), and true closures"
        " among the accepted (precision) and accepted among the true (recall), by per cent of closures that are to be"
        " false; that is rounded to a whole number of them (false_share in robustness_shares.csv)."
    )
    return block(caption, cells, ["survey", "simulated", "kernel", "method", *names, "runs", "failed"])


def _by_start(rows: pd.DataFrame, datasets: Numbers) -> Block:
    """Return a kernel's results from either start, over all methods, in the repetitions that tried both."""
    shares, by = numbers.few_shares(rows["share"]), ["survey", "kernel", "start"]
    starts = rows.groupby(["survey", "kernel", "method", "share", "repetition"])["start"].transform("nunique")
    cases = numbers.summarise(rows[(starts > 1).astype(bool)], [*by, "share"])
    cells = [{**_named(by, key, datasets), **_by_share(group, shares)} for key, group in numbers.groups(cases, by)]
    names = [f"{name}_{numbers.percent(share)}" for name in ("truth_m", "recall") for share in shares]
    caption = "Where the search starts: from the corrupted poses, or from where the kernel named as start ended."
    return block(caption, cells, ["survey", "simulated", "kernel", "start", *names])


def _all_cases(rows: pd.DataFrame, datasets: Numbers) -> Block:
    cases = numbers.summarise(rows).to_dict("records")
    cells = [{**case, "simulated": datasets[case["survey"]]["simulated"]} for case in cases]
    columns = ["survey", "simulated", *numbers.CASE[1:], *numbers.MEASURES]
    return block("Wrong loop closures, every share and start.", cells, columns)


def _gates(gate: pd.DataFrame, datasets: Numbers) -> Block:
    by = ["survey", "at"]
    cells = [
        {
            **_named(by, key, datasets),
            "tried": len(rows),
            **{name: float(rows[name].mean()) for name in numbers.PAIRS},
            **numbers.precision_recall(rows),
        }
        for key, rows in numbers.groups(gate, by)
    ]
    columns = ["survey", "simulated", "at", "tried", *numbers.PAIRS, "precision", "recall"]
    caption = "The loop gate: pairs joined, pairs that cover enough at the true poses, and both; means."
    return block(caption, cells, columns)


def _named(by: list[str], key: tuple[Any, ...], datasets: Numbers) -> dict[str, Any]:
    """Return a group's key by column; its first is the survey, beside which stands whether it is simulated."""
    return {**dict(zip(by, key, strict=True)), "simulated": datasets[key[0]]["simulated"]}


def _by_share(cases: pd.DataFrame, shares: Iterable[float]) -> dict[str, float | None]:
    by_share = cases.set_index("share")
    return {
        f"{short}_{numbers.percent(share)}": float(by_share.at[share, name]) if share in by_share.index else None
        for short, name in _SHORT.items()
        for share in shares
    }
