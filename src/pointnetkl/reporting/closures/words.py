"""The page's words on loop closures: does Q, made from one submap, tell the truth of them, and what follows."""

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from pointnetkl.reporting.closures.numbers import PAIR, SPLIT
from pointnetkl.reporting.page import Section
from pointnetkl.reporting.results import GOLD
from pointnetkl.reporting.text_table import Block, cell

_GOAL = 0.95
_NAMED = {GOLD: "labels", SPLIT: "labels of copy split", PAIR: "Q_ij"}


def section(shown: Mapping[str, Sequence[Block]], copies: Mapping[str, str]) -> Section:
    """Return the section around the tables `calibration_lc`; `copies` is the label.copy of each survey's labels."""
    methods, surveys, holds, _ = (block.frame for block in shown["calibration_lc"])
    return Section(
        "Is the covariance right on real loop closures?",
        (
            "Q_i is made from submap S_i alone, and the graph takes it as the covariance of registering S_i onto the"
            " earlier submaps that it returns to: the paper's central assumption. Here it meets those registrations'"
            " errors, of every draw of the graph, against the truth (against: gt where that is not known). nees and"
            " coverage_95 are as under Calibration; nees_median is the median of eᵀ Q⁻¹ e over that of a chi-squared"
            " variable, which heavy tails leave alone: 1 is right.",
            "A loop closure errs because its registration does, and because the map it is registered to, and the pose"
            " it starts from, are of GT, which errs too. placed_* is of registrations from the same starts with every"
            " submap where it truly lies (where GT has it, if that is not known): only the registration errs."
            " given_m is how far off GT has S_i as seen from its targets: over flat ground nothing"
            " corrects that, and no Q made from terrain can know it. heading_m is the error that GT's yaw alone makes"
            " of it, by its lever to the common ground.",
            "An error is a registration's, the mean of its edges'. The graph takes each edge, which errs by where GT"
            " has that target among the others too: there every Q falls shorter than here. And Q is judged as it was"
            " made, while stage slam adds slam.floor_m2 to it.",
            "split is a label of copy split: two halves of one pass, from alternate pings. pair is Q_ij, from S_i and"
            " its actual targets, where all truly lie, without added noise, because two passes have their own. It is"
            " an oracle, which has seen the truth, and its placed_* are circular: the same registrations from other"
            " starts, that mostly end at the same error. So Q_ij is little more than the square of that error, of which"
            " size and direction tell, and the short axis nothing: ratio is sqrt(tr Q_ij / tr Q_i), worst_ratio that of"
            " the standard deviations in the direction in which Q_i falls shortest. Slopes of S_i that its targets do"
            " not have (outside) count in Q_i all the same. network_overlap is network asked about the points of S_i"
            " that lie over its targets alone.",
            *_shares(surveys),
            *_causes(holds),
            *_coverages(methods),
            *_advice(methods, copies),
            *_widened(methods),
        ),
        shown["calibration_lc"],
        {
            "calibration_lc": "NEES (beyond the axis: at its border) and coverage of the 95 % ellipses, on loop"
            " closures beside what held-out errors of the labels' own kind promise. Dotted: right.",
            "closure_ratios": "Q_ij against Q_i: a dot for each submap that closes a loop.",
            "closure_sigmas": "Errors found against errors predicted, in bins of equally many registrations.",
        },
        (
            "inflation is the factor on Q, added_m2 the variance added to it, with which its 95 % ellipses hold 95 % of"
            " this survey's errors; coverage_95_inflated and _added are of this survey with what the other test"
            " surveys ask for: only where they are near 0.95 does such a correction carry over. placed_inflation"
            " leaves GT's errors out.",
            "Registrations of one submap in several draws, and of neighbours, share ground and map: they count as"
            " many, and tell less. placed_* and Q_ij take the targets of the first draw that registers the submap.",
        ),
    )


