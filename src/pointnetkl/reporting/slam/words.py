"""The page's sections on SLAM: what the tables and figures show, and what one cannot conclude from them."""

from collections.abc import Mapping

import pandas as pd

from pointnetkl.registration.covariance.catalogue import CONSTANT, NAIVE_GICP
from pointnetkl.reporting.page import Section
from pointnetkl.reporting.results import OURS
from pointnetkl.reporting.slam.consistency import PERCENTILE
from pointnetkl.reporting.text_table import Blocks, Numbers, cell

_BASELINES = (CONSTANT, NAIVE_GICP)  # the paper's
_MEASURES = {  # by the words before the comparison: the end of network_minus_* in the numbers' names
    "By truth_rmse_xyz_m, network less (95 % interval), metres": "",
    "By truth_relative_m": "_relative",
}


def sections(shown: Blocks, slam: Mapping[str, Numbers]) -> list[Section]:
    """Return the page's sections on SLAM.

    `shown` has the tables by the stems of their files, and `slam` the results of `numbers.summarise` by survey.
    """
    return [_benchmark(shown, slam), _maps(), _both_ways(shown), _consistency(shown, slam)]


def _benchmark(shown: Blocks, slam: Mapping[str, Numbers]) -> Section:
    return Section(
        "SLAM",
        (
            "Yaw noise corrupts the dead reckoning of each survey's graph, and the graph is optimised with each"
            " method's Q on its loop closures. RMSE_xyz is over submap positions (m), without alignment. Map-to-map is"
            " the distance between overlapping submaps (root mean square over cells of their worst pair). Even a"
            " perfect map is not at 0, because soundings lie apart. N_DR and N_LC count edges of dead reckoning and"
            " loop closures.",
            "The paper's table is of one graph and slam.repetitions noises. The columns draws_* beside it are of"
            " graph.draws graphs, each with loop closures registered anew, and slam.draw_repetitions noises on each."
            " Their intervals and tests count a draw as one observation. network_minus_* is network's error less the"
            " method's, and network_*p the p-value that network is better: above 0.975 it is significantly worse.",
            "pose_nees tests the covariance that a solution gives itself. It is the median over submaps of eᵀ C⁻¹ e,"
            " over that of a chi-squared variable, where C is the solution's covariance of a submap's x, y, and e its"
            " error against the truth, moved so that the held submap has none. 1 would be right. All methods are"
            " expected below 1, because the graph allows each edge of dead reckoning metres of error in x and y"
            " (graph.dead_reckoning), and the protocol adds none.",
            *_verdicts(slam),
        ),
        shown["table_4"],
        {
            "slam": "Error by method, on the paper's graph. Bars are 95 % intervals of the mean over its noises.",
            "slam_differences": "Network's error against the truth less the method's, by draw and noise, with 95 %"
            " intervals over draws. Left of the line network is better, right of it worse. From top to bottom: not"
            " aligned, aligned in SE(2), and of pairs that a loop closure joins. Each panel has its own scale.",
        },
        (
            "GT is navigation optimised with the Monte Carlo covariances, as in the paper, so it favours monte_carlo."
            " Where the truth is known (simulated surveys), draw conclusions from the errors against the truth; the row"
            " gt has GT's own. measured_pair (Q_ij) has seen the truth: it is an oracle and not a method.",
            "Intervals over noises on the paper's one graph say nothing of another draw of its loop closures, and"
            " intervals over draws say nothing of another survey: terrain, layout, GT, and the edges' z, roll, pitch"
            " and yaw are the same in all draws. Few draws give wide intervals, and three are the least.",
            "A turn of the whole map about its held first submap counts in truth_rmse_xyz_m and in none of the other"
            " errors; loop closures between neighbouring lines hardly see it, whatever their Q.",
        ),
    )


def _verdicts(slam: Mapping[str, Numbers]) -> list[str]:
    """Return how network compares with the paper's baselines over draws, by both errors against the truth."""
    with_truth = {
        survey: numbers
        for survey, numbers in slam.items()
        if pd.notna(numbers.get(OURS, {}).get("draws_truth_rmse_xyz_m"))
    }
    if not with_truth:
        return []
    errors = [
        f"{survey} {cell(numbers[OURS]['draws_truth_rmse_xyz_m'], 3)} m"
        f" and {cell(numbers[OURS]['draws_truth_rmse_se2_m'], 3)} m"
        for survey, numbers in with_truth.items()
    ]
    comparisons = {words: _comparisons(with_truth, measure) for words, measure in _MEASURES.items()}
    return [
        "The main measure is truth_rmse_xyz_m; truth_relative_m, of pairs that a loop closure joins, is more sensitive."
        f" Network's error, not aligned and aligned in SE(2): {'; '.join(errors)}.",
        *(f"{words}: {'; '.join(clauses)}." for words, clauses in comparisons.items() if clauses),
    ]


