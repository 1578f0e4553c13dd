"""The page's words on covariances: divergence, calibration, terrain classes, run time, and what simulation shows."""

from collections.abc import Mapping

import pandas as pd

from pointnetkl.registration.covariance import catalogue
from pointnetkl.reporting import intervals
from pointnetkl.reporting.covariances.tables import UNSEEN
from pointnetkl.reporting.page import Measured, Section
from pointnetkl.reporting.text_table import Blocks, Numbers
from pointnetkl.workflow import machine

# Methods whose worst submaps the page shows, where it has them
_WORST_OF = (catalogue.NETWORK, catalogue.POINTNETKL, catalogue.STRUCTURE_TENSOR)


def divergence(shown: Blocks, copies: Mapping[str, str]) -> Section:
    """Return the section of Table II; `copies` are the surveys' label.copy."""
    return Section(
        "Divergence from the labels",
        (
            "KL(label || Q), nats: 0 is the label itself. The floor report.kl_floor_m2 is added to label and Q, because"
            " otherwise one wrong tiny label would decide the mean; mean_floor0 is without it. constant is the mean of"
            " the test survey's own labels (a posteriori, as in the paper); constant_train that of the training labels,"
            f" which a vehicle could have. {copy_words(copies)}",
            "Table II is at that floor: a method that was fitted or trained at another (floor_m2) has a dash. Intervals"
            " are a bootstrap over submaps, in blocks of report.block_submaps along the track, because neighbours"
            " overlap. network_better is the share of its draws in which network has the lower mean: 1 is sure, 0.5 a"
            " tie."
            " axis_error_deg is the mean angle between the major axes of label and Q, weighted by the anisotropy"
            " (a - b) / (a + b) of the label's eigenvalues, with the floor. A guess would be off by 45.",
        ),
        shown["table_2"],
        {
            "kl": "Mean KL(label || Q) by method, the best on top, with its 95 % interval. Left is better; log scale.",
            "submaps": "Submaps from the largest label to the smallest, seen from above with the track upward: seabed,"
            " and to scale the 95 % ellipses of the label and of a few methods, with their KL. beyond: larger than the"
            " frame. reports/figures/worst has the ten submaps on which each method is worst.",
            **{f"worst/{name}": f"The ten submaps on which {name} is worst." for name in _WORST_OF},
        },
        (
            "Adjacent lines share terrain too, and a survey is one sample of it, so the true intervals are wider.",
            "Where most labels are below the floor, any small Q is as good: read mean_floor0 and the calibration too.",
        ),
    )


def calibration(shown: Blocks) -> Section:
    """Return the section of NEES and coverage."""
    return Section(
        "Calibration",
        (
            "Does Q describe errors that no label has seen? nees is the mean of eᵀ Q⁻¹ e / M, M its size: 1 is right,"
            " above 1 is overconfident. coverage_95 is the share of errors inside the ellipse that should hold"
            " 95 %, and mc_coverage_95 that inside monte_carlo's own, on the same errors.",
        ),
        shown["calibration"],
        {
            "calibration": "Normalised NEES (shaded: 0.85 to 1.15; a number: beyond the axis) and coverage of the 95 %"
            " ellipses. Dotted: 95 %. Dashed: monte_carlo's own, which errors with heavy tails allow.",
            "reliability": "Share of errors inside the ellipse that should hold so many. Below the diagonal Q is"
            " overconfident. monte_carlo, the labels themselves, shows how good a Gaussian can be.",
        },
        (
            "Errors have heavy tails, so even exact second moments (monte_carlo) may cover less than they should."
            " These errors are of the labels' own kind of registration, submap against copy, not of loop closures.",
            "The calibrated closed forms have no floor of their own: on rugged ground their variance goes to zero,"
            " which NEES, and KL without a floor, show.",
        ),
    )


def classes(shown: Blocks) -> Section:
    """Return the section of the measures by terrain class, size of label and copy."""
    terrain = shown["terrain"][0].frame
    return Section(
        "By terrain, by size of the label, by copy",
        (
            "Means over a survey hide which ground they come from. A simulated submap is named after the feature of its"
            " terrain that gives it the most slope; where that is no special feature, or nobody knows what made the"
            " ground (real grids, measured surveys: their slopes are taken from the points), it is flat, smooth or"
            " rugged by its rms slope (report.terrain_classes). Such a class says how steep the ground is, not that"
            " training has seen ground like it. relief is the flank between a basin and a plateau.",
            "A feature that has a significant slope in no training submap names every submap in which it has one,"
            f" whatever other features are there. {unseen(terrain)}",
            "A row of few submaps is rough, so look at their number first. by_class.csv has every measure, with"
            f" intervals where a row has {intervals.FEWEST} submaps or more. monte_carlo among the copies is the label"
            " itself: what it is off by is the sampling error of fewer runs, and what the other copy changes.",
        ),
        shown["terrain"],
        notes=(
            "On flat ground a label is wide, and any Q near the prior is right. On rugged ground it is below the floor,"
            " and any small Q is right. Methods differ on the ground between, and in telling flat from rugged.",
        ),
    )


