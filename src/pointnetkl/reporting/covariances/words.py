"""The report's words on terrain classes, and on what a simulation can show and what it cannot."""

from collections.abc import Mapping, Sequence

import pandas as pd

from pointnetkl.reporting import intervals
from pointnetkl.reporting.covariances.tables import UNSEEN
from pointnetkl.reporting.page import Section
from pointnetkl.reporting.text_table import Block

Blocks = Mapping[str, Sequence[Block]]


def classes(shown: Blocks) -> Section:
    """Return the section around the tables of class_tables, by the stems of their files."""
    terrain = shown["terrain"][0].frame
    return Section(
        "By terrain, by size of the label, by copy",
        (
            "Means over a survey hide what they are of. A simulated submap is named after the feature of its terrain"
            " that gives it the most slope; where that is no special feature, or nobody knows what made the ground"
            " (real grids, measured surveys: their slopes are taken from the points), it is flat, smooth or rugged by"
            " its rms slope (report.terrain_classes): such a class says how steep ground is, not that training has seen"
            " the like. relief: the flank between a basin and a plateau.",
            "A feature that no training submap has as a slope worth holding on to names every submap in which it has"
            f" one, whatever else is there. {unseen(terrain)}",
            "Few submaps make a rough row: look at their number first. by_class.csv has every measure, with intervals"
            f" where a row has {intervals.FEWEST} submaps or more. monte_carlo among the copies is the label itself:"
            " what it is off by is the sampling error of fewer runs, and what the other copy changes.",
        ),
        shown["terrain"],
        notes=(
            "On flat ground a label is wide, and any Q near the prior is right; on rugged ground it is below the floor,"
            " and any small Q is. What tells methods apart is the ground between, and knowing one from the other.",
        ),
    )


def limits(copies: Mapping[str, str], datasets: Mapping[str, Mapping[str, object]]) -> Section:
    """Return the section on circularity; `copies` are the surveys' label.copy."""
    return Section(
        "What simulation can and cannot show",
        (
            f"{_simulated(datasets)} Drawn terrain comes from this program's own generator, training and test surveys"
            " from other seeds and settings of it. A method that does well has learned how that generator's slopes and"
            " our registration go together; that real seabed is as patchy, and as steep at each length, is an"
            " assumption.",
            "A survey over a real grid has real shapes, but simulated pings: noise, drop-outs and attitude are a model"
            " of a sonar. Nothing of the ground below a grid's cell (5 m, say) is in it, no boulder, ripple or edge of"
            " rock: there it is smooth, or has a stated roughness that is made up (grid_roughness_m).",
            "No survey that is tested on was trained on, but the default's three were looked at while network was made:"
            " docs/network.md says which of its numbers were chosen with their results in sight.",
            "Labels come from our own registration, GICP held to the plane, and so do the held-out errors that Q is"
            " calibrated on: both are of a submap against a noisy copy of itself. They say how well a method knows this"
            " registration's error, not how a vehicle's navigation errs. Only the SLAM section meets other passes over"
            " the same ground.",
            f"{copy_words(copies)} With copy same S_j is the very points of S_i, as in the paper; it flatters, most"
            " where points are far apart. With copy split they share no point. The tables by copy, above, judge the"
            " same Q against both on a few submaps; the column monte_carlo there is how far the label itself is off.",
            "What it can show: whether a method tells flat from rugged and finds the axis, on ground that it was not"
            " trained on and of kinds that it has not seen; how methods rank on one and the same question; what each"
            " costs. What it cannot: the number that a real survey will get. The paper's KL of its network on its own"
            " data stands beside ours for scale, not as a contest.",
        ),
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
