"""The report's words on loop closures that are not true, and on what to use against them."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from pointnetkl.reporting.page import Section
from pointnetkl.reporting.text_table import Block, cell
from pointnetkl.slam.robust.tables import CORRUPTED, PLAIN

_STANDS = 1.5  # times the error without false closures: a kernel that stays below stands them


def section(shown: Mapping[str, Sequence[Block]]) -> Section:
    """Return the section around the tables of robustness, by the stems of their files."""
    return Section(
        "Wrong loop closures",
        (
            "A place recognised where there is none: false closures join submaps that do not overlap at the true poses,"
            " with the x, y of a true closure, and z, roll, pitch and yaw of GT as all closures have here. They are"
            " per cent of all closures, and carry the Q of their source as true ones do. Every kernel and method gets"
            " the same ones, and those of a lower share are among those of a higher.",
            f"{_advice(shown['robustness'][0].frame)}",
            "Kernels (plain is the optimiser without one) judge the length of a closure's whitened residual; with"
            " stress.thresholds as they come, a weight is a half at a length of 1.0 (Cauchy), 1.35 (DCS), 2.69 (Huber),"
            " and GNC lets go at 4.1. At a solution true closures are shorter than their own errors would have it: dead"
            " reckoning, allowed metres in x and y (graph.dead_reckoning), gives way to them. So a Q that is too small"
            " need not throw them out; what it does is in the column recall of no false closures."
            f"{_recalls(shown['robustness'][0].frame)}",
            "Huber's pull never fades, so it cannot let go of an error of hundreds of metres.",
            "Where the search starts matters too. At the corrupted poses true closures look as wrong as false ones: a"
            " kernel that lets go of what looks wrong may let go of both, and GNC's first problem, which believes all,"
            " may end far off. So one rule for all: Cauchy, whose pull fades and never ends, starts from the corrupted"
            " poses, as plain does, and each other kernel from where Cauchy ended; GNC then believes at first only what"
            f" its threshold lets pass. {_starts(shown['robustness'][1].frame)}",
            "The last table is the loop gate itself (graph.coverage), which joins pairs by the poses that it has:"
            " precision is how many of them cover enough at the true poses, recall how many that do were joined. graph:"
            " in Algorithm 1, which works on GT; navigation, corrupted: had it worked on those poses instead.",
        ),
        [*shown["robustness"], *shown["loop_gate"]],
        {
            "robustness": "Error against the share of false closures: median over repetitions, log scale.",
            "robustness_gate": "Each estimator as a gate: closures with a weight above a half are accepted. Lines:"
            " mean over methods; bands: their span.",
        },
        (
            "These false closures miss by the distance between two places, which is easy to see. A closure that misses"
            " by a few metres, as on ground that repeats itself, is among the true ones here: their own errors have"
            " heavy tails.",
            "Dead reckoning's x and y are exact here, as in the paper's protocol, and its yaw is not: what a kernel"
            " checks closures against is better than a vehicle's.",
        ),
    )


def _advice(table: pd.DataFrame) -> str:
    """Return which kernels stand the largest share: one that failed anywhere, or has no number, does not."""
    columns = _errors(table)
    known = table[table["survey"].isin(_with_truth(table))]
    if len(columns) < 2 or known.empty:
        return "No survey here has both loop closures and a known truth, so nothing can be said of the errors."
    worst = _worst(known, columns)
    failed = known.groupby("kernel", sort=False)["failed"].sum()
    each = ", ".join(f"{kernel} {cell(ratio, 3)}{_failures(failed[kernel])}" for kernel, ratio in worst.items())
    stand = [kernel for kernel, ratio in worst.items() if ratio < _STANDS and not failed[kernel]]
    share = columns[-1].rsplit("_", 1)[1]
    use = f"Use {' or '.join(stand)}" if stand else "No kernel stands them"
    return (
        f"{use}: with {share} % false closures the error is at most so many times that of the plain optimiser without"
        f" any, over surveys and methods: {each}."
    )


def _errors(table: pd.DataFrame) -> list[str]:
    return [name for name in table.columns if name.startswith("truth_m_")]


def _with_truth(table: pd.DataFrame) -> list[str]:
    """Return the surveys that any run has an error against the truth of."""
    found = table.loc[table[_errors(table)].notna().any(axis=1), "survey"]
    return [str(survey) for survey in found.unique()]


def _worst(known: pd.DataFrame, columns: Sequence[str]) -> dict[str, float]:
    """Return by kernel the largest ratio of the last error to the plain one's first, NaN if any is missing."""
    clean = known[known["kernel"] == PLAIN].set_index(["survey", "method"])[columns[0]].astype(float)
    due = np.array([clean[key] for key in zip(known["survey"], known["method"], strict=True)])
    ratio = known[columns[-1]].astype(float) / due
    return {str(kernel): float(of.max(skipna=False)) for kernel, of in ratio.groupby(known["kernel"], sort=False)}


def _failures(count: int) -> str:
    return f" ({count} failed)" if count else ""


def _recalls(table: pd.DataFrame) -> str:
    columns = [name for name in table.columns if name.startswith("recall_")]
    known = table[table[columns[0]].notna()] if columns else table.iloc[:0]
    least = known.groupby("kernel", sort=False)[columns[0]].min() if len(known) else {}
    each = ", ".join(f"{kernel} {cell(float(recall), 3)}" for kernel, recall in least.items())
    return f" The least here, over surveys and methods: {each}." if each else ""


def _starts(table: pd.DataFrame) -> str:
    """Return by how much worse a kernel ends that starts from the corrupted poses, at the largest share."""
    columns = _errors(table)
    if not columns or table.empty:
        return ""
    wide = table.pivot(index=["survey", "kernel"], columns="start", values=columns[-1]).astype(float)
    settled = wide.drop(columns=CORRUPTED, errors="ignore")
    if settled.empty or CORRUPTED not in wide:
        return ""
    ratio = (wide[CORRUPTED] / settled.max(axis=1)).dropna()
    worst = ratio.groupby("kernel", sort=False).max()
    each = ", ".join(f"{kernel} {cell(float(value), 3)}" for kernel, value in worst.items())
    share = columns[-1].rsplit("_", 1)[1]
    return (
        f"From the corrupted poses instead, with {share} % false closures, the error is at most so many times that"
        f" (second table): {each}."
        if each
        else ""
    )
