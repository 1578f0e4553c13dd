"""The page's words on the map-to-map error: where a map disagrees with itself, and what the measure hides."""

from collections.abc import Mapping, Sequence

import pandas as pd

from pointnetkl.reporting.page import Section
from pointnetkl.reporting.results import OURS
from pointnetkl.reporting.slam.consistency import PERCENTILE
from pointnetkl.reporting.text_table import Block, cell


def section(shown: Mapping[str, Sequence[Block]]) -> Section:
    """Return the section of the consistency maps and of thinning, of the tables by the stems of their files."""
    return Section(
        "Consistency of the map",
        (
            "In each cell of slam.map_cell_m, for every ordered pair of submaps in it: the mean over a's points of the"
            " distance to b's nearest; the cell counts its worst pair. Every slam.map_thinning-th point asks, and all"
            " answer. map_to_map_auvlib_m is the authors' way, on 500 x 500 cells however large the map: compare it"
            " between methods, never between surveys.",
            "Thinning is not neutral. Fewer points that ask overlook submaps that barely reach into a cell, whose pairs"
            " are the worst, and tell a cell's worst pair less surely, which makes it worse: ratio has both."
            " both_thinned_m is what thinning the points that answer as well would do: a map seems worse because its"
            " points are farther apart.",
        ),
        shown["map_thinning"],
        {
            "consistency": "Map-to-map error by cell (root mean square above), repetition 0, a row for each survey and"
            f" on one scale in it, which ends at the {PERCENTILE:.0f}th percentile of its cells. Every method, in map"
            " coordinates: reports/slam/<survey>_consistency.tif, a band each.",
        },
        (
            "Dark stripes at every trajectory, the true one too, are where one submap ends and the next begins: both"
            " have points in the cell, and those of one are far from the other's end. They and the spacing of"
            f" soundings are in the number of every map, however good.{_floors(shown)}",
        ),
    )


def _floors(shown: Mapping[str, Sequence[Block]]) -> str:
    """Return how much of a solved map's error the map at GT has as well."""
    errors = shown["table_4"][1].frame
    thinned = shown["map_thinning"][0].frame
    at_gt = thinned[thinned["thinning"] == 1].set_index("survey")["map_to_map_m"]
    told = [
        f"{row.survey} {cell(at_gt[row.survey], 3)} at GT, {cell(row.map_to_map_m, 3)} solved"
        for row in errors[errors["method"] == OURS].itertuples()
        if row.survey in at_gt and pd.notna(row.map_to_map_m)
    ]
    return f" Metres at GT's poses (no thinning) and as network has them: {'; '.join(told)}." if told else ""