def limits(copies: Mapping[str, str], datasets: Mapping[str, Mapping[str, object]]) -> Section:
    """Return the section on circularity; `copies` are the surveys' label.copy."""
    return Section(
        "What simulation can and cannot show",
        (
            f"{_simulated(datasets)} Drawn terrain comes from this program's own generator, training and test surveys"
            " from other seeds and settings of it. A method that does well has learned how that generator's slopes"
            " affect our registration. That real seabed is as patchy, and as steep at each length, is an assumption.",
            "A survey over a real grid has real shapes, but simulated pings: noise, drop-outs and attitude are a model"
            " of a sonar. It has no detail smaller than a grid's cell (5 m, say): no boulder, ripple or edge of rock."
            " Below a cell's size the ground is smooth, or has a stated roughness that is made up (grid_roughness_m).",
            "No test survey was trained on, but the default's were looked at while network was made: docs/network.md"
            " says which of its numbers were chosen with their results in sight.",
            "Labels come from our own registration, GICP constrained to the plane, and so do the held-out errors of the"
            " calibration: both are of a submap against a noisy copy of itself. They show how well a method knows this"
            " registration's error, not the error of a vehicle's navigation. Only the sections on loop closures and"
            " SLAM use other passes over the same ground.",
            f"{copy_words(copies)} With copy same S_j has the same points as S_i, as in the paper; this flatters,"
            " most where points are far apart. With copy split they share no point. The tables by copy, above, judge"
            " the same Q against both on a few submaps; the column monte_carlo there is how far the label itself is"
            " off.",
            "Simulation can show whether a method tells flat from rugged and finds the axis, on ground that it was not"
            " trained on and of kinds that it has not seen; how methods rank on the same question; what each costs. It"
            " cannot show the number that a real survey will get. The paper's KL of its network on its own"
            " data stands beside ours for scale, not as a contest.",
        ),
    )


def time(shown: Blocks, runtime: Numbers) -> Section:
    """Return the section of Table III; `runtime` is what stage time measured."""
    again = "On another machine, measure it there: `dvc repro --force --single-item time && dvc repro report`."
    return Section(
        "Run time",
        (
            "Seconds for the covariance of one submap of the paper's size, on one thread, every"
            " preprocessing step included; mean and standard deviation over submaps. times_faster is against"
            " our own Monte Carlo label, of as many registrations as the table's title says (the paper: 3000).",
        ),
        shown["table_3"],
        {
            "accuracy_time": "Divergence against time, log scales. Nothing lies left of and below the dashed line, the"
            " Pareto front. Bars: 95 % intervals."
        },
        (
            "The paper's machine is another one: compare ratios, not seconds. Divergence is judged on this"
            " scale's test submaps, time on submaps of the paper's size.",
        ),
        Measured("Table III", machine.in_words(runtime.get("machine", {})), again),
    )


def unseen(terrain: pd.DataFrame) -> str:
    """Return which rows of the table of classes are of terrain that training does not have."""
    rows = terrain[terrain["training"] == UNSEEN]
    if rows.empty:
        return "Here no submap is of a class that training does not have."
    each = [f"{row.survey}: {row['class']} ({row['submaps']} submaps)" for _, row in rows.iterrows()]
    return f"Rows marked {UNSEEN}: {', '.join(each)}."


def copy_words(copies: Mapping[str, str]) -> str:
    """Return which copy the labels are of, by survey where they differ."""
    if len(set(copies.values())) == 1:
        return f"All labels here are of label.copy {next(iter(copies.values()))}."
    return f"Labels here are of label.copy {', '.join(f'{copy} ({name})' for name, copy in copies.items())}."


def _simulated(datasets: Mapping[str, Mapping[str, object]]) -> str:
    names = [name for name, each in datasets.items() if each["simulated"]]
    if not names:
        return "No survey here is simulated; what follows is of those that the defaults simulate."
    return f"Simulated: {', '.join(names)}."
