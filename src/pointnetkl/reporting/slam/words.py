"""The page's words on SLAM: what its tables and figures show, and what cannot be concluded from them."""

from collections.abc import Mapping, Sequence

import pandas as pd

from pointnetkl.reporting.page import Section
from pointnetkl.reporting.results import OURS
from pointnetkl.reporting.slam.consistency import PERCENTILE
from pointnetkl.reporting.text_table import Block, Numbers, cell

Blocks = Mapping[str, Sequence[Block]]
_RIVALS = ("constant", "naive_gicp")  # the paper's baselines
_MEASURES = {  # by what is said of them: which of network_minus_*
    "By truth_rmse_xyz_m, network less (95 % interval), metres": "",
    "By truth_relative_m": "_relative",
}


def sections(shown: Blocks, slam: Numbers) -> list[Section]:
    """Return the page's sections on SLAM.

    `shown` has the tables by the stems of their files, `slam` the results of `numbers.summarise` by survey.
    """
    return [_benchmark(shown, slam), _maps(), _both_ways(shown), _consistency(shown, slam)]


def _benchmark(shown: Blocks, slam: Numbers) -> Section:
    return Section(
        "SLAM",
        (
            "Yaw noise corrupts the dead reckoning of each survey's graph; the graph is optimised with each method's Q"
            " on its loop closures. RMSE_xyz is over submap positions (m), not aligned. Map-to-map is the distance"
            " between overlapping submaps (root mean square over cells of their worst pair); a perfect map is not at 0,"
            " because soundings are apart. N_DR and N_LC count edges of dead reckoning and loop closures.",
            "The paper's table is of one graph and slam.repetitions noises. Beside it stand the columns draws_*: of"
            " graph.draws graphs, each with loop closures registered anew, and slam.draw_repetitions noises on each."
            " Their intervals and tests take a draw as one observation. network_minus_* is network's error less the"
            " method's, network_*p that of network being better: above 0.975 it is significantly worse.",
            "pose_nees asks what a solution claims of itself: the median over submaps of eᵀ C⁻¹ e, over that of a"
            " chi-squared variable, where C is the solution's covariance of a submap's x, y and e its error against the"
            " truth, moved so that the submap that is held has none. 1 would be right. Below 1 is expected of every"
            " method: the graph allows each edge of dead reckoning metres of error in x and y (graph.dead_reckoning),"
            " and the protocol adds none.",
            *_verdicts(slam),
        ),
        shown["table_4"],
        {
            "slam": "Error by method, on the paper's graph. Bars are 95 % intervals of the mean over its noises.",
            "slam_differences": "Network's error against the truth less the method's, by draw and noise; 95 % intervals"
            " over draws. Left of the line network is better, right of it worse. From top to bottom: as it is, turned"
            " and moved to fit best, and of pairs that a loop closure joins. Each panel has a scale of its own.",
        },
        (
            "GT is navigation optimised with the Monte Carlo covariances, as in the paper: it favours monte_carlo."
            " Where the truth is known (simulated surveys), rest conclusions on errors against it; the row gt tells how"
            " far GT itself is from it. pair (Q_ij) has seen the truth: an oracle, and no method.",
            "Intervals over noises on the paper's one graph say nothing of another draw of its loop closures, and those"
            " over draws nothing of another survey: terrain, layout, GT and z, roll, pitch and yaw of the edges are the"
            " same in all draws. Of few draws the intervals are wide; three are the least.",
            "A turn of the whole map about its held first submap is in truth_rmse_xyz_m and in none of the others; loop"
            " closures between neighbouring lines hardly see it, whatever their Q.",
        ),
    )


def _verdicts(slam: Numbers) -> list[str]:
    """Return what the draws say of network against the paper's baselines, by the primary measure and of pairs."""
    known = {
        survey: numbers
        for survey, numbers in slam.items()
        if pd.notna(numbers.get(OURS, {}).get("draws_truth_rmse_xyz_m"))
    }
    if not known:
        return []
    ours = [
        f"{survey} {cell(numbers[OURS]['draws_truth_rmse_xyz_m'], 3)} m"
        f" and {cell(numbers[OURS]['draws_truth_rmse_se2_m'], 3)} m"
        for survey, numbers in known.items()
    ]
    against = [f"{name}: {'; '.join(told)}." for name, which in _MEASURES.items() if (told := _against(known, which))]
    return [
        "The measure is truth_rmse_xyz_m; truth_relative_m, of pairs that a loop closure joins, is a more sensitive one"
        f" beside it. Network's error as it is, and moved and turned in the plane to fit best: {'; '.join(ours)}.",
        *against,
    ]


