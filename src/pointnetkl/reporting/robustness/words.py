"""The page's section on false loop closures, and on what to use against them."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from pointnetkl.reporting.page import Section
from pointnetkl.reporting.text_table import Blocks, cell
from pointnetkl.slam.robust.schemas import CORRUPTED, PLAIN

_TOLERABLE = 1.5  # times the error without false closures; a kernel that stays below it withstands them


def section(shown: Blocks) -> Section:
    """Return the section around the tables of robustness, which `shown` has by the stems of their files."""
    by_kernel, by_start = (block.frame for block in shown["robustness"])
    return Section(
        "Wrong loop closures",
        (
            "A false closure stands for a place recognised by mistake. It joins two submaps that do not overlap at the"
            " true poses, with the x, y of a true closure and, like all closures here, z, roll, pitch and yaw of GT."
            " Shares are per cent of all closures. A false closure carries the Q of its source, as a true one does."
            " Every kernel and method gets the same false closures, and those of a lower share are among those of a"
            " higher.",
            _advice(by_kernel),
            "Kernels (plain is the optimiser without one) judge the length of a closure's whitened residual. With"
            " stress.thresholds as they come, a weight is a half at a length of 1.0 (Cauchy), 1.35 (DCS) and 2.69"
            " (Huber), and GNC rejects closures beyond 4.1. At a solution true closures have shorter residuals than"
            " their own errors suggest, because dead reckoning, which may err by metres in x and y"
            " (graph.dead_reckoning), gives way to them. So a Q that is too small need not reject them; what it does"
            " is in the recall without false closures."
            f"{_recalls(by_kernel)}",
            "The pull of Huber's kernel never fades, so it cannot reject an error of hundreds of metres.",
            "It also matters where the search starts. At the corrupted poses true closures look as wrong as false ones:"
            " a kernel that rejects what looks wrong may reject both, and GNC's first problem, which trusts all"
            " closures, may end far off. So all runs follow one rule. Cauchy, whose pull fades but never ends, starts"
            " from the corrupted poses, and so does plain; each other kernel starts where Cauchy ended. From there GNC"
            f" at first trusts only what its threshold lets pass. {_starts(by_start)}",
            "The last table is the loop gate itself (graph.coverage), which joins pairs by the poses that it has."
            " precision is the share of joined pairs that cover enough at the true poses, and recall the share of such"
            " pairs that were joined. graph: the gate in Algorithm 1, which works on GT; navigation, corrupted: the"
            " gate on those poses instead.",
        ),
        [*shown["robustness"], *shown["loop_gate"]],
        {
            "robustness": "Error against the share of false closures: median over repetitions, log scale.",
            "robustness_gate": "Each estimator as a gate: it accepts closures with a weight above a half. Lines: mean"
            " over methods; bands: their span.",
        },
        (
            "These false closures err by the distance between two places, which is easy to see. A closure that errs by"
            " a few metres, as on ground that repeats itself, is among the true ones here: their own errors have heavy"
            " tails.",
            "Dead reckoning's x and y are exact here, as in the paper's protocol, and only its yaw has noise. So the"
            " kernels check closures against better dead reckoning than a vehicle has.",
        ),
    )


def _advice(by_kernel: pd.DataFrame) -> str:
    """Return which kernels withstand the largest share.

    A kernel that failed in any run, or has no number for some method, does not count as one of them.
    """
    columns = _errors(by_kernel)
    rows = by_kernel[by_kernel["survey"].isin(_with_truth(by_kernel))]
    if len(columns) < 2 or rows.empty:
        return "No survey here has both loop closures and a known truth, so nothing can be said of the errors."
    worst = _worst(rows, columns)
    failed = rows.groupby("kernel", sort=False)["failed"].sum()
    ratios = ", ".join(f"{kernel} {cell(ratio, 3)}{_failures(failed[kernel])}" for kernel, ratio in worst.items())
    robust = [kernel for kernel, ratio in worst.items() if ratio < _TOLERABLE and not failed[kernel]]
    advice = f"Use {' or '.join(robust)}" if robust else "No kernel withstands them"
    return (
        f"{advice}: with {_share(columns[-1])} % false closures the error is at most so many times that of the plain"
        f" optimiser without any, over surveys and methods: {ratios}."
    )


def _errors(table: pd.DataFrame) -> list[str]:
    return [name for name in table.columns if name.startswith("truth_m_")]


def _share(column: str) -> str:
    return column.rsplit("_", 1)[1]


def _with_truth(table: pd.DataFrame) -> list[str]:
    """Return the surveys with an error against the truth in any run."""
    surveys = table.loc[table[_errors(table)].notna().any(axis=1), "survey"]
    return [str(survey) for survey in surveys.unique()]


def _worst(rows: pd.DataFrame, columns: Sequence[str]) -> dict[str, float]:
    """Return by kernel the largest ratio of the last column's error to the plain kernel's in the first column.

    The ratio is NaN if any error is missing.
    """
    plain = rows[rows["kernel"] == PLAIN].set_index(["survey", "method"])[columns[0]].astype(float)
    without_false = np.array([plain[key] for key in zip(rows["survey"], rows["method"], strict=True)])
    ratios = rows[columns[-1]].astype(float) / without_false
    return {str(kernel): float(own.max(skipna=False)) for kernel, own in ratios.groupby(rows["kernel"], sort=False)}


def _failures(count: int) -> str:
    return f" ({count} failed)" if count else ""


def _recalls(by_kernel: pd.DataFrame) -> str:
    columns = [name for name in by_kernel.columns if name.startswith("recall_")]
    rows = by_kernel[by_kernel[columns[0]].notna()] if columns else by_kernel.iloc[:0]
    least = rows.groupby("kernel", sort=False)[columns[0]].min() if len(rows) else {}
    recalls = ", ".join(f"{kernel} {cell(float(recall), 3)}" for kernel, recall in least.items())
    return f" The least here, over surveys and methods: {recalls}." if recalls else ""


def _starts(by_start: pd.DataFrame) -> str:
    """Return by how much worse a kernel ends that starts from the corrupted poses, with the largest share."""
    columns = _errors(by_start)
    if not columns or by_start.empty:
        return ""
    errors = by_start.pivot(index=["survey", "kernel"], columns="start", values=columns[-1]).astype(float)
    settled = errors.drop(columns=CORRUPTED, errors="ignore")
    if settled.empty or CORRUPTED not in errors:
        return ""
    worst = (errors[CORRUPTED] / settled.max(axis=1)).dropna().groupby("kernel", sort=False).max()
    ratios = ", ".join(f"{kernel} {cell(float(ratio), 3)}" for kernel, ratio in worst.items())
    if not ratios:
        return ""
    return (
        f"From the corrupted poses instead, with {_share(columns[-1])} % false closures, the error is at most so many"
        f" times that (second table): {ratios}."
    )
