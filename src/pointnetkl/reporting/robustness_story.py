"""The report's words on loop closures that are not true, and on what to use against them."""

from collections.abc import Mapping, Sequence

import pandas as pd

from pointnetkl.reporting import robustness
from pointnetkl.reporting.page import Section
from pointnetkl.text_table import Block, cell

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
            "Kernels (plain is the optimiser without one) judge the whitened residual, so Q decides what looks wrong."
            " Where Q is too small, true closures are thrown out, and false ones that stay pull the harder; where it is"
            " too large they pull less. Huber's weight falls too slowly to let go of an error of hundreds of metres.",
            "Where the search starts matters as much. At the corrupted poses true closures look as wrong as false ones:"
            " DCS lets go of both and stays there, and GNC's first problem, which believes all, may end where nothing"
            " leads back from (second table). Cauchy's pull never ends, and finds its way. So one rule for all: Cauchy"
            " starts from the corrupted poses, each other kernel from where Cauchy ended; GNC then believes at first"
            " only what its threshold lets pass.",
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
    columns = [name for name in table.columns if name.startswith("truth_m_")]
    if len(columns) < 2 or table[columns[-1]].isna().all():
        return "No survey here has both loop closures and a known truth, so nothing can be said of the errors."
    clean = table[table["kernel"] == robustness.PLAIN].set_index(["survey", "method"])[columns[0]].astype(float)
    due = [clean[key] for key in zip(table["survey"], table["method"], strict=True)]
    worst = (table[columns[-1]].astype(float) / due).groupby(table["kernel"], sort=False).max()
    each = ", ".join(f"{kernel} {cell(float(ratio), 3)}" for kernel, ratio in worst.items())
    stand = [str(kernel) for kernel, ratio in worst.items() if ratio < _STANDS]
    share = columns[-1].rsplit("_", 1)[1]
    use = f"Use {' or '.join(stand)}" if stand else "No kernel stands them"
    return (
        f"{use}: with {share} % false closures the error is at most so many times that of the plain optimiser without"
        f" any, over surveys and methods: {each}."
    )