def _shares(surveys: pd.DataFrame) -> list[str]:
    told = [
        f"{row.survey} {100 * (row.placed_error_m / row.error_m) ** 2:.0f} %"
        f" ({cell(row.placed_error_m, 2)} m of {cell(row.error_m, 2)} m)"
        for row in surveys.itertuples()
        if row.error_m and row.placed_error_m and row.against == "truth"
    ]
    return [f"Share of the registrations in the loop closures' mean squared error: {', '.join(told)}."] if told else []


def _causes(holds: pd.DataFrame) -> list[str]:
    """Return what errors are of where the ground holds best: there a label claims centimetres."""
    told = [
        f"{row.survey} {cell(row.error_m, 2)} m, of the registration alone {cell(row.placed_error_m, 2)} m,"
        f" of GT's yaw alone {cell(row.heading_m, 2)} m"
        for row in holds.itertuples()
        if row.sigma_of_Q_ij.startswith("below") and row.heading_m is not None
    ]
    return [f"Where Q_ij has a sigma below 0.1 m, the median error is: {'; '.join(told)}."] if told else []


def _coverages(methods: pd.DataFrame) -> list[str]:
    if methods.empty:
        return ["No survey here closes a loop."]
    lines = []
    for survey, rows in methods.groupby("survey", sort=False):
        of = rows.set_index("method")
        told = [
            f"{name} {_percent(of['coverage_95'][method])}{_placed(of.loc[method])}"
            for method, name in _NAMED.items()
            if method in of.index
        ]
        lines.append(f"{survey}: {', '.join(told)}")
    return [f"Inside the ellipse that should hold 95 %: {'; '.join(lines)}."]


def _placed(row: "pd.Series[Any]") -> str:
    """Return the coverage of placed registrations where that says something: from the truth, and not of Q_ij."""
    says = row["against"] == "truth" and row.name != PAIR
    return f" (placed {_percent(row['placed_coverage_95'])})" if says else ""


def _advice(methods: pd.DataFrame, copies: Mapping[str, str]) -> list[str]:
    """Return which copy's labels are nearer to the truth of registrations, by the coverage of the placed ones.

    Where the truth is not known, they were placed where GT has them, which the labels made: that tells nothing.
    """
    methods = methods[methods["against"] == "truth"]
    miss = methods.assign(miss=(methods["placed_coverage_95"].astype(float) - _GOAL).abs())
    table = miss.pivot_table(index="survey", columns="method", values="miss", sort=False)
    same = [survey for survey in table.index if copies.get(survey) == "same"]
    if not same or not {GOLD, SPLIT} <= set(table.columns):
        return []
    better = [survey for survey in same if table.loc[survey, SPLIT] < table.loc[survey, GOLD]]
    if len(better) == len(same):
        told = "on every survey here, those of copy split: take label.copy: split where Q goes into a graph"
    elif better:
        told = f"on {', '.join(better)} those of copy split, elsewhere those of copy same: no default follows"
    else:
        told = "on every survey here, those of copy same: the paper's labels stand"
    return [f"What follows: labels nearer to the truth of registrations are, {told}."]


def _widened(methods: pd.DataFrame) -> list[str]:
    """Return what becomes of the labels' coverage with the factor that other surveys ask for."""
    told = [
        f"{row.survey}, {_NAMED[row.method]}: {_percent(row.coverage_95)} becomes {_percent(row.coverage_95_inflated)}"
        f" (its own factor would be {cell(row.inflation, 2)}{_without_gt(row)})"
        for row in methods.itertuples()
        if row.method in (GOLD, SPLIT) and not pd.isna(row.coverage_95_inflated)
    ]
    return [f"With Q times the factor that the other test surveys ask for: {'; '.join(told)}."] if told else []


def _without_gt(row: Any) -> str:
    return f", {cell(row.placed_inflation, 2)} without GT's errors" if row.against == "truth" else ""


def _percent(share: object) -> str:
    return cell(None) if share is None or pd.isna(share) else f"{100 * float(str(share)):.0f} %"
