"""The page's words on SLAM: what its tables and figures show, and what cannot be concluded from them."""

from collections.abc import Mapping, Sequence

from pointnetkl.reporting.page import Section
from pointnetkl.text_table import Block

Blocks = Mapping[str, Sequence[Block]]


def sections(shown: Blocks) -> list[Section]:
    """Return the page's sections on SLAM around the tables, by the stems of their files."""
    return [_benchmark(shown), _maps(), _both_ways(shown)]


def _benchmark(shown: Blocks) -> Section:
    return Section(
        "SLAM",
        (
            "Yaw noise corrupts the dead reckoning of each survey's graph; the graph is optimised with each method's Q"
            " on its loop closures. RMSE_xyz is over submap positions (m), not aligned. Map-to-map is the distance"
            " between overlapping submaps (root mean square over cells of their worst pair); a perfect map is not at 0,"
            " because soundings are apart. N_DR and N_LC count edges of dead reckoning and loop closures.",
            "The paper's table is of one graph and slam.repetitions noises. Beside it stand the columns draws_*: of"
            " graph.draws graphs, each with loop closures registered anew, and slam.draw_repetitions noises on each."
            " Their intervals and tests take a draw as one observation.",
        ),
        shown["table_4"],
        {
            "slam": "Error by method, on the paper's graph. Bars are 95 % intervals of the mean over its noises.",
            "slam_differences": "Error against the truth less network's, by draw and noise; 95 % intervals over draws."
            " Right of the line is worse than network. From top to bottom: as it is, turned and moved to fit best, and"
            " of pairs that a loop closure joins. Each panel has a scale of its own.",
        },
        (
            "GT is navigation optimised with the Monte Carlo covariances, as in the paper: it favours monte_carlo."
            " Where the truth is known (simulated surveys), rest conclusions on truth_rmse_xyz_m; the row gt"
            " tells how far GT itself is from it.",
            "Intervals over noises on the paper's one graph say nothing of another draw of its loop closures, and those"
            " over draws nothing of another survey: terrain, layout, GT and z, roll, pitch and yaw of the edges are the"
            " same in all draws. Of few draws the intervals are wide; three are the least.",
            "Most of the unaligned error is a turn and bend of the whole map that all methods leave alike, because loop"
            " closures between neighbouring lines hardly see it. It tells methods apart badly, errors of pairs better.",
        ),
    )


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
            "The ellipses are of a submap against a noisy copy of itself; a loop closure meets other soundings of the"
            " same ground, at GT's poses and yaw, which are not the truth's. That more than 5 % lie outside is no"
            " fault of the network's: compare monte_carlo, the label itself.",
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