def _comparisons(slam: Mapping[str, Numbers], measure: str) -> list[str]:
    """Return a clause for each survey and baseline: network's error less the baseline's, and the verdict."""
    clauses = []
    for survey, numbers in slam.items():
        for method, values in numbers.items():
            interval = values.get(f"network_minus{measure}_ci95_m") if method in _BASELINES else None
            if interval is not None:
                low, high = interval
                verdict = "better" if high < 0 else "worse" if low > 0 else "no difference seen"
                less = cell(values[f"network_minus{measure}_m"], 2)
                clauses.append(f"{survey}, {method} {less} ({cell(low, 2)} to {cell(high, 2)}), {verdict}")
    return clauses


def _maps() -> Section:
    return Section(
        "SLAM, seen from above",
        (
            "All figures are of draw 0 and the first noise. Comparisons are with the truth, or with GT where a survey's"
            " truth is not known. + marks the pose that a registration gave a submap, the dot its true pose.",
        ),
        (),
        {
            "trajectories": "Trajectories on one scale. Below: the reference in grey and, magnified and coloured by"
            " length, each solved trajectory's displacements from it after alignment in SE(2).",
            "bathymetry": "Depth (m) with the submaps at corrupted, solved and true poses (the paper's Fig. 5), on one"
            " scale; below, how much deeper than the last map. The scale of red and blue ends where 95 % of the cells"
            " are within it.",
            "closures": "95 % ellipses of the registrations' Q, magnified by the factor above, blue where they hold"
            " the true error. Below, some to scale, from the largest Q to the smallest.",
            "error_along_track": "Position error in x and y by submap (m, log scale), as it is and aligned (SE(2)).",
        },
        (
            "Labels are of a submap against a copy of itself, with the same points or others of the same pass"
            " (label.copy). A loop closure meets another pass over the same ground, at the poses and yaw of GT, which"
            " differ from the truth's. So network is not to blame for errors outside the ellipses of monte_carlo, which"
            " are the labels' own.",
            "The first submap is held: errors without alignment begin there at 0, and show where the track was bent.",
        ),
    )


def _both_ways(shown: Blocks) -> Section:
    return Section(
        "SLAM, other ways to solve",
        (
            "The authors' program whitens residuals with the wrong triangle of the Cholesky factor, which turns the"
            " ellipses of correlated Q, and leaves out the first loop closure: see docs/authors_slam.md. Variant"
            " authors repeats both slips. Variants all and shared are the other choice of slam.edges: a registration"
            " counts once for each edge that it gives, as in the paper, or its Q is multiplied by the number of its"
            " edges.",
        ),
        [*shown["table_4_authors"], *shown["slam_variants"]],
        {
            "slam_both_ways": "Mean RMSE of submap positions against the truth (m), on the paper's graph. Filled: as it"
            " should be; hollow: with the authors' slips."
        },
        (
            "The authors had real surveys and one draw. Our numbers show how large the effect of such slips is, and not"
            " what they did to the authors' table. Where minus_table's interval holds 0, no difference was seen.",
        ),
    )


def _consistency(shown: Blocks, slam: Mapping[str, Numbers]) -> Section:
    return Section(
        "Consistency of the map",
        (
            "For each cell of slam.map_cell_m and every ordered pair of submaps a, b in it, the error is the mean over"
            " a's points of the distance to the nearest point of b, and the cell counts its worst pair. Only every"
            " slam.map_thinning-th point of a is used, and all points of b. map_to_map_auvlib_m is the authors' way, on"
            " 500 x 500 cells however large the map: compare it between methods, never between surveys.",
            "Thinning is not neutral. With fewer points of a, submaps that barely reach into a cell are overlooked, and"
            " their pairs are the worst; and the mean of each pair is noisier, which makes the worst pair worse. ratio"
            " has both effects. both_thinned_m shows what thinning b as well would do: a map seems worse because its"
            " points are farther apart.",
        ),
        shown["map_thinning"],
        {
            "consistency": "Map-to-map error by cell (root mean square above), repetition 0. Each survey has a row and"
            f" one scale, which ends at the {PERCENTILE:.0f}th percentile of its cells. Every method, in map"
            " coordinates: reports/slam/<survey>_consistency.tif, a band each.",
        },
        (
            "All trajectories, the true one too, show dark stripes where one submap ends and the next begins: both have"
            " points in the cell, and those of one are far from the other's end. These stripes and the spacing of"
            f" soundings are part of the number of every map, however good.{_floors(shown, slam)}",
        ),
    )


def _floors(shown: Blocks, slam: Mapping[str, Numbers]) -> str:
    """Return the map-to-map errors at GT, without thinning, and at network's solution."""
    thinning = shown["map_thinning"][0].frame
    at_gt = thinning[thinning["thinning"] == 1].set_index("survey")["map_to_map_m"]
    solved = {survey: numbers.get(OURS, {}).get("map_to_map_m") for survey, numbers in slam.items()}
    errors = [
        f"{survey} {cell(at_gt[survey], 3)} at GT, {cell(error, 3)} solved"
        for survey, error in solved.items()
        if survey in at_gt and pd.notna(error)
    ]
    return f" Metres at GT's poses (no thinning) and as network has them: {'; '.join(errors)}." if errors else ""