def _against(slam: Numbers, which: str) -> list[str]:
    """Return a clause for each survey and baseline: network's error less the baseline's, and whether it is better."""
    told = []
    for survey, numbers in slam.items():
        for method, values in numbers.items():
            interval = values.get(f"network_minus{which}_ci95_m") if method in _RIVALS else None
            if interval is not None:
                low, high = interval
                seen = "better" if high < 0 else "worse" if low > 0 else "no difference seen"
                less = cell(values[f"network_minus{which}_m"], 2)
                told.append(f"{survey}, {method} {less} ({cell(low, 2)} to {cell(high, 2)}), {seen}")
    return told


def _maps() -> Section:
    return Section(
        "SLAM, seen from above",
        (
            "Draw 0, first noise, everywhere. What is compared with the truth is compared with GT where a survey has"
            " none. + marks where a registration put a submap, the dot where it truly is.",
        ),
        (),
        {
            "trajectories": "Trajectories on one scale. Below: reference in grey and, magnified and coloured by"
            " length, what is left of each solved trajectory's displacement after it is turned and moved to fit best.",
            "bathymetry": "Depth (m) with the submaps at corrupted, solved and true poses (the paper's Fig. 5), on one"
            " scale; below, how much deeper than the last map. Red and blue beyond 95 % of the cells are full.",
            "closures": "95 % ellipses of the registrations' Q, magnified as said, blue where they hold the true error."
            " Below, some to scale, from the largest Q to the smallest.",
            "error_along_track": "Position error in x and y by submap (m, log scale), as it is and aligned (SE(2)).",
        },
        (
            "Labels are of a submap against a copy of itself, the same points or others of the same pass (label.copy);"
            " a loop closure meets another pass over the same ground, at GT's poses and yaw, which are not the truth's."
            " Errors outside monte_carlo's ellipses, the labels' own, are no fault of the network's.",
            "The first submap is held: errors that are not aligned begin there at 0, and say where the track was bent.",
        ),
    )


def _both_ways(shown: Blocks) -> Section:
    return Section(
        "SLAM, other ways to solve",
        (
            "The authors' program whitens residuals with the wrong triangle of the Cholesky factor, which turns the"
            " ellipses of correlated Q, and leaves out the first loop closure: docs/authors_slam.md. Variant authors"
            " repeats both. Variants all and shared are slam.edges' other choice: a registration counts once for each"
            " edge it gives, as in the paper, or its Q is multiplied by their number.",
        ),
        [*shown["table_4_authors"], *shown["slam_variants"]],
        {
            "slam_both_ways": "Mean RMSE of submap positions against the truth (m), the paper's graph. Filled: as it"
            " should be; hollow: with the authors' slips."
        },
        (
            "The authors had real surveys and one draw: what a slip does to their table cannot be told from ours, only"
            " how large such a thing is. Where minus_table's interval holds 0, no difference was seen.",
        ),
    )


def _consistency(shown: Blocks, slam: Numbers) -> Section:
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
            f" soundings are in the number of every map, however good.{_floors(shown, slam)}",
        ),
    )


def _floors(shown: Blocks, slam: Numbers) -> str:
    """Return how much of a solved map's error the map at GT has as well."""
    thinned = shown["map_thinning"][0].frame
    at_gt = thinned[thinned["thinning"] == 1].set_index("survey")["map_to_map_m"]
    errors = {survey: numbers.get(OURS, {}).get("map_to_map_m") for survey, numbers in slam.items()}
    told = [
        f"{survey} {cell(at_gt[survey], 3)} at GT, {cell(error, 3)} solved"
        for survey, error in errors.items()
        if survey in at_gt and pd.notna(error)
    ]
    return f" Metres at GT's poses (no thinning) and as network has them: {'; '.join(told)}." if told else ""
